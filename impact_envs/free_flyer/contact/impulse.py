"""Impulses of the contacts of one moment in world k, by projected Gauss-Seidel on changes of velocity.

Compiled scalar functions, the law of ``physics.impact.solve_contacts`` without its matrices: row r of
``scratch.contacts[c]`` is a contact, and the changes of velocity end in columns of ``scratch.motion[c]``.
"""

from __future__ import annotations

import math

from impact_envs.compiled import compiled
from impact_envs.free_flyer.contact.touch import find_approach, find_gap
from impact_envs.free_flyer.truth import FRICTION, INERTIA, MASS
from impact_envs.free_flyer.worlds import (
    ACROSS,
    ALONG,
    CHANGE,
    COMPRESSION,
    GAP,
    NX,
    NY,
    PAIR,
    PARTING,
    PARTING_GOAL,
    PX,
    PY,
    SLIP,
    SLIP_GOAL,
    Arena,
    I,
    J,
    Scratch,
    Worlds,
)
from impact_envs.physics.impact import SMALL_CHANGE, SWEEPS, project_impulse


@compiled
def write_contact(arena: Arena, worlds: Worlds, scratch: Scratch, c: int, k: int, row: int, pair: int) -> None:
    """Write a pair's contact as it is now."""
    contacts = scratch.contacts
    i, j = arena.pairs[pair, 0], arena.pairs[pair, 1]
    gap, nx, ny, px, py = find_gap(arena, worlds, scratch, c, k, i, j, 0.0)
    contacts[c, row, I], contacts[c, row, J], contacts[c, row, GAP], contacts[c, row, PAIR] = i, j, gap, pair
    contacts[c, row, NX], contacts[c, row, NY], contacts[c, row, PX], contacts[c, row, PY] = nx, ny, px, py
    contacts[c, row, PARTING] = -find_approach(arena, worlds, k, i, j, nx, ny, px, py)
    contacts[c, row, SLIP] = -find_approach(arena, worlds, k, i, j, -ny, nx, px, py)


@compiled
def read_contact(scratch: Scratch, c: int, row: int) -> tuple[int, int, float, float, float, float]:
    """Return bodies, normal and point of a contact."""
    contacts = scratch.contacts
    i, j = int(contacts[c, row, I]), int(contacts[c, row, J])
    return i, j, contacts[c, row, NX], contacts[c, row, NY], contacts[c, row, PX], contacts[c, row, PY]


@compiled
def find_mobility(worlds: Worlds, k: int, n: int, i: int, j: int, dx: float, dy: float, px: float, py: float) -> float:
    """Return the inverse of the mass that an impulse along (dx, dy) at a point feels [1/kg]."""
    state = worlds.state
    lever = (px - state[k, i, 0]) * dy - (py - state[k, i, 1]) * dx
    total = 1.0 / worlds.body[k, i, MASS] + lever * lever / worlds.body[k, i, INERTIA]
    if j < n:
        lever = (px - state[k, j, 0]) * dy - (py - state[k, j, 1]) * dx
        total += 1.0 / worlds.body[k, j, MASS] + lever * lever / worlds.body[k, j, INERTIA]
    return total


@compiled
def find_speed(
    worlds: Worlds,
    scratch: Scratch,
    c: int,
    k: int,
    n: int,
    column: int,
    i: int,
    j: int,
    dx: float,
    dy: float,
    px: float,
    py: float,
) -> float:
    """Return the speed of j's point of contact against i's along (dx, dy), from changes of velocity [m/s]."""
    state, motion = worlds.state, scratch.motion
    lever = (px - state[k, i, 0]) * dy - (py - state[k, i, 1]) * dx
    speed = -dx * motion[c, i, column] - dy * motion[c, i, column + 1] - lever * motion[c, i, column + 2]
    if j < n:
        lever = (px - state[k, j, 0]) * dy - (py - state[k, j, 1]) * dx
        speed += dx * motion[c, j, column] + dy * motion[c, j, column + 1] + lever * motion[c, j, column + 2]
    return speed


@compiled
def add_impulse(
    worlds: Worlds,
    scratch: Scratch,
    c: int,
    k: int,
    n: int,
    column: int,
    i: int,
    j: int,
    dx: float,
    dy: float,
    px: float,
    py: float,
    impulse: float,
) -> None:
    """Add an impulse along (dx, dy) on j, and its opposite on i."""
    state, motion = worlds.state, scratch.motion
    lever = (px - state[k, i, 0]) * dy - (py - state[k, i, 1]) * dx
    motion[c, i, column] -= impulse * dx / worlds.body[k, i, MASS]
    motion[c, i, column + 1] -= impulse * dy / worlds.body[k, i, MASS]
    motion[c, i, column + 2] -= impulse * lever / worlds.body[k, i, INERTIA]
    if j < n:
        lever = (px - state[k, j, 0]) * dy - (py - state[k, j, 1]) * dx
        motion[c, j, column] += impulse * dx / worlds.body[k, j, MASS]
        motion[c, j, column + 1] += impulse * dy / worlds.body[k, j, MASS]
        motion[c, j, column + 2] += impulse * lever / worlds.body[k, j, INERTIA]


@compiled
def solve_impulses(
    worlds: Worlds, scratch: Scratch, c: int, k: int, n: int, column: int, count: int, aim: float, friction: float
) -> None:
    """Solve for impulses that bring the speeds of contact to their goals, or as near as their bounds let it be.

    Args:
        worlds, scratch, c, k, n: where; n movable bodies.
        column: of ``scratch.motion`` where the changes of velocity go.
        count: of the contacts.
        aim: factor on the goals of separation; 0 solves for the end of compression.
        friction: bound of the tangential impulse over the normal one; 0 leaves the tangents alone.
    """
    contacts = scratch.contacts
    for i in range(n):
        for axis in range(3):
            scratch.motion[c, i, column + axis] = 0.0
    for row in range(count):
        contacts[c, row, ALONG] = contacts[c, row, ACROSS] = 0.0
    for _ in range(SWEEPS):
        largest, step = 0.0, 0.0
        for row in range(count):
            i, j, nx, ny, px, py = read_contact(scratch, c, row)
            speed = contacts[c, row, PARTING] + find_speed(worlds, scratch, c, k, n, column, i, j, nx, ny, px, py)
            excess = speed - aim * contacts[c, row, PARTING_GOAL]
            old = contacts[c, row, ALONG]
            mobility = find_mobility(worlds, k, n, i, j, nx, ny, px, py)
            new = project_impulse(old, excess, mobility, 0.0, math.inf)
            if new != old:
                contacts[c, row, ALONG] = new
                add_impulse(worlds, scratch, c, k, n, column, i, j, nx, ny, px, py, new - old)
            largest, step = max(largest, new), max(step, abs(new - old))
        if friction > 0:
            for row in range(count):
                i, j, nx, ny, px, py = read_contact(scratch, c, row)
                speed = contacts[c, row, SLIP] + find_speed(worlds, scratch, c, k, n, column, i, j, -ny, nx, px, py)
                old, limit = contacts[c, row, ACROSS], friction * contacts[c, row, ALONG]
                excess = speed - contacts[c, row, SLIP_GOAL]
                mobility = find_mobility(worlds, k, n, i, j, -ny, nx, px, py)
                new = project_impulse(old, excess, mobility, -limit, limit)
                if new != old:
                    contacts[c, row, ACROSS] = new
                    add_impulse(worlds, scratch, c, k, n, column, i, j, -ny, nx, px, py, new - old)
                step = max(step, abs(new - old))
        if (count == 1 and friction == 0) or step <= SMALL_CHANGE * largest:
            return


@compiled
def solve_impacts(worlds: Worlds, scratch: Scratch, c: int, k: int, n: int, count: int) -> None:
    """Solve for the impulses of an impact; PARTING, PARTING_GOAL and SLIP are given.

    With friction the tangential impulses stop the slip that is left when compression ends (Chatterjee & Ruina).
    """
    friction = worlds.contact[k, FRICTION]
    solve_impulses(worlds, scratch, c, k, n, CHANGE, count, 1.0, 0.0)
    if friction == 0:
        return
    solve_impulses(worlds, scratch, c, k, n, COMPRESSION, count, 0.0, 0.0)
    for row in range(count):
        i, j, nx, ny, px, py = read_contact(scratch, c, row)
        slip = find_speed(worlds, scratch, c, k, n, CHANGE, i, j, -ny, nx, px, py)
        slip -= find_speed(worlds, scratch, c, k, n, COMPRESSION, i, j, -ny, nx, px, py)
        scratch.contacts[c, row, SLIP_GOAL] = slip
    solve_impulses(worlds, scratch, c, k, n, CHANGE, count, 1.0, friction)


@compiled
def add_held_impulses(worlds: Worlds, scratch: Scratch, c: int, k: int, count: int, share: float) -> None:
    """Add a share of the impulses of lasting contacts to what world k's pairs exchange in this control period."""
    if worlds.held.shape[1] == 0:
        return
    for row in range(count):
        _, _, nx, ny, _, _ = read_contact(scratch, c, row)
        along, across = scratch.contacts[c, row, ALONG], scratch.contacts[c, row, ACROSS]
        pair = int(scratch.contacts[c, row, PAIR])
        worlds.held[k, pair, 0] += share * (along * nx - across * ny)
        worlds.held[k, pair, 1] += share * (along * ny + across * nx)

"""What happens at one instant of impact in world k: rebound, or the start of a lasting contact.

Compiled scalar functions.
"""

from __future__ import annotations

import numpy as np

from impact_envs.compiled import compiled
from impact_envs.free_flyer.contact.deviation import compute_deviation, roll_dice
from impact_envs.free_flyer.contact.impulse import add_held_impulses, read_contact, solve_impacts, write_contact
from impact_envs.free_flyer.contact.pair import CONTACT_STEP, GRAZE, PART_SPEED, REST_GAP, REST_PRESS, REST_SHARE
from impact_envs.free_flyer.contact.touch import find_approach, find_gap, find_press
from impact_envs.free_flyer.truth import CORNERS, DEVIATION, DICE, MASS, RESTITUTION, RESTITUTION_SPEED
from impact_envs.free_flyer.worlds import (
    ACROSS,
    ALONG,
    CHANGE,
    FELT,
    GAP,
    HITS,
    NEAR,
    PARTING,
    PARTING_GOAL,
    STEPS,
    STRUCK,
    TIME,
    Arena,
    I,
    J,
    Scratch,
    Worlds,
)
from impact_envs.physics.impact import compute_restitution, is_rebound


@compiled
def resolve_impacts(
    arena: Arena, worlds: Worlds, scratch: Scratch, log: np.ndarray, c: int, k: int, count: int, end: float, t: float
) -> None:
    """Change velocities by the impacts of one instant.

    If all of them are starts of lasting contacts, everything that touches comes to rest together instead.

    Args:
        arena, worlds, scratch, log, c, k: where.
        count: of the near pairs.
        end: pairs that touch until then take part [s].
        t: the instant, from the start of the control period [s].
    """
    n = arena.discs.shape[0]
    contacts = scratch.contacts
    rows = 0
    for entry in range(count):
        if scratch.contacts[c, entry, TIME] <= end:
            write_contact(arena, worlds, scratch, c, k, rows, scratch.marks[c, entry, NEAR])
            if contacts[c, rows, GAP] <= REST_GAP and does_rebound(arena, worlds, scratch, c, k, rows, count):
                speed = -contacts[c, rows, PARTING]
                e = compute_restitution(speed, worlds.contact[k, RESTITUTION], worlds.contact[k, RESTITUTION_SPEED])
                contacts[c, rows, PARTING_GOAL] = speed * e
                rows += 1
    if rows == 0:
        start_lasting_contacts(arena, worlds, scratch, c, k, count)
        return
    solve_impacts(worlds, scratch, c, k, n, rows)
    for row in range(rows):
        deviate(arena, worlds, scratch, c, k, row)
        log_impact(arena, worlds, scratch, log, c, k, row, t)
    change_velocities(worlds, scratch, c, k, n)


@compiled
def deviate(arena: Arena, worlds: Worlds, scratch: Scratch, c: int, k: int, row: int) -> None:
    """Let a robot's impact on an object deviate from the law: an impulse m_O d more, through both centres of mass."""
    i, j, nx, ny, _, _ = read_contact(scratch, c, row)
    if worlds.body.shape[2] <= DICE or i >= arena.robots or not arena.robots <= j < arena.discs.shape[0]:
        return
    size, at_corners = worlds.body[k, j, DEVIATION], worlds.body[k, j, CORNERS] > 0.0
    if size == 0.0:
        return
    first = roll_dice(worlds.body[k, j, DICE])
    second = worlds.body[k, j, DICE] = roll_dice(first)
    dx, dy = compute_deviation(first, size, at_corners), compute_deviation(second, size, at_corners)
    mass = worlds.body[k, j, MASS]
    share = mass / worlds.body[k, i, MASS]
    scratch.contacts[c, row, ALONG] += mass * (dx * nx + dy * ny)
    scratch.contacts[c, row, ACROSS] += mass * (dy * nx - dx * ny)
    scratch.motion[c, j, CHANGE] += dx
    scratch.motion[c, j, CHANGE + 1] += dy
    scratch.motion[c, i, CHANGE] -= share * dx
    scratch.motion[c, i, CHANGE + 1] -= share * dy


@compiled
def does_rebound(arena: Arena, worlds: Worlds, scratch: Scratch, c: int, k: int, row: int, count: int) -> bool:
    """Return whether an impact, one of count near pairs, is more than the start of a lasting contact."""
    contacts = scratch.contacts
    i, j, approach = int(contacts[c, row, I]), int(contacts[c, row, J]), -contacts[c, row, PARTING]
    press = find_press(arena, worlds, scratch, c, k, i, j, contacts[c, row, GAP], approach)
    low_speed = arena.rest_speed
    if REST_SHARE * low_speed < approach <= low_speed and not is_any_pressed(arena, worlds, scratch, c, k, count):
        low_speed *= REST_SHARE
    return is_rebound(approach, press, low_speed, CONTACT_STEP)


@compiled
def is_any_pressed(arena: Arena, worlds: Worlds, scratch: Scratch, c: int, k: int, count: int) -> bool:
    """Return whether anything presses any of the near pairs together that touch: if so it may press them all."""
    for entry in range(count):
        pair = scratch.marks[c, entry, NEAR]
        i, j = arena.pairs[pair, 0], arena.pairs[pair, 1]
        gap, nx, ny, px, py = find_gap(arena, worlds, scratch, c, k, i, j, 0.0)
        if gap <= REST_GAP:
            approach = find_approach(arena, worlds, k, i, j, nx, ny, px, py)
            if approach >= -PART_SPEED and find_press(arena, worlds, scratch, c, k, i, j, gap, approach) > REST_PRESS:
                return True
    return False


@compiled
def start_lasting_contacts(arena: Arena, worlds: Worlds, scratch: Scratch, c: int, k: int, count: int) -> None:
    """Bring everything that touches to rest on each other, without restitution, and take back overlap."""
    n = arena.discs.shape[0]
    contacts = scratch.contacts
    rows = 0
    for entry in range(count):
        write_contact(arena, worlds, scratch, c, k, rows, scratch.marks[c, entry, NEAR])
        if contacts[c, rows, GAP] <= REST_GAP and not does_rebound(arena, worlds, scratch, c, k, rows, count):
            contacts[c, rows, PARTING_GOAL] = 0.0
            rows += 1
    solve_impacts(worlds, scratch, c, k, n, rows)
    change_velocities(worlds, scratch, c, k, n)
    add_held_impulses(worlds, scratch, c, k, rows, 1.0)
    for row in range(rows):
        i, j, nx, ny, _, _ = read_contact(scratch, c, row)
        gap = contacts[c, row, GAP]
        if gap < -GRAZE:
            share = worlds.body[k, j, MASS] / (worlds.body[k, i, MASS] + worlds.body[k, j, MASS]) if j < n else 1.0
            worlds.state[k, i, 0] += gap * share * nx
            worlds.state[k, i, 1] += gap * share * ny
            if j < n:
                worlds.state[k, j, 0] -= gap * (1 - share) * nx
                worlds.state[k, j, 1] -= gap * (1 - share) * ny


@compiled
def change_velocities(worlds: Worlds, scratch: Scratch, c: int, k: int, n: int) -> None:
    """Apply the changes of velocity that impulses made."""
    for i in range(n):
        worlds.state[k, i, 2] += scratch.motion[c, i, CHANGE + 0]
        worlds.state[k, i, 3] += scratch.motion[c, i, CHANGE + 1]
        worlds.state[k, i, 5] += scratch.motion[c, i, CHANGE + 2]


@compiled
def log_impact(
    arena: Arena, worlds: Worlds, scratch: Scratch, log: np.ndarray, c: int, k: int, row: int, t: float
) -> None:
    """Write an impact to the log and to what its bodies feel."""
    n = arena.discs.shape[0]
    i, j, nx, ny, px, py = read_contact(scratch, c, row)
    along, across = scratch.contacts[c, row, ALONG], scratch.contacts[c, row, ACROSS]
    speed = -scratch.contacts[c, row, PARTING]
    worlds.state[k, i, FELT] = max(worlds.state[k, i, FELT], speed)
    if j < n:
        worlds.state[k, j, FELT] = max(worlds.state[k, j, FELT], speed)
    place = worlds.counter[k, HITS]
    worlds.counter[k, HITS] += 1
    worlds.counter[k, STRUCK] = i + 1
    if place < log.shape[1]:
        log[k, place, 0] = worlds.counter[k, STEPS] * arena.period + t
        log[k, place, 1], log[k, place, 2] = i, j
        log[k, place, 3], log[k, place, 4] = px, py
        log[k, place, 5], log[k, place, 6] = nx, ny
        log[k, place, 7], log[k, place, 8] = along * nx - across * ny, along * ny + across * nx
        log[k, place, 9] = speed

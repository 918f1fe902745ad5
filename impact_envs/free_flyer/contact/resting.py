"""Lasting contacts of world k: which bodies rest on each other, and the forces that keep them apart.

Compiled scalar functions. Impulses that keep pressed bodies from closing in over a contact step are held as forces.
"""

from __future__ import annotations

import math

from impact_envs.compiled import compiled, inlined
from impact_envs.free_flyer.contact.impulse import find_speed, read_contact, solve_impulses, write_contact
from impact_envs.free_flyer.contact.pair import CONTACT_STEP, PART_SPEED, REST_GAP, REST_PRESS, REST_SHARE
from impact_envs.free_flyer.contact.touch import find_approach, find_gap, find_press, is_offset
from impact_envs.free_flyer.truth import FRICTION, OFFSET_X
from impact_envs.free_flyer.worlds import (
    ACCELERATION,
    CHANGE,
    COMPRESSION,
    NEAR,
    PARTING,
    PARTING_GOAL,
    REST,
    SLIP,
    SLIP_GOAL,
    Arena,
    Scratch,
    Worlds,
)


@compiled
def find_resting(arena: Arena, worlds: Worlds, scratch: Scratch, c: int, k: int, count: int) -> int:
    """Mark the pairs that rest on each other; return 0 if none is pressed, 1 if all that are rest on walls, else 2.

    Where any is pressed, every pair that touches may become so, and counts as pressed.
    """
    n = arena.discs.shape[0]
    pressed, turning, rest_speed = False, False, REST_SHARE * arena.rest_speed
    for entry in range(count):
        pair = scratch.marks[c, entry, NEAR]
        i, j = arena.pairs[pair, 0], arena.pairs[pair, 1]
        gap, nx, ny, px, py = find_gap(arena, worlds, scratch, c, k, i, j, 0.0)
        if gap > REST_GAP:
            continue
        approach = find_approach(arena, worlds, k, i, j, nx, ny, px, py)
        if -PART_SPEED <= approach <= rest_speed:
            press = find_press(arena, worlds, scratch, c, k, i, j, gap, approach)
            # Parting bodies are pressed if the pressure turns them round within a contact step.
            pressed = pressed or press > max(REST_PRESS, -approach / CONTACT_STEP)
            scratch.marks[c, pair, REST] = 2 if press <= REST_PRESS else 1
            # Forces on bodies that part a little, or not from a wall, change within the step.
            turning = turning or approach < -rest_speed or j < n or arena.faces[arena.first_face[j - n], 4] < math.inf
            turning = turning or (worlds.body.shape[2] > OFFSET_X and is_offset(worlds, k, i))
    if not pressed:
        for entry in range(count):
            pair = scratch.marks[c, entry, NEAR]
            scratch.marks[c, pair, REST] = 2 if scratch.marks[c, pair, REST] == 2 else 0
        return 0
    for entry in range(count):
        pair = scratch.marks[c, entry, NEAR]
        scratch.marks[c, pair, REST] = min(scratch.marks[c, pair, REST], 1)
    return 2 if turning or worlds.contact[k, FRICTION] > 0 else 1


@compiled
def add_contact_forces(arena: Arena, worlds: Worlds, scratch: Scratch, c: int, k: int, count: int, h: float) -> int:
    """Add to the accelerations what keeps the pairs pressed on each other from closing in over h; return how many.

    Normals are taken where velocities alone lead, as pymunk does: with those of the start, bodies that slide round
    each other would drift apart and bounce.
    """
    n = arena.discs.shape[0]
    state, motion, contacts = worlds.state, scratch.motion, scratch.contacts
    for i in range(n):
        for axis in range(3):
            place = axis if axis < 2 else 4
            motion[c, i, COMPRESSION + axis] = state[k, i, place]
            state[k, i, place] += h * state[k, i, 2 + axis if axis < 2 else 5]
    rows = 0
    for entry in range(count):
        pair = scratch.marks[c, entry, NEAR]
        if scratch.marks[c, pair, REST] == 1:
            write_contact(arena, worlds, scratch, c, k, rows, pair)
            i, j, nx, ny, px, py = read_contact(scratch, c, rows)
            contacts[c, rows, PARTING] += h * find_speed(worlds, scratch, c, k, n, ACCELERATION, i, j, nx, ny, px, py)
            contacts[c, rows, SLIP] += h * find_speed(worlds, scratch, c, k, n, ACCELERATION, i, j, -ny, nx, px, py)
            contacts[c, rows, PARTING_GOAL] = contacts[c, rows, SLIP_GOAL] = 0.0
            rows += 1
    solve_impulses(worlds, scratch, c, k, n, CHANGE, rows, 0.0, worlds.contact[k, FRICTION])
    for i in range(n):
        for axis in range(3):
            state[k, i, axis if axis < 2 else 4] = motion[c, i, COMPRESSION + axis]
            motion[c, i, ACCELERATION + axis] += motion[c, i, CHANGE + axis] / h
    return rows


@inlined
def clear_rest(scratch: Scratch, c: int) -> None:
    """Forget which pairs rest on each other."""
    for pair in range(scratch.marks.shape[1]):
        scratch.marks[c, pair, REST] = 0

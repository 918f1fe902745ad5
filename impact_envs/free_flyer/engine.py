"""Exact discs: one control period of world k, event by event, in closed form.

Compiled scalar functions; the rules are those of ``model.py``, where pymunk solves lasting contacts. Here the
impulses that keep pressed bodies from closing in over a contact step are solved by ``impulse.py`` and held as
forces.
"""

from __future__ import annotations

import math

import numpy as np

from impact_envs.compiled import compiled, inlined
from impact_envs.free_flyer.contact_rules import (
    CONTACT_STEP,
    GRAZE,
    LOW_SPEED,
    PART_SPEED,
    REST_GAP,
    REST_PRESS,
    REST_SPEED,
    SIMULTANEOUS,
)
from impact_envs.free_flyer.impulse import collide, find_speed, read_contact, relax
from impact_envs.free_flyer.touch import find_approach, find_gap, find_press, find_touch, is_offset
from impact_envs.free_flyer.worlds import (
    ACCELERATION,
    ACROSS,
    ALONG,
    CHANGE,
    COMPRESSION,
    DRIFT_X,
    FELT,
    FRICTION,
    GAP,
    HELD,
    HITS,
    INERTIA,
    LIMIT,
    MASS,
    NEAR,
    NX,
    NY,
    OFFSET_X,
    OFFSET_Y,
    OVERFLOW,
    OWED,
    PARTING,
    PARTING_GOAL,
    PX,
    PY,
    RADIUS,
    REST,
    RESTITUTION,
    RESTITUTION_SPEED,
    ROOM,
    SLIP,
    SLIP_GOAL,
    STEPS,
    TIME,
    Arena,
    I,
    J,
    Scratch,
    Worlds,
    read_states,
)

# In one control period; more count as overflow, and the bodies stand still for the rest of it.
EVENTS = 1000


@inlined
def step_world(
    arena: Arena, worlds: Worlds, scratch: Scratch, log: np.ndarray, c: int, k: int, controls: np.ndarray
) -> None:
    """Advance world k by one control period under held controls.

    Args:
        arena, worlds, scratch: see ``worlds.py``.
        log: takes the impacts as rows time, i, j, point, normal, impulse, speed, shape (N, rows, 10); what finds no
            row is only counted.
        c: which room of the scratch.
        k: which world.
        controls: body-frame force and torque of each robot within its limits, shape (N, r, 3) [N], [N m].
    """
    n = arena.discs.shape[0]
    worlds.counter[k, HITS] = 0
    for i in range(n):
        worlds.body[k, i, FELT] = 0.0
        for axis in range(3):
            scratch.motion[c, i, HELD + axis] = (
                worlds.body[k, i, DRIFT_X + axis] if axis < 2 and worlds.body.shape[2] > DRIFT_X else 0.0
            )
    for i in range(arena.robots):
        actuate(arena, worlds, scratch, c, k, i, controls)
    advance(arena, worlds, scratch, log, c, k)
    worlds.counter[k, STEPS] += 1


@compiled
def step_alone(
    period: float,
    on_off: bool,
    robots: int,
    discs: np.ndarray,
    pairs: np.ndarray,
    first_face: np.ndarray,
    faces: np.ndarray,
    state: np.ndarray,
    body: np.ndarray,
    thruster: np.ndarray,
    contact: np.ndarray,
    counter: np.ndarray,
    motion: np.ndarray,
    marks: np.ndarray,
    contacts: np.ndarray,
    log: np.ndarray,
    controls: np.ndarray,
    states: np.ndarray,
) -> None:
    """Advance world 0 and read its states: ``step_world`` for Python, which hands over arrays faster than tuples."""
    worlds = Worlds(state, body, thruster, contact, counter)
    arena = Arena(period, on_off, robots, discs, pairs, first_face, faces)
    step_world(arena, worlds, Scratch(motion, marks, contacts), log, 0, 0, controls)
    read_states(worlds, 0, states)


@inlined
def actuate(arena: Arena, worlds: Worlds, scratch: Scratch, c: int, k: int, i: int, controls: np.ndarray) -> None:
    """Turn robot i's command into accelerations; the force turns with the heading of mid-period free flight."""
    fx, fy, tau = controls[k, i, 0], controls[k, i, 1], controls[k, i, 2]
    if arena.on_off:
        fx = quantise(worlds, k, i, 0, fx, arena.discs[i, LIMIT + 0])
        fy = quantise(worlds, k, i, 1, fy, arena.discs[i, LIMIT + 1])
    if worlds.thruster.shape[1] > 0:
        fx *= worlds.thruster[k, i, 2 * 0 + (0 if fx >= 0 else 1)]
        fy *= worlds.thruster[k, i, 2 * 1 + (0 if fy >= 0 else 1)]
        tau *= worlds.thruster[k, i, 2 * 2 + (0 if tau >= 0 else 1)]
    if worlds.body.shape[2] > OFFSET_X:
        tau -= worlds.body[k, i, OFFSET_X] * fy - worlds.body[k, i, OFFSET_Y] * fx
    alpha = tau / worlds.body[k, i, INERTIA]
    middle = worlds.state[k, i, 4] + (worlds.state[k, i, 5] + alpha * arena.period / 4) * arena.period / 2
    cos, sin = math.cos(middle), math.sin(middle)
    scratch.motion[c, i, HELD + 0] = (cos * fx - sin * fy) / worlds.body[k, i, MASS]
    scratch.motion[c, i, HELD + 1] = (sin * fx + cos * fy) / worlds.body[k, i, MASS]
    scratch.motion[c, i, HELD + 2] = alpha


@inlined
def quantise(worlds: Worlds, k: int, i: int, axis: int, command: float, limit: float) -> float:
    """Return a force that is off or full, and whose sum follows the command's to half a pulse."""
    wanted = command / limit + worlds.thruster[k, i, OWED + axis]
    pulse = 1.0 if wanted > 0.5 else -1.0 if wanted < -0.5 else 0.0
    worlds.thruster[k, i, OWED + axis] = wanted - pulse
    return pulse * limit


@inlined
def advance(arena: Arena, worlds: Worlds, scratch: Scratch, log: np.ndarray, c: int, k: int) -> None:
    """Move all bodies through one control period, event by event."""
    n = arena.discs.shape[0]
    period, t = arena.period, 0.0
    for _ in range(EVENTS):
        left = period - t
        for i in range(n):
            for axis in range(3):
                scratch.motion[c, i, ACCELERATION + axis] = scratch.motion[c, i, HELD + axis]
        count = found = find_near(arena, worlds, scratch, c, k, left)
        pressed = find_resting(arena, worlds, scratch, c, k, found) if found > 0 else 0
        if pressed > 0:
            # On walls, without friction, forces stay what they are; elsewhere they turn with the normal.
            left = min(left, CONTACT_STEP) if pressed > 1 else left
            hold(arena, worlds, scratch, c, k, found, left)
            count = find_near(arena, worlds, scratch, c, k, left)
        first = find_first(arena, worlds, scratch, c, k, count, left)
        h = min(first, left)
        fly(worlds, scratch, c, k, n, h)
        t = period if h == period - t else t + h
        if first <= left:
            hit(arena, worlds, scratch, log, c, k, count, min(left, first + SIMULTANEOUS), t)
        if found > 0:
            clear_rest(scratch, c)
        if t >= period:
            return
    worlds.counter[k, OVERFLOW] += 1


@inlined
def clear_rest(scratch: Scratch, c: int) -> None:
    """Forget which pairs rest on each other."""
    for pair in range(scratch.marks.shape[1]):
        scratch.marks[c, pair, REST] = 0


@inlined
def fly(worlds: Worlds, scratch: Scratch, c: int, k: int, n: int, h: float) -> None:
    """Move all bodies for a time h without contact: x+ = x + v h + a h^2 / 2, v+ = v + a h."""
    state, motion = worlds.state, scratch.motion
    for i in range(n):
        ax, ay, alpha = motion[c, i, ACCELERATION + 0], motion[c, i, ACCELERATION + 1], motion[c, i, ACCELERATION + 2]
        state[k, i, 0] += (state[k, i, 2] + 0.5 * ax * h) * h
        state[k, i, 1] += (state[k, i, 3] + 0.5 * ay * h) * h
        state[k, i, 4] += (state[k, i, 5] + 0.5 * alpha * h) * h
        state[k, i, 2] += ax * h
        state[k, i, 3] += ay * h
        state[k, i, 5] += alpha * h


@inlined
def find_near(arena: Arena, worlds: Worlds, scratch: Scratch, c: int, k: int, h: float) -> int:
    """List the pairs that could touch within h (circles round the bodies, grown by their motion); return how many."""
    state, motion = worlds.state, scratch.motion
    n = arena.discs.shape[0]
    for i in range(n):
        speed = math.sqrt(state[k, i, 2] * state[k, i, 2] + state[k, i, 3] * state[k, i, 3])
        ax, ay = motion[c, i, ACCELERATION + 0], motion[c, i, ACCELERATION + 1]
        reach = arena.discs[i, RADIUS] + REST_GAP
        if worlds.body.shape[2] > OFFSET_X:
            ox, oy = worlds.body[k, i, OFFSET_X], worlds.body[k, i, OFFSET_Y]
            reach += math.sqrt(ox * ox + oy * oy)
        motion[c, i, ROOM] = reach + (speed + math.sqrt(ax * ax + ay * ay) * h / 2) * h
    count, pair = 0, 0
    for i in range(n):
        for j in range(i + 1, n):
            dx, dy = state[k, i, 0] - state[k, j, 0], state[k, i, 1] - state[k, j, 1]
            reach = motion[c, i, ROOM] + motion[c, j, ROOM]
            if dx * dx + dy * dy <= reach * reach:
                scratch.marks[c, count, NEAR] = pair
                count += 1
            pair += 1
    for i in range(n):
        x, y, reach = state[k, i, 0], state[k, i, 1], motion[c, i, ROOM]
        for fixed in range(arena.first_face.shape[0] - 1):
            if not is_beyond(arena, fixed, x, y, reach):
                scratch.marks[c, count, NEAR] = pair
                count += 1
            pair += 1
    return count


@inlined
def is_beyond(arena: Arena, fixed: int, x: float, y: float, room: float) -> bool:
    """Return whether a point is farther than room from a fixed body, judged by its faces."""
    for f in range(arena.first_face[fixed], arena.first_face[fixed + 1]):
        if arena.faces[f, 2] * (x - arena.faces[f, 0]) + arena.faces[f, 3] * (y - arena.faces[f, 1]) > room:
            return True
    return False


@compiled
def find_resting(arena: Arena, worlds: Worlds, scratch: Scratch, c: int, k: int, count: int) -> int:
    """Mark the pairs that rest on each other; return 0 if none is pressed, 1 if all that are lie on walls, else 2.

    Where any is pressed, every pair that touches may become so, and counts as pressed.
    """
    n = arena.discs.shape[0]
    pressed, turning = False, False
    for entry in range(count):
        pair = scratch.marks[c, entry, NEAR]
        i, j = arena.pairs[pair, 0], arena.pairs[pair, 1]
        gap, nx, ny, px, py = find_gap(arena, worlds, scratch, c, k, i, j, 0.0)
        if gap > REST_GAP:
            continue
        approach = find_approach(arena, worlds, k, i, j, nx, ny, px, py)
        if -PART_SPEED <= approach <= REST_SPEED:
            press = find_press(arena, worlds, scratch, c, k, i, j, gap, approach)
            # Parting bodies are pressed if the pressure turns them round within a contact step.
            pressed = pressed or press > max(REST_PRESS, -approach / CONTACT_STEP)
            scratch.marks[c, pair, REST] = 2 if press <= REST_PRESS else 1
            turning = turning or j < n or arena.faces[arena.first_face[j - n], 4] < math.inf
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
def hold(arena: Arena, worlds: Worlds, scratch: Scratch, c: int, k: int, count: int, h: float) -> None:
    """Add to the accelerations what keeps the pairs pressed on each other from closing in over a time h.

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
    relax(worlds, scratch, c, k, n, CHANGE, rows, 0.0, worlds.contact[k, FRICTION])
    for i in range(n):
        for axis in range(3):
            state[k, i, axis if axis < 2 else 4] = motion[c, i, COMPRESSION + axis]
            motion[c, i, ACCELERATION + axis] += motion[c, i, CHANGE + axis] / h


@compiled
def write_contact(arena: Arena, worlds: Worlds, scratch: Scratch, c: int, k: int, row: int, pair: int) -> None:
    """Write a pair's contact as it is now."""
    contacts = scratch.contacts
    i, j = arena.pairs[pair, 0], arena.pairs[pair, 1]
    gap, nx, ny, px, py = find_gap(arena, worlds, scratch, c, k, i, j, 0.0)
    contacts[c, row, I], contacts[c, row, J], contacts[c, row, GAP] = i, j, gap
    contacts[c, row, NX], contacts[c, row, NY], contacts[c, row, PX], contacts[c, row, PY] = nx, ny, px, py
    contacts[c, row, PARTING] = -find_approach(arena, worlds, k, i, j, nx, ny, px, py)
    contacts[c, row, SLIP] = -find_approach(arena, worlds, k, i, j, -ny, nx, px, py)


@inlined
def find_first(arena: Arena, worlds: Worlds, scratch: Scratch, c: int, k: int, count: int, end: float) -> float:
    """Write the times of impact of the near pairs, and return the first one, infinity if none is within end [s]."""
    first = math.inf
    for entry in range(count):
        pair = scratch.marks[c, entry, NEAR]
        i, j = arena.pairs[pair, 0], arena.pairs[pair, 1]
        end = min(end, first + SIMULTANEOUS)
        time = find_touch(arena, worlds, scratch, c, k, i, j, scratch.marks[c, pair, REST] > 0, end)
        scratch.contacts[c, entry, TIME] = time
        first = min(first, time)
    return first


@compiled
def hit(
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
            if contacts[c, rows, GAP] <= REST_GAP and rebounds(arena, worlds, scratch, c, k, rows):
                speed, e, e_speed = (
                    -contacts[c, rows, PARTING],
                    worlds.contact[k, RESTITUTION],
                    worlds.contact[k, RESTITUTION_SPEED],
                )
                contacts[c, rows, PARTING_GOAL] = speed * (e * math.exp(-speed / e_speed) if e_speed > 0 else e)
                rows += 1
    if rows == 0:
        settle(arena, worlds, scratch, c, k, count)
        return
    collide(worlds, scratch, c, k, n, rows)
    for row in range(rows):
        report(arena, worlds, scratch, log, c, k, row, t)
    change_velocities(worlds, scratch, c, k, n)


@compiled
def rebounds(arena: Arena, worlds: Worlds, scratch: Scratch, c: int, k: int, row: int) -> bool:
    """Return whether an impact is more than the start of a lasting contact."""
    contacts = scratch.contacts
    i, j, approach = int(contacts[c, row, I]), int(contacts[c, row, J]), -contacts[c, row, PARTING]
    press = find_press(arena, worlds, scratch, c, k, i, j, contacts[c, row, GAP], approach)
    return approach > max(LOW_SPEED, press * CONTACT_STEP / 2)


@compiled
def settle(arena: Arena, worlds: Worlds, scratch: Scratch, c: int, k: int, count: int) -> None:
    """Bring everything that touches to rest on each other, without restitution, and take back overlap."""
    n = arena.discs.shape[0]
    contacts = scratch.contacts
    rows = 0
    for entry in range(count):
        write_contact(arena, worlds, scratch, c, k, rows, scratch.marks[c, entry, NEAR])
        if contacts[c, rows, GAP] <= REST_GAP and not rebounds(arena, worlds, scratch, c, k, rows):
            contacts[c, rows, PARTING_GOAL] = 0.0
            rows += 1
    collide(worlds, scratch, c, k, n, rows)
    change_velocities(worlds, scratch, c, k, n)
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
def report(arena: Arena, worlds: Worlds, scratch: Scratch, log: np.ndarray, c: int, k: int, row: int, t: float) -> None:
    """Write an impact to the log and to what its bodies feel."""
    n = arena.discs.shape[0]
    i, j, nx, ny, px, py = read_contact(scratch, c, row)
    along, across = scratch.contacts[c, row, ALONG], scratch.contacts[c, row, ACROSS]
    speed = -scratch.contacts[c, row, PARTING]
    worlds.body[k, i, FELT] = max(worlds.body[k, i, FELT], speed)
    if j < n:
        worlds.body[k, j, FELT] = max(worlds.body[k, j, FELT], speed)
    place = worlds.counter[k, HITS]
    worlds.counter[k, HITS] += 1
    if place < log.shape[1]:
        log[k, place, 0] = worlds.counter[k, STEPS] * arena.period + t
        log[k, place, 1], log[k, place, 2] = i, j
        log[k, place, 3], log[k, place, 4] = px, py
        log[k, place, 5], log[k, place, 6] = nx, ny
        log[k, place, 7], log[k, place, 8] = along * nx - across * ny, along * ny + across * nx
        log[k, place, 9] = speed

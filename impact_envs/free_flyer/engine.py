"""Exact discs: one control period of world k, event by event, in closed form.

Compiled scalar functions; the rules are those of ``model.py``, where pymunk solves lasting contacts.
"""

from __future__ import annotations

import math

import numpy as np

from impact_envs.compiled import compiled, inlined
from impact_envs.elementary import cos_sin
from impact_envs.free_flyer.contact.hits import resolve_impacts
from impact_envs.free_flyer.contact.impulse import add_held_impulses
from impact_envs.free_flyer.contact.pair import CONTACT_STEP, EVENTS, REST_GAP, SIMULTANEOUS
from impact_envs.free_flyer.contact.resting import add_contact_forces, clear_rest, find_resting
from impact_envs.free_flyer.contact.touch import find_touch
from impact_envs.free_flyer.truth import DRIFT_X, DRIFT_Y, FADE, INERTIA, MASS, OFFSET_X, OFFSET_Y, TURN
from impact_envs.free_flyer.worlds import (
    ACCELERATION,
    FELT,
    HELD,
    HITS,
    LIMIT,
    LINE_VX,
    LINE_VY,
    LINE_X,
    LINE_Y,
    NEAR,
    OVERFLOW,
    OWED,
    RADIUS,
    REST,
    ROOM,
    SINCE,
    STEPS,
    STRUCK,
    TIME,
    Arena,
    Scratch,
    Worlds,
    read_states,
)

AVERAGED = 1.0 - 1e-9  # time over which an object that keeps its velocity averages it after an impact [s]
KEEPING = 0.5  # w of the law by which it does [rad/s]


@inlined
def step_world(arena: Arena, worlds: Worlds, scratch: Scratch, log: np.ndarray, c: int, k: int) -> None:
    """Advance world k by one control period under held controls.

    Args:
        arena, worlds: see ``worlds.py``.
        scratch: each robot's body-frame force and torque, within its limits, in the columns HELD [N], [N m].
        log: takes the impacts as rows time, i, j, point, normal, impulse, speed, shape (N, rows, 10); what finds no
            row is only counted.
        c: which room of the scratch.
        k: which world.
    """
    n = arena.discs.shape[0]
    worlds.counter[k, HITS] = worlds.counter[k, STRUCK] = 0
    for pair in range(worlds.held.shape[1]):
        worlds.held[k, pair, 0] = worlds.held[k, pair, 1] = 0.0
    for i in range(n):
        was_hit = worlds.state[k, i, FELT] > 0.0
        worlds.state[k, i, FELT] = 0.0
        if i < arena.robots:
            apply_command(arena, worlds, scratch, c, k, i)
        else:
            ax, ay = 0.0, 0.0
            if worlds.body.shape[2] > DRIFT_X:
                body = worlds.body[k, i]
                ax, ay = turn_drift(body[DRIFT_X], body[DRIFT_Y], body[TURN], worlds.counter[k, STEPS], arena.period)
            scratch.motion[c, i, HELD], scratch.motion[c, i, HELD + 1] = ax, ay
            scratch.motion[c, i, HELD + 2] = 0.0
            if worlds.body.shape[2] > SINCE and arena.discs[i, LIMIT] > 0.0:
                ax, ay = keep_velocity(arena, worlds, k, i, was_hit)
                scratch.motion[c, i, HELD] += ax
                scratch.motion[c, i, HELD + 1] += ay
    advance_period(arena, worlds, scratch, log, c, k)
    worlds.counter[k, STEPS] += 1


@compiled
def step_alone(
    period: float,
    rest_speed: float,
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
    held: np.ndarray,
    counter: np.ndarray,
    motion: np.ndarray,
    marks: np.ndarray,
    contacts: np.ndarray,
    log: np.ndarray,
    controls: np.ndarray,
    states: np.ndarray,
) -> None:
    """Advance world 0 and read its states: ``step_world`` for Python, which hands over arrays faster than tuples."""
    worlds = Worlds(state, body, thruster, contact, held, counter)
    arena = Arena(period, rest_speed, on_off, robots, discs, pairs, first_face, faces)
    for i in range(robots):
        for channel in range(3):
            motion[0, i, HELD + channel] = controls[i, channel]
    step_world(arena, worlds, Scratch(motion, marks, contacts), log, 0, 0)
    read_states(worlds, 0, states)


@compiled
def turn_drift(x: float, y: float, rate: float, steps: int, period: float) -> tuple[float, float]:
    """Return an object's drift over the control period after so many others, as it is in the middle of it [m/s^2].

    Args:
        x, y: at the start of the episode [m/s^2].
        rate: at which its direction turns [rad/s].
        steps: control periods since then.
        period: [s].
    """
    if rate == 0.0:
        return x, y
    angle = rate * (steps + 0.5) * period
    cos, sin = cos_sin(angle)
    return cos * x - sin * y, sin * x + cos * y


@compiled
def fade_thruster(gain: float, loss: float, time: float) -> float:
    """Return true over commanded force of a thruster at a time, gain (1 - loss time), never below zero.

    Args:
        gain: at the start of the episode.
        loss: share of it that is lost per second [1/s].
        time: since then [s].
    """
    return gain * max(1.0 - loss * time, 0.0)


@inlined
def apply_command(arena: Arena, worlds: Worlds, scratch: Scratch, c: int, k: int, i: int) -> None:
    """Turn robot i's command into accelerations; the force turns with the heading of mid-period free flight."""
    held = scratch.motion
    fx, fy, tau = held[c, i, HELD], held[c, i, HELD + 1], held[c, i, HELD + 2]
    if arena.on_off:
        fx = quantise_force(worlds, k, i, 0, fx, arena.discs[i, LIMIT])
        fy = quantise_force(worlds, k, i, 1, fy, arena.discs[i, LIMIT + 1])
    if worlds.thruster.shape[1] > 0:
        thruster, time = worlds.thruster[k, i], worlds.counter[k, STEPS] * arena.period
        x, y, turn = 0 if fx >= 0 else 1, 2 if fy >= 0 else 3, 4 if tau >= 0 else 5
        fx *= fade_thruster(thruster[x], thruster[FADE + x], time)
        fy *= fade_thruster(thruster[y], thruster[FADE + y], time)
        tau *= fade_thruster(thruster[turn], thruster[FADE + turn], time)
    if worlds.body.shape[2] > OFFSET_X:
        tau -= worlds.body[k, i, OFFSET_X] * fy - worlds.body[k, i, OFFSET_Y] * fx
    alpha = tau / worlds.body[k, i, INERTIA]
    middle = worlds.state[k, i, 4] + (worlds.state[k, i, 5] + alpha * arena.period / 4) * arena.period / 2
    cos, sin = cos_sin(middle)
    scratch.motion[c, i, HELD] = (cos * fx - sin * fy) / worlds.body[k, i, MASS]
    scratch.motion[c, i, HELD + 1] = (sin * fx + cos * fy) / worlds.body[k, i, MASS]
    scratch.motion[c, i, HELD + 2] = alpha


@inlined
def keep_velocity(arena: Arena, worlds: Worlds, k: int, i: int, was_hit: bool) -> tuple[float, float]:
    r"""Return the acceleration by which object i keeps its velocity between impacts [m/s^2].

    For 1 s after an impact it does nothing but average its velocity, then it follows the straight line of that
    velocity: a = -w^2 (p - p_line) - 2 w (v - v_line), within its force.

    Source: Verhagen & Tumova, App. C, with a critically damped law in place of its MPC.
    """
    body, h = worlds.body, arena.period
    x, y = worlds.state[k, i, 0], worlds.state[k, i, 1]
    if worlds.counter[k, STEPS] == 0 or was_hit:
        body[k, i, SINCE] = 0.0 if was_hit else math.inf
        body[k, i, LINE_X], body[k, i, LINE_Y] = x, y
        # What it was given at the start it keeps; after an impact this is measured first.
        body[k, i, LINE_VX] = 0.0 if was_hit else worlds.state[k, i, 2]
        body[k, i, LINE_VY] = 0.0 if was_hit else worlds.state[k, i, 3]
    else:
        body[k, i, SINCE] += h
    since = body[k, i, SINCE]
    if since < AVERAGED:
        return 0.0, 0.0
    if since - h < AVERAGED:
        body[k, i, LINE_VX], body[k, i, LINE_VY] = (x - body[k, i, LINE_X]) / since, (y - body[k, i, LINE_Y]) / since
        body[k, i, LINE_X], body[k, i, LINE_Y] = x, y
    else:
        body[k, i, LINE_X] += h * body[k, i, LINE_VX]
        body[k, i, LINE_Y] += h * body[k, i, LINE_VY]
    vx, vy = worlds.state[k, i, 2] - body[k, i, LINE_VX], worlds.state[k, i, 3] - body[k, i, LINE_VY]
    ax = -KEEPING * (KEEPING * (x - body[k, i, LINE_X]) + 2.0 * vx)
    ay = -KEEPING * (KEEPING * (y - body[k, i, LINE_Y]) + 2.0 * vy)
    most = arena.discs[i, LIMIT] / body[k, i, MASS]
    scale = min(1.0, most / max(math.hypot(ax, ay), 1e-12))
    return scale * ax, scale * ay


@inlined
def quantise_force(worlds: Worlds, k: int, i: int, axis: int, command: float, limit: float) -> float:
    """Return a force that is off or full, and whose sum follows the command's to half a pulse."""
    wanted = command / limit + worlds.thruster[k, i, OWED + axis]
    pulse = 1.0 if wanted > 0.5 else -1.0 if wanted < -0.5 else 0.0
    worlds.thruster[k, i, OWED + axis] = wanted - pulse
    return pulse * limit


@inlined
def advance_period(arena: Arena, worlds: Worlds, scratch: Scratch, log: np.ndarray, c: int, k: int) -> None:
    """Move all bodies through one control period, event by event."""
    n = arena.discs.shape[0]
    period, t = arena.period, 0.0
    for _ in range(EVENTS):
        left, rows = period - t, 0
        for i in range(n):
            for axis in range(3):
                scratch.motion[c, i, ACCELERATION + axis] = scratch.motion[c, i, HELD + axis]
        count = found = find_near(arena, worlds, scratch, c, k, left)
        pressed = find_resting(arena, worlds, scratch, c, k, found) if found > 0 else 0
        if pressed > 0:
            # On walls, without friction, forces stay what they are; elsewhere they turn with the normal.
            left = CONTACT_STEP if pressed > 1 and left > CONTACT_STEP + SIMULTANEOUS else left
            rows = add_contact_forces(arena, worlds, scratch, c, k, found, left)
            count = find_near(arena, worlds, scratch, c, k, left)
        first = find_first(arena, worlds, scratch, c, k, count, left)
        h = min(first, left)
        fly_bodies(worlds, scratch, c, k, n, h)
        if rows > 0:
            add_held_impulses(worlds, scratch, c, k, rows, h / left)
        t = period if h == period - t else t + h
        if first <= left:
            resolve_impacts(arena, worlds, scratch, log, c, k, count, min(left, first + SIMULTANEOUS), t)
        if found > 0:
            clear_rest(scratch, c)
        if t >= period:
            return
    worlds.counter[k, OVERFLOW] += 1


@inlined
def fly_bodies(worlds: Worlds, scratch: Scratch, c: int, k: int, n: int, h: float) -> None:
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

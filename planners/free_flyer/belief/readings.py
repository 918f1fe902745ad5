r"""Which readings of bodies are believed: those that motion within the limits explains; compiled.

A reading of a body (place p, heading theta, their rates) is believed if it lies within reach of what is predicted from
the readings that were believed before:

|p - p_hat| <= s sqrt(P_pp + sigma^2) + f + dv dt,  |theta - theta_hat| <= (dv / radius) dt,

where P_pp is the filter's variance, which grows with thrust, drift and felt impacts, s and f are `surprise` and
`surprise_floor`, and dv is the most that an impact can change the body's velocity at the speed limits (`BODY.jump`), so
that an impact nobody felt is believed. dt is the time since the last reading, believed or not: missing readings open
the gate, wrong ones do not. A reading out of reach is rejected whole, and counted; a rate that alone is out of reach is
left out. The same holds for a reading outside the world's walls, for a heading that is no direction, and for a clock
that does not go forward by at most `clock_steps` periods.

A reading that repeats the one before it bit for bit is stale, and rejected, where that cannot be: the body is read at a
speed, or is predicted elsewhere, or readings are known to be noisy.

Readings that stay out of reach, but agree with each other (each within reach of the one before it) for `patience`, are
taken up: then the estimate was wrong and not the sensor. That is counted, too. And for `patience` after a surprise,
which is a reading beyond the first two terms, the estimate without it is kept: if a later reading is a surprise again
but fits that estimate, it was right, and is taken back.
"""

from __future__ import annotations

import math

import numpy as np

from impact_envs.compiled import inlined
from impact_envs.elementary import atan2, cos_sin
from impact_envs.free_flyer.sensing import BODY_SIZE, COS, OMEGA, SIN, TIME, VX, VY, X, Y, find_shared_place
from planners.free_flyer.belief.options import Options
from planners.free_flyer.belief.plan_table import PlanTable
from planners.free_flyer.belief.world_memory import WorldMemory

# What is done with a reading.
MISSING, REJECTED, SURPRISING, EXPECTED = range(4)
UNIT = 0.5  # cos^2 + sin^2 of a heading is 1 within this, otherwise nothing was read
STILL = 1e-9  # a body that is slower can be read twice at the same place [m/s], [rad/s]
KNOWN_NOISE = 5.0  # weight of the samples from which the noise counts as known
NOISY = 1e-6  # noise above which no two readings are alike [m]


@inlined
def is_start(plan: PlanTable, joint: np.ndarray, k: int) -> bool:
    """Return whether world k starts anew: its time is 0, and it is read at all."""
    clock = find_shared_place(len(plan.body), plan.robots) + TIME
    return joint[k, clock] == 0.0 and (joint[k, COS] != 0.0 or joint[k, SIN] != 0.0)


@inlined
def open_tracks(plan: PlanTable, memory: WorldMemory, k: int) -> None:
    """Expect world k's first readings at the scenario's start states."""
    for i in range(len(plan.body)):
        track, body = memory.track[k, i], plan.body[i]
        track.reading[X], track.reading[Y] = body.start[0], body.start[1]
        track.reading[VX], track.reading[VY] = body.start_velocity[0], body.start_velocity[1]
        track.reading[COS], track.reading[SIN] = cos_sin(body.heading)
        track.reading[OMEGA] = 0.0
        track.time, track.since, track.doubted = -plan.period, math.inf, -math.inf
        track.changes, track.use = False, EXPECTED


@inlined
def read_clock(plan: PlanTable, memory: WorldMemory, options: Options, k: int, joint: np.ndarray) -> float:
    """Return the time of world k's readings: the clock's, or a period after the last one where that is impossible."""
    now = joint[k, find_shared_place(len(plan.body), plan.robots) + TIME] * plan.horizon
    last, first = memory.time[k], memory.track[k, 0].time < 0.0
    step = now - last
    if (step > 0.0 and step <= options.estimation.clock_steps * plan.period) or (first and step == 0.0):
        return now
    memory.counts[k].rejected += 1
    return last if first else last + plan.period


@inlined
def is_speed_possible(plan: PlanTable, memory: WorldMemory, options: Options, k: int, i: int, square: float) -> bool:
    """Return whether the velocity read of body i can be; otherwise count that it is left out.

    Args:
        square: of the difference from the filter's velocity [m^2/s^2].
    """
    if square <= plan.body[i].jump * plan.body[i].jump:
        return True
    noise = memory.sensor[k].sigma / plan.period  # of the difference of two places, over sqrt(2)
    spread = math.sqrt(memory.filter[k, i].P_vv + 2.0 * noise * noise)
    possible = math.sqrt(square) <= plan.body[i].jump + options.estimation.surprise * spread
    memory.counts[k].rejected += 0 if possible else 1
    return possible


@inlined
def is_repeated(track: np.record, joint: np.ndarray, k: int, at: int) -> bool:
    """Return whether a body's reading, which begins at a place, is the one before it, bit for bit."""
    repeated = True
    for j in range(BODY_SIZE):
        repeated = repeated and joint[k, at + j] == track.reading[j]
    return repeated


@inlined
def is_moving(memory: WorldMemory, k: int, joint: np.ndarray, at: int) -> bool:
    """Return whether no two readings of a body can be alike: it has a speed, or readings are noisy."""
    noisy = memory.sensor[k].weight > KNOWN_NOISE and memory.sensor[k].sigma > NOISY
    speed = max(abs(joint[k, at + VX]), abs(joint[k, at + VY]))
    return noisy or speed > STILL or abs(joint[k, at + OMEGA]) > STILL


@inlined
def judge_reading(
    plan: PlanTable, memory: WorldMemory, options: Options, k: int, i: int, joint: np.ndarray, miss: float
) -> int:
    """Return what is done with the reading of body i, and remember it, with the angle read.

    Args:
        joint: everything measured once, shape (N, 7 n + r + 3).
        miss: distance between read and predicted place [m].
    """
    track, z, at, now = memory.track[k, i], memory.filter[k, i], BODY_SIZE * i, memory.time[k]
    total = 0.0
    for j in range(BODY_SIZE):
        total += joint[k, at + j]
    if not math.isfinite(total):
        memory.counts[k].no_measurement += 1
        return MISSING
    dt, sigma, jump = now - track.time, memory.sensor[k].sigma, plan.body[i].jump
    near = options.estimation.surprise * math.sqrt(z.P_pp + sigma * sigma) + options.estimation.surprise_floor
    if miss > near and now <= track.doubted:
        old = track.old
        old_miss = math.hypot(joint[k, at + X] - old.position[0], joint[k, at + Y] - old.position[1])
        old_near = options.estimation.surprise * math.sqrt(old.P_pp + sigma * sigma) + options.estimation.surprise_floor
        if old_miss <= old_near:
            memory.filter[k, i], miss, near = old, old_miss, old_near
            track.doubted = -math.inf
            memory.counts[k].rejected += 1
    cos, sin = joint[k, at + COS], joint[k, at + SIN]
    # The angle read is only known up to whole turns.
    turn = atan2(sin, cos) - plan.body[i].heading
    turn -= 2.0 * math.pi * math.floor(turn / (2.0 * math.pi) + 0.5)
    track.angle = plan.body[i].heading + turn
    turn = track.angle - memory.heading[k, i].angle
    turn -= 2.0 * math.pi * math.floor(turn / (2.0 * math.pi) + 0.5)
    outside = max(plan.walls[0] - joint[k, at + X], joint[k, at + X] - plan.walls[2])
    outside = max(outside, plan.walls[1] - joint[k, at + Y], joint[k, at + Y] - plan.walls[3])
    whole = abs(cos * cos + sin * sin - 1.0) <= UNIT and outside <= near
    fits = whole and miss <= near + jump * dt and abs(turn) <= jump * dt / plan.body[i].radius
    stale = track.changes and (miss > near or is_moving(memory, k, joint, at)) and is_repeated(track, joint, k, at)
    if stale:
        fits = False
    elif whole:
        if not track.changes:
            track.changes = track.time >= 0.0 and not is_repeated(track, joint, k, at)
        track.time = now
    if fits or not whole:
        track.since = math.inf
    else:
        apart = math.hypot(joint[k, at + X] - track.reading[X], joint[k, at + Y] - track.reading[Y])
        if track.since == math.inf or not apart <= near + jump * dt:
            track.since = now
    for j in range(BODY_SIZE):
        track.reading[j] = joint[k, at + j]
    if not fits and now - track.since < options.estimation.patience - plan.period / 2.0:
        memory.counts[k].rejected += 1
        return REJECTED
    if not fits:
        memory.counts[k].taken_up += 1
        track.since = math.inf
    if miss <= near:
        return EXPECTED
    if now > track.doubted:
        track.old, track.doubted = z, now + options.estimation.patience
    return SURPRISING

"""State estimation of robots and objects: Kalman filters over free flight, re-opened at contacts.

One filter serves every body: position, velocity and a constant unknown acceleration (drift) per axis. Both axes share
one covariance. A filter is a row [px, py, vx, vy, ax, ay, Ppp, Ppv, Ppa, Pvv, Pva, Paa] of numbers.
"""

from __future__ import annotations

import math

import numpy as np

from impact_envs.compiled import compiled
from impact_envs.free_flyer.sensing import BODY_SIZE
from planners.free_flyer.belief.impact_parameters import compute_pair_gain, get_pair, learn_velocity_error
from planners.free_flyer.belief.options import Options
from planners.free_flyer.belief.plan_table import (
    HOME,
    KEEPS,
    MASS,
    RADIUS,
    START_VX,
    START_VY,
    START_X,
    START_Y,
    PlanTable,
)
from planners.free_flyer.belief.world_memory import (
    APPROACH,
    FREE_X,
    FREE_Y,
    HIT_X,
    HIT_Y,
    NO_MEASUREMENT,
    NOBODY,
    OBJECT_ERROR,
    ROBOT_ERROR,
    SAMPLES,
    SIGMA,
    SQUARE,
    UNKNOWN,
    WEIGHT,
    WorldMemory,
)
from planners.free_flyer.impact_law import compute_velocity_gain

NEAR = 0.1  # a felt impact is blamed on a body closer than this gap [m]
UNTRUSTED_JUMP = 0.5  # standard deviation of a modelled velocity jump, relative to its size
UNKNOWN_JUMP = 0.002  # the same, at least [m/s]
UNSEEN_JUMP = 0.05  # of a robot that felt an impact with nothing near [m/s]
START_POSITION = 1e-3  # bodies start where the scenario says [m]
START_VELOCITY = 1e-4  # and as fast [m/s]; knowing this makes a small drift visible early
SURPRISE = 6.0  # standard deviations, and
SURPRISE_FLOOR = 2e-3  # [m] beyond which a position tells of an unseen event, such as a bounce off a wall
# What the filters believe of sensors and disturbances, as standard deviations.
POSITION_PRIOR = 5e-3  # of measured positions until it is estimated [m]
POSITION_FLOOR = 1e-7  # of measured positions, at least [m]
# Of measured velocities over that of positions per control period; a velocity that comes from differences of noisy
# positions then hardly counts, an exact one counts fully.
VELOCITY_RATIO = 100.0
MEMORY = 50.0  # samples over which the position noise is estimated
THRUST = 4e-3  # unmodelled acceleration of robots [m/s^2],
THRUST_SHARE = 0.15  # and this share of what they are pushed with
FLIGHT = 1e-5  # unmodelled acceleration of objects [m/s^2]
KEPT = 3e-4  # of objects that keep their velocity [m/s^2]
DRIFT = 5e-4  # constant acceleration of an object [m/s^2]


@compiled
def predict(z: np.ndarray, ux: float, uy: float, h: float, unmodelled: float) -> None:
    """Move a filter ahead in place: p += h v + h^2/2 (a + u), v += h (a + u).

    Args:
        z: filter, shape (12,).
        ux, uy: known acceleration [m/s^2].
        h: time step [s].
        unmodelled: standard deviation of an acceleration held over the step [m/s^2].
    """
    for axis, u in ((0, ux), (1, uy)):
        a = z[4 + axis] + u
        z[axis] += h * (z[2 + axis] + h / 2 * a)
        z[2 + axis] += h * a
    pp, pv, pa, vv, va, aa = z[6], z[7], z[8], z[9], z[10], z[11]
    q = unmodelled * unmodelled * h * h
    z[6] = pp + 2 * h * pv + h * h * (pa + vv) + h**3 * va + h**4 / 4 * aa + q * h * h / 4
    z[7] = pv + h * (pa + vv) + 1.5 * h * h * va + h**3 / 2 * aa + q * h / 2
    z[8] = pa + h * va + h * h / 2 * aa
    z[9] = vv + 2 * h * va + h * h * aa + q
    z[10] = va + h * aa


@compiled
def correct_position(z: np.ndarray, x: float, y: float, variance: float) -> None:
    """Update a filter in place by a measured position.

    Args:
        z: filter, shape (12,).
        x, y: measured position [m].
        variance: of the measurement per axis, above zero [m^2].
    """
    pp, pv, pa = z[6], z[7], z[8]
    total = pp + variance
    for axis, value in ((0, x), (1, y)):
        innovation = (value - z[axis]) / total
        z[axis] += pp * innovation
        z[2 + axis] += pv * innovation
        z[4 + axis] += pa * innovation
    z[9] = max(z[9] - pv * pv / total, 0.0)
    z[10] -= pv * pa / total
    z[11] = max(z[11] - pa * pa / total, 0.0)
    z[6], z[7], z[8] = pp * (variance / total), pv * (variance / total), pa * (variance / total)


@compiled
def correct_velocity(z: np.ndarray, vx: float, vy: float, variance: float) -> None:
    """Update a filter in place by a measured velocity.

    Args:
        z: filter, shape (12,).
        vx, vy: measured velocity [m/s].
        variance: of the measurement per axis, above zero [m^2/s^2].
    """
    pv, vv, va = z[7], z[9], z[10]
    total = vv + variance
    for axis, value in ((0, vx), (1, vy)):
        innovation = (value - z[2 + axis]) / total
        z[axis] += pv * innovation
        z[2 + axis] += vv * innovation
        z[4 + axis] += va * innovation
    z[6] = max(z[6] - pv * pv / total, 0.0)
    z[8] -= pv * va / total
    z[11] = max(z[11] - va * va / total, 0.0)
    z[7], z[9], z[10] = pv * (variance / total), vv * (variance / total), va * (variance / total)


@compiled
def shift(z: np.ndarray, px: float, py: float, vx: float, vy: float, sigma_p: float, sigma_v: float) -> None:
    """Add a jump to a filter in place and open its covariance.

    Args:
        z: filter, shape (12,).
        px, py: jump of the position [m].
        vx, vy: jump of the velocity [m/s].
        sigma_p, sigma_v: standard deviation of the jump [m], [m/s].
    """
    z[0] += px
    z[1] += py
    z[2] += vx
    z[3] += vy
    z[6] += sigma_p * sigma_p
    z[9] += sigma_v * sigma_v


@compiled
def open_filters(plan: PlanTable, memory: WorldMemory, options: Options, k: int) -> None:
    """Start world k's estimates as the scenario says."""
    for i in range(len(plan.body)):
        z = memory.filter[k, i]
        for column in range(len(z)):
            z[column] = 0.0
        z[0], z[1] = plan.body[i, START_X], plan.body[i, START_Y]
        z[2], z[3] = plan.body[i, START_VX], plan.body[i, START_VY]
        z[6], z[9] = START_POSITION * START_POSITION, START_VELOCITY * START_VELOCITY
        if options.drift and i >= plan.robots and plan.body[i, KEEPS] == 0.0:
            z[11] = DRIFT * DRIFT
        memory.heading[k, i, 0], memory.heading[k, i, 1] = plan.body[i, HOME], 0.0
    memory.sensor[k, SIGMA], memory.sensor[k, WEIGHT] = POSITION_PRIOR, 0.0
    memory.sensor[k, SQUARE], memory.sensor[k, SAMPLES] = 0.0, 0.0


@compiled
def update_estimates(plan: PlanTable, memory: WorldMemory, k: int, joint: np.ndarray, now: float) -> None:
    """Take in one sample of world k: move all filters ahead, apply felt impacts, correct by what was measured.

    How noisy positions are is learned from the objects: between contacts their acceleration is constant, so the third
    difference of their positions is pure noise of variance 20 sigma^2. Measurements that are not finite are passed
    over.

    Args:
        plan: what is believed.
        memory: of all worlds; ``touch`` says afterwards who was hit.
        k: world.
        joint: everything measured once, shape (N, 7 n + r + 3).
        now: time of the sample [s].
    """
    h, n, r = now - memory.time[k], len(plan.body), plan.robots
    memory.time[k] = now
    for i in range(n):
        ux, uy = (memory.push[k, i, 0], memory.push[k, i, 1]) if i < r else (0.0, 0.0)
        keeps = plan.body[i, KEEPS] > 0.0
        unmodelled = THRUST + THRUST_SHARE * math.hypot(ux, uy) if i < r else KEPT if keeps else FLIGHT
        predict(memory.filter[k, i], ux, uy, h, unmodelled)
    calm = True
    for i in range(r):
        memory.touch[k, i] = NOBODY
        if joint[k, BODY_SIZE * n + i] > 0.5:
            calm = False
            other = find_nearest(plan, memory, k, i)
            memory.touch[k, i] = other
            if other == UNKNOWN:
                shift(memory.filter[k, i], 0.0, 0.0, 0.0, 0.0, UNSEEN_JUMP * h, UNSEEN_JUMP)
            else:
                apply_impact(plan, memory, k, i, other, h)
    variance = memory.sensor[k, SIGMA] * memory.sensor[k, SIGMA]
    for i in range(n):
        z, at = memory.filter[k, i], BODY_SIZE * i
        miss = math.hypot(joint[k, at] - z[0], joint[k, at + 1] - z[1])
        if math.isfinite(miss) and miss > SURPRISE * math.sqrt(z[6] + variance) + SURPRISE_FLOOR:
            shift(z, 0.0, 0.0, 0.0, 0.0, miss, miss / plan.period)
            calm = False
    learn_noise(memory, k, joint, r, calm)
    variance = memory.sensor[k, SIGMA] * memory.sensor[k, SIGMA]
    slow = VELOCITY_RATIO / plan.period
    for i in range(n):
        z, at, total = memory.filter[k, i], BODY_SIZE * i, 0.0
        for j in range(BODY_SIZE):
            total += joint[k, at + j]
        if not math.isfinite(total):
            memory.counts[k, NO_MEASUREMENT] += 1
            continue
        if calm:
            dx, dy = joint[k, at + 2] - z[2], joint[k, at + 3] - z[3]
            learn_velocity_error(memory, k, i, dx * dx + dy * dy, slow * slow * variance)
        correct_position(z, joint[k, at], joint[k, at + 1], variance)
        correct_velocity(z, joint[k, at + 2], joint[k, at + 3], slow * slow * variance)
        # The measured angle is only known up to whole turns.
        turn = math.atan2(joint[k, at + 5], joint[k, at + 4]) - plan.body[i, HOME]
        turn -= 2.0 * math.pi * math.floor(turn / (2.0 * math.pi) + 0.5)
        memory.heading[k, i, 0], memory.heading[k, i, 1] = plan.body[i, HOME] + turn, joint[k, at + 6]


@compiled
def find_nearest(plan: PlanTable, memory: WorldMemory, k: int, i: int) -> int:
    """Return the body nearest to robot i, UNKNOWN if none is near."""
    best, found, z = NEAR, UNKNOWN, memory.filter[k, i]
    for j in range(len(plan.body)):
        if j != i:
            y = memory.filter[k, j]
            gap = math.hypot(y[0] - z[0], y[1] - z[1]) - plan.body[i, RADIUS] - plan.body[j, RADIUS]
            if gap < best:
                best, found = gap, j
    return found


@compiled
def apply_impact(plan: PlanTable, memory: WorldMemory, k: int, i: int, j: int, h: float) -> None:
    """Apply Eq. 6 to the estimates; how deep free flight would have overlapped says how long ago it was."""
    a, b = memory.filter[k, i], memory.filter[k, j]
    x, y = b[0] - a[0], b[1] - a[1]
    distance = math.hypot(x, y)
    nx, ny = (x / distance, y / distance) if distance > 0 else (1.0, 0.0)
    approach = max((a[2] - b[2]) * nx + (a[3] - b[3]) * ny, 0.0)
    reach = plan.body[i, RADIUS] + plan.body[j, RADIUS]
    ago = min(max(reach - distance, 0.0) / approach, h) if approach > 0.0 else 0.0
    m_a, m_b = plan.body[i, MASS], plan.body[j, MASS]
    gain, ratio = compute_velocity_gain(plan.restitution, m_a, m_b), m_b / m_a
    if j >= plan.robots:
        o = j - plan.robots
        gain, ratio = compute_pair_gain(memory, k, i, o), get_pair(memory, k, i, o)[1]
    # The velocities are those of the end of the step.
    approach = max(approach - ago * (memory.push[k, i, 0] * nx + memory.push[k, i, 1] * ny), 0.0)
    felt = memory.felt[k, i]
    felt[APPROACH], felt[HIT_X], felt[HIT_Y], felt[FREE_X], felt[FREE_Y] = approach, nx, ny, a[2], a[3]
    felt[OBJECT_ERROR] = b[9]
    # What is learned of the thrust takes the place of what the filter believes of it.
    felt[ROBOT_ERROR] = max(a[9] - THRUST * THRUST * h * h, 0.0) + memory.velocity_error[k, i]
    for body in (0, 1):
        change = gain * approach if body == 0 else -gain * approach * ratio
        sigma = UNTRUSTED_JUMP * abs(change) + UNKNOWN_JUMP
        dx, dy = change * nx, change * ny
        shift(b if body == 0 else a, ago * dx, ago * dy, dx, dy, sigma * h, sigma)


@compiled
def learn_noise(memory: WorldMemory, k: int, joint: np.ndarray, robots: int, calm: bool) -> None:
    """Take the third difference of the objects' positions into the estimate of the noise, unless something happened."""
    sensor, objects = memory.sensor[k], memory.recent.shape[1]
    samples = sensor[SAMPLES] if calm else 0.0
    for o in range(objects):
        recent, at = memory.recent[k, o], BODY_SIZE * (robots + o)
        x, y = joint[k, at], joint[k, at + 1]
        if samples >= 3.0:
            dx = x - 3.0 * recent[4] + 3.0 * recent[2] - recent[0]
            dy = y - 3.0 * recent[5] + 3.0 * recent[3] - recent[1]
            square = dx * dx + dy * dy
            if math.isfinite(square):
                keep = 1.0 - 1.0 / MEMORY
                sensor[WEIGHT] = keep * sensor[WEIGHT] + 1.0
                sensor[SQUARE] = keep * sensor[SQUARE] + square / 40.0
        for i in range(4):
            recent[i] = recent[i + 2]
        recent[4], recent[5] = x, y
    # The sample that came with the event is not kept.
    sensor[SAMPLES] = min(samples + 1.0, 3.0) if calm else 0.0
    if sensor[WEIGHT] > 5.0:
        sensor[SIGMA] = max(math.sqrt(sensor[SQUARE] / sensor[WEIGHT]), POSITION_FLOOR)


@compiled
def extrapolate(memory: WorldMemory, k: int, i: int, time: float) -> tuple[float, float, float, float]:
    """Return position and velocity of body i in free flight at a time.

    Source: Verhagen & Tumova, Sec. VI, with the estimated drift added.
    """
    z, h = memory.filter[k, i], time - memory.time[k]
    x, y = z[0] + h * (z[2] + h / 2 * z[4]), z[1] + h * (z[3] + h / 2 * z[5])
    return x, y, z[2] + h * z[4], z[3] + h * z[5]


@compiled
def compute_variance(memory: WorldMemory, k: int, i: int, time: float) -> float:
    """Return the variance per axis of where body i is in free flight at a time [m^2]."""
    z, h = memory.filter[k, i], time - memory.time[k]
    pp, pv, pa, vv, va, aa = z[6], z[7], z[8], z[9], z[10], z[11]
    return pp + 2 * h * pv + h * h * (pa + vv) + h**3 * va + h**4 / 4 * aa

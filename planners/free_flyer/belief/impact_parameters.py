r"""Estimate restitution and mass ratio of every pair of robot and object from what impacts did to both; compiled.

One Gaussian is kept over all pairs: restitution e and logarithm of the mass ratio mu = m_O / m_R of each. A hit with
approach speed s changes the velocities along the normal by

dv_O = (1 + e) / (1 + mu) s,  dv_R = mu dv_O,

so the object alone tells the gain (1 + e) / (1 + mu), and the robot's recoil tells the two apart. What is learned from
one pair holds for others by the prior: one object has one mass, whoever hits it; restitutions are much alike.
"""

from __future__ import annotations

import math

import numpy as np

from impact_envs.compiled import compiled
from planners.free_flyer.belief.plan_table import MASS, PlanTable
from planners.free_flyer.belief.world_memory import (
    APPROACH,
    FREE_X,
    FREE_Y,
    GAINED,
    GAINED_VARIANCE,
    HIT_AT,
    HIT_BY,
    HIT_X,
    HIT_Y,
    NOBODY,
    OBJECT_ERROR,
    PENDING,
    RECOIL,
    RECOIL_VARIANCE,
    ROBOT_ERROR,
    SPENT,
    WATCHED,
    WorldMemory,
)

NOW, KNOWN = range(2)  # of WorldMemory.pair: with the hits that are still observed, and without them
RESTITUTION_SPREAD = 0.18  # standard deviation of a pair's restitution about the believed one
MASS_SPREAD = 0.17  # of the logarithm of an object's mass; together they give the gain a spread of 13 %
SAME_MATERIAL = 0.9  # correlation of the restitutions of pairs with different objects, and
SAME_OBJECT = 0.97  # with the same object
WANDER = 0.05  # standard deviation of a pair's restitution from hit to hit, e.g. by their speed
THRUST_ERROR = 2e-3  # of a robot's velocity over one control period, until it is learned [m/s]
THRUST_SHARE = 0.1  # of the velocity change by thrust, unknown while the error above is
ERROR_MEMORY = 20.0  # samples over which such errors are learned
MODEL_ERROR = 0.01  # of the changes of object and robot, independent, relative to the approach speed
OBJECT_FLOOR = 5e-5  # of an observed change, at least [m/s]
RECOIL_SECONDS = 1.5  # after a hit in which the robot's change is looked for [s]
UNSEEN = 1.0  # variance of a change that was not observed [m^2/s^2]
SLOWEST = 1e-3  # approach that tells anything [m/s]
ITERATIONS = 8  # of Gauss-Newton
FARTHEST = 1.5  # that one hit may move the logarithm of a mass ratio
SHARE_O, SHARE_R = -2, -1  # columns of WorldMemory.pair for computing


@compiled
def find_row(memory: WorldMemory, r: int, o: int) -> int:
    """Return the row of WorldMemory.pair with the restitution of robot r on object o; the log mass ratio comes next."""
    return 2 * (r * memory.hit.shape[1] + o)


@compiled
def start_pairs(plan: PlanTable, memory: WorldMemory, k: int) -> None:
    """Start world k with what is believed, as uncertain as it is before any hit."""
    objects = len(plan.first)
    size = 2 * plan.robots * objects
    for i in range(size):
        r, o, mass = i // 2 // objects, i // 2 % objects, i % 2 == 1
        ratio = plan.body[plan.robots + o, MASS] / plan.body[r, MASS]
        for version in (NOW, KNOWN):
            memory.pair[k, version, i, 0] = math.log(ratio) if mass else plan.restitution
        for j in range(size):
            same = j // 2 % objects == o
            if i % 2 != j % 2 or (mass and not same):
                value = 0.0
            elif mass:
                value = MASS_SPREAD * MASS_SPREAD
            else:
                value = RESTITUTION_SPREAD * RESTITUTION_SPREAD
                if i != j:
                    value *= SAME_OBJECT if same else SAME_MATERIAL
            for version in (NOW, KNOWN):
                memory.pair[k, version, i, 1 + j] = value
    for i in range(len(plan.body)):
        memory.velocity_error[k, i] = THRUST_ERROR * THRUST_ERROR if i < plan.robots else 0.0


@compiled
def get_pair(memory: WorldMemory, k: int, r: int, o: int) -> tuple[float, float]:
    """Return the estimated restitution, in [0, 1], and mass ratio of robot r and object o."""
    i = find_row(memory, r, o)
    restitution = memory.pair[k, NOW, i, 0]
    return min(max(restitution, 0.0), 1.0), math.exp(memory.pair[k, NOW, i + 1, 0])


@compiled
def compute_pair_gain(memory: WorldMemory, k: int, r: int, o: int) -> float:
    """Return the estimated change of object o's speed per approach speed of robot r, (1 + e) / (1 + mu)."""
    restitution, ratio = get_pair(memory, k, r, o)
    return (1.0 + restitution) / (1.0 + ratio)


@compiled
def compute_gain_spread(memory: WorldMemory, k: int, r: int, o: int) -> float:
    """Return the standard deviation of the gain of the next hit, relative to the gain, to first order."""
    restitution, ratio = get_pair(memory, k, r, o)
    i, pair = find_row(memory, r, o), memory.pair[k, NOW]
    by_e, by_mass = 1.0 / (1.0 + restitution), -ratio / (1.0 + ratio)
    variance = by_e * by_e * (pair[i, 1 + i] + WANDER * WANDER) + 2.0 * by_e * by_mass * pair[i, 2 + i]
    variance += by_mass * by_mass * pair[i + 1, 2 + i]
    return math.sqrt(max(variance, 0.0))


@compiled
def learn_velocity_error(memory: WorldMemory, k: int, i: int, square: float, variance: float) -> None:
    """Learn how far body i's velocity after a control period is from what its filter expects.

    Thrusters that do not do as they are told show in it, and objects whose centre of mass is elsewhere.

    Args:
        memory: of all worlds.
        k: world.
        i: body.
        square: of the difference of measured and predicted velocity [m^2/s^2].
        variance: of the measured velocity per axis; one that is worse than what is to be learned tells little.
    """
    expected = THRUST_ERROR * THRUST_ERROR
    weight = expected / (expected + variance) / ERROR_MEMORY
    memory.velocity_error[k, i] += weight * (max(square / 2.0 - variance, 0.0) - memory.velocity_error[k, i])


@compiled
def watch_recoil(memory: WorldMemory, k: int, o: int, now: float) -> None:
    """Look at the change of velocity of the robot that hit object o, and keep the observation that is the surest.

    Where the robot would be without the hit follows from its thrust, which is known the worse the longer it acts.
    """
    hit = memory.hit[k, o]
    r, since = int(hit[HIT_BY]), now - hit[HIT_AT]
    if hit[WATCHED] == math.inf or since > RECOIL_SECONDS:
        return
    if since > 0.0:
        if memory.touch[k, r] != NOBODY:
            hit[WATCHED] = math.inf
            return
        h = now - hit[WATCHED]
        x, y = h * memory.push[k, r, 0], h * memory.push[k, r, 1]
        hit[FREE_X], hit[FREE_Y], hit[SPENT] = hit[FREE_X] + x, hit[FREE_Y] + y, hit[SPENT] + math.hypot(x, y)
    hit[WATCHED] = now
    z, error = memory.filter[k, r], memory.velocity_error[k, r]
    share = THRUST_SHARE * hit[SPENT] / THRUST_ERROR
    variance = z[9] + error * (2.0 + share * share) + (MODEL_ERROR * hit[APPROACH]) ** 2
    if variance < hit[RECOIL_VARIANCE]:
        hit[RECOIL_VARIANCE] = variance
        hit[RECOIL] = (hit[FREE_X] - z[2]) * hit[HIT_X] + (hit[FREE_Y] - z[3]) * hit[HIT_Y]


@compiled
def relearn(memory: WorldMemory, k: int) -> None:
    """Take what is seen of the hits that are still observed into what is known of all others."""
    size = memory.pair.shape[2]
    for i in range(size):
        for j in range(size + 1):
            memory.pair[k, NOW, i, j] = memory.pair[k, KNOWN, i, j]
    for o in range(memory.hit.shape[1]):
        absorb(memory, k, NOW, o)


@compiled
def settle(memory: WorldMemory, k: int, o: int) -> None:
    """End the observation of the last hit on object o; the next hit of any pair may differ a little."""
    if memory.hit[k, o, PENDING] > 0.0 and memory.hit[k, o, GAINED_VARIANCE] > 0.0:
        absorb(memory, k, KNOWN, o)
        for i in range(0, memory.pair.shape[2], 2):
            memory.pair[k, KNOWN, i, 1 + i] += WANDER * WANDER
    memory.hit[k, o, PENDING] = 0.0


@compiled
def absorb(memory: WorldMemory, k: int, version: int, o: int) -> None:
    r"""Take the hit that is observed on object o into the Gaussian: an iterated extended Kalman filter.

    With the errors epsilon of the velocities before and eta of those after, alpha = (1 + e) / (1 + mu) and the measured
    approach s_m = s + epsilon_R - epsilon_O,

    dv_O,m = alpha s_m + (alpha - 1) epsilon_O - alpha epsilon_R + eta_O
    dv_R,m = alpha mu s_m + alpha mu epsilon_O + (1 - alpha mu) epsilon_R - eta_R

    Restitution is kept in [0, 1] by the most likely of what is left.
    """
    hit = memory.hit[k, o]
    if hit[PENDING] == 0.0 or hit[GAINED_VARIANCE] == 0.0 or hit[APPROACH] < SLOWEST:
        return
    pairs, s = memory.pair[k, version], hit[APPROACH]
    i = find_row(memory, int(hit[HIT_BY]), o)
    j = i + 1
    e_0, b_0, ee, eb, bb = pairs[i, 0], pairs[j, 0], pairs[i, 1 + i], pairs[i, 1 + j], pairs[j, 1 + j]
    e, b, o_e, o_b, r_e, r_b = e_0, b_0, 0.0, 0.0, 0.0, 0.0
    oo, rr, cross, w_o, w_r = 1.0, 1.0, 0.0, 0.0, 0.0
    for _ in range(ITERATIONS):
        mu = math.exp(b)
        alpha = (1.0 + e) / (1.0 + mu)
        # Derivatives of the changes of object and robot by e and log mu.
        o_e, o_b = s / (1.0 + mu), -s * alpha * mu / (1.0 + mu)
        r_e, r_b = s * mu / (1.0 + mu), s * alpha * mu / (1.0 + mu)
        oo = hit[GAINED_VARIANCE] + (alpha - 1.0) ** 2 * hit[OBJECT_ERROR] + alpha * alpha * hit[ROBOT_ERROR]
        rr = hit[RECOIL_VARIANCE] + (alpha * mu) ** 2 * hit[OBJECT_ERROR] + (1.0 - alpha * mu) ** 2 * hit[ROBOT_ERROR]
        cross = (alpha - 1.0) * alpha * mu * hit[OBJECT_ERROR] - alpha * (1.0 - alpha * mu) * hit[ROBOT_ERROR]
        oo += o_e * (o_e * ee + 2.0 * o_b * eb) + o_b * o_b * bb
        rr += r_e * (r_e * ee + 2.0 * r_b * eb) + r_b * r_b * bb
        cross += o_e * (r_e * ee + r_b * eb) + o_b * (r_e * eb + r_b * bb)
        miss_o = hit[GAINED] - s * alpha - o_e * (e_0 - e) - o_b * (b_0 - b)
        miss_r = hit[RECOIL] - s * alpha * mu - r_e * (e_0 - e) - r_b * (b_0 - b)
        det = oo * rr - cross * cross
        w_o, w_r = (rr * miss_o - cross * miss_r) / det, (oo * miss_r - cross * miss_o) / det
        e = e_0 + (o_e * ee + o_b * eb) * w_o + (r_e * ee + r_b * eb) * w_r
        b = b_0 + (o_e * eb + o_b * bb) * w_o + (r_e * eb + r_b * bb) * w_r
        e, b = min(max(e, -0.5), 1.5), min(max(b, b_0 - FARTHEST), b_0 + FARTHEST)
    det = oo * rr - cross * cross
    correct_pairs(pairs, i, (o_e, o_b, r_e, r_b), (oo / det, rr / det, cross / det), (w_o, w_r))


@compiled
def correct_pairs(
    pairs: np.ndarray,
    i: int,
    slopes: tuple[float, float, float, float],
    covariance: tuple[float, float, float],
    weights: tuple[float, float],
) -> None:
    """Correct mean and covariance of all pairs by two observed changes that depend on one of them.

    Args:
        pairs: of WorldMemory.pair, shape (2 P, 2 P + 3).
        i: row of that pair.
        slopes: of the changes of object and robot over restitution and log mass ratio [m/s].
        covariance: of the innovation, elements (object, robot, both) over its determinant [s^2/m^2].
        weights: inverse covariance times innovation, of object and robot [s/m].
    """
    oo, rr, cross = covariance
    for n in range(len(pairs)):
        # How the two changes vary with every number, kept apart from what is corrected.
        pairs[n, SHARE_O] = pairs[n, 1 + i] * slopes[0] + pairs[n, 2 + i] * slopes[1]
        pairs[n, SHARE_R] = pairs[n, 1 + i] * slopes[2] + pairs[n, 2 + i] * slopes[3]
    for n in range(len(pairs)):
        g_o, g_r = pairs[n, SHARE_O], pairs[n, SHARE_R]
        pairs[n, 0] += g_o * weights[0] + g_r * weights[1]
        g_o, g_r = rr * g_o - cross * g_r, oo * g_r - cross * g_o
        for m in range(len(pairs)):
            pairs[n, 1 + m] -= g_o * pairs[m, SHARE_O] + g_r * pairs[m, SHARE_R]
    outside = min(max(pairs[i, 0], 0.0), 1.0) - pairs[i, 0]
    if outside != 0.0:
        share = outside / pairs[i, 1 + i]
        for n in range(len(pairs)):
            pairs[n, 0] += pairs[n, 1 + i] * share

r"""Estimate restitution and mass ratio of every pair of robot and object from what impacts did to both; compiled.

One Gaussian is kept over all pairs: restitution e and logarithm of the mass ratio mu = m_O / m_R of each. A hit with
approach speed s changes the velocities along the normal by

dv_O = (1 + e) / (1 + mu + lever) s,  dv_R = mu dv_O,

where a hit beside the object's centre of mass has a lever (`offset.compute_lever`), 0 otherwise. So the object alone
tells the gain (1 + e) / (1 + mu), and the robot's recoil tells the two apart. What is learned from
one pair holds for others by the prior: one object has one mass, whoever hits it; restitutions are much alike.
"""

from __future__ import annotations

import math

import numpy as np

from impact_envs.compiled import compiled, inlined
from impact_envs.elementary import exp, log
from planners.free_flyer.belief.options import Options
from planners.free_flyer.belief.plan_table import PlanTable
from planners.free_flyer.belief.world_memory import NOBODY, WorldMemory

NOW, KNOWN = range(2)  # versions in WorldMemory.pair_*: with the hits that are still observed, and without them
UNSEEN = 1.0  # variance of a change that was not observed [m^2/s^2]
OF_OBJECT, OF_ROBOT = range(2)  # changes of velocity in WorldMemory.pair_share


@compiled
def find_row(memory: WorldMemory, r: int, o: int) -> int:
    """Return the index in WorldMemory.pair_* of robot r's restitution on object o; the log mass ratio comes next."""
    return 2 * (r * memory.hit.shape[1] + o)


@compiled
def start_pairs(plan: PlanTable, memory: WorldMemory, options: Options, k: int) -> None:
    """Start world k with the believed values and their prior covariance."""
    objects = len(plan.first)
    size = 2 * plan.robots * objects
    for i in range(size):
        r, o, mass = i // 2 // objects, i // 2 % objects, i % 2 == 1
        ratio = plan.body[plan.robots + o].mass / plan.body[r].mass
        for version in (NOW, KNOWN):
            memory.pair_mean[k, version, i] = log(ratio) if mass else plan.restitution
        for j in range(size):
            same = j // 2 % objects == o
            if i % 2 != j % 2 or (mass and not same):
                value = 0.0
            elif mass:
                value = options.impact_parameters.mass_spread * options.impact_parameters.mass_spread
            else:
                value = options.impact_parameters.restitution_spread * options.impact_parameters.restitution_spread
                if i != j:
                    value *= options.impact_parameters.same_object if same else options.impact_parameters.same_material
            for version in (NOW, KNOWN):
                memory.pair_covariance[k, version, i, j] = value
    for i in range(len(plan.body)):
        memory.velocity_error[k, i] = (
            options.impact_parameters.thrust_error * options.impact_parameters.thrust_error if i < plan.robots else 0.0
        )


@compiled
def get_pair(memory: WorldMemory, k: int, r: int, o: int) -> tuple[float, float]:
    """Return the estimated restitution, in [0, 1], and mass ratio of robot r and object o."""
    i = find_row(memory, r, o)
    mean = memory.pair_mean[k, NOW]
    return min(max(mean[i], 0.0), 1.0), exp(mean[i + 1])


@compiled
def compute_pair_gain(memory: WorldMemory, k: int, r: int, o: int, lever: float = 0.0) -> float:
    """Return the estimated change of object o's speed per approach speed of robot r, (1 + e) / (1 + mu + lever).

    Args:
        lever: of a hit beside the centre of mass, see `offset.compute_lever`.
    """
    restitution, ratio = get_pair(memory, k, r, o)
    return (1.0 + restitution) / (1.0 + ratio + lever)


@compiled
def compute_gain_spread(memory: WorldMemory, options: Options, k: int, r: int, o: int) -> float:
    """Return the standard deviation of the gain of the next hit, relative to the gain, to first order."""
    restitution, ratio = get_pair(memory, k, r, o)
    i, P = find_row(memory, r, o), memory.pair_covariance[k, NOW]
    by_e, by_mass = 1.0 / (1.0 + restitution), -ratio / (1.0 + ratio)
    variance = (
        by_e * by_e * (P[i, i] + options.impact_parameters.wander * options.impact_parameters.wander)
        + 2.0 * by_e * by_mass * P[i, i + 1]
    )
    variance += by_mass * by_mass * P[i + 1, i + 1]
    return math.sqrt(max(variance, 0.0))


@inlined
def learn_velocity_error(memory: WorldMemory, options: Options, k: int, i: int, square: float, variance: float) -> None:
    """Learn the variance of body i's velocity after a control period about what its filter predicts.

    Thrusters that do not do as they are told show in it, and objects whose centre of mass is elsewhere.

    Args:
        i: body.
        square: of the difference of measured and predicted velocity [m^2/s^2].
        variance: of the measured velocity per axis; one that is worse than what is to be learned tells little.
    """
    expected = options.impact_parameters.thrust_error * options.impact_parameters.thrust_error
    weight = expected / (expected + variance) / options.impact_parameters.error_memory
    memory.velocity_error[k, i] += weight * (max(square / 2.0 - variance, 0.0) - memory.velocity_error[k, i])


@inlined
def watch_recoil(memory: WorldMemory, options: Options, k: int, o: int, now: float) -> None:
    """Observe the change of velocity of the robot that hit object o; keep the observation with the least variance.

    Where the robot would be without the hit follows from its thrust, whose error grows with the time it acts.
    """
    hit = memory.hit[k, o]
    contact, r, since = hit.contact, hit.robot, now - hit.time
    if hit.watched_at == math.inf or since > options.impact_parameters.recoil_seconds:
        return
    if since > 0.0:
        if memory.touch[k, r] != NOBODY:
            hit.watched_at = math.inf
            return
        h = now - hit.watched_at
        x, y = h * memory.push[k, r, 0], h * memory.push[k, r, 1]
        contact.free_velocity[0] += x
        contact.free_velocity[1] += y
        hit.thrust += math.hypot(x, y)
    hit.watched_at = now
    z, error = memory.filter[k, r], memory.velocity_error[k, r]
    share = options.impact_parameters.thrust_share * hit.thrust / options.impact_parameters.thrust_error
    variance = z.P_vv + error * (2.0 + share * share) + (options.impact_parameters.model_error * contact.approach) ** 2
    if variance < hit.recoil_variance:
        hit.recoil_variance = variance
        x, y = contact.free_velocity[0] - z.velocity[0], contact.free_velocity[1] - z.velocity[1]
        hit.recoil = x * contact.normal[0] + y * contact.normal[1]


@compiled
def relearn_pairs(memory: WorldMemory, options: Options, k: int) -> None:
    """Recompute the estimate of all pairs from settled hits plus all hits still under observation."""
    size = memory.pair_mean.shape[2]
    for i in range(size):
        memory.pair_mean[k, NOW, i] = memory.pair_mean[k, KNOWN, i]
        for j in range(size):
            memory.pair_covariance[k, NOW, i, j] = memory.pair_covariance[k, KNOWN, i, j]
    for o in range(memory.hit.shape[1]):
        learn_hit(memory, options, k, NOW, o)


@compiled
def is_disturbed(memory: WorldMemory, options: Options, k: int, o: int, gained: float) -> bool:
    """Return whether something else has changed object o's velocity since its last hit was looked at.

    Args:
        gained: change of its velocity along the hit's normal as it looks now [m/s].
    """
    hit, sure = memory.hit[k, o], options.impact_parameters.sure
    return hit.gained_variance > 0.0 and (gained - hit.gained) ** 2 > sure * sure * hit.gained_variance


@compiled
def settle_hit(memory: WorldMemory, options: Options, k: int, o: int) -> None:
    """End the observation of the last hit on object o; the next hit of any pair may differ a little."""
    hit = memory.hit[k, o]
    if hit.is_pending and hit.gained_variance > 0.0:
        learn_hit(memory, options, k, KNOWN, o)
        for i in range(0, memory.pair_mean.shape[2], 2):
            memory.pair_covariance[k, KNOWN, i, i] += (
                options.impact_parameters.wander * options.impact_parameters.wander
            )
    hit.is_pending = False


@compiled
def learn_hit(memory: WorldMemory, options: Options, k: int, version: int, o: int) -> None:
    r"""Update a version of the Gaussian by the observed hit on object o: an iterated extended Kalman filter.

    With the errors epsilon of the velocities before and eta of those after, alpha = (1 + e) / (1 + mu + lever) and the
    measured approach s_m = s + epsilon_R - epsilon_O,

    dv_O,m = alpha s_m + (alpha - 1) epsilon_O - alpha epsilon_R + eta_O
    dv_R,m = alpha mu s_m + alpha mu epsilon_O + (1 - alpha mu) epsilon_R - eta_R

    Restitution is kept in [0, 1]: the mean moves to the most likely point inside.
    """
    hit = memory.hit[k, o]
    s, unmoved = hit.contact.approach, 1.0 + hit.contact.lever
    if not hit.is_pending or hit.gained_variance == 0.0 or s < options.impact_parameters.slowest:
        return
    V_o, V_r = hit.contact.object_variance, hit.contact.robot_variance
    mean, P = memory.pair_mean[k, version], memory.pair_covariance[k, version]
    i = find_row(memory, hit.robot, o)
    j = i + 1
    e_0, b_0, ee, eb, bb = mean[i], mean[j], P[i, i], P[i, j], P[j, j]
    e, b, o_e, o_b, r_e, r_b = e_0, b_0, 0.0, 0.0, 0.0, 0.0
    oo, rr, cross, w_o, w_r = 1.0, 1.0, 0.0, 0.0, 0.0
    for _ in range(options.impact_parameters.iterations):
        mu = exp(b)
        alpha = (1.0 + e) / (unmoved + mu)
        # Derivatives of the changes of object and robot by e and log mu.
        o_e, o_b = s / (unmoved + mu), -s * alpha * mu / (unmoved + mu)
        r_e, r_b = s * mu / (unmoved + mu), s * alpha * mu * unmoved / (unmoved + mu)
        oo = hit.gained_variance + (alpha - 1.0) ** 2 * V_o + alpha * alpha * V_r
        rr = hit.recoil_variance + (alpha * mu) ** 2 * V_o + (1.0 - alpha * mu) ** 2 * V_r
        cross = (alpha - 1.0) * alpha * mu * V_o - alpha * (1.0 - alpha * mu) * V_r
        oo += o_e * (o_e * ee + 2.0 * o_b * eb) + o_b * o_b * bb
        rr += r_e * (r_e * ee + 2.0 * r_b * eb) + r_b * r_b * bb
        cross += o_e * (r_e * ee + r_b * eb) + o_b * (r_e * eb + r_b * bb)
        miss_o = hit.gained - s * alpha - o_e * (e_0 - e) - o_b * (b_0 - b)
        miss_r = hit.recoil - s * alpha * mu - r_e * (e_0 - e) - r_b * (b_0 - b)
        det = oo * rr - cross * cross
        w_o, w_r = (rr * miss_o - cross * miss_r) / det, (oo * miss_r - cross * miss_o) / det
        e = e_0 + (o_e * ee + o_b * eb) * w_o + (r_e * ee + r_b * eb) * w_r
        b = b_0 + (o_e * eb + o_b * bb) * w_o + (r_e * eb + r_b * bb) * w_r
        e, b = (
            min(max(e, -0.5), 1.5),
            min(max(b, b_0 - options.impact_parameters.farthest), b_0 + options.impact_parameters.farthest),
        )
    det = oo * rr - cross * cross
    slopes, covariance = (o_e, o_b, r_e, r_b), (oo / det, rr / det, cross / det)
    correct_pairs(mean, P, memory.pair_share[k, version], i, slopes, covariance, (w_o, w_r))


@compiled
def correct_pairs(
    mean: np.ndarray,
    P: np.ndarray,
    share: np.ndarray,
    i: int,
    slopes: tuple[float, float, float, float],
    covariance: tuple[float, float, float],
    weights: tuple[float, float],
) -> None:
    """Correct mean and covariance of all pairs by two observed changes that depend on one of them.

    Args:
        mean, P: one version of WorldMemory.pair_mean and .pair_covariance, shapes (2 p,), (2 p, 2 p).
        share: scratch, shape (2 p, 2).
        i: index of that pair.
        slopes: of the changes of object and robot over restitution and log mass ratio [m/s].
        covariance: of the innovation, elements (object, robot, both) over its determinant [s^2/m^2].
        weights: inverse covariance times innovation, of object and robot [s/m].
    """
    oo, rr, cross = covariance
    for n in range(len(mean)):
        # The covariance of every number with the two changes, before it is corrected.
        share[n, OF_OBJECT] = P[n, i] * slopes[0] + P[n, i + 1] * slopes[1]
        share[n, OF_ROBOT] = P[n, i] * slopes[2] + P[n, i + 1] * slopes[3]
    for n in range(len(mean)):
        g_o, g_r = share[n, OF_OBJECT], share[n, OF_ROBOT]
        mean[n] += g_o * weights[0] + g_r * weights[1]
        g_o, g_r = rr * g_o - cross * g_r, oo * g_r - cross * g_o
        for m in range(len(mean)):
            P[n, m] -= g_o * share[m, OF_OBJECT] + g_r * share[m, OF_ROBOT]
    outside = min(max(mean[i], 0.0), 1.0) - mean[i]
    if outside != 0.0:
        step = outside / P[i, i]
        for n in range(len(mean)):
            mean[n] += P[n, i] * step

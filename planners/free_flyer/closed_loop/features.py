"""What a learner sees of the coming impact that a correction is due for, compiled."""

from __future__ import annotations

import math

import numpy as np

from impact_envs.compiled import compiled, inlined
from impact_envs.elementary import cos_sin
from impact_envs.physics.impact import compute_velocity_gain
from planners.free_flyer.belief.estimator import compute_variance, extrapolate_flight
from planners.free_flyer.belief.impact_parameters import compute_gain_spread, compute_pair_gain
from planners.free_flyer.belief.offset import extrapolate_swing
from planners.free_flyer.belief.options import Options
from planners.free_flyer.belief.plan_table import NO_IMPACT, PlanTable
from planners.free_flyer.belief.world_memory import NO_OBJECT, WorldMemory
from planners.free_flyer.next_impact.aim import choose_desired_velocity
from planners.free_flyer.next_impact.correction import predict_margin
from planners.free_flyer.next_impact.desired_velocity import (
    ROUND_OFF,
    compute_margin,
    find_next_knot,
)

ONE_HOT = 6
FEATURES = ONE_HOT + 39
FAR = 2.0  # a margin beyond this tells no more [m]


@compiled
def write_features(
    plan: PlanTable, memory: WorldMemory, options: Options, k: int, due: int, features: np.ndarray
) -> None:
    """Write what a learner may see of world k.

    Vectors are along the change of velocity that the expert wishes, and across it, to the left.

    Args:
        due: object whose coming impact's correction is due; that of the soonest impact with NO_OBJECT.
        features: written, shape (N, FEATURES), zeros where no planned impact is to come: one-hot number of the impact
            in the plan (6); time / horizon; time to the impact [s]; duration of the leg after it [s]; wished change:
            direction in the world (2), size [m/s]; velocity of the object before (2) and after it (2) [m/s]; place of
            the object at the impact, from the planned one (2) [m]; position (2) [m] and velocity (2) [m/s] of the robot
            from the object now; heading of the object at the impact as cosine and sine, rate [rad/s]; its geometric
            centre from its centre of mass then (2) [m]; its drift (2) [m/s^2]; probability that it has none; standard
            deviations of its place at the impact [m], velocity [m/s], drift [m/s^2] and offset [m], and of measured
            positions [m]; estimated over believed velocity gain and its relative standard deviation; observed over
            commanded change at the last hit of this object, along and across that, and at the one before, (1, 0) where
            there was none (4); number of hits observed; how deep the object is predicted to be at the impact in what
            that demands, and in what the next knot does, cut at 2 m, and the lesser of both as the expert aims (3) [m].
    """
    for i in range(FEATURES):
        features[k, i] = 0.0
    o = find_soonest(memory, k) if due == NO_OBJECT else due
    strike = memory.strike[k, o]
    if strike.index == NO_IMPACT:
        return
    now, r, body, time = memory.time[k], strike.robot, plan.robots + o, strike.time
    planned, hit, z = plan.impact[strike.index], memory.hit[k, o], memory.filter[k, body]
    striker, heading = memory.filter[k, planned.robot], memory.heading[k, body]
    x, y, vx, vy = extrapolate_flight(memory, k, body, time)
    wish_x, wish_y = choose_desired_velocity(plan, memory, options, k, o)
    knot, leg_end, _ = find_next_knot(plan, memory, k, o, strike.is_inserted)
    size = math.hypot(wish_x - vx, wish_y - vy)
    cos, sin = strike.reference_normal[0], strike.reference_normal[1]
    if size > ROUND_OFF:
        cos, sin = (wish_x - vx) / size, (wish_y - vy) / size
    features[k, min(strike.index, ONE_HOT - 1)] = 1.0
    row, at = features[k], ONE_HOT
    row[at], row[at + 1], row[at + 2] = now / plan.horizon, time - now, leg_end - time
    row[at + 3], row[at + 4], row[at + 5] = cos, sin, size
    turn_in(row, at + 6, cos, sin, vx, vy)
    turn_in(row, at + 8, cos, sin, wish_x, wish_y)
    turn_in(row, at + 10, cos, sin, x - planned.position[0], y - planned.position[1])
    dx, dy = striker.position[0] - z.position[0], striker.position[1] - z.position[1]
    turn_in(row, at + 12, cos, sin, dx, dy)
    dx, dy = striker.velocity[0] - z.velocity[0], striker.velocity[1] - z.velocity[1]
    turn_in(row, at + 14, cos, sin, dx, dy)
    angle = heading.angle + (time - now) * heading.rate
    ahead_x, ahead_y = cos_sin(angle)
    turn_in(row, at + 16, cos, sin, ahead_x, ahead_y)
    row[at + 18] = heading.rate
    dx, dy, _, _ = extrapolate_swing(memory, k, body, time)
    turn_in(row, at + 19, cos, sin, dx, dy)
    turn_in(row, at + 21, cos, sin, z.drift[0], z.drift[1])
    row[at + 23] = z.still
    row[at + 24] = math.sqrt(max(compute_variance(memory, k, body, time), 0.0))
    row[at + 25], row[at + 26] = math.sqrt(max(z.P_vv, 0.0)), math.sqrt(max(z.P_aa, 0.0))
    row[at + 27], row[at + 28] = math.sqrt(max(z.P_dd, 0.0)), memory.sensor[k].sigma
    believed = compute_velocity_gain(plan.restitution, plan.body[r].mass, plan.body[body].mass)
    row[at + 29] = compute_pair_gain(memory, k, r, o) / believed
    row[at + 30] = compute_gain_spread(memory, options, k, r, o)
    row[at + 31] = row[at + 33] = 1.0
    seen = min(hit.seen, 2)
    if hit.is_seen and seen > 0:
        row[at + 31], row[at + 32] = hit.observed[0], hit.observed[1]
        seen -= 1
    if seen > 0:
        row[at + 33], row[at + 34] = hit.earlier[0], hit.earlier[1]
    row[at + 35] = hit.seen
    end_x, end_y = x + (leg_end - time) * wish_x, y + (leg_end - time) * wish_y
    row[at + 36] = cut(compute_margin(plan, strike.index, x, y))
    row[at + 37] = cut(compute_margin(plan, knot, end_x, end_y))
    row[at + 38] = cut(predict_margin(plan, memory, options, k, o, 0.0, 0.0, time))


@inlined
def turn_in(row: np.ndarray, at: int, cos: float, sin: float, x: float, y: float) -> None:
    """Write a vector's parts along a direction (cos, sin) and across it to the left, from a place of a row on."""
    row[at], row[at + 1] = cos * x + sin * y, cos * y - sin * x


@inlined
def cut(margin: float) -> float:
    """Return a margin within plus and minus FAR [m]."""
    return min(max(margin, -FAR), FAR)


@compiled
def find_soonest(memory: WorldMemory, k: int) -> int:
    """Return the object of world k whose impact comes first, the first of several."""
    soonest = 0
    for o in range(1, memory.strike.shape[1]):
        if memory.strike[k, o].time < memory.strike[k, soonest].time:
            soonest = o
    return soonest

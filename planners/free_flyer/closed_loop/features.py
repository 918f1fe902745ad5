"""What a learner sees of the coming impact that a correction is due for, compiled."""

from __future__ import annotations

import numpy as np

from impact_envs.compiled import compiled
from impact_envs.physics.impact import compute_velocity_gain
from planners.free_flyer.belief.estimator import extrapolate_flight
from planners.free_flyer.belief.impact_parameters import compute_gain_spread, compute_pair_gain
from planners.free_flyer.belief.options import Options
from planners.free_flyer.belief.plan_table import NO_IMPACT, PlanTable
from planners.free_flyer.belief.world_memory import NO_OBJECT, WorldMemory
from planners.free_flyer.next_impact.desired_velocity import choose_desired_velocity, find_next_knot

ONE_HOT = 6
FEATURES = ONE_HOT + 21


@compiled
def write_features(
    plan: PlanTable, memory: WorldMemory, options: Options, k: int, due: int, features: np.ndarray
) -> None:
    """Write what a learner may see of world k.

    Args:
        due: object whose coming impact's correction is due; that of the soonest impact with NO_OBJECT.
        features: written, shape (N, FEATURES), zeros where no planned impact is to come: one-hot number of the impact
            in the plan (6); time / horizon; time to the impact [s]; duration of the leg after it [s]; predicted
            position of the object at the impact minus planned (2) [m]; velocity of the object (2), desired velocity
            (2), desired change (2) [m/s]; change over commanded change at the last impact of this object, 1 before any;
            number of such observations; position (2) [m] and velocity (2) [m/s] of the robot relative to the object;
            estimated over believed velocity gain and its standard deviation; estimated drift of the object (2) [m/s^2].
    """
    for i in range(FEATURES):
        features[k, i] = 0.0
    o = find_soonest(memory, k) if due == NO_OBJECT else due
    strike = memory.strike[k, o]
    if strike.index == NO_IMPACT:
        return
    now, r, body = memory.time[k], strike.robot, plan.robots + o
    planned, hit, z = plan.impact[strike.index], memory.hit[k, o], memory.filter[k, body]
    striker = memory.filter[k, planned.robot]
    x, y, vx, vy = extrapolate_flight(memory, k, body, strike.time)
    wish_x, wish_y = choose_desired_velocity(plan, memory, options, k, o)
    _, leg_end, _ = find_next_knot(plan, memory, k, o, strike.is_inserted)
    believed = compute_velocity_gain(plan.restitution, plan.body[r].mass, plan.body[body].mass)
    factor = compute_pair_gain(memory, k, r, o) / believed
    features[k, min(strike.index, ONE_HOT - 1)] = 1.0
    at = ONE_HOT
    features[k, at], features[k, at + 1], features[k, at + 2] = (
        now / plan.horizon,
        strike.time - now,
        leg_end - strike.time,
    )
    features[k, at + 3], features[k, at + 4] = x - planned.position[0], y - planned.position[1]
    features[k, at + 5], features[k, at + 6] = z.velocity[0], z.velocity[1]
    features[k, at + 7], features[k, at + 8] = wish_x, wish_y
    features[k, at + 9], features[k, at + 10] = wish_x - vx, wish_y - vy
    features[k, at + 11], features[k, at + 12] = hit.ratio if hit.ratio != 0.0 else 1.0, hit.seen
    for axis in range(2):
        features[k, at + 13 + axis] = striker.position[axis] - z.position[axis]
        features[k, at + 15 + axis] = striker.velocity[axis] - z.velocity[axis]
        features[k, at + 19 + axis] = z.drift[axis]
    features[k, at + 17] = factor
    features[k, at + 18] = factor * compute_gain_spread(memory, options, k, r, o)


@compiled
def find_soonest(memory: WorldMemory, k: int) -> int:
    """Return the object of world k whose impact comes first, the first of several."""
    soonest = 0
    for o in range(1, memory.strike.shape[1]):
        if memory.strike[k, o].time < memory.strike[k, soonest].time:
            soonest = o
    return soonest

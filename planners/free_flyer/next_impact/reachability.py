"""Whether and when a robot can be somewhere: its thrust, and what it has to hit before; compiled."""

from __future__ import annotations

import math

from impact_envs.compiled import compiled
from planners.free_flyer.belief.estimator import extrapolate
from planners.free_flyer.belief.plan_table import END, NEXT, NORMAL_X, NORMAL_Y, OBJECT, RADIUS, ROBOT, PlanTable
from planners.free_flyer.belief.world_memory import AGENT, IMPACT_INDEX, INSERTED, TIME, WorldMemory
from planners.free_flyer.tracking.mpc import GAIN, INPUT_LIMIT

EASE = 0.75  # of the thrust
QUINTIC = 5.7735  # greatest acceleration of a rest-to-rest quintic over d / T^2


@compiled
def compute_time(plan: PlanTable, r: int, d: float) -> float:
    """Return the time that robot r needs for a way from rest to rest by a quintic [s]: sqrt(5.77 d / a)."""
    return math.sqrt(QUINTIC * d / (EASE * plan.pilot[r, GAIN] * plan.pilot[r, INPUT_LIMIT]))


@compiled
def find_contact(plan: PlanTable, memory: WorldMemory, k: int, index: int) -> tuple[float, float]:
    """Return where the robot of a planned impact is to be, with the object where it is wanted and hit as planned."""
    r, body = int(plan.impact[index, ROBOT]), int(plan.impact[index, OBJECT])
    reach = plan.body[r, RADIUS] + plan.body[body, RADIUS]
    x = memory.place[k, index, 0] - reach * plan.impact[index, NORMAL_X]
    return x, memory.place[k, index, 1] - reach * plan.impact[index, NORMAL_Y]


@compiled
def compute_arrival(plan: PlanTable, memory: WorldMemory, k: int, index: int) -> float:
    """Return when the robot of a planned impact can be there after what it has to hit before; 0 if there is nothing."""
    r, arrival = int(plan.impact[index, ROBOT]), 0.0
    x, y = find_contact(plan, memory, k, index)
    for o in range(len(plan.first)):
        strike = memory.strike[k, o]
        at, time = int(strike[IMPACT_INDEX]), strike[TIME]
        if strike[INSERTED] > 0.0 and strike[AGENT] == r:
            ox, oy, _, _ = extrapolate(memory, k, plan.robots + o, time)
            arrival = max(arrival, time + compute_time(plan, r, math.hypot(x - ox, y - oy)))
        while at != END and at != index:
            time = memory.clock[k, at]
            if plan.impact[at, ROBOT] == r and time < memory.clock[k, index]:
                ox, oy = find_contact(plan, memory, k, at)
                arrival = max(arrival, time + compute_time(plan, r, math.hypot(x - ox, y - oy)))
            at = int(plan.impact[at, NEXT])
    return arrival


@compiled
def is_reachable(
    plan: PlanTable, memory: WorldMemory, k: int, r: int, x: float, y: float, vx: float, vy: float, span: float
) -> bool:
    r"""Return whether robot r can be at a position with a velocity after a time by a quintic, within its thrust.

    a(tau) = d (60 tau - 180 tau^2 + 120 tau^3) / T^2 + 6 (v - v_0) tau (1 - tau) / T, d = x - x_0 - T (v + v_0) / 2
    """
    z, pilot = memory.filter[k, r], plan.pilot[r]
    dx, dy = x - z[0] - span / 2 * (vx + z[2]), y - z[1] - span / 2 * (vy + z[3])
    most = 0.0
    for i in range(1, 8):
        tau = i / 8.0
        way = (60.0 * tau - 180.0 * tau * tau + 120.0 * tau * tau * tau) / (span * span)
        turn = 6.0 * tau * (1.0 - tau) / span
        most = max(most, math.hypot(way * dx + turn * (vx - z[2]), way * dy + turn * (vy - z[3])))
    return most <= EASE * pilot[GAIN] * pilot[INPUT_LIMIT]

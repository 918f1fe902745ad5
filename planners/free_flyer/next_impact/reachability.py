"""Compute whether and when a robot can be somewhere, given its thrust and its earlier impacts; compiled."""

from __future__ import annotations

import math

from impact_envs.compiled import compiled
from planners.free_flyer.belief.estimator import extrapolate_flight
from planners.free_flyer.belief.options import Options
from planners.free_flyer.belief.plan_table import NO_IMPACT, PlanTable
from planners.free_flyer.belief.world_memory import WorldMemory
from planners.free_flyer.tracking.mpc import GAIN, INPUT_LIMIT

QUINTIC = 5.7735  # greatest acceleration of a rest-to-rest quintic over d / T^2


@compiled
def compute_time(plan: PlanTable, options: Options, r: int, d: float) -> float:
    """Return the time that robot r needs for a way from rest to rest by a quintic [s]: sqrt(5.77 d / a)."""
    return math.sqrt(QUINTIC * d / (options.reach.ease * plan.pilot[r, GAIN] * plan.pilot[r, INPUT_LIMIT]))


@compiled
def compute_leg_speed(plan: PlanTable, options: Options, o: int, index: int, least: float) -> float:
    """Return the speed per axis at which object o may fly its leg after a planned impact [m/s].

    A plan for a tight deadline has fast legs; the same leg has to be flown as fast after the impact before it was late.

    Args:
        index: of the planned impact, followed by another one or by the end.
        least: speed that any leg may have [m/s].
    """
    following = plan.impact[index].next
    if following == NO_IMPACT:
        return least
    here, there = plan.knot[index].position, plan.knot[following].position
    way = max(abs(there[0] - here[0]), abs(there[1] - here[1]))
    planned = way / (plan.impact[following].time - plan.impact[index].time)
    fastest = options.aim.fastest * plan.body[plan.robots + o].speed_limit
    return max(least, min(options.aim.hurry * planned, fastest))


@compiled
def find_contact(plan: PlanTable, memory: WorldMemory, k: int, index: int) -> tuple[float, float]:
    """Return where a planned impact's robot is to be, with the object at its wanted place and the planned normal."""
    impact = plan.impact[index]
    reach = plan.body[impact.robot].radius + plan.body[impact.body].radius
    x = memory.place[k, index, 0] - reach * impact.normal[0]
    return x, memory.place[k, index, 1] - reach * impact.normal[1]


@compiled
def compute_arrival(plan: PlanTable, memory: WorldMemory, options: Options, k: int, index: int) -> float:
    """Return when the robot of a planned impact can be there after its earlier impacts; 0 if it has none."""
    r, arrival = plan.impact[index].robot, 0.0
    x, y = find_contact(plan, memory, k, index)
    for o in range(len(plan.first)):
        strike = memory.strike[k, o]
        at, time = strike.index, strike.time
        if strike.is_inserted and strike.robot == r:
            ox, oy, _, _ = extrapolate_flight(memory, k, plan.robots + o, time)
            arrival = max(arrival, time + compute_time(plan, options, r, math.hypot(x - ox, y - oy)))
        while at != NO_IMPACT and at != index:
            time = memory.clock[k, at]
            if plan.impact[at].robot == r and time < memory.clock[k, index]:
                ox, oy = find_contact(plan, memory, k, at)
                arrival = max(arrival, time + compute_time(plan, options, r, math.hypot(x - ox, y - oy)))
            at = plan.impact[at].next
    return arrival


@compiled
def is_reachable(
    plan: PlanTable,
    memory: WorldMemory,
    options: Options,
    k: int,
    r: int,
    x: float,
    y: float,
    vx: float,
    vy: float,
    span: float,
) -> bool:
    r"""Return whether robot r can be at a position with a velocity after a time by a quintic, within its thrust.

    a(tau) = d (60 tau - 180 tau^2 + 120 tau^3) / T^2 + 6 (v - v_0) tau (1 - tau) / T, d = x - x_0 - T (v + v_0) / 2
    """
    z, pilot = memory.filter[k, r], plan.pilot[r]
    x_0, y_0, vx_0, vy_0 = z.position[0], z.position[1], z.velocity[0], z.velocity[1]
    dx, dy = x - x_0 - span / 2 * (vx + vx_0), y - y_0 - span / 2 * (vy + vy_0)
    most = options.reach.ease * pilot[GAIN] * pilot[INPUT_LIMIT]
    for i in range(1, 8):
        tau = i / 8.0
        way = (60.0 * tau - 180.0 * tau * tau + 120.0 * tau * tau * tau) / (span * span)
        turn = 6.0 * tau * (1.0 - tau) / span
        if math.hypot(way * dx + turn * (vx - vx_0), way * dy + turn * (vy - vy_0)) > most:
            return False
    return True

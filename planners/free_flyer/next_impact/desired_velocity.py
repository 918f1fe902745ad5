"""Margins of an object's flight, and the velocity that takes it from its coming impact to its next knot; compiled."""

from __future__ import annotations

import math

from impact_envs.compiled import compiled
from planners.free_flyer.belief.drift import find_drift
from planners.free_flyer.belief.estimator import compute_variance, extrapolate_flight
from planners.free_flyer.belief.offset import extrapolate_swing
from planners.free_flyer.belief.options import Options
from planners.free_flyer.belief.plan_table import NO_IMPACT, PlanTable
from planners.free_flyer.belief.world_memory import WorldMemory
from planners.free_flyer.next_impact.reachability import compute_arrival

ROUND_OFF = 1e-6  # of times [s]


@compiled
def compute_margin(plan: PlanTable, knot: int, x: float, y: float) -> float:
    """Return the distance of a position from the faces of a knot, negative outside [m]; inf without faces."""
    margin = math.inf
    for i in range(plan.knot[knot].faces):
        face = plan.face[knot, i]
        margin = min(margin, face.offset - face.normal[0] * x - face.normal[1] * y)
    return margin


@compiled
def is_promised(plan: PlanTable, memory: WorldMemory, k: int, o: int) -> bool:
    """Return whether object o will be in the box for which the plan promises that its further impacts do."""
    index = memory.strike[k, o].index
    x, y, _, _ = extrapolate_flight(memory, k, plan.robots + o, memory.clock[k, index])
    lower, upper = plan.knot[index].lower, plan.knot[index].upper
    return lower[0] <= x <= upper[0] and lower[1] <= y <= upper[1]


@compiled
def is_answered(plan: PlanTable, memory: WorldMemory, options: Options, k: int, o: int) -> bool:
    """Return whether the plan has a response to where object o will be at its coming impact, or at its end."""
    strike = memory.strike[k, o]
    index = strike.index
    if len(plan.response) == 0 or strike.is_inserted or memory.hit[k, o].is_beyond:
        return False
    knot = len(plan.impact) + o if index == NO_IMPACT else index
    time = plan.horizon if index == NO_IMPACT else plan.impact[index].time
    if index != NO_IMPACT and abs(memory.clock[k, index] - time) > ROUND_OFF:
        return False
    x, y, _, _ = extrapolate_flight(memory, k, plan.robots + o, time)
    lower, upper, edge = plan.knot[knot].lower, plan.knot[knot].upper, options.response.edge
    return lower[0] - edge <= x <= upper[0] + edge and lower[1] - edge <= y <= upper[1] + edge


@compiled
def is_settled(plan: PlanTable, memory: WorldMemory, options: Options, k: int, o: int, now: float) -> bool:
    """Return whether object o's flight is known well enough since its last contact to plan with."""
    strike = memory.strike[k, o]
    if now >= strike.last_contact + options.timing.settle - ROUND_OFF:
        return True
    if strike.index == NO_IMPACT or not is_answered(plan, memory, options, k, o):
        return False
    return math.sqrt(max(compute_variance(memory, k, plan.robots + o, strike.time), 0.0)) <= options.response.known


@compiled
def find_next_knot(plan: PlanTable, memory: WorldMemory, k: int, o: int, inserted: bool) -> tuple[int, float, bool]:
    """Return the knot after the coming impact of object o, when it is expected, and whether it is the end.

    Args:
        inserted: the coming impact is not in the plan.
    """
    index = memory.strike[k, o].index
    if index != NO_IMPACT and not inserted:
        index = plan.impact[index].next
    if index == NO_IMPACT:
        return len(plan.impact) + o, plan.horizon, True
    return index, memory.clock[k, index], False


@compiled
def compute_desired_velocity(
    x: float, y: float, target_x: float, target_y: float, duration: float, drift_x: float, drift_y: float, limit: float
) -> tuple[float, float]:
    """Return the velocity that takes an object from its impact to its next knot.

    v_des = (P_{k+1} - x_O(t_I)) / L - a L / 2,  L = t_{k+1} - t_I, shortened to the speed limit

    Args:
        x, y: of the object at the impact [m].
        target_x, target_y: where it should be next [m].
        duration: of its flight there, L [s].
        drift_x, drift_y: constant acceleration of the object [m/s^2].
        limit: greatest speed per axis [m/s].

    Returns:
        Velocity [m/s].

    Source: Verhagen & Tumova, Sec. VI, with the estimated drift added.
    """
    vx = (target_x - x) / duration - drift_x * duration / 2
    vy = (target_y - y) / duration - drift_y * duration / 2
    scale = min(1.0, limit / max(abs(vx), abs(vy), 1e-12))
    return vx * scale, vy * scale


@compiled
def find_mass(memory: WorldMemory, k: int, i: int, time: float) -> tuple[float, float]:
    """Return where the centre of mass of body i is in free flight at a time: the mean of where its centre will be."""
    x, y, _, _ = extrapolate_flight(memory, k, i, time)
    if memory.filter[k, i].P_dd > 0.0:
        rx, ry, _, _ = extrapolate_swing(memory, k, i, time)
        x, y = x - rx, y - ry
    return x, y


@compiled
def compute_turn(plan: PlanTable, memory: WorldMemory, k: int, o: int, wish_x: float, wish_y: float) -> float:
    """Return the cosine between the planned impulse on object o and what a desired velocity needs; 1 without change."""
    strike = memory.strike[k, o]
    _, _, vx, vy = extrapolate_flight(memory, k, plan.robots + o, strike.time)
    dx, dy = wish_x - vx, wish_y - vy
    size = math.hypot(dx, dy)
    normal = strike.reference_normal
    return 1.0 if size < ROUND_OFF else (dx * normal[0] + dy * normal[1]) / size


@compiled
def compute_room(
    plan: PlanTable, memory: WorldMemory, k: int, o: int, r: int, time: float, wish_x: float, wish_y: float
) -> float:
    """Return the margin of robot r to the areas it may not leave, when it gives object o a velocity at a time [m]."""
    body = plan.robots + o
    x, y, vx, vy = extrapolate_flight(memory, k, body, time)
    dx, dy = wish_x - vx, wish_y - vy
    reach = (plan.body[r].radius + plan.body[body].radius) / max(math.hypot(dx, dy), ROUND_OFF)
    room = math.inf
    for i in range(plan.own.shape[1]):
        own = plan.own[r, i]
        if own.normal[0] != 0.0 or own.normal[1] != 0.0:
            room = min(room, own.offset - own.normal[0] * (x - reach * dx) - own.normal[1] * (y - reach * dy))
    return room


@compiled
def hasten_next_knot(plan: PlanTable, memory: WorldMemory, options: Options, k: int, o: int) -> None:
    """Expect the next knot of object o earlier, if the drift would bend its way there too far.

    A flight of duration L against an acceleration a that it compensates leaves the straight way by a L^2 / 8.
    """
    strike, (drift_x, drift_y) = memory.strike[k, o], find_drift(memory.filter[k, plan.robots + o])
    knot, due, last = find_next_knot(plan, memory, k, o, strike.is_inserted)
    drift = math.hypot(drift_x, drift_y)
    bend = min(options.aim.bend, max(0.5 * plan.knot[knot].depth, 0.0))
    if last or drift * (due - strike.time) ** 2 <= 8.0 * bend:
        return
    x, y, _, _ = extrapolate_flight(memory, k, plan.robots + o, strike.time)
    way = math.hypot(memory.place[k, knot, 0] - x, memory.place[k, knot, 1] - y)
    sooner = strike.time + max(math.sqrt(8.0 * bend / drift), way / options.aim.cruise)
    sooner = max(sooner, plan.knot[knot].opens, compute_arrival(plan, memory, options, k, knot))
    memory.clock[k, knot] = min(sooner, due)


@compiled
def find_share(
    plan: PlanTable, options: Options, knot: int, x: float, y: float, target_x: float, target_y: float
) -> float:
    """Return the share of the way from a position to a target after which it is deep enough inside a knot's faces."""
    share, deep = 0.0, options.aim.deep_enough * plan.knot[knot].depth
    for i in range(plan.knot[knot].faces):
        face = plan.face[knot, i]
        hx, hy, b = face.normal[0], face.normal[1], face.offset
        here, there = b - hx * x - hy * y, b - hx * target_x - hy * target_y
        if here < deep and there > here:
            share = max(share, min((deep - here) / (there - here), 1.0))
    return share

"""When an object is hit: move the coming impact to when the object is nearest to where it should be hit; compiled."""

from __future__ import annotations

import math

from impact_envs.compiled import compiled, inlined
from planners.free_flyer.belief.drift import find_motion
from planners.free_flyer.belief.estimator import compute_variance, extrapolate_flight
from planners.free_flyer.belief.options import Options
from planners.free_flyer.belief.plan_table import NO_IMPACT, PlanTable
from planners.free_flyer.belief.world_memory import WorldMemory
from planners.free_flyer.next_impact.bookkeeping import set_clocks, set_time
from planners.free_flyer.next_impact.desired_velocity import ROUND_OFF, compute_margin
from planners.free_flyer.next_impact.reachability import (
    compute_arrival,
    compute_leg_speed,
    find_contact,
    is_reachable,
)


@compiled
def compute_reserve(plan: PlanTable, memory: WorldMemory, options: Options, k: int, o: int, knot: int) -> float:
    """Return the latest time of an impact of object o from which all its later ones can be reached [s]."""
    latest = plan.horizon - max(options.retiming.reserve, options.retiming.reserve_share * plan.horizon)
    before, at = knot, plan.impact[knot].next
    x, y = memory.place[k, knot, 0], memory.place[k, knot, 1]
    while at != NO_IMPACT:
        speed = compute_leg_speed(plan, options, o, before, options.aim.cruise)
        latest -= math.hypot(memory.place[k, at, 0] - x, memory.place[k, at, 1] - y) / speed
        x, y = memory.place[k, at, 0], memory.place[k, at, 1]
        before, at = at, plan.impact[at].next
    return latest


@compiled
def may_move(plan: PlanTable, memory: WorldMemory, options: Options, k: int, o: int, now: float) -> bool:
    """Return whether the coming impact of object o may still be moved; in the last seconds only what came too early."""
    strike = memory.strike[k, o]
    if now <= strike.time - options.retiming.frozen:
        return True
    x, y, _, _ = extrapolate_flight(memory, k, plan.robots + o, strike.time)
    early = compute_margin(plan, strike.index, x, y) < options.insertion.safe
    return now <= strike.time - options.retiming.last and early


@compiled
def is_straying(plan: PlanTable, memory: WorldMemory, options: Options, k: int, o: int, most: float) -> bool:
    """Return whether object o, which waits for its first impact, will surely have drifted away from its place then.

    Args:
        most: distance from where its impact is planned [m].
    """
    strike, body = memory.strike[k, o], plan.robots + o
    if strike.index == NO_IMPACT or len(plan.response) > 0:
        return False
    x, y, _, _ = extrapolate_flight(memory, k, body, strike.time)
    far = math.hypot(x - memory.place[k, strike.index, 0], y - memory.place[k, strike.index, 1])
    if far <= most:
        return False
    spread = math.sqrt(max(compute_variance(memory, k, body, strike.time), 0.0))
    return far > most + options.retiming.stray_deviations * spread


@compiled
def hasten_waiting(plan: PlanTable, memory: WorldMemory, options: Options, k: int, o: int, now: float) -> None:
    """Move the first impact of object o, which drifts away where it waits, to the latest time when it is not far yet.

    Its robot has to be there in time, and has more to spare than for other impacts: it may come from the other side.
    """
    strike, body, place = memory.strike[k, o], plan.robots + o, memory.place[k, memory.strike[k, o].index]
    index, r, old = strike.index, strike.robot, strike.time
    time, late = now, old
    while late - time > options.retiming.fine:
        middle = 0.5 * (time + late)
        x, y, _, _ = extrapolate_flight(memory, k, body, middle)
        if math.hypot(x - place[0], y - place[1]) <= options.retiming.stray_share * options.retiming.stray:
            time = middle
        else:
            late = middle
    px, py = find_contact(plan, memory, k, index)
    notice = options.retiming.frozen
    while now + notice < old:
        if is_reachable(plan, memory, options, k, r, px, py, 0.0, 0.0, notice / options.retiming.careful):
            break
        notice += 1.0
    time = max(max(time, now + notice), max(plan.knot[index].opens, compute_arrival(plan, memory, options, k, index)))
    if time < old - options.retiming.fine:
        memory.counts[k].retimed += 1
        set_time(plan, memory, k, o, index, time)
        set_clocks(plan, memory, options, k, now)


@compiled
def retime_impact(plan: PlanTable, memory: WorldMemory, options: Options, k: int, o: int, now: float) -> None:
    """Move the coming impact of object o to when the object is nearest to where it should be hit.

    min_t |x_O(t) - P_k|^2 + 20 max(0, crowding - margin_k(x_O(t)))^2 + 1e-5 (t - t_k)^2

    A learner's shift comes on top.
    """
    strike = memory.strike[k, o]
    shift = options.correction.shift * strike.shift
    index, old = strike.index, strike.time - shift
    latest = min(plan.knot[index].closes, max(compute_reserve(plan, memory, options, k, o, index), old))
    notice = options.retiming.frozen
    r = strike.robot
    place_x, place_y = find_contact(plan, memory, k, index)
    while now + notice < old and not is_reachable(plan, memory, options, k, r, place_x, place_y, 0.0, 0.0, notice):
        notice += 1.0
    earliest = min(max(now + notice, plan.knot[index].opens), old)
    best, time = compute_miss(plan, memory, options, k, o, old, old, math.inf), old
    arrival = compute_arrival(plan, memory, options, k, index)
    if arrival > old:
        # Its robot has to hit something else before: the impact comes when it can.
        earliest, latest, best = arrival, max(latest, arrival + options.retiming.frozen), math.inf
    earliest = max(earliest, arrival)
    if latest <= earliest:
        return
    step = (latest - earliest) / (options.retiming.candidates - 1)
    for i in range(options.retiming.candidates):
        t = earliest + i * step
        miss = compute_miss(plan, memory, options, k, o, t, old, best)
        if miss < best:
            best, time = miss, t
    middle = time
    for i in range(1, 2 * options.retiming.refined):
        t = min(max(middle + (i / options.retiming.refined - 1.0) * step, earliest), latest)
        miss = compute_miss(plan, memory, options, k, o, t, old, best)
        if miss < best:
            best, time = miss, t
    if abs(time - old) > ROUND_OFF:
        if shift != 0.0:
            time = min(max(time + shift, earliest), latest)
        memory.counts[k].retimed += 1
        set_time(plan, memory, k, o, index, time)
        set_clocks(plan, memory, options, k, now)


@compiled
def compute_miss(
    plan: PlanTable, memory: WorldMemory, options: Options, k: int, o: int, time: float, old: float, least: float
) -> float:
    """Return what `retime_impact` minimises; inf where it is not below the least so far, and that is told for less."""
    knot, pull = memory.strike[k, o].index, options.retiming.pull * (time - old) * (time - old)
    if pull >= least or is_far(memory, k, plan.robots + o, knot, time, math.sqrt(least)):
        return math.inf
    x, y, _, _ = extrapolate_flight(memory, k, plan.robots + o, time)
    dx, dy = x - memory.place[k, knot, 0], y - memory.place[k, knot, 1]
    outside = max(min(options.retiming.crowding, 0.4 * plan.knot[knot].depth) - compute_margin(plan, knot, x, y), 0.0)
    return dx * dx + dy * dy + options.retiming.outside * outside * outside + pull


@inlined
def is_far(memory: WorldMemory, k: int, i: int, knot: int, time: float, distance: float) -> bool:
    """Return whether body i in free flight is farther from a knot's place at a time, however it is turned then."""
    z, h, place = memory.filter[k, i], time - memory.time[k], memory.place[k, knot]
    p, v, a = find_motion(z)
    dx = p.real + h * (v.real + h / 2 * a.real) - place[0]
    dy = p.imag + h * (v.imag + h / 2 * a.imag) - place[1]
    arm = math.sqrt(z.offset[0] * z.offset[0] + z.offset[1] * z.offset[1])
    reach = distance + 2.0 * arm + ROUND_OFF  # the centre is seen from the centre of mass before and then
    return dx * dx + dy * dy > reach * reach

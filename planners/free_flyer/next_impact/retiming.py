"""When an object is hit: move the coming impact to when the object is nearest to where it should be hit; compiled."""

from __future__ import annotations

import math

from impact_envs.compiled import compiled
from planners.free_flyer.belief.estimator import extrapolate_flight
from planners.free_flyer.belief.plan_table import NO_IMPACT, PlanTable
from planners.free_flyer.belief.world_memory import WorldMemory
from planners.free_flyer.next_impact.bookkeeping import set_clocks, set_time
from planners.free_flyer.next_impact.desired_velocity import CRUISE, ROUND_OFF, compute_margin
from planners.free_flyer.next_impact.reachability import compute_arrival, find_contact, is_reachable

FROZEN = 4.0  # before an impact its time is kept [s]
CANDIDATES = 121
REFINED = 20
CROWDING = 0.1  # the object should be hit so deep inside what its knot demands [m]
OUTSIDE = 20.0  # weight of missing that, squared, over missing the planned place, squared
PULL = 1e-5  # weight of changing the time, squared [m^2/s^2]
RESERVE = 4.0  # after the last impact [s], or
RESERVE_SHARE = 0.1  # of the horizon


@compiled
def compute_reserve(plan: PlanTable, memory: WorldMemory, k: int, knot: int) -> float:
    """Return the latest time of an impact from which all later ones can be reached [s]."""
    latest, at = plan.horizon - max(RESERVE, RESERVE_SHARE * plan.horizon), plan.impact[knot].next
    x, y = memory.place[k, knot, 0], memory.place[k, knot, 1]
    while at != NO_IMPACT:
        latest -= math.hypot(memory.place[k, at, 0] - x, memory.place[k, at, 1] - y) / CRUISE
        x, y = memory.place[k, at, 0], memory.place[k, at, 1]
        at = plan.impact[at].next
    return latest


@compiled
def retime_impact(plan: PlanTable, memory: WorldMemory, k: int, o: int, now: float) -> None:
    """Move the coming impact of object o to when the object is nearest to where it should be hit.

    min_t |x_O(t) - P_k|^2 + 20 max(0, crowding - margin_k(x_O(t)))^2 + 1e-5 (t - t_k)^2
    """
    strike = memory.strike[k, o]
    index, old = strike.index, strike.time
    latest = min(plan.knot[index].closes, max(compute_reserve(plan, memory, k, index), old))
    notice = FROZEN
    r = strike.robot
    place_x, place_y = find_contact(plan, memory, k, index)
    while now + notice < old and not is_reachable(plan, memory, k, r, place_x, place_y, 0.0, 0.0, notice):
        notice += 1.0
    earliest = min(max(now + notice, plan.knot[index].opens), old)
    best, time = compute_miss(plan, memory, k, o, old, old), old
    arrival = compute_arrival(plan, memory, k, index)
    if arrival > old:
        # Its robot has to hit something else before: the impact comes when it can.
        earliest, latest, best = arrival, max(latest, arrival + FROZEN), math.inf
    earliest = max(earliest, arrival)
    if latest <= earliest:
        return
    step = (latest - earliest) / (CANDIDATES - 1)
    for i in range(CANDIDATES):
        t = earliest + i * step
        miss = compute_miss(plan, memory, k, o, t, old)
        if miss < best:
            best, time = miss, t
    middle = time
    for i in range(1, 2 * REFINED):
        t = min(max(middle + (i / REFINED - 1.0) * step, earliest), latest)
        miss = compute_miss(plan, memory, k, o, t, old)
        if miss < best:
            best, time = miss, t
    if abs(time - old) > ROUND_OFF:
        memory.counts[k].retimed += 1
        set_time(plan, memory, k, o, index, time)
        set_clocks(plan, memory, k, now)


@compiled
def compute_miss(plan: PlanTable, memory: WorldMemory, k: int, o: int, time: float, old: float) -> float:
    """Return what `retime_impact` minimises."""
    knot = memory.strike[k, o].index
    x, y, _, _ = extrapolate_flight(memory, k, plan.robots + o, time)
    dx, dy = x - memory.place[k, knot, 0], y - memory.place[k, knot, 1]
    outside = max(min(CROWDING, 0.4 * plan.knot[knot].depth) - compute_margin(plan, knot, x, y), 0.0)
    return dx * dx + dy * dy + OUTSIDE * outside * outside + PULL * (time - old) * (time - old)

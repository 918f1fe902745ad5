"""Keep an object that drifts where it has to stay for a while: throw it up against its drift; compiled.

A stay is what "eventually always" asks of the place where an object's last impact brings it: F[0,T] G[0,S] o in a. It
counts from when the object is inside, so it need not last until the end of the horizon.
"""

from __future__ import annotations

import math

from impact_envs.compiled import compiled
from planners.free_flyer.belief.drift import find_drift
from planners.free_flyer.belief.estimator import compute_variance, extrapolate_flight
from planners.free_flyer.belief.options import Options
from planners.free_flyer.belief.plan_table import NO_IMPACT, PlanTable
from planners.free_flyer.belief.world_memory import NO_ROBOT, WorldMemory
from planners.free_flyer.next_impact.desired_velocity import (
    ROUND_OFF,
    compute_desired_velocity,
    compute_margin,
    compute_room,
    compute_turn,
    find_mass,
)

Flight = tuple[float, float, float, float, float, float]  # position, velocity, drift [m, m/s, m/s^2]


@compiled
def find_stay(plan: PlanTable, o: int) -> int:
    """Return the last planned impact of object o if it has to stay where that brings it, or NO_IMPACT."""
    at, last = plan.first[o], NO_IMPACT
    while at != NO_IMPACT:
        at, last = plan.impact[at].next, at
    return last if last != NO_IMPACT and plan.knot[last].stay > 0.0 else NO_IMPACT


@compiled
def watch_stays(plan: PlanTable, memory: WorldMemory, options: Options, k: int, now: float) -> None:
    """Take note of since when the objects of world k are where they have to stay, and whether that was long enough."""
    for o in range(len(plan.first)):
        knot, hit = find_stay(plan, o), memory.hit[k, o]
        if knot == NO_IMPACT:
            continue
        z = memory.filter[k, plan.robots + o]
        if compute_margin(plan, knot, z.position[0], z.position[1]) <= 0.0:
            hit.outside_at = now
        elif (
            hit.outside_at <= plan.knot[knot].closes
            and now >= hit.outside_at + plan.knot[knot].stay + options.stay.later
        ):
            hit.has_stayed = True


@compiled
def compute_span(
    plan: PlanTable, memory: WorldMemory, options: Options, k: int, o: int, knot: int, time: float
) -> float:
    """Return how long object o should stay from a time on, or from when it enters then [s].

    Args:
        knot: from `find_stay`.
        time: [s].
    """
    z, since = memory.filter[k, plan.robots + o], memory.hit[k, o].outside_at
    x, y, _, _ = extrapolate_flight(memory, k, plan.robots + o, time)
    wanted = options.stay.longer * plan.knot[knot].stay + options.stay.later
    inside = compute_margin(plan, knot, z.position[0], z.position[1]) > 0.0 and compute_margin(plan, knot, x, y) > 0.0
    if inside and since <= plan.knot[knot].closes:
        wanted = max(wanted - (time - since), options.stay.later)
    return min(wanted, plan.horizon - time)


@compiled
def measure_stay(
    plan: PlanTable, options: Options, knot: int, flight: Flight, before: float, span: float, left: float
) -> float:
    """Return the least margin of an object's stay [m]; where it ends too soon, minus the share that is missing.

    Args:
        knot: from `find_stay`.
        flight: of the object.
        before: time until which it has to be inside at the latest [s].
        span: of the stay [s].
        left: time until the end of the horizon [s].
    """
    x, y, vx, vy, ax, ay = flight
    step, t, least = span / options.stay.samples, 0.0, math.inf
    entered = 0.0 if compute_margin(plan, knot, x, y) > 0.0 else math.inf
    while t < left - ROUND_OFF:
        t = min(t + step, left)
        margin = compute_margin(plan, knot, x + t * (vx + t / 2 * ax), y + t * (vy + t / 2 * ay))
        if entered < math.inf:
            if margin <= 0.0:
                return -1.0 + (t - entered) / (span + step)
            least = min(least, margin)
            if t >= entered + span - ROUND_OFF:
                return least
        elif margin > 0.0:
            entered = t
        elif t > before:
            return -1.0
    return -1.0 if entered == math.inf else -1.0 + (left - entered) / (span + step)


@compiled
def is_leaving(plan: PlanTable, memory: WorldMemory, options: Options, k: int, o: int, now: float) -> bool:
    """Return whether object o, after its last planned impact, will surely not stay as long as it has to."""
    knot = find_stay(plan, o)
    if knot == NO_IMPACT or memory.hit[k, o].has_stayed:
        return False
    body, span = plan.robots + o, compute_span(plan, memory, options, k, o, knot, now)
    (ax, ay), (x, y, vx, vy) = find_drift(memory.filter[k, body]), extrapolate_flight(memory, k, body, now)
    before = plan.knot[knot].closes - now
    margin = measure_stay(plan, options, knot, (x, y, vx, vy, ax, ay), before, span, plan.horizon - now)
    spread = math.sqrt(max(compute_variance(memory, k, body, now + span), 0.0))
    return margin + options.insertion.safe_deviations * spread < options.insertion.safe


@compiled
def choose_stay(
    plan: PlanTable,
    memory: WorldMemory,
    options: Options,
    k: int,
    o: int,
    r: int,
    time: float,
    duration: float,
    wish: tuple[float, float],
) -> tuple[float, float]:
    """Return the velocity that object o should have after its last impact: the wish, unless it does not stay with it.

    Else that of the greatest least margin, of flights that are on the straight way to the plan's place, or a share of
    it, after a share of the time that is left.

    Args:
        r: robot that hits, whose room and side count, or NO_ROBOT.
        time: of the impact [s].
        duration: until the end of the horizon [s].
        wish: velocity that brings it to its end [m/s].
    """
    knot = find_stay(plan, o)
    if knot == NO_IMPACT or memory.hit[k, o].has_stayed:
        return wish
    body, span = plan.robots + o, compute_span(plan, memory, options, k, o, knot, time)
    ax, ay = find_drift(memory.filter[k, body])
    x, y = find_mass(memory, k, body, time)
    left, before = plan.horizon - time, plan.knot[knot].closes - time
    best, chosen = measure_stay(plan, options, knot, (x, y, wish[0], wish[1], ax, ay), before, span, left), wish
    if best >= options.stay.shallow * plan.knot[knot].depth:
        return wish
    best = rate_stay(plan, memory, options, k, o, r, time, wish, best)
    way_x, way_y = plan.knot[knot].position[0] - x, plan.knot[knot].position[1] - y
    for j in range(len(options.stay.throws)):
        lasts = max(options.stay.throws[j] * duration, options.stay.shortest_throw)
        for i in range(options.stay.targets + 1):
            share = i / options.stay.targets
            to_x, to_y, limit = x + share * way_x, y + share * way_y, plan.body[body].speed_limit
            vx, vy = compute_desired_velocity(x, y, to_x, to_y, lasts, ax, ay, limit)
            margin = measure_stay(plan, options, knot, (x, y, vx, vy, ax, ay), before, span, left)
            score = rate_stay(plan, memory, options, k, o, r, time, (vx, vy), margin)
            if score > best:
                best, chosen = score, (vx, vy)
    return chosen


@compiled
def rate_stay(
    plan: PlanTable,
    memory: WorldMemory,
    options: Options,
    k: int,
    o: int,
    r: int,
    time: float,
    wish: tuple[float, float],
    margin: float,
) -> float:
    """Return the margin of a stay, or the robot's room if that is less; less where it has to go to the other side."""
    if r == NO_ROBOT:
        return margin
    score = min(margin, compute_room(plan, memory, k, o, r, time, wish[0], wish[1]))
    if compute_turn(plan, memory, k, o, wish[0], wish[1]) < options.aim.same_side:
        score -= options.aim.other_side
    return score

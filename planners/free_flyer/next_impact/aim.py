"""Choose the velocity that an object should have after its coming impact; compiled."""

from __future__ import annotations

import math

from impact_envs.compiled import compiled
from planners.free_flyer.belief.drift import find_drift
from planners.free_flyer.belief.options import Options
from planners.free_flyer.belief.plan_table import NO_IMPACT, PlanTable
from planners.free_flyer.belief.world_memory import WorldMemory
from planners.free_flyer.next_impact.desired_velocity import (
    compute_desired_velocity,
    compute_margin,
    compute_room,
    compute_turn,
    find_mass,
    find_next_knot,
    is_answered,
)
from planners.free_flyer.next_impact.reachability import compute_arrival, find_contact, is_reachable
from planners.free_flyer.next_impact.stay import choose_stay


@compiled
def choose_desired_velocity(
    plan: PlanTable, memory: WorldMemory, options: Options, k: int, o: int
) -> tuple[float, float]:
    """Return the velocity object o should have after its coming impact [m/s]."""
    strike, body = memory.strike[k, o], plan.robots + o
    time, (drift_x, drift_y) = strike.time, find_drift(memory.filter[k, body])
    x, y = find_mass(memory, k, body, time)
    knot, due, last = find_next_knot(plan, memory, k, o, strike.is_inserted)
    target_x, target_y = memory.place[k, knot, 0], memory.place[k, knot, 1]
    duration = max(due - time, options.aim.shortest_leg if last else 2.0)
    limit = plan.body[body].speed_limit
    if strike.index != NO_IMPACT and is_answered(plan, memory, options, k, o):
        response = plan.response[strike.index]
        vx = response.velocity[0] + response.gain[0] * (x - response.centre[0])
        vy = response.velocity[1] + response.gain[1] * (y - response.centre[1])
        target_x, target_y = x + vx * duration, y + vy * duration
        return compute_desired_velocity(x, y, target_x, target_y, duration, drift_x, drift_y, limit)
    passes = options.insert and strike.index != NO_IMPACT and not strike.is_inserted
    if passes and plan.knot[strike.index].via_share > 0.0:
        place = x, y
        target_x, target_y = turn_to_via(
            plan, options, strike.index, place, (target_x, target_y), duration, (drift_x, drift_y)
        )
        return compute_desired_velocity(x, y, target_x, target_y, duration, drift_x, drift_y, limit)
    if not last or not options.insert or plan.knot[knot].faces == 0:
        return compute_desired_velocity(x, y, target_x, target_y, duration, drift_x, drift_y, limit)
    # The depth that is enough grows with the time that is left, up to the plan's; a plan that says what happens if the
    # object is off may leave less time.
    full = options.aim.full_correction
    if plan.last[o] > 0.0:
        full = min(full, plan.last[o])
    extra = min(max(duration / full - 0.5, 0.0) * 2.0, 1.0)
    enough = (options.aim.deep_enough + (1.0 - options.aim.deep_enough) * extra) * plan.knot[knot].depth
    best, chosen = -math.inf, 1.0
    for i in range(options.aim.shares + 1):
        share = i / options.aim.shares
        end_x, end_y = x + share * (target_x - x), y + share * (target_y - y)
        wish_x, wish_y = compute_desired_velocity(x, y, end_x, end_y, duration, drift_x, drift_y, limit)
        room = compute_room(plan, memory, k, o, strike.robot, time, wish_x, wish_y)
        score = min(compute_margin(plan, knot, end_x, end_y), enough, room) - options.aim.smallest * share
        if compute_turn(plan, memory, k, o, wish_x, wish_y) < options.aim.same_side:
            score -= options.aim.other_side
        if score > best:
            best, chosen = score, share
    end_x, end_y = x + chosen * (target_x - x), y + chosen * (target_y - y)
    wish = compute_desired_velocity(x, y, end_x, end_y, duration, drift_x, drift_y, limit)
    return choose_stay(plan, memory, options, k, o, strike.robot, time, duration, wish)


@compiled
def turn_to_via(
    plan: PlanTable,
    options: Options,
    knot: int,
    place: tuple[float, float],
    target: tuple[float, float],
    duration: float,
    drift: tuple[float, float],
) -> tuple[float, float]:
    """Return the target of a flight, moved as little as it takes to pass the place that it has to pass on its way [m].

    At share s of a flight of duration L against an acceleration a that it compensates it is a s (1 - s) L^2 / 2 beside
    the straight way.

    Args:
        knot: at which it begins.
        place: where it begins [m].
        target: where it ends [m].
        duration: L [s].
        drift: a [m/s^2].
    """
    share, via = plan.knot[knot].via_share, plan.knot[knot].via
    bend = share * (1.0 - share) * duration * duration / 2.0
    off_x = place[0] + share * (target[0] - place[0]) - bend * drift[0] - via[0]
    off_y = place[1] + share * (target[1] - place[1]) - bend * drift[1] - via[1]
    off, allowed = math.hypot(off_x, off_y), options.aim.via * plan.knot[knot].via_depth
    if off <= allowed:
        return target
    back = (1.0 - allowed / off) / share
    return target[0] - back * off_x, target[1] - back * off_y


@compiled
def keep_side(plan: PlanTable, memory: WorldMemory, options: Options, k: int, o: int) -> None:
    """Expect the next knot of object o, which waits for its first impact, so early that this pushes it as planned.

    A drift towards the next knot does what the impulse should; to come there at the planned time the object would then
    be braked, by a robot that waits on its other side.
    """
    strike, body = memory.strike[k, o], plan.robots + o
    if strike.last_contact > 0.0 or strike.is_inserted or strike.index == NO_IMPACT:
        return
    knot, due, last = find_next_knot(plan, memory, k, o, False)
    if last:
        return
    x, y = find_mass(memory, k, body, strike.time)
    to_x, to_y, limit = memory.place[k, knot, 0], memory.place[k, knot, 1], plan.body[body].speed_limit
    (ax, ay), (cx, cy) = find_drift(memory.filter[k, body]), find_contact(plan, memory, k, knot)
    earliest = max(plan.knot[knot].opens, compute_arrival(plan, memory, options, k, knot))
    earliest = max(earliest, strike.time + math.hypot(to_x - x, to_y - y) / options.aim.cruise)
    r, time = plan.impact[knot].robot, due
    for _ in range(options.aim.hastenings):
        vx, vy = compute_desired_velocity(x, y, to_x, to_y, time - strike.time, ax, ay, limit)
        if compute_turn(plan, memory, k, o, vx, vy) >= options.aim.kept_side:
            memory.clock[k, knot] = time
            return
        time = strike.time + options.aim.sooner * (time - strike.time)
        span = time - memory.time[k]
        if time < earliest or not is_reachable(plan, memory, options, k, r, cx, cy, 0.0, 0.0, span):
            return

"""Add an unplanned impact on an object that goes astray, by the robot in the best position; compiled."""

from __future__ import annotations

import math

from impact_envs.compiled import compiled
from planners.free_flyer.belief.drift import find_drift
from planners.free_flyer.belief.estimator import compute_variance, extrapolate_flight
from planners.free_flyer.belief.impact_parameters import compute_pair_gain
from planners.free_flyer.belief.options import Options
from planners.free_flyer.belief.plan_table import NO_IMPACT, PlanTable
from planners.free_flyer.belief.surroundings import is_way_clear
from planners.free_flyer.belief.world_memory import NO_ROBOT, WorldMemory, find_next_event
from planners.free_flyer.next_impact.aim import choose_desired_velocity
from planners.free_flyer.next_impact.bookkeeping import set_clocks, set_time
from planners.free_flyer.next_impact.desired_velocity import (
    ROUND_OFF,
    compute_desired_velocity,
    compute_margin,
    compute_room,
    compute_turn,
    find_mass,
    find_share,
)
from planners.free_flyer.next_impact.reachability import compute_arrival, compute_time, find_contact, is_reachable
from planners.free_flyer.next_impact.stay import choose_stay, is_leaving


@compiled
def insert_impact(plan: PlanTable, memory: WorldMemory, options: Options, k: int, o: int, now: float) -> None:
    """Add an unplanned impact on object o if it would miss its next knot's demands, or end without enough margin."""
    strike, body = memory.strike[k, o], plan.robots + o
    index = strike.index
    over = index == NO_IMPACT
    knot = len(plan.impact) + o if over else index
    time = plan.horizon if over else strike.time
    x, y, _, _ = extrapolate_flight(memory, k, body, time)
    spread = (options.insertion.deviations if over else options.insertion.safe_deviations) * math.sqrt(
        max(compute_variance(memory, k, body, time), 0.0)
    )
    needed = options.insertion.shallow * plan.knot[knot].depth if over else options.insertion.safe
    astray = compute_margin(plan, knot, x, y) + spread < needed
    if over and not astray:
        astray = is_leaving(plan, memory, options, k, o, now)
    elif strike.last_contact <= 0.0:  # it waits, and drifts
        astray = True
    if not over and not astray:
        wish_x, wish_y = choose_desired_velocity(plan, memory, options, k, o)
        room = compute_room(plan, memory, k, o, strike.robot, time, wish_x, wish_y)
        turned = compute_turn(plan, memory, k, o, wish_x, wish_y) < options.aim.same_side
        astray = room + spread < options.insertion.edge or turned
    if not astray:
        strike.astray_since = math.inf
    if not astray or plan.horizon - now < options.insertion.leads[0] + options.insertion.rest:
        return
    for lead in options.insertion.leads:
        if strike.insertions >= options.insertion.most:
            break
        for haste in options.insertion.hastes:
            duration = haste * compute_leg(plan, memory, options, k, o, knot, over, now + lead)
            if (
                now + lead + duration > plan.horizon - (0.0 if over else options.retiming.reserve)
                or duration < options.insertion.least_leg
            ):
                continue
            if not over and not is_served(plan, memory, options, k, index, now, now + lead + duration):
                continue
            robot = choose_robot(plan, memory, options, k, o, knot, over, now, now + lead, duration)
            if robot == NO_ROBOT:
                continue
            strike.is_inserted, strike.robot, strike.time, strike.is_decided = True, robot, now + lead, True
            strike.replanned_at, strike.scale, strike.turn = -math.inf, 0.0, 0.0
            strike.misses, strike.is_solved, strike.insertions = 0, False, strike.insertions + 1
            if not over:
                set_time(plan, memory, k, o, index, now + lead + duration)
                strike.time = now + lead
            strike.due = strike.time
            memory.counts[k].inserted += 1
            set_clocks(plan, memory, options, k, now)
            return
    if compute_margin(plan, knot, x, y) + spread >= 0.0:
        strike.astray_since = math.inf
    elif strike.astray_since == math.inf:
        strike.astray_since = now
    elif now >= strike.astray_since + options.insertion.long_astray and memory.wanted[k] == math.inf:
        memory.counts[k].stranded += 1
        memory.wanted[k] = now


@compiled
def is_served(
    plan: PlanTable, memory: WorldMemory, options: Options, k: int, index: int, now: float, time: float
) -> bool:
    """Return whether the robot of a planned impact can be there at a time."""
    r = plan.impact[index].robot
    x, y = find_contact(plan, memory, k, index)
    free = time >= compute_arrival(plan, memory, options, k, index)
    return free and is_reachable(plan, memory, options, k, r, x, y, 0.0, 0.0, time - now)


@compiled
def compute_leg(
    plan: PlanTable, memory: WorldMemory, options: Options, k: int, o: int, knot: int, over: bool, time: float
) -> float:
    """Return how long the flight from an inserted impact to the knot after it may take [s]."""
    x, y, _, _ = extrapolate_flight(memory, k, plan.robots + o, time)
    if over:
        return plan.horizon - time
    way = math.hypot(memory.place[k, knot, 0] - x, memory.place[k, knot, 1] - y)
    longest = max(plan.knot[knot].closes - time, options.insertion.least_leg)
    return max(memory.clock[k, knot] - time, min(way / options.aim.cruise, longest), options.insertion.least_leg)


@compiled
def choose_robot(
    plan: PlanTable,
    memory: WorldMemory,
    options: Options,
    k: int,
    o: int,
    knot: int,
    over: bool,
    now: float,
    time: float,
    duration: float,
) -> int:
    """Return the robot in the best position for an impact on object o at a time, or NO_ROBOT."""
    body = plan.robots + o
    drift_x, drift_y = find_drift(memory.filter[k, body])
    x, y, vx, vy = extrapolate_flight(memory, k, body, time)
    if not over and time + duration > plan.knot[knot].closes + ROUND_OFF:
        return NO_ROBOT
    target_x, target_y = memory.place[k, knot, 0], memory.place[k, knot, 1]
    if over:
        share = find_share(plan, options, knot, x, y, target_x, target_y)
        target_x, target_y = x + share * (target_x - x), y + share * (target_y - y)
    limit = plan.body[body].speed_limit
    from_x, from_y = find_mass(memory, k, body, time)
    wish = compute_desired_velocity(from_x, from_y, target_x, target_y, duration, drift_x, drift_y, limit)
    if over:
        wish = choose_stay(plan, memory, options, k, o, NO_ROBOT, time, duration, wish)
    dx, dy = wish[0] - vx, wish[1] - vy
    change = math.hypot(dx, dy)
    best, found = options.insertion.side, NO_ROBOT
    if change < options.insertion.least_change:
        return NO_ROBOT
    nx, ny = dx / change, dy / change
    for r in range(plan.robots):
        event, _, index = find_next_event(plan, memory, k, r)
        mine = memory.strike[k, o].robot == r
        if memory.course[k, r].ends_in_impact and not mine:
            continue
        reach = plan.body[r].radius + plan.body[body].radius
        px, py = x - reach * nx, y - reach * ny
        if index != NO_IMPACT and not mine:
            # The robot has to be at its own next impact in time.
            cx, cy = find_contact(plan, memory, k, index)
            if event < time + max(options.insertion.rest, compute_time(plan, options, r, math.hypot(cx - px, cy - py))):
                continue
        a = memory.filter[k, r]
        distance = math.hypot(x - a.position[0], y - a.position[1])
        cosine = ((x - a.position[0]) * nx + (y - a.position[1]) * ny) / max(distance, ROUND_OFF)
        inside = compute_room(plan, memory, k, o, r, time, wish[0], wish[1]) >= options.insertion.wall
        if options.walls:
            inside = inside and is_way_clear(plan, r, a.position[0], a.position[1], px, py)
        speed = change / compute_pair_gain(memory, k, r, o)
        limit = plan.body[r].speed_limit
        if max(abs(vx + speed * nx), abs(vy + speed * ny)) > limit:
            continue  # too slow to meet the object as it flies and to push it
        reachable = is_reachable(plan, memory, options, k, r, px, py, vx + speed * nx, vy + speed * ny, time - now)
        if inside and reachable and cosine > best:
            best, found = cosine, r
    if found != NO_ROBOT:
        reference = memory.strike[k, o].reference_normal
        reference[0], reference[1] = nx, ny
    return found

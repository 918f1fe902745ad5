"""Add an unplanned impact on an object that goes astray, by the robot in the best position; compiled."""

from __future__ import annotations

import math

from impact_envs.compiled import compiled
from planners.free_flyer.belief.estimator import compute_variance, extrapolate_flight
from planners.free_flyer.belief.impact_parameters import compute_pair_gain
from planners.free_flyer.belief.options import Options
from planners.free_flyer.belief.plan_table import NO_IMPACT, PlanTable
from planners.free_flyer.belief.world_memory import NO_ROBOT, WorldMemory, find_next_event
from planners.free_flyer.next_impact.bookkeeping import set_clocks, set_time
from planners.free_flyer.next_impact.desired_velocity import (
    CRUISE,
    ROUND_OFF,
    SAME_SIDE,
    choose_desired_velocity,
    compute_desired_velocity,
    compute_margin,
    compute_room,
    compute_turn,
    find_share,
)
from planners.free_flyer.next_impact.reachability import compute_arrival, compute_time, find_contact, is_reachable
from planners.free_flyer.next_impact.retiming import RESERVE

SAFE = 0.02  # an impact is inserted where a knot's demands would be met by less than this [m]
SAFE_DEVIATIONS = 0.5  # and so many standard deviations less,
DEVIATIONS = 1.0
SHALLOW = 0.3  # or, after the last impact, for ending less deep than this share of the plan's margin
MOST_INSERTED = 4
LONG_ASTRAY = 5.0  # without a robot that could mend it, until a new plan is wanted [s],
SOON = 2.0  # or this if what is left of the plan has no optimum
LEADS = (6.0, 7.0, 9.0, 5.0, 4.0, 12.0, 15.0, 20.0)  # from now to an inserted impact [s]
HASTES = (1.0, 0.7, 0.5)  # of the flight after it, by which its direction comes nearer to the flight's
LEAST_LEG = 3.0  # after an inserted impact [s]
REST = 5.0  # of its robot before the next one [s]
LEAST_CHANGE = 4e-3  # of the object's velocity that is worth an impact [m/s]
SIDE = 0.6  # cosine between the way from robot to object and the change of velocity, at least
EDGE = 0.2  # or if its robot would come so near to the edge of areas it may not leave [m]
WALL = 0.1  # kept by the robot from the edge of areas it may not leave [m]


@compiled
def insert_impact(plan: PlanTable, memory: WorldMemory, options: Options, k: int, o: int, now: float) -> None:
    """Add an unplanned impact on object o if it would miss its next knot's demands, or end without enough margin."""
    strike, body = memory.strike[k, o], plan.robots + o
    index = strike.index
    over = index == NO_IMPACT
    knot = len(plan.impact) + o if over else index
    time = plan.horizon if over else strike.time
    x, y, _, _ = extrapolate_flight(memory, k, body, time)
    spread = (DEVIATIONS if over else SAFE_DEVIATIONS) * math.sqrt(max(compute_variance(memory, k, body, time), 0.0))
    needed = SHALLOW * plan.knot[knot].depth if over else SAFE
    astray = compute_margin(plan, knot, x, y) + spread < needed
    if not over and not astray:
        wish_x, wish_y = choose_desired_velocity(plan, memory, options, k, o)
        room = compute_room(plan, memory, k, o, strike.robot, time, wish_x, wish_y)
        turned = compute_turn(plan, memory, k, o, wish_x, wish_y) < SAME_SIDE
        astray = room + spread < EDGE or turned
    if not astray:
        strike.astray_since = math.inf
    if not astray or plan.horizon - now < LEADS[0] + REST:
        return
    for lead in LEADS:
        if strike.insertions >= MOST_INSERTED:
            break
        for haste in HASTES:
            duration = haste * compute_leg(plan, memory, k, o, knot, over, now + lead)
            if now + lead + duration > plan.horizon - (0.0 if over else RESERVE) or duration < LEAST_LEG:
                continue
            if not over and not is_served(plan, memory, k, index, now, now + lead + duration):
                continue
            robot = choose_robot(plan, memory, k, o, knot, over, now, now + lead, duration)
            if robot == NO_ROBOT:
                continue
            strike.is_inserted, strike.robot, strike.time, strike.is_decided = True, robot, now + lead, True
            strike.replanned_at, strike.scale, strike.turn = -math.inf, 0.0, 0.0
            strike.misses, strike.is_solved, strike.insertions = 0, False, strike.insertions + 1
            if not over:
                set_time(plan, memory, k, o, index, now + lead + duration)
                strike.time = now + lead
            memory.counts[k].inserted += 1
            set_clocks(plan, memory, k, now)
            return
    if compute_margin(plan, knot, x, y) + spread >= 0.0:
        strike.astray_since = math.inf
    elif strike.astray_since == math.inf:
        strike.astray_since = now
    elif now >= strike.astray_since + LONG_ASTRAY and memory.wanted[k] == math.inf:
        memory.counts[k].stranded += 1
        memory.wanted[k] = now


@compiled
def is_served(plan: PlanTable, memory: WorldMemory, k: int, index: int, now: float, time: float) -> bool:
    """Return whether the robot of a planned impact can be there at a time."""
    r = plan.impact[index].robot
    x, y = find_contact(plan, memory, k, index)
    free = time >= compute_arrival(plan, memory, k, index)
    return free and is_reachable(plan, memory, k, r, x, y, 0.0, 0.0, time - now)


@compiled
def compute_leg(plan: PlanTable, memory: WorldMemory, k: int, o: int, knot: int, over: bool, time: float) -> float:
    """Return how long the flight from an inserted impact to the knot after it may take [s]."""
    x, y, _, _ = extrapolate_flight(memory, k, plan.robots + o, time)
    if over:
        return plan.horizon - time
    way = math.hypot(memory.place[k, knot, 0] - x, memory.place[k, knot, 1] - y)
    longest = max(plan.knot[knot].closes - time, LEAST_LEG)
    return max(memory.clock[k, knot] - time, min(way / CRUISE, longest), LEAST_LEG)


@compiled
def choose_robot(
    plan: PlanTable,
    memory: WorldMemory,
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
    z = memory.filter[k, body]
    x, y, vx, vy = extrapolate_flight(memory, k, body, time)
    if not over and time + duration > plan.knot[knot].closes + ROUND_OFF:
        return NO_ROBOT
    target_x, target_y = memory.place[k, knot, 0], memory.place[k, knot, 1]
    if over:
        share = find_share(plan, knot, x, y, target_x, target_y)
        target_x, target_y = x + share * (target_x - x), y + share * (target_y - y)
    limit = plan.body[body].speed_limit
    wish = compute_desired_velocity(x, y, target_x, target_y, duration, z.drift[0], z.drift[1], limit)
    dx, dy = wish[0] - vx, wish[1] - vy
    change = math.hypot(dx, dy)
    best, found = SIDE, NO_ROBOT
    if change < LEAST_CHANGE:
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
            if event < time + max(REST, compute_time(plan, r, math.hypot(cx - px, cy - py))):
                continue
        a = memory.filter[k, r]
        distance = math.hypot(x - a.position[0], y - a.position[1])
        cosine = ((x - a.position[0]) * nx + (y - a.position[1]) * ny) / max(distance, ROUND_OFF)
        inside = compute_room(plan, memory, k, o, r, time, wish[0], wish[1]) >= WALL
        speed = change / compute_pair_gain(memory, k, r, o)
        reachable = is_reachable(plan, memory, k, r, px, py, vx + speed * nx, vy + speed * ny, time - now)
        if inside and reachable and cosine > best:
            best, found = cosine, r
    if found != NO_ROBOT:
        reference = memory.strike[k, o].reference_normal
        reference[0], reference[1] = nx, ny
    return found

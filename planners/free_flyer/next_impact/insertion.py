"""Hit an object once more where it goes astray, by the robot that stands best."""

from __future__ import annotations

import math

from impact_envs.compiled import compiled
from planners.free_flyer.belief.estimator import compute_variance, extrapolate
from planners.free_flyer.belief.impact_parameters import compute_pair_gain
from planners.free_flyer.belief.options import Options
from planners.free_flyer.belief.plan_table import (
    CLOSE,
    DEPTH,
    END,
    RADIUS,
    ROBOT,
    SPEED,
    PlanTable,
)
from planners.free_flyer.belief.world_memory import (
    AGENT,
    ASTRAY,
    DECIDED,
    EXTRA,
    IMPACT_INDEX,
    INSERTED,
    INSERTS,
    MISSES,
    REFERENCE_X,
    REFERENCE_Y,
    REPLANNED,
    SCALE,
    SOLVED,
    STRANDED,
    TIME,
    TURN,
    WorldMemory,
    find_next_event,
)
from planners.free_flyer.next_impact.bookkeeping import set_clocks, set_time
from planners.free_flyer.next_impact.desired_velocity import (
    CRUISE,
    ROUND_OFF,
    SAME_SIDE,
    aim,
    compute_desired_velocity,
    compute_margin,
    compute_room,
    compute_turn,
    find_share,
)
from planners.free_flyer.next_impact.reachability import compute_arrival, compute_time, find_contact, is_reachable
from planners.free_flyer.next_impact.retiming import RESERVE
from planners.free_flyer.tracking.course import IMPACT

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
def insert(plan: PlanTable, memory: WorldMemory, options: Options, k: int, o: int, now: float) -> None:
    """Hit object o once more where it would miss its next knot's demands, or end without enough margin."""
    strike, body = memory.strike[k, o], plan.robots + o
    index = int(strike[IMPACT_INDEX])
    over = index == END
    knot = len(plan.impact) + o if over else index
    time = plan.horizon if over else strike[TIME]
    x, y, _, _ = extrapolate(memory, k, body, time)
    spread = (DEVIATIONS if over else SAFE_DEVIATIONS) * math.sqrt(max(compute_variance(memory, k, body, time), 0.0))
    needed = SHALLOW * plan.knot[knot, DEPTH] if over else SAFE
    astray = compute_margin(plan, knot, x, y) + spread < needed
    if not over and not astray:
        wish_x, wish_y = aim(plan, memory, options, k, o)
        room = compute_room(plan, memory, k, o, int(strike[AGENT]), time, wish_x, wish_y)
        turned = compute_turn(plan, memory, k, o, wish_x, wish_y) < SAME_SIDE
        astray = room + spread < EDGE or turned
    if not astray:
        strike[ASTRAY] = math.inf
    if not astray or plan.horizon - now < LEADS[0] + REST:
        return
    for lead in LEADS:
        if strike[EXTRA] >= MOST_INSERTED:
            break
        for haste in HASTES:
            duration = haste * compute_leg(plan, memory, k, o, knot, over, now + lead)
            if now + lead + duration > plan.horizon - (0.0 if over else RESERVE) or duration < LEAST_LEG:
                continue
            if not over and not is_served(plan, memory, k, index, now, now + lead + duration):
                continue
            agent = choose_agent(plan, memory, k, o, knot, over, now, now + lead, duration)
            if agent == END:
                continue
            strike[INSERTED], strike[AGENT], strike[TIME], strike[DECIDED] = 1.0, agent, now + lead, 1.0
            strike[REPLANNED], strike[SCALE], strike[TURN] = -math.inf, 0.0, 0.0
            strike[MISSES], strike[SOLVED], strike[EXTRA] = 0.0, 0.0, strike[EXTRA] + 1.0
            if not over:
                set_time(plan, memory, k, o, index, now + lead + duration)
                strike[TIME] = now + lead
            memory.counts[k, INSERTS] += 1
            set_clocks(plan, memory, k, now)
            return
    if compute_margin(plan, knot, x, y) + spread >= 0.0:
        strike[ASTRAY] = math.inf
    elif strike[ASTRAY] == math.inf:
        strike[ASTRAY] = now
    elif now >= strike[ASTRAY] + LONG_ASTRAY and memory.wanted[k] == math.inf:
        memory.counts[k, STRANDED] += 1
        memory.wanted[k] = now


@compiled
def is_served(plan: PlanTable, memory: WorldMemory, k: int, index: int, now: float, time: float) -> bool:
    """Return whether the robot of a planned impact can be there at a time."""
    r = int(plan.impact[index, ROBOT])
    x, y = find_contact(plan, memory, k, index)
    free = time >= compute_arrival(plan, memory, k, index)
    return free and is_reachable(plan, memory, k, r, x, y, 0.0, 0.0, time - now)


@compiled
def compute_leg(plan: PlanTable, memory: WorldMemory, k: int, o: int, knot: int, over: bool, time: float) -> float:
    """Return how long the flight from an inserted impact to the knot after it may take [s]."""
    x, y, _, _ = extrapolate(memory, k, plan.robots + o, time)
    if over:
        return plan.horizon - time
    way = math.hypot(memory.place[k, knot, 0] - x, memory.place[k, knot, 1] - y)
    longest = max(plan.knot[knot, CLOSE] - time, LEAST_LEG)
    return max(memory.clock[k, knot] - time, min(way / CRUISE, longest), LEAST_LEG)


@compiled
def choose_agent(
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
    """Return the robot that stands best for an impact on object o at a time, or END."""
    body = plan.robots + o
    z = memory.filter[k, body]
    x, y, vx, vy = extrapolate(memory, k, body, time)
    if not over and time + duration > plan.knot[knot, CLOSE] + ROUND_OFF:
        return END
    target_x, target_y = memory.place[k, knot, 0], memory.place[k, knot, 1]
    if over:
        share = find_share(plan, knot, x, y, target_x, target_y)
        target_x, target_y = x + share * (target_x - x), y + share * (target_y - y)
    wish = compute_desired_velocity(x, y, target_x, target_y, duration, z[4], z[5], plan.body[body, SPEED])
    dx, dy = wish[0] - vx, wish[1] - vy
    change = math.hypot(dx, dy)
    best, found = SIDE, END
    if change < LEAST_CHANGE:
        return END
    nx, ny = dx / change, dy / change
    for r in range(plan.robots):
        event, _, index = find_next_event(plan, memory, k, r)
        mine = memory.strike[k, o, AGENT] == r
        if memory.course[k, r, IMPACT] > 0.0 and not mine:
            continue
        reach = plan.body[r, RADIUS] + plan.body[body, RADIUS]
        px, py = x - reach * nx, y - reach * ny
        if index != END and not mine:
            # The robot has to be at its own next impact in time.
            cx, cy = find_contact(plan, memory, k, index)
            if event < time + max(REST, compute_time(plan, r, math.hypot(cx - px, cy - py))):
                continue
        a = memory.filter[k, r]
        distance = math.hypot(x - a[0], y - a[1])
        cosine = ((x - a[0]) * nx + (y - a[1]) * ny) / max(distance, ROUND_OFF)
        inside = compute_room(plan, memory, k, o, r, time, wish[0], wish[1]) >= WALL
        speed = change / compute_pair_gain(memory, k, r, o)
        reachable = is_reachable(plan, memory, k, r, px, py, vx + speed * nx, vy + speed * ny, time - now)
        if inside and reachable and cosine > best:
            best, found = cosine, r
    if found != END:
        memory.strike[k, o, REFERENCE_X], memory.strike[k, o, REFERENCE_Y] = nx, ny
    return found

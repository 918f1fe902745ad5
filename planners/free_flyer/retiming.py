"""When and how often an object is hit: move an impact to where the object will be, insert one where it goes astray."""

from __future__ import annotations

import math

from impact_envs.compiled import compiled
from planners.free_flyer.aim import (
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
from planners.free_flyer.course import IMPACT
from planners.free_flyer.estimator import compute_variance, extrapolate
from planners.free_flyer.options import Options
from planners.free_flyer.pair_estimate import compute_pair_gain
from planners.free_flyer.progress import (
    AGENT,
    ASTRAY,
    DECIDED,
    EXTRA,
    IMPACT_INDEX,
    INSERTED,
    INSERTS,
    LAST,
    LOOKED,
    MISSES,
    NO_OPTIMUM,
    OPTIMISED,
    REFERENCE_X,
    REFERENCE_Y,
    REOPTIMISED,
    REPLANNED,
    RETIMED,
    SCALE,
    SOLVED,
    STRANDED,
    TIME,
    TURN,
    Progress,
    find_next_event,
)
from planners.free_flyer.reach import compute_arrival, compute_time, find_contact, is_reachable
from planners.free_flyer.reoptimisation import Program, reoptimise
from planners.free_flyer.script import (
    CLOSE,
    DEPTH,
    END,
    NEXT,
    OPEN,
    RADIUS,
    ROBOT,
    SPEED,
    Script,
)
from planners.free_flyer.strike import REPLAN_PERIOD, SETTLE, set_clocks, set_time

FROZEN = 4.0  # before an impact its time is kept [s]
CANDIDATES = 121
REFINED = 20
CROWDING = 0.1  # the object should be hit so deep inside what its knot demands [m]
OUTSIDE = 20.0  # weight of missing that, squared, over missing the planned place, squared
PULL = 1e-5  # weight of changing the time, squared [m^2/s^2]
RESERVE = 4.0  # after the last impact [s], or
RESERVE_SHARE = 0.1  # of the horizon
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
def look_ahead(
    script: Script, progress: Progress, options: Options, program: Program, c: int, k: int, now: float
) -> None:
    """Move or insert the coming impacts of world k, where options say so and the objects' flight is known."""
    for o in range(len(script.first)):
        strike = progress.strike[k, o]
        settled = now >= strike[LAST] + SETTLE - ROUND_OFF
        if not settled or strike[INSERTED] > 0.0 or now < strike[LOOKED] + REPLAN_PERIOD - ROUND_OFF:
            continue
        strike[LOOKED] = now
        if options.reoptimise and strike[LAST] > strike[OPTIMISED] and strike[IMPACT_INDEX] != END:
            strike[OPTIMISED] = now
            if reoptimise(script, progress, program, c, k, o, now):
                progress.counts[k, REOPTIMISED] += 1
                set_clocks(script, progress, k, now)
            else:
                progress.counts[k, NO_OPTIMUM] += 1
                # Its rows are on the safe side: a new plan is wanted if the flight does go astray, but sooner.
                strike[ASTRAY] = min(strike[ASTRAY], now - LONG_ASTRAY + SOON)
        if options.retime and strike[LAST] > 0.0 and strike[IMPACT_INDEX] != END and now <= strike[TIME] - FROZEN:
            retime(script, progress, k, o, now)
        if options.insert and strike[LAST] > 0.0:
            insert(script, progress, options, k, o, now)


@compiled
def compute_reserve(script: Script, progress: Progress, k: int, knot: int) -> float:
    """Return the latest time of an impact from which all later ones can be reached [s]."""
    latest, at = script.horizon - max(RESERVE, RESERVE_SHARE * script.horizon), int(script.impact[knot, NEXT])
    x, y = progress.place[k, knot, 0], progress.place[k, knot, 1]
    while at != END:
        latest -= math.hypot(progress.place[k, at, 0] - x, progress.place[k, at, 1] - y) / CRUISE
        x, y = progress.place[k, at, 0], progress.place[k, at, 1]
        at = int(script.impact[at, NEXT])
    return latest


@compiled
def retime(script: Script, progress: Progress, k: int, o: int, now: float) -> None:
    """Move the coming impact of object o to when the object is nearest to where it should be hit.

    min_t |x_O(t) - P_k|^2 + 20 max(0, crowding - margin_k(x_O(t)))^2 + 1e-5 (t - t_k)^2
    """
    strike = progress.strike[k, o]
    index, old = int(strike[IMPACT_INDEX]), strike[TIME]
    latest = min(script.knot[index, CLOSE], max(compute_reserve(script, progress, k, index), old))
    notice = FROZEN
    r = int(strike[AGENT])
    place_x, place_y = find_contact(script, progress, k, index)
    while now + notice < old and not is_reachable(script, progress, k, r, place_x, place_y, 0.0, 0.0, notice):
        notice += 1.0
    earliest = min(max(now + notice, script.knot[index, OPEN]), old)
    best, time = compute_miss(script, progress, k, o, old, old), old
    arrival = compute_arrival(script, progress, k, index)
    if arrival > old:
        # Its robot has to hit something else before: the impact comes when it can.
        earliest, latest, best = arrival, max(latest, arrival + FROZEN), math.inf
    earliest = max(earliest, arrival)
    if latest <= earliest:
        return
    step = (latest - earliest) / (CANDIDATES - 1)
    for i in range(CANDIDATES):
        t = earliest + i * step
        miss = compute_miss(script, progress, k, o, t, old)
        if miss < best:
            best, time = miss, t
    middle = time
    for i in range(1, 2 * REFINED):
        t = min(max(middle + (i / REFINED - 1.0) * step, earliest), latest)
        miss = compute_miss(script, progress, k, o, t, old)
        if miss < best:
            best, time = miss, t
    if abs(time - old) > ROUND_OFF:
        progress.counts[k, RETIMED] += 1
        set_time(script, progress, k, o, index, time)
        set_clocks(script, progress, k, now)


@compiled
def compute_miss(script: Script, progress: Progress, k: int, o: int, time: float, old: float) -> float:
    """Return what `retime` minimises."""
    knot = int(progress.strike[k, o, IMPACT_INDEX])
    x, y, _, _ = extrapolate(progress, k, script.robots + o, time)
    dx, dy = x - progress.place[k, knot, 0], y - progress.place[k, knot, 1]
    outside = max(min(CROWDING, 0.4 * script.knot[knot, DEPTH]) - compute_margin(script, knot, x, y), 0.0)
    return dx * dx + dy * dy + OUTSIDE * outside * outside + PULL * (time - old) * (time - old)


@compiled
def insert(script: Script, progress: Progress, options: Options, k: int, o: int, now: float) -> None:
    """Hit object o once more where it would miss its next knot's demands, or end without enough margin."""
    strike, body = progress.strike[k, o], script.robots + o
    index = int(strike[IMPACT_INDEX])
    over = index == END
    knot = len(script.impact) + o if over else index
    time = script.horizon if over else strike[TIME]
    x, y, _, _ = extrapolate(progress, k, body, time)
    spread = (DEVIATIONS if over else SAFE_DEVIATIONS) * math.sqrt(max(compute_variance(progress, k, body, time), 0.0))
    needed = SHALLOW * script.knot[knot, DEPTH] if over else SAFE
    astray = compute_margin(script, knot, x, y) + spread < needed
    if not over and not astray:
        wish_x, wish_y = aim(script, progress, options, k, o)
        room = compute_room(script, progress, k, o, int(strike[AGENT]), time, wish_x, wish_y)
        turned = compute_turn(script, progress, k, o, wish_x, wish_y) < SAME_SIDE
        astray = room + spread < EDGE or turned
    if not astray:
        strike[ASTRAY] = math.inf
    if not astray or script.horizon - now < LEADS[0] + REST:
        return
    for lead in LEADS:
        if strike[EXTRA] >= MOST_INSERTED:
            break
        for haste in HASTES:
            duration = haste * compute_leg(script, progress, k, o, knot, over, now + lead)
            if now + lead + duration > script.horizon - (0.0 if over else RESERVE) or duration < LEAST_LEG:
                continue
            if not over and not is_served(script, progress, k, index, now, now + lead + duration):
                continue
            agent = choose_agent(script, progress, k, o, knot, over, now, now + lead, duration)
            if agent == END:
                continue
            strike[INSERTED], strike[AGENT], strike[TIME], strike[DECIDED] = 1.0, agent, now + lead, 1.0
            strike[REPLANNED], strike[SCALE], strike[TURN] = -math.inf, 0.0, 0.0
            strike[MISSES], strike[SOLVED], strike[EXTRA] = 0.0, 0.0, strike[EXTRA] + 1.0
            if not over:
                set_time(script, progress, k, o, index, now + lead + duration)
                strike[TIME] = now + lead
            progress.counts[k, INSERTS] += 1
            set_clocks(script, progress, k, now)
            return
    if compute_margin(script, knot, x, y) + spread >= 0.0:
        strike[ASTRAY] = math.inf
    elif strike[ASTRAY] == math.inf:
        strike[ASTRAY] = now
    elif now >= strike[ASTRAY] + LONG_ASTRAY and progress.wanted[k] == math.inf:
        progress.counts[k, STRANDED] += 1
        progress.wanted[k] = now


@compiled
def is_served(script: Script, progress: Progress, k: int, index: int, now: float, time: float) -> bool:
    """Return whether the robot of a planned impact can be there at a time."""
    r = int(script.impact[index, ROBOT])
    x, y = find_contact(script, progress, k, index)
    free = time >= compute_arrival(script, progress, k, index)
    return free and is_reachable(script, progress, k, r, x, y, 0.0, 0.0, time - now)


@compiled
def compute_leg(script: Script, progress: Progress, k: int, o: int, knot: int, over: bool, time: float) -> float:
    """Return how long the flight from an inserted impact to the knot after it may take [s]."""
    x, y, _, _ = extrapolate(progress, k, script.robots + o, time)
    if over:
        return script.horizon - time
    way = math.hypot(progress.place[k, knot, 0] - x, progress.place[k, knot, 1] - y)
    longest = max(script.knot[knot, CLOSE] - time, LEAST_LEG)
    return max(progress.clock[k, knot] - time, min(way / CRUISE, longest), LEAST_LEG)


@compiled
def choose_agent(
    script: Script, progress: Progress, k: int, o: int, knot: int, over: bool, now: float, time: float, duration: float
) -> int:
    """Return the robot that stands best for an impact on object o at a time, or END."""
    body = script.robots + o
    z = progress.filter[k, body]
    x, y, vx, vy = extrapolate(progress, k, body, time)
    if not over and time + duration > script.knot[knot, CLOSE] + ROUND_OFF:
        return END
    target_x, target_y = progress.place[k, knot, 0], progress.place[k, knot, 1]
    if over:
        share = find_share(script, knot, x, y, target_x, target_y)
        target_x, target_y = x + share * (target_x - x), y + share * (target_y - y)
    wish = compute_desired_velocity(x, y, target_x, target_y, duration, z[4], z[5], script.body[body, SPEED])
    dx, dy = wish[0] - vx, wish[1] - vy
    change = math.hypot(dx, dy)
    best, found = SIDE, END
    if change < LEAST_CHANGE:
        return END
    nx, ny = dx / change, dy / change
    for r in range(script.robots):
        event, _, index = find_next_event(script, progress, k, r)
        mine = progress.strike[k, o, AGENT] == r
        if progress.course[k, r, IMPACT] > 0.0 and not mine:
            continue
        reach = script.body[r, RADIUS] + script.body[body, RADIUS]
        px, py = x - reach * nx, y - reach * ny
        if index != END and not mine:
            # The robot has to be at its own next impact in time.
            cx, cy = find_contact(script, progress, k, index)
            if event < time + max(REST, compute_time(script, r, math.hypot(cx - px, cy - py))):
                continue
        a = progress.filter[k, r]
        distance = math.hypot(x - a[0], y - a[1])
        cosine = ((x - a[0]) * nx + (y - a[1]) * ny) / max(distance, ROUND_OFF)
        inside = compute_room(script, progress, k, o, r, time, wish[0], wish[1]) >= WALL
        speed = change / compute_pair_gain(progress, k, r, o)
        reachable = is_reachable(script, progress, k, r, px, py, vx + speed * nx, vy + speed * ny, time - now)
        if inside and reachable and cosine > best:
            best, found = cosine, r
    if found != END:
        progress.strike[k, o, REFERENCE_X], progress.strike[k, o, REFERENCE_Y] = nx, ny
    return found

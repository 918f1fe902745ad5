"""The coming impact of every object: when it is expected, what came of the last one, where to aim; compiled."""

from __future__ import annotations

import math

from impact_envs.compiled import compiled
from planners.free_flyer.course import IMPACT, STOP, read_clock, return_to_plan, set_clock
from planners.free_flyer.estimator import extrapolate
from planners.free_flyer.options import Options
from planners.free_flyer.progress import (
    AGENT,
    APPROACH,
    BEFORE_X,
    BEFORE_Y,
    CHANGE,
    COMMANDED,
    DECIDED,
    FACTOR,
    GIVE_UP,
    HIT_AT,
    IMPACT_INDEX,
    INSERTED,
    KNOWN_FACTOR,
    KNOWN_SPREAD,
    LAST,
    LATEST_X,
    LATEST_Y,
    LOOKED,
    MISSES,
    OUTCOME,
    PENDING,
    RATIO,
    REFERENCE_X,
    REFERENCE_Y,
    REPLANNED,
    REPLANS,
    RETRY,
    SCALE,
    SEEN,
    SOLVED,
    SPREAD,
    TIME,
    TURN,
    UNPLANNED,
    Progress,
    find_next_event,
)
from planners.free_flyer.script import (
    AT,
    CLOSE,
    DEPTH,
    END,
    FACES,
    KNOT_X,
    KNOT_Y,
    NEXT,
    NORMAL_X,
    NORMAL_Y,
    OPEN,
    RADIUS,
    ROBOT,
    SPEED,
    Script,
)
from planners.free_flyer.two_body import Outcome

SETTLE = 1.5  # after a contact, until the object's velocity is known well enough to plan with [s]
DECISION_LEAD = 8.0  # before an impact its correction is decided [s]
DECISION_SETTLE = 2.5  # after the previous contact, at least [s]
REPLAN_LAST = 1.0  # before an impact; later changes only shake the robot [s]
REPLAN_PERIOD = 0.5  # [s]
SHORTEST_NOTICE = DECISION_SETTLE + REPLAN_LAST + REPLAN_PERIOD  # of an impact after a contact that came late [s]
EARLIEST = 2.0  # before the expected impact a contact is taken for it [s]
PATIENCE = 1.5  # after the expected impact it counts as missed [s]
RETRY_IN = 5.0  # a missed impact is tried again after [s]
RETRIES = 3
OBSERVABLE = 1.0  # after a contact the object's velocity change can be observed [s]
PRIOR_SPREAD = 0.13  # standard deviation of the true over the believed velocity gain
APPROACH_ERROR = 4e-3  # standard deviation of the estimated approach speed [m/s]
MODEL_ERROR = 0.02  # standard deviation of an observed factor, at least
RETURN_SECONDS = 12.0  # longest quintic back to the plan
FASTEST_CLOCK = 1.5  # plan seconds per second; more would force the end pose within the few seconds left
SHORTEST_LEG = 5.0  # a delayed impact does not make the object faster than for a leg of this duration [s]
# The last impact brings the object to its end if as much time is left [s], otherwise only deep enough into its goal.
FULL_CORRECTION = 15.0
DEEP_ENOUGH = 0.65  # of the plan's margin
BEND = 0.25  # from the straight way that a drifting object may fly, at most half the next knot's depth [m]
CRUISE = 0.15  # speed at which any leg can be flown [m/s]
SHARES, SMALLEST = 20, 1e-3  # of the way to the plan's end that are tried, and the preference for a short way [m]
SAME_SIDE = 0.3  # cosine by which an impulse may turn from the planned normal, beyond which its robot had to go round
OTHER_SIDE = 1.0  # how much less a way to the plan's end is worth for that [m]
ROUND_OFF = 1e-6  # of times [s]


@compiled
def start_strikes(script: Script, progress: Progress, k: int) -> None:
    """Start world k with the first impact of every object."""
    for i in range(len(script.impact)):
        # What has to happen in a window is expected in its first half: late objects are the rule.
        middle = (script.knot[i, OPEN] + script.knot[i, CLOSE]) / 2
        progress.clock[k, i] = min(script.impact[i, AT], middle)
    for o in range(len(script.first)):
        for column in range(progress.strike.shape[2]):
            progress.strike[k, o, column] = 0.0
        for column in range(progress.hit.shape[2]):
            progress.hit[k, o, column] = 0.0
        progress.strike[k, o, LAST] = progress.strike[k, o, LOOKED] = -math.inf
        progress.hit[k, o, FACTOR] = progress.hit[k, o, KNOWN_FACTOR] = 1.0
        progress.hit[k, o, SPREAD] = progress.hit[k, o, KNOWN_SPREAD] = PRIOR_SPREAD * PRIOR_SPREAD
        await_impact(script, progress, k, o, int(script.first[o]), 0.0)


@compiled
def await_impact(script: Script, progress: Progress, k: int, o: int, index: int, now: float) -> None:
    """Make a planned impact, or END, the coming one of object o."""
    strike = progress.strike[k, o]
    strike[IMPACT_INDEX], strike[INSERTED], strike[MISSES], strike[REPLANNED] = index, 0.0, 0.0, -math.inf
    strike[SCALE], strike[TURN], strike[DECIDED], strike[SOLVED] = 0.0, 0.0, 0.0, 0.0
    strike[AGENT], strike[TIME] = -1.0, math.inf
    if index != END:
        strike[AGENT] = script.impact[index, ROBOT]
        strike[REFERENCE_X], strike[REFERENCE_Y] = script.impact[index, NORMAL_X], script.impact[index, NORMAL_Y]
        earliest = now + SHORTEST_NOTICE if now > 0.0 else 0.0
        set_time(script, progress, k, o, index, max(progress.clock[k, index], earliest))


@compiled
def set_time(script: Script, progress: Progress, k: int, o: int, index: int, time: float) -> None:
    """Expect a planned impact at a time; later ones of the object share the time that is left."""
    old = progress.clock[k, index]
    share = (script.horizon - time) / max(script.horizon - old, ROUND_OFF)
    progress.strike[k, o, TIME] = progress.clock[k, index] = time
    at = int(script.impact[index, NEXT])
    while at != END and time != old:
        moved = time + (progress.clock[k, at] - old) * share
        earliest, latest = script.knot[at, OPEN], max(script.knot[at, CLOSE], time)
        progress.clock[k, at] = min(max(moved, earliest), latest)
        at = int(script.impact[at, NEXT])


@compiled
def set_clocks(script: Script, progress: Progress, k: int, now: float) -> None:
    """Let every robot that follows its plan arrive at its next event when it is expected."""
    for r in range(script.robots):
        if progress.course[k, r, IMPACT] == 0.0:
            time, planned, _ = find_next_event(script, progress, k, r)
            tau = min(read_clock(progress.course, k, r, now), progress.course[k, r, STOP])
            set_clock(progress.course, k, r, now, tau, time, planned, FASTEST_CLOCK)


@compiled
def go_back(script: Script, progress: Progress, k: int, r: int, now: float, tau: float) -> None:
    """Plan robot r's course back to its plan, which stands at tau."""
    time, planned, _ = find_next_event(script, progress, k, r)
    z = progress.filter[k, r]
    begin = (z[0], z[1], z[2], z[3])
    return_to_plan(
        progress.course,
        script.breaks,
        script.coefficients,
        k,
        r,
        now,
        begin,
        tau,
        time,
        planned,
        RETURN_SECONDS,
        FASTEST_CLOCK,
    )
    progress.counts[k, REPLANS] += 1


@compiled
def remember_before(script: Script, progress: Progress, k: int) -> None:
    """Keep the objects' velocities as they were before the impact that may come now."""
    for o in range(len(script.first)):
        z = progress.filter[k, script.robots + o]
        progress.hit[k, o, LATEST_X], progress.hit[k, o, LATEST_Y] = z[2], z[3]


@compiled
def take_contact(script: Script, progress: Progress, k: int, r: int, now: float) -> None:
    """Take note of a contact of robot r: the coming impact is done if robot, object and time fit."""
    other = progress.touch[k, r]
    tau = min(read_clock(progress.course, k, r, now), progress.course[k, r, STOP])
    if other < script.robots:
        progress.counts[k, UNPLANNED] += 1
        go_back(script, progress, k, r, now, tau)
        return
    o = other - script.robots
    strike, hit = progress.strike[k, o], progress.hit[k, o]
    strike[LAST], index = now, int(strike[IMPACT_INDEX])
    hit[KNOWN_FACTOR], hit[KNOWN_SPREAD], hit[PENDING] = hit[FACTOR], hit[SPREAD], 0.0
    expected = strike[AGENT] == r and now >= strike[TIME] - EARLIEST
    if not expected:
        progress.counts[k, UNPLANNED] += 1
        go_back(script, progress, k, r, now, tau)
        return
    if strike[SOLVED] > 0.0:
        hit[PENDING], hit[HIT_AT], hit[COMMANDED] = 1.0, now, strike[CHANGE]
        hit[BEFORE_X], hit[BEFORE_Y] = hit[LATEST_X], hit[LATEST_Y]
    if strike[INSERTED] > 0.0:
        await_impact(script, progress, k, o, index, now)
    else:
        tau = script.impact[index, AT] + min(max(now - strike[TIME], 0.0), script.period)
        await_impact(script, progress, k, o, int(script.impact[index, NEXT]), now)
    go_back(script, progress, k, r, now, tau)
    set_clocks(script, progress, k, now)


@compiled
def take_misses(script: Script, progress: Progress, options: Options, k: int, now: float) -> None:
    """Put off the impacts that are overdue, or give them up."""
    for o in range(len(script.first)):
        strike = progress.strike[k, o]
        if now <= strike[TIME] + PATIENCE:
            continue
        index, r = int(strike[IMPACT_INDEX]), int(strike[AGENT])
        outcome = int(strike[OUTCOME])
        useless = outcome == Outcome.NOT_NEEDED or outcome == Outcome.OUT_OF_REACH
        hopeless = strike[SOLVED] > 0.0 and useless
        again = strike[INSERTED] == 0.0 and not hopeless and strike[MISSES] < RETRIES
        if again and options.retime and now + RETRY_IN < script.horizon:
            strike[MISSES], strike[REPLANNED] = strike[MISSES] + 1.0, -math.inf
            set_time(script, progress, k, o, index, now + RETRY_IN)
            progress.counts[k, RETRY] += 1
        else:
            tau = min(read_clock(progress.course, k, r, now), progress.course[k, r, STOP])
            if strike[INSERTED] == 0.0:
                tau = script.impact[index, AT]
                index = int(script.impact[index, NEXT])
            await_impact(script, progress, k, o, index, now)
            go_back(script, progress, k, r, now, tau)
            progress.counts[k, GIVE_UP] += 1
        set_clocks(script, progress, k, now)


@compiled
def learn_from_hits(script: Script, progress: Progress, options: Options, k: int, now: float) -> None:
    r"""Compare what the last impact of each object did with what it should have done.

    f = |v - v_before - a (t - t_hit)| / (alpha s), s the estimated approach speed, taken into the mean by its variance
    (P_vv + (alpha sigma_s)^2) / (alpha s)^2 + sigma_model^2. One number stands for restitution and masses.
    """
    for o in range(len(script.first)):
        hit, z = progress.hit[k, o], progress.filter[k, script.robots + o]
        since = now - hit[HIT_AT]
        if hit[PENDING] == 0.0 or since < OBSERVABLE - ROUND_OFF:
            continue
        change = math.hypot(z[2] - hit[BEFORE_X] - z[4] * since, z[3] - hit[BEFORE_Y] - z[5] * since)
        if hit[COMMANDED] > 0.0:
            hit[SEEN] += 1.0 if hit[RATIO] == 0.0 else 0.0
            hit[RATIO] = change / hit[COMMANDED]
        if options.learn and hit[APPROACH] > APPROACH_ERROR:
            expected = hit[APPROACH]
            variance = (z[9] + APPROACH_ERROR * APPROACH_ERROR) / (expected * expected) + MODEL_ERROR * MODEL_ERROR
            weight = hit[KNOWN_SPREAD] / (hit[KNOWN_SPREAD] + variance)
            hit[FACTOR] = hit[KNOWN_FACTOR] + weight * (change / expected - hit[KNOWN_FACTOR])
            hit[SPREAD] = (1.0 - weight) * hit[KNOWN_SPREAD]


@compiled
def find_due(script: Script, progress: Progress, k: int, now: float) -> int:
    """Return the object whose coming impact's correction is to be decided now, or END."""
    for o in range(len(script.first)):
        strike = progress.strike[k, o]
        due = max(strike[TIME] - DECISION_LEAD, strike[LAST] + DECISION_SETTLE)
        if strike[DECIDED] == 0.0 and strike[IMPACT_INDEX] != END and now >= due - ROUND_OFF:
            return o
    return END


@compiled
def compute_margin(script: Script, knot: int, x: float, y: float) -> float:
    """Return how deep a position lies in what a knot demands, negative outside [m]; inf without demands."""
    margin = math.inf
    for i in range(int(script.knot[knot, FACES])):
        margin = min(margin, script.face[knot, i, 2] - script.face[knot, i, 0] * x - script.face[knot, i, 1] * y)
    return margin


@compiled
def find_next_knot(script: Script, progress: Progress, k: int, o: int, inserted: bool) -> tuple[int, float, bool]:
    """Return the knot after the coming impact of object o, when it is expected, and whether it is the end.

    Args:
        script: what is followed.
        progress: of all worlds.
        k: world.
        o: object.
        inserted: the coming impact is none of the plan.
    """
    index = int(progress.strike[k, o, IMPACT_INDEX])
    if index != END and not inserted:
        index = int(script.impact[index, NEXT])
    if index == END:
        return len(script.impact) + o, script.horizon, True
    return index, progress.clock[k, index], False


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
def aim(script: Script, progress: Progress, options: Options, k: int, o: int) -> tuple[float, float]:
    """Return the velocity object o should have after its coming impact [m/s]."""
    strike, body = progress.strike[k, o], script.robots + o
    z, time = progress.filter[k, body], strike[TIME]
    x, y, _, _ = extrapolate(progress, k, body, time)
    knot, due, last = find_next_knot(script, progress, k, o, strike[INSERTED] > 0.0)
    target_x, target_y = script.knot[knot, KNOT_X], script.knot[knot, KNOT_Y]
    duration = max(due - time, SHORTEST_LEG if last else 2.0)
    limit = script.body[body, SPEED]
    if not last or not options.insert or script.knot[knot, FACES] == 0.0:
        return compute_desired_velocity(x, y, target_x, target_y, duration, z[4], z[5], limit)
    # How deep is enough grows to the plan's depth with the time that is left.
    extra = min(max(duration / FULL_CORRECTION - 0.5, 0.0) * 2.0, 1.0)
    enough = (DEEP_ENOUGH + (1.0 - DEEP_ENOUGH) * extra) * script.knot[knot, DEPTH]
    best, chosen = -math.inf, 1.0
    for i in range(SHARES + 1):
        share = i / SHARES
        end_x, end_y = x + share * (target_x - x), y + share * (target_y - y)
        wish_x, wish_y = compute_desired_velocity(x, y, end_x, end_y, duration, z[4], z[5], limit)
        room = compute_room(script, progress, k, o, int(strike[AGENT]), time, wish_x, wish_y)
        score = min(compute_margin(script, knot, end_x, end_y), enough, room) - SMALLEST * share
        if compute_turn(script, progress, k, o, wish_x, wish_y) < SAME_SIDE:
            score -= OTHER_SIDE
        if score > best:
            best, chosen = score, share
    end_x, end_y = x + chosen * (target_x - x), y + chosen * (target_y - y)
    return compute_desired_velocity(x, y, end_x, end_y, duration, z[4], z[5], limit)


@compiled
def compute_turn(script: Script, progress: Progress, k: int, o: int, wish_x: float, wish_y: float) -> float:
    """Return the cosine between reference normal and change to a velocity at object o's coming impact; 1 for none."""
    strike = progress.strike[k, o]
    _, _, vx, vy = extrapolate(progress, k, script.robots + o, strike[TIME])
    dx, dy = wish_x - vx, wish_y - vy
    size = math.hypot(dx, dy)
    return 1.0 if size < ROUND_OFF else (dx * strike[REFERENCE_X] + dy * strike[REFERENCE_Y]) / size


@compiled
def compute_room(
    script: Script, progress: Progress, k: int, o: int, r: int, time: float, wish_x: float, wish_y: float
) -> float:
    """Return how deep robot r lies in the areas it may not leave, when it gives object o a velocity at a time [m]."""
    body = script.robots + o
    x, y, vx, vy = extrapolate(progress, k, body, time)
    dx, dy = wish_x - vx, wish_y - vy
    reach = (script.body[r, RADIUS] + script.body[body, RADIUS]) / max(math.hypot(dx, dy), ROUND_OFF)
    room = math.inf
    for i in range(script.own.shape[1]):
        own = script.own[r, i]
        if own[0] != 0.0 or own[1] != 0.0:
            room = min(room, own[2] - own[0] * (x - reach * dx) - own[1] * (y - reach * dy))
    return room


@compiled
def hasten(script: Script, progress: Progress, k: int, o: int) -> None:
    """Expect the next knot of object o earlier, if the drift it has to fly against would bend its way there too far.

    A flight of duration L against an acceleration a that it compensates leaves the straight way by a L^2 / 8.
    """
    strike, z = progress.strike[k, o], progress.filter[k, script.robots + o]
    knot, due, last = find_next_knot(script, progress, k, o, strike[INSERTED] > 0.0)
    drift = math.hypot(z[4], z[5])
    bend = min(BEND, 0.5 * script.knot[knot, DEPTH])
    if last or drift * (due - strike[TIME]) ** 2 <= 8.0 * bend:
        return
    x, y, _, _ = extrapolate(progress, k, script.robots + o, strike[TIME])
    way = math.hypot(script.knot[knot, KNOT_X] - x, script.knot[knot, KNOT_Y] - y)
    sooner = strike[TIME] + max(math.sqrt(8.0 * bend / drift), way / CRUISE)
    progress.clock[k, knot] = min(max(sooner, script.knot[knot, OPEN]), due)


@compiled
def find_share(script: Script, knot: int, x: float, y: float, target_x: float, target_y: float) -> float:
    """Return the share of the way from a position to a target at which it is deep enough in what a knot demands."""
    share, deep = 0.0, DEEP_ENOUGH * script.knot[knot, DEPTH]
    for i in range(int(script.knot[knot, FACES])):
        hx, hy, b = script.face[knot, i, 0], script.face[knot, i, 1], script.face[knot, i, 2]
        here, there = b - hx * x - hy * y, b - hx * target_x - hy * target_y
        if here < deep and there > here:
            share = max(share, min((deep - here) / (there - here), 1.0))
    return share

"""The coming impact of every object: when it is expected, and what came of the last one; compiled."""

from __future__ import annotations

import math

from impact_envs.compiled import compiled
from planners.free_flyer.belief.impact_parameters import (
    MODEL_ERROR,
    OBJECT_FLOOR,
    UNSEEN,
    relearn,
    settle,
    start_pairs,
    watch_recoil,
)
from planners.free_flyer.belief.options import Options
from planners.free_flyer.belief.plan_table import (
    AT,
    CLOSE,
    END,
    KNOT_X,
    KNOT_Y,
    NEXT,
    NORMAL_X,
    NORMAL_Y,
    OPEN,
    ROBOT,
    Script,
)
from planners.free_flyer.belief.world_memory import (
    AGENT,
    APPROACH,
    ASTRAY,
    BEFORE_X,
    BEFORE_Y,
    CHANGE,
    COMMANDED,
    DECIDED,
    FELT_SIZE,
    GAINED,
    GAINED_VARIANCE,
    GIVE_UP,
    HIT_AT,
    HIT_BY,
    HIT_X,
    HIT_Y,
    IMPACT_INDEX,
    INSERTED,
    LAST,
    LATEST_X,
    LATEST_Y,
    LEARNED,
    LOOKED,
    MISSES,
    OPTIMISED,
    OUTCOME,
    PENDING,
    RATIO,
    RECOIL_VARIANCE,
    REFERENCE_X,
    REFERENCE_Y,
    REPLANNED,
    REPLANS,
    RETRY,
    SCALE,
    SEEN,
    SOLVED,
    SPENT,
    TIME,
    TURN,
    UNPLANNED,
    WATCHED,
    Progress,
    find_next_event,
)
from planners.free_flyer.next_impact.desired_velocity import ROUND_OFF
from planners.free_flyer.next_impact.two_body import Outcome
from planners.free_flyer.tracking.course import IMPACT, STOP, read_clock, return_to_plan, set_clock

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
LEARN_PERIOD = 0.5  # between looks at what a hit did [s]
RETURN_SECONDS = 12.0  # longest quintic back to the plan
HASTE = 0.8  # of the time until a window closes, that a flight into it takes
FAST = 0.2  # speed of such a flight, at most [m/s]
FASTEST_CLOCK = 1.5  # plan seconds per second; more would force the end pose within the few seconds left


@compiled
def forget_hits(script: Script, progress: Progress, k: int) -> None:
    """Forget what world k's impacts taught."""
    for o in range(progress.hit.shape[1]):
        for column in range(progress.hit.shape[2]):
            progress.hit[k, o, column] = 0.0
    start_pairs(script, progress, k)


@compiled
def start_strikes(script: Script, progress: Progress, k: int, now: float) -> None:
    """Start world k with the first impact of every object.

    Args:
        script: what is followed.
        progress: of all worlds.
        k: world.
        now: when the script begins; after 0 the objects are in flight [s].
    """
    for o in range(len(script.first)):
        at, before = int(script.first[o]), END
        while at != END:
            progress.clock[k, at] = script.impact[at, AT]
            if before != END and script.knot[at, CLOSE] < math.inf:
                # Late objects are the rule: a flight that a window ends is begun fast enough for a weak throw.
                start = progress.clock[k, before]
                way = math.hypot(
                    script.knot[at, KNOT_X] - script.knot[before, KNOT_X],
                    script.knot[at, KNOT_Y] - script.knot[before, KNOT_Y],
                )
                sooner = start + max(HASTE * (script.knot[at, CLOSE] - start), way / FAST)
                progress.clock[k, at] = min(max(sooner, script.knot[at, OPEN]), script.impact[at, AT])
            at, before = int(script.impact[at, NEXT]), at
    for i in range(len(script.knot)):
        progress.place[k, i, 0], progress.place[k, i, 1] = script.knot[i, KNOT_X], script.knot[i, KNOT_Y]
    for o in range(len(script.first)):
        for column in range(progress.strike.shape[2]):
            progress.strike[k, o, column] = 0.0
        calm = now - SETTLE if now > 0.0 else -math.inf
        progress.strike[k, o, LAST] = progress.strike[k, o, LOOKED] = progress.strike[k, o, OPTIMISED] = calm
        await_impact(script, progress, k, o, int(script.first[o]), now)


@compiled
def await_impact(script: Script, progress: Progress, k: int, o: int, index: int, now: float) -> None:
    """Make a planned impact, or END, the coming one of object o."""
    strike = progress.strike[k, o]
    strike[IMPACT_INDEX], strike[INSERTED], strike[MISSES], strike[REPLANNED] = index, 0.0, 0.0, -math.inf
    strike[SCALE], strike[TURN], strike[DECIDED], strike[SOLVED] = 0.0, 0.0, 0.0, 0.0
    strike[ASTRAY] = math.inf
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
    settle(progress, k, o)
    expected = strike[AGENT] == r and now >= strike[TIME] - EARLIEST
    if not expected:
        progress.counts[k, UNPLANNED] += 1
        go_back(script, progress, k, r, now, tau)
        return
    if strike[SOLVED] > 0.0:
        hit[PENDING], hit[HIT_AT], hit[COMMANDED] = 1.0, now, strike[CHANGE]
        hit[BEFORE_X], hit[BEFORE_Y] = hit[LATEST_X], hit[LATEST_Y]
        for column in range(FELT_SIZE):
            hit[column] = progress.felt[k, r, column]
        hit[HIT_BY], hit[WATCHED], hit[SPENT], hit[LEARNED] = r, now, 0.0, -math.inf
        hit[GAINED_VARIANCE], hit[RECOIL_VARIANCE] = 0.0, UNSEEN
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
    """Compare what the last impact of each object did with what it should have done.

    The change of the object's velocity is v - v_before - a (t - t_before), of variance P_vv - 2 (t - t_hit) P_va +
    (t - t_hit)^2 P_aa.
    """
    seen = False
    for o in range(len(script.first)):
        hit, z = progress.hit[k, o], progress.filter[k, script.robots + o]
        since = now - hit[HIT_AT]
        if hit[PENDING] == 0.0:
            continue
        watch_recoil(progress, k, o, now)
        if since < OBSERVABLE - ROUND_OFF:
            continue
        flight = since + script.period  # the velocity before the hit is that of a step before
        x, y = z[2] - hit[BEFORE_X] - z[4] * flight, z[3] - hit[BEFORE_Y] - z[5] * flight
        if hit[COMMANDED] > 0.0:
            hit[SEEN] += 1.0 if hit[RATIO] == 0.0 else 0.0
            hit[RATIO] = math.hypot(x, y) / hit[COMMANDED]
        if options.learn and now >= hit[LEARNED] + LEARN_PERIOD - ROUND_OFF:
            hit[GAINED] = x * hit[HIT_X] + y * hit[HIT_Y]
            variance = max(z[9] - 2.0 * since * z[10] + since * since * z[11], 0.0)
            variance += progress.velocity_error[k, script.robots + o] + OBJECT_FLOOR * OBJECT_FLOOR
            hit[GAINED_VARIANCE] = variance + (MODEL_ERROR * hit[APPROACH]) ** 2
            hit[LEARNED], seen = now, True
    if seen:
        relearn(progress, k)


@compiled
def find_due(script: Script, progress: Progress, k: int, now: float) -> int:
    """Return the object whose coming impact's correction is to be decided now, or END."""
    for o in range(len(script.first)):
        strike = progress.strike[k, o]
        due = max(strike[TIME] - DECISION_LEAD, strike[LAST] + DECISION_SETTLE)
        if strike[DECIDED] == 0.0 and strike[IMPACT_INDEX] != END and now >= due - ROUND_OFF:
            return o
    return END

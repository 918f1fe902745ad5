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
    PlanTable,
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
    WorldMemory,
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
def forget_hits(plan: PlanTable, memory: WorldMemory, k: int) -> None:
    """Forget what world k's impacts taught."""
    for o in range(memory.hit.shape[1]):
        for column in range(memory.hit.shape[2]):
            memory.hit[k, o, column] = 0.0
    start_pairs(plan, memory, k)


@compiled
def start_strikes(plan: PlanTable, memory: WorldMemory, k: int, now: float) -> None:
    """Start world k with the first impact of every object.

    Args:
        plan: what is followed.
        memory: of all worlds.
        k: world.
        now: when the plan begins; after 0 the objects are in flight [s].
    """
    for o in range(len(plan.first)):
        at, before = int(plan.first[o]), END
        while at != END:
            memory.clock[k, at] = plan.impact[at, AT]
            if before != END and plan.knot[at, CLOSE] < math.inf:
                # Late objects are the rule: a flight that a window ends is begun fast enough for a weak throw.
                start = memory.clock[k, before]
                way = math.hypot(
                    plan.knot[at, KNOT_X] - plan.knot[before, KNOT_X],
                    plan.knot[at, KNOT_Y] - plan.knot[before, KNOT_Y],
                )
                sooner = start + max(HASTE * (plan.knot[at, CLOSE] - start), way / FAST)
                memory.clock[k, at] = min(max(sooner, plan.knot[at, OPEN]), plan.impact[at, AT])
            at, before = int(plan.impact[at, NEXT]), at
    for i in range(len(plan.knot)):
        memory.place[k, i, 0], memory.place[k, i, 1] = plan.knot[i, KNOT_X], plan.knot[i, KNOT_Y]
    for o in range(len(plan.first)):
        for column in range(memory.strike.shape[2]):
            memory.strike[k, o, column] = 0.0
        calm = now - SETTLE if now > 0.0 else -math.inf
        memory.strike[k, o, LAST] = memory.strike[k, o, LOOKED] = memory.strike[k, o, OPTIMISED] = calm
        await_impact(plan, memory, k, o, int(plan.first[o]), now)


@compiled
def await_impact(plan: PlanTable, memory: WorldMemory, k: int, o: int, index: int, now: float) -> None:
    """Make a planned impact, or END, the coming one of object o."""
    strike = memory.strike[k, o]
    strike[IMPACT_INDEX], strike[INSERTED], strike[MISSES], strike[REPLANNED] = index, 0.0, 0.0, -math.inf
    strike[SCALE], strike[TURN], strike[DECIDED], strike[SOLVED] = 0.0, 0.0, 0.0, 0.0
    strike[ASTRAY] = math.inf
    strike[AGENT], strike[TIME] = -1.0, math.inf
    if index != END:
        strike[AGENT] = plan.impact[index, ROBOT]
        strike[REFERENCE_X], strike[REFERENCE_Y] = plan.impact[index, NORMAL_X], plan.impact[index, NORMAL_Y]
        earliest = now + SHORTEST_NOTICE if now > 0.0 else 0.0
        set_time(plan, memory, k, o, index, max(memory.clock[k, index], earliest))


@compiled
def set_time(plan: PlanTable, memory: WorldMemory, k: int, o: int, index: int, time: float) -> None:
    """Expect a planned impact at a time; later ones of the object share the time that is left."""
    old = memory.clock[k, index]
    share = (plan.horizon - time) / max(plan.horizon - old, ROUND_OFF)
    memory.strike[k, o, TIME] = memory.clock[k, index] = time
    at = int(plan.impact[index, NEXT])
    while at != END and time != old:
        moved = time + (memory.clock[k, at] - old) * share
        earliest, latest = plan.knot[at, OPEN], max(plan.knot[at, CLOSE], time)
        memory.clock[k, at] = min(max(moved, earliest), latest)
        at = int(plan.impact[at, NEXT])


@compiled
def set_clocks(plan: PlanTable, memory: WorldMemory, k: int, now: float) -> None:
    """Let every robot that follows its plan arrive at its next event when it is expected."""
    for r in range(plan.robots):
        if memory.course[k, r, IMPACT] == 0.0:
            time, planned, _ = find_next_event(plan, memory, k, r)
            tau = min(read_clock(memory.course, k, r, now), memory.course[k, r, STOP])
            set_clock(memory.course, k, r, now, tau, time, planned, FASTEST_CLOCK)


@compiled
def go_back(plan: PlanTable, memory: WorldMemory, k: int, r: int, now: float, tau: float) -> None:
    """Plan robot r's course back to its plan, which stands at tau."""
    time, planned, _ = find_next_event(plan, memory, k, r)
    z = memory.filter[k, r]
    begin = (z[0], z[1], z[2], z[3])
    return_to_plan(
        memory.course,
        plan.breaks,
        plan.coefficients,
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
    memory.counts[k, REPLANS] += 1


@compiled
def remember_before(plan: PlanTable, memory: WorldMemory, k: int) -> None:
    """Keep the objects' velocities as they were before the impact that may come now."""
    for o in range(len(plan.first)):
        z = memory.filter[k, plan.robots + o]
        memory.hit[k, o, LATEST_X], memory.hit[k, o, LATEST_Y] = z[2], z[3]


@compiled
def take_contact(plan: PlanTable, memory: WorldMemory, k: int, r: int, now: float) -> None:
    """Take note of a contact of robot r: the coming impact is done if robot, object and time fit."""
    other = memory.touch[k, r]
    tau = min(read_clock(memory.course, k, r, now), memory.course[k, r, STOP])
    if other < plan.robots:
        memory.counts[k, UNPLANNED] += 1
        go_back(plan, memory, k, r, now, tau)
        return
    o = other - plan.robots
    strike, hit = memory.strike[k, o], memory.hit[k, o]
    strike[LAST], index = now, int(strike[IMPACT_INDEX])
    settle(memory, k, o)
    expected = strike[AGENT] == r and now >= strike[TIME] - EARLIEST
    if not expected:
        memory.counts[k, UNPLANNED] += 1
        go_back(plan, memory, k, r, now, tau)
        return
    if strike[SOLVED] > 0.0:
        hit[PENDING], hit[HIT_AT], hit[COMMANDED] = 1.0, now, strike[CHANGE]
        hit[BEFORE_X], hit[BEFORE_Y] = hit[LATEST_X], hit[LATEST_Y]
        for column in range(FELT_SIZE):
            hit[column] = memory.felt[k, r, column]
        hit[HIT_BY], hit[WATCHED], hit[SPENT], hit[LEARNED] = r, now, 0.0, -math.inf
        hit[GAINED_VARIANCE], hit[RECOIL_VARIANCE] = 0.0, UNSEEN
    if strike[INSERTED] > 0.0:
        await_impact(plan, memory, k, o, index, now)
    else:
        tau = plan.impact[index, AT] + min(max(now - strike[TIME], 0.0), plan.period)
        await_impact(plan, memory, k, o, int(plan.impact[index, NEXT]), now)
    go_back(plan, memory, k, r, now, tau)
    set_clocks(plan, memory, k, now)


@compiled
def take_misses(plan: PlanTable, memory: WorldMemory, options: Options, k: int, now: float) -> None:
    """Put off the impacts that are overdue, or give them up."""
    for o in range(len(plan.first)):
        strike = memory.strike[k, o]
        if now <= strike[TIME] + PATIENCE:
            continue
        index, r = int(strike[IMPACT_INDEX]), int(strike[AGENT])
        outcome = int(strike[OUTCOME])
        useless = outcome == Outcome.NOT_NEEDED or outcome == Outcome.OUT_OF_REACH
        hopeless = strike[SOLVED] > 0.0 and useless
        again = strike[INSERTED] == 0.0 and not hopeless and strike[MISSES] < RETRIES
        if again and options.retime and now + RETRY_IN < plan.horizon:
            strike[MISSES], strike[REPLANNED] = strike[MISSES] + 1.0, -math.inf
            set_time(plan, memory, k, o, index, now + RETRY_IN)
            memory.counts[k, RETRY] += 1
        else:
            tau = min(read_clock(memory.course, k, r, now), memory.course[k, r, STOP])
            if strike[INSERTED] == 0.0:
                tau = plan.impact[index, AT]
                index = int(plan.impact[index, NEXT])
            await_impact(plan, memory, k, o, index, now)
            go_back(plan, memory, k, r, now, tau)
            memory.counts[k, GIVE_UP] += 1
        set_clocks(plan, memory, k, now)


@compiled
def learn_from_hits(plan: PlanTable, memory: WorldMemory, options: Options, k: int, now: float) -> None:
    """Compare what the last impact of each object did with what it should have done.

    The change of the object's velocity is v - v_before - a (t - t_before), of variance P_vv - 2 (t - t_hit) P_va +
    (t - t_hit)^2 P_aa.
    """
    seen = False
    for o in range(len(plan.first)):
        hit, z = memory.hit[k, o], memory.filter[k, plan.robots + o]
        since = now - hit[HIT_AT]
        if hit[PENDING] == 0.0:
            continue
        watch_recoil(memory, k, o, now)
        if since < OBSERVABLE - ROUND_OFF:
            continue
        flight = since + plan.period  # the velocity before the hit is that of a step before
        x, y = z[2] - hit[BEFORE_X] - z[4] * flight, z[3] - hit[BEFORE_Y] - z[5] * flight
        if hit[COMMANDED] > 0.0:
            hit[SEEN] += 1.0 if hit[RATIO] == 0.0 else 0.0
            hit[RATIO] = math.hypot(x, y) / hit[COMMANDED]
        if options.learn and now >= hit[LEARNED] + LEARN_PERIOD - ROUND_OFF:
            hit[GAINED] = x * hit[HIT_X] + y * hit[HIT_Y]
            variance = max(z[9] - 2.0 * since * z[10] + since * since * z[11], 0.0)
            variance += memory.velocity_error[k, plan.robots + o] + OBJECT_FLOOR * OBJECT_FLOOR
            hit[GAINED_VARIANCE] = variance + (MODEL_ERROR * hit[APPROACH]) ** 2
            hit[LEARNED], seen = now, True
    if seen:
        relearn(memory, k)


@compiled
def find_due(plan: PlanTable, memory: WorldMemory, k: int, now: float) -> int:
    """Return the object whose coming impact's correction is to be decided now, or END."""
    for o in range(len(plan.first)):
        strike = memory.strike[k, o]
        due = max(strike[TIME] - DECISION_LEAD, strike[LAST] + DECISION_SETTLE)
        if strike[DECIDED] == 0.0 and strike[IMPACT_INDEX] != END and now >= due - ROUND_OFF:
            return o
    return END

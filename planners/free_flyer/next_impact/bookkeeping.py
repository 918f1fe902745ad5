"""Keep account of the coming impact of every object: when it is expected, and what the last one did; compiled."""

from __future__ import annotations

import math

from impact_envs.compiled import compiled, inlined
from planners.free_flyer.belief.drift import find_motion, mix_variance
from planners.free_flyer.belief.impact_parameters import (
    UNSEEN,
    is_disturbed,
    relearn_pairs,
    settle_hit,
    start_pairs,
    watch_recoil,
)
from planners.free_flyer.belief.offset import compute_lever
from planners.free_flyer.belief.options import Options
from planners.free_flyer.belief.plan_table import NO_IMPACT, PlanTable
from planners.free_flyer.belief.world_memory import (
    BLANK_HIT,
    BLANK_STRIKE,
    NO_OBJECT,
    NO_ROBOT,
    WorldMemory,
    find_next_event,
)
from planners.free_flyer.next_impact.desired_velocity import ROUND_OFF
from planners.free_flyer.next_impact.detour import go_round
from planners.free_flyer.next_impact.two_body import Outcome
from planners.free_flyer.tracking.course import read_clock, return_to_plan, set_clock


@compiled
def forget_hits(plan: PlanTable, memory: WorldMemory, options: Options, k: int) -> None:
    """Forget what world k's impacts taught."""
    for o in range(memory.hit.shape[1]):
        memory.hit[k, o] = BLANK_HIT
    start_pairs(plan, memory, options, k)


@compiled
def start_strikes(plan: PlanTable, memory: WorldMemory, options: Options, k: int, now: float) -> None:
    """Start world k with the first impact of every object.

    Args:
        now: when the plan begins; after 0 the objects are in flight [s].
    """
    for o in range(len(plan.first)):
        at, before = plan.first[o], NO_IMPACT
        while at != NO_IMPACT:
            impact, knot = plan.impact[at], plan.knot[at]
            memory.clock[k, at] = impact.time
            if options.retime and before == NO_IMPACT and now == 0.0 and len(plan.response) == 0:
                memory.clock[k, at] = find_departure(plan, options, o)
            if before != NO_IMPACT and knot.closes < math.inf and len(plan.response) == 0:
                # Objects usually arrive late: start the flight into a window early enough for a weak throw to arrive.
                # A plan with responses has reckoned with that.
                start, last = memory.clock[k, before], plan.knot[before].position
                way = math.hypot(knot.position[0] - last[0], knot.position[1] - last[1])
                sooner = start + max(options.timing.haste * (knot.closes - start), way / options.timing.fast)
                memory.clock[k, at] = min(max(sooner, knot.opens), impact.time)
            if before != NO_IMPACT and plan.knot[before].via_share > 0.0 and len(plan.response) == 0:
                sooner = find_passage(plan, options, before, memory.clock[k, before])
                memory.clock[k, at] = min(memory.clock[k, at], max(sooner, knot.opens))
            at, before = impact.next, at
    for i in range(len(plan.knot)):
        memory.place[k, i, 0], memory.place[k, i, 1] = plan.knot[i].position[0], plan.knot[i].position[1]
    for o in range(len(plan.first)):
        strike = memory.strike[k, o]
        memory.strike[k, o] = BLANK_STRIKE
        calm = now - options.timing.settle if now > 0.0 else -math.inf
        strike.last_contact = strike.looked_at = strike.optimised_at = calm
        await_impact(plan, memory, options, k, o, plan.first[o], now)


@compiled
def find_passage(plan: PlanTable, options: Options, index: int, start: float) -> float:
    """Return when the flight from a knot should end, so that a weak throw still passes its via place in time [s].

    Args:
        index: of the knot.
        start: when the flight begins [s].
    """
    knot, timing = plan.knot[index], options.timing
    way = math.hypot(knot.via[0] - knot.position[0], knot.via[1] - knot.position[1])
    passage = max(timing.haste * (knot.via_closes - start), way / timing.fast)
    return start + passage / knot.via_share


@compiled
def find_departure(plan: PlanTable, options: Options, o: int) -> float:
    """Return when object o should be hit first, as the plan says or earlier [s].

    The gain of a first throw is not known. Where the next window closes too soon for a weak one, an object that rests
    leaves sooner: so that it is still inside its region when the window opens in which it has to be there.
    """
    first = plan.first[o]
    here, following, time = plan.knot[first], plan.impact[first].next, plan.impact[first].time
    start = plan.body[plan.robots + o].start_velocity
    moves = start[0] != 0.0 or start[1] != 0.0
    if moves or following == NO_IMPACT or here.opens <= 0.0 or here.depth == math.inf:
        return time
    there = plan.knot[following]
    way = math.hypot(there.position[0] - here.position[0], there.position[1] - here.position[1])
    in_time = there.closes - way / (options.timing.fast * options.timing.haste)
    inside = here.opens - options.timing.inside * here.depth / options.timing.fast
    return min(time, max(in_time, inside))


@compiled
def await_impact(
    plan: PlanTable, memory: WorldMemory, options: Options, k: int, o: int, index: int, now: float
) -> None:
    """Make a planned impact, or none (NO_IMPACT), the coming one of object o."""
    strike = memory.strike[k, o]
    strike.index, strike.is_inserted, strike.misses, strike.replanned_at = index, False, 0, -math.inf
    strike.scale = strike.turn = strike.shift = 0.0
    strike.is_decided, strike.is_solved, strike.is_slowed = False, False, False
    strike.robot, strike.time, strike.due, strike.astray_since = NO_ROBOT, math.inf, math.inf, math.inf
    if index != NO_IMPACT:
        strike.robot, strike.reference_normal = plan.impact[index].robot, plan.impact[index].normal
        timing = options.timing
        notice = timing.decision_settle + timing.replan_last + timing.replan_period  # after a contact that came late
        earliest = now + notice if now > 0.0 else 0.0
        set_time(plan, memory, k, o, index, max(memory.clock[k, index], earliest))


@compiled
def set_time(plan: PlanTable, memory: WorldMemory, k: int, o: int, index: int, time: float) -> None:
    """Expect a planned impact at a time; later ones of the object share the time that is left."""
    old = memory.clock[k, index]
    share = (plan.horizon - time) / max(plan.horizon - old, ROUND_OFF)
    memory.strike[k, o].time = memory.strike[k, o].due = memory.clock[k, index] = time
    at = plan.impact[index].next
    while at != NO_IMPACT and time != old:
        moved = time + (memory.clock[k, at] - old) * share
        earliest, latest = plan.knot[at].opens, max(plan.knot[at].closes, time)
        memory.clock[k, at] = min(max(moved, earliest), latest)
        at = plan.impact[at].next


@compiled
def withdraw_impact(plan: PlanTable, memory: WorldMemory, options: Options, k: int, o: int, now: float) -> None:
    """Give up the inserted impact on object o: its robot returns to the plan, and the object can get another one."""
    strike = memory.strike[k, o]
    r = strike.robot
    tau = min(read_clock(memory.course[k, r], now), memory.course[k, r].stop)
    await_impact(plan, memory, options, k, o, strike.index, now)
    return_robot(plan, memory, options, k, r, now, tau)
    set_clocks(plan, memory, options, k, now)
    memory.counts[k].withdrawn += 1


@compiled
def set_clocks(plan: PlanTable, memory: WorldMemory, options: Options, k: int, now: float) -> None:
    """Set the clock of every robot that follows its plan, so that it is in time for its next event."""
    for r in range(plan.robots):
        course = memory.course[k, r]
        if not course.ends_in_impact:
            time, planned, _ = find_next_event(plan, memory, k, r)
            tau = min(read_clock(course, now), course.stop)
            set_clock(course, now, tau, time, planned, options.timing.fastest_clock)


@compiled
def return_robot(
    plan: PlanTable, memory: WorldMemory, options: Options, k: int, r: int, now: float, tau: float
) -> None:
    """Plan robot r's course back to its plan, whose time is tau now."""
    time, planned, _ = find_next_event(plan, memory, k, r)
    z = memory.filter[k, r]
    begin = (z.position[0], z.position[1], z.velocity[0], z.velocity[1])
    curves = memory.flown[k] if len(plan.response) > 0 else plan.coefficients
    return_to_plan(
        memory.course[k, r],
        plan.breaks,
        curves,
        r,
        now,
        begin,
        tau,
        time,
        planned,
        options.timing.return_seconds,
        options.timing.fastest_clock,
    )
    if options.walls:
        go_round(plan, memory, options, k, r, NO_OBJECT, now, time)
    memory.counts[k].replans += 1


@inlined
def remember_before(plan: PlanTable, memory: WorldMemory, k: int) -> None:
    """Store the objects' velocities before the impact that may come now."""
    for o in range(len(plan.first)):
        _, velocity, _ = find_motion(memory.filter[k, plan.robots + o])
        memory.hit[k, o].latest[0], memory.hit[k, o].latest[1] = velocity.real, velocity.imag


@compiled
def take_contact(plan: PlanTable, memory: WorldMemory, options: Options, k: int, r: int, now: float) -> None:
    """Record a contact of robot r: the coming impact is done if robot, object and time fit."""
    other = memory.touch[k, r]
    tau = min(read_clock(memory.course[k, r], now), memory.course[k, r].stop)
    if other < plan.robots:
        memory.counts[k].unplanned_contact += 1
        return_robot(plan, memory, options, k, r, now, tau)
        return
    o = other - plan.robots
    strike, hit = memory.strike[k, o], memory.hit[k, o]
    strike.last_contact, index = now, strike.index
    settle_hit(memory, options, k, o)
    # A robot that postponed its impact may still hit at the time that was meant.
    expected = strike.robot == r and now >= min(strike.time, strike.due) - options.timing.earliest
    if not expected:
        memory.counts[k].unplanned_contact += 1
        return_robot(plan, memory, options, k, r, now, tau)
        return
    if strike.is_solved:
        hit.is_pending, hit.time, hit.robot, hit.commanded = True, now, r, strike.change
        if hit.is_seen:
            hit.earlier = hit.observed
        hit.direction, hit.is_seen = strike.normal, False
        hit.is_answered, hit.aim = strike.is_answered, strike.object_plus
        hit.before, hit.contact = hit.latest, memory.felt[k, r]
        hit.watched_at, hit.thrust, hit.learned_at = now, 0.0, -math.inf
        hit.gained_variance, hit.recoil_variance = 0.0, UNSEEN
    if strike.is_inserted:
        await_impact(plan, memory, options, k, o, index, now)
    else:
        tau = plan.impact[index].time + min(max(now - strike.time, 0.0), plan.period)
        await_impact(plan, memory, options, k, o, plan.impact[index].next, now)
    return_robot(plan, memory, options, k, r, now, tau)
    set_clocks(plan, memory, options, k, now)


@inlined
def take_misses(plan: PlanTable, memory: WorldMemory, options: Options, k: int, now: float) -> None:
    """Retry the impacts that are overdue, or give them up."""
    for o in range(len(plan.first)):
        if now > memory.strike[k, o].time + options.timing.patience:
            take_miss(plan, memory, options, k, o, now)


@compiled
def take_miss(plan: PlanTable, memory: WorldMemory, options: Options, k: int, o: int, now: float) -> None:
    """Retry the impact on object o, which is overdue, or give it up."""
    strike = memory.strike[k, o]
    index, r = strike.index, strike.robot
    useless = strike.outcome == Outcome.NOT_NEEDED or strike.outcome == Outcome.OUT_OF_REACH
    hopeless = strike.is_solved and useless
    again = not strike.is_inserted and not hopeless and strike.misses < options.timing.retries
    if again and options.retime and now + options.timing.retry_in < plan.horizon:
        strike.misses, strike.replanned_at = strike.misses + 1, -math.inf
        set_time(plan, memory, k, o, index, now + options.timing.retry_in)
        memory.counts[k].retry += 1
    else:
        tau = min(read_clock(memory.course[k, r], now), memory.course[k, r].stop)
        if not strike.is_inserted:
            tau = plan.impact[index].time
            index = plan.impact[index].next
        await_impact(plan, memory, options, k, o, index, now)
        return_robot(plan, memory, options, k, r, now, tau)
        memory.counts[k].give_up += 1
    set_clocks(plan, memory, options, k, now)


@inlined
def learn_from_hits(plan: PlanTable, memory: WorldMemory, options: Options, k: int, now: float) -> None:
    """Compare the change of velocity that each object's last impact made with the commanded one.

    The change of the object's velocity is v - v_before - a (t - t_before), of variance P_vv - 2 (t - t_hit) P_va +
    (t - t_hit)^2 P_aa.
    """
    seen = False
    for o in range(len(plan.first)):
        hit, z, body = memory.hit[k, o], memory.filter[k, plan.robots + o], plan.body[plan.robots + o]
        since = now - hit.time
        if not hit.is_pending:
            continue
        watch_recoil(memory, options, k, o, now)
        if since < options.timing.observable - ROUND_OFF:
            continue
        if hit.is_answered and not hit.is_beyond:
            _, velocity, drift = find_motion(z)
            miss = velocity - drift * since - complex(hit.aim[0], hit.aim[1])
            off = max(abs(miss.real), abs(miss.imag))
            most = (1.0 + options.response.excess) * plan.deviation
            hit.is_beyond = off > most + options.response.sure * math.sqrt(max(z.P_vv, 0.0))
        flight = since + plan.period  # the velocity before the hit is that of a step before
        _, velocity, drift = find_motion(z)
        change = velocity - complex(hit.before[0], hit.before[1]) - drift * flight
        x, y = change.real, change.imag
        if hit.commanded > 0.0:
            if not hit.is_seen:
                hit.is_seen, hit.seen = True, hit.seen + 1
            nx, ny = hit.direction
            hit.observed[0] = (x * nx + y * ny) / hit.commanded
            hit.observed[1] = (y * nx - x * ny) / hit.commanded
        if options.learn and now >= hit.learned_at + options.timing.learn_period - ROUND_OFF:
            nx, ny = hit.contact.normal[0], hit.contact.normal[1]
            hit.contact.lever = compute_lever(z, body.gyration, hit.contact.angle, nx, ny)
            gained = x * nx + y * ny
            if is_disturbed(memory, options, k, o, gained):
                settle_hit(memory, options, k, o)
                seen = True
                continue
            hit.gained = gained
            variance = z.P_vv - 2.0 * since * z.P_va.real + since * since * z.P_aa
            variance = max(mix_variance(z, variance, z.P_va - since * z.P_aa), 0.0)
            variance += (
                memory.velocity_error[k, plan.robots + o]
                + options.impact_parameters.object_floor * options.impact_parameters.object_floor
            )
            hit.gained_variance = variance + (options.impact_parameters.model_error * hit.contact.approach) ** 2
            hit.learned_at, seen = now, True
    if seen:
        relearn_pairs(memory, options, k)


@inlined
def find_due(plan: PlanTable, memory: WorldMemory, options: Options, k: int, now: float) -> int:
    """Return the object whose coming impact's correction is to be decided now, or NO_OBJECT."""
    for o in range(len(plan.first)):
        strike = memory.strike[k, o]
        due = max(strike.time - options.timing.decision_lead, strike.last_contact + options.timing.decision_settle)
        if not strike.is_decided and strike.index != NO_IMPACT and now >= due - ROUND_OFF:
            return o
    return NO_OBJECT

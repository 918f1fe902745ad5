"""One control period of one world, compiled: observe, look ahead, replan the courses to the impacts, track them."""

from __future__ import annotations

import math

import numpy as np

from impact_envs.compiled import compiled, inlined
from planners.free_flyer.belief.estimator import open_filters, update_estimates
from planners.free_flyer.belief.options import Options
from planners.free_flyer.belief.plan_table import NO_IMPACT, PlanTable
from planners.free_flyer.belief.readings import is_start, read_clock
from planners.free_flyer.belief.thruster import open_thrusters
from planners.free_flyer.belief.world_memory import (
    BLANK_COUNTS,
    BLANK_COURSE,
    NO_OBJECT,
    NOBODY,
    PAST_PERIOD,
    WorldMemory,
    find_next_event,
    find_strike,
)
from planners.free_flyer.closed_loop.features import write_features
from planners.free_flyer.closed_loop.tracker import apply_solution, fill_reference, fill_state, track_course
from planners.free_flyer.next_impact.bookkeeping import (
    find_due,
    forget_hits,
    learn_from_hits,
    remember_before,
    return_robot,
    set_clocks,
    start_strikes,
    take_contact,
    take_misses,
)
from planners.free_flyer.next_impact.correction import take_correction
from planners.free_flyer.next_impact.desired_velocity import ROUND_OFF, is_answered, is_promised, is_settled
from planners.free_flyer.next_impact.insertion import insert_impact
from planners.free_flyer.next_impact.reoptimisation import reoptimise_rest
from planners.free_flyer.next_impact.replanner import replan_course
from planners.free_flyer.next_impact.response import forget_responses, respond
from planners.free_flyer.next_impact.rest_qp import RestQP
from planners.free_flyer.next_impact.retiming import hasten_waiting, is_straying, may_move, retime_impact
from planners.free_flyer.next_impact.stay import watch_stays
from planners.free_flyer.tracking.mpc import Workspace

# What to do with the worlds.
START, OBSERVE, RECEIVE, CONTROL, ACT, ADOPT, PREPARE, APPLY, DECIDE, DESCRIBE = range(10)


@compiled
def start_world(plan: PlanTable, memory: WorldMemory, options: Options, k: int) -> None:
    """Forget the last episode of world k."""
    memory.time[k] = 0.0
    open_filters(plan, memory, options, k)
    open_thrusters(memory, options, k)
    forget_hits(plan, memory, options, k)
    forget_responses(plan, memory, k)
    start_strikes(plan, memory, options, k, 0.0)
    memory.wanted[k] = math.inf
    memory.counts[k] = BLANK_COUNTS
    for r in range(plan.robots):
        memory.push[k, r, 0] = memory.push[k, r, 1] = memory.spin[k, r] = 0.0
        memory.shifted[k, r].count = 0
        memory.course[k, r] = BLANK_COURSE
    set_clocks(plan, memory, options, k, 0.0)


@compiled
def adopt_world(plan: PlanTable, memory: WorldMemory, options: Options, k: int) -> None:
    """Let world k follow a new plan from now on; keep what was learned of its objects."""
    now = memory.time[k]
    start_strikes(plan, memory, options, k, now)
    for r in range(plan.robots):
        return_robot(plan, memory, options, k, r, now, now)


@inlined
def observe_world(
    plan: PlanTable, memory: WorldMemory, options: Options, qp: RestQP, c: int, k: int, joint: np.ndarray
) -> int:
    """Update the estimates, record contacts and missed impacts, look ahead.

    Args:
        joint: everything measured once, shape (N, 7 n + r + 3).

    Returns:
        The object whose coming impact's correction is due, or NO_OBJECT.
    """
    now = read_clock(plan, memory, options, k, joint)
    remember_before(plan, memory, k)
    update_estimates(plan, memory, options, k, joint, now)
    for r in range(plan.robots):
        if memory.touch[k, r] != NOBODY:
            take_contact(plan, memory, options, k, r, now)
    take_misses(plan, memory, options, k, now)
    watch_stays(plan, memory, options, k, now)
    learn_from_hits(plan, memory, options, k, now)
    look_ahead(plan, memory, options, qp, c, k, now)
    remember_positions(plan, memory, k, now)
    return find_due(plan, memory, options, k, now)


@inlined
def remember_positions(plan: PlanTable, memory: WorldMemory, k: int, now: float) -> None:
    """Store the estimated positions of world k's bodies every half second."""
    at = int(now / PAST_PERIOD + ROUND_OFF)
    if at < memory.past.shape[1] and now - at * PAST_PERIOD < plan.period - ROUND_OFF:
        for i in range(memory.past.shape[2]):
            position = memory.filter[k, i].position
            memory.past[k, at, i, 0], memory.past[k, at, i, 1] = position[0], position[1]


@inlined
def control_world(
    plan: PlanTable, memory: WorldMemory, options: Options, workspace: Workspace, c: int, k: int, actions: np.ndarray
) -> None:
    """Replan where it is time to, and write each robot's action.

    Args:
        workspace: of all threads.
        actions: body-frame forces and torque over their limits, written, shape (N, r, 3).
    """
    take_corrections(plan, memory, options, k)
    for r in range(plan.robots):
        o = replan_robot(plan, memory, options, k, r)
        track_course(plan, memory, options, workspace, c, k, r, o, actions)


@compiled
def prepare_robot(plan: PlanTable, memory: WorldMemory, options: Options, workspace: Workspace, k: int, r: int) -> None:
    """Do what comes before robot r's tracker: replan where it is time to, and fill row r of the workspace.

    Robots are prepared in their order, each after the one before it acts: so does `control_world`.
    """
    if r == 0:
        take_corrections(plan, memory, options, k)
    o = replan_robot(plan, memory, options, k, r)
    workspace.target[r] = o
    fill_state(memory, workspace, r, k, r)
    fill_reference(plan, memory, workspace, r, k, r, o)


@inlined
def take_corrections(plan: PlanTable, memory: WorldMemory, options: Options, k: int) -> None:
    """Take the corrections that are due as they are now; the courses to their impacts are planned anew."""
    due = find_due(plan, memory, options, k, memory.time[k])
    while due != NO_OBJECT:
        due = decide_impact(plan, memory, options, k, due)


@compiled
def correct_impact(
    plan: PlanTable, memory: WorldMemory, options: Options, k: int, o: int, corrections: np.ndarray
) -> int:
    """Take the correction that is given for object o's coming impact; return the object whose correction is due next.

    Args:
        corrections: in [-1, 1], shape (N, 3); NaN where none is given, and o's stays due.
    """
    if math.isnan(corrections[k, 0]):
        return o
    scale, turn, shift = corrections[k]
    take_correction(plan, memory, options, k, o, (scale, turn, shift))
    return decide_impact(plan, memory, options, k, o)


@compiled
def decide_impact(plan: PlanTable, memory: WorldMemory, options: Options, k: int, o: int) -> int:
    """Take the correction of object o's coming impact as it is now; return the object whose correction is due next."""
    memory.strike[k, o].is_decided = True
    if not options.once:
        memory.strike[k, o].replanned_at = -math.inf
    return find_due(plan, memory, options, k, memory.time[k])


@inlined
def replan_robot(plan: PlanTable, memory: WorldMemory, options: Options, k: int, r: int) -> int:
    """Replan robot r's course where it is time to; return the object it is to hit, or NO_OBJECT."""
    now = memory.time[k]
    respond(plan, memory, options, k, r, now)
    o = find_strike(memory, k, r)
    if o != NO_OBJECT:
        strike = memory.strike[k, o]
        event, _, _ = find_next_event(plan, memory, k, r)
        if not strike.is_inserted and strike.time > event + ROUND_OFF:
            o = NO_OBJECT
        elif should_replan(plan, memory, options, k, r, o, now):
            replan_course(plan, memory, options, k, r, o, now)
            o = find_strike(memory, k, r)  # the impact may be withdrawn
    return o


@compiled
def should_replan(plan: PlanTable, memory: WorldMemory, options: Options, k: int, r: int, o: int, now: float) -> bool:
    """Return whether the course of robot r to its impact on object o has to be replanned now."""
    strike = memory.strike[k, o]
    time = strike.time
    settled = is_settled(plan, memory, options, k, o, now)
    begin = time - options.timing.replan_window
    if strike.index != NO_IMPACT and is_answered(plan, memory, options, k, o):
        begin = plan.response[strike.index].leave
    near = begin <= now + ROUND_OFF or memory.course[k, r].ends_in_impact
    due = (
        strike.replanned_at == -math.inf
        if options.once
        else now >= strike.replanned_at + options.timing.replan_period - ROUND_OFF
    )
    return settled and near and due and now <= time - options.timing.replan_last + ROUND_OFF


@inlined
def look_ahead(plan: PlanTable, memory: WorldMemory, options: Options, qp: RestQP, c: int, k: int, now: float) -> None:
    """Move or insert the coming impacts of world k, where options say so and the objects' flight is known."""
    for o in range(len(plan.first)):
        strike = memory.strike[k, o]
        settled = now >= strike.last_contact + options.timing.settle - ROUND_OFF
        due = now >= strike.looked_at + options.timing.replan_period - ROUND_OFF
        if settled and due and not strike.is_inserted:
            reconsider_impact(plan, memory, options, qp, c, k, o, now)


@compiled
def reconsider_impact(
    plan: PlanTable, memory: WorldMemory, options: Options, qp: RestQP, c: int, k: int, o: int, now: float
) -> None:
    """Move the coming impact of object o, or insert one, where options say so."""
    strike = memory.strike[k, o]
    strike.looked_at = now
    # Times and places of the plan stay while it promises success with them.
    answered = is_answered(plan, memory, options, k, o)
    kept = answered or (strike.index != NO_IMPACT and is_promised(plan, memory, k, o))
    if not kept and options.reoptimise and strike.last_contact > strike.optimised_at and strike.index != NO_IMPACT:
        strike.optimised_at = now
        if reoptimise_rest(plan, memory, options, qp, c, k, o, now):
            memory.counts[k].reoptimised += 1
            set_clocks(plan, memory, options, k, now)
        else:
            memory.counts[k].no_optimum += 1
            # Its rows are on the safe side: a new plan is wanted only if the flight goes astray, but then sooner.
            strike.astray_since = min(strike.astray_since, now - options.insertion.long_astray + options.insertion.soon)
    hit_before = strike.last_contact > 0.0
    may_retime = options.retime and not kept and strike.index != NO_IMPACT
    may_retime = may_retime and may_move(plan, memory, options, k, o, now)
    if may_retime and hit_before:
        retime_impact(plan, memory, options, k, o, now)
    elif may_retime and is_straying(plan, memory, options, k, o, options.retiming.stray):
        hasten_waiting(plan, memory, options, k, o, now)
    long_wait = strike.index != NO_IMPACT and strike.time - now > options.insertion.wait
    may_insert = hit_before or (long_wait and is_straying(plan, memory, options, k, o, options.insertion.stray))
    if options.insert and may_insert and not answered:
        insert_impact(plan, memory, options, k, o, now)


@compiled
def run_experts(
    plan: tuple,
    memory: tuple,
    options: np.ndarray,
    workspace: tuple,
    qp: tuple,
    joint: np.ndarray,
    actions: np.ndarray,
    due: np.ndarray,
    corrections: np.ndarray,
    features: np.ndarray,
    phase: int,
    c: int,
    first: int,
    end: int,
) -> None:
    """Start, observe or control the worlds from first to before end; plain tuples pass three times faster from Python.

    A tracker that is no compiled one is called between PREPARE and APPLY of each robot.

    Args:
        plan, memory, workspace, qp: the fields of PlanTable, WorldMemory, Workspace, RestQP.
        options: see `options.make_record`.
        joint: everything measured once, shape (N, 7 n + r + 3).
        actions: written by CONTROL, ACT and APPLY, shape (N, r, 3).
        due: object whose coming impact's correction is due, or NO_OBJECT, written by START, OBSERVE and DECIDE, shape
            (N,).
        corrections: read by DECIDE, see `correct_impact`.
        features: written by DESCRIBE, see `write_features`.
        phase: START, OBSERVE, CONTROL; RECEIVE: observe, and start where time is 0; ACT: both and control; ADOPT: go on
            with a new plan; PREPARE, APPLY: control one robot; DECIDE: take the corrections that are given, and find
            what is due next; DESCRIBE: write the features.
        c: thread; of PREPARE and APPLY the robot, which has the workspace's row of its number.
        first, end: range of worlds.
    """
    plan_, memory_ = PlanTable(*plan), WorldMemory(*memory)
    options_, workspace_, qp_ = options[0], Workspace(*workspace), RestQP(*qp)
    for k in range(first, end):
        if phase == START or (phase in (RECEIVE, ACT) and is_start(plan_, joint, k)):
            start_world(plan_, memory_, options_, k)
            due[k] = NO_OBJECT
        if phase == ADOPT:
            adopt_world(plan_, memory_, options_, k)
        if phase == DECIDE and due[k] != NO_OBJECT:
            due[k] = correct_impact(plan_, memory_, options_, k, due[k], corrections)
        if phase in (OBSERVE, RECEIVE, ACT):
            due[k] = observe_world(plan_, memory_, options_, qp_, c, k, joint)
        if phase in (CONTROL, ACT):
            control_world(plan_, memory_, options_, workspace_, c, k, actions)
        if phase == PREPARE:
            prepare_robot(plan_, memory_, options_, workspace_, k, c)
        if phase == APPLY:
            apply_solution(plan_, memory_, options_, workspace_, c, k, c, workspace_.target[c], actions)
        if phase == DESCRIBE:
            write_features(plan_, memory_, options_, k, due[k], features)

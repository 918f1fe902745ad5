"""One control period of one world, compiled: observe, look ahead, replan the courses to the impacts, track them."""

from __future__ import annotations

import math

import numpy as np

from impact_envs.compiled import compiled
from impact_envs.free_flyer.sensing import BODY_SIZE
from planners.free_flyer.belief.estimator import open_filters, update_estimates
from planners.free_flyer.belief.options import Options
from planners.free_flyer.belief.plan_table import (
    END,
    PlanTable,
)
from planners.free_flyer.belief.world_memory import (
    ASTRAY,
    DECIDED,
    IMPACT_INDEX,
    INSERTED,
    LAST,
    LOOKED,
    NO_OPTIMUM,
    NOBODY,
    OPTIMISED,
    PAST_PERIOD,
    REOPTIMISED,
    REPLANNED,
    TIME,
    WorldMemory,
    find_next_event,
    find_strike,
)
from planners.free_flyer.closed_loop.tracker import apply_solution, fill_reference, fill_state, track
from planners.free_flyer.next_impact.bookkeeping import (
    REPLAN_LAST,
    REPLAN_PERIOD,
    SETTLE,
    find_due,
    forget_hits,
    go_back,
    learn_from_hits,
    remember_before,
    set_clocks,
    start_strikes,
    take_contact,
    take_misses,
)
from planners.free_flyer.next_impact.desired_velocity import ROUND_OFF
from planners.free_flyer.next_impact.insertion import LONG_ASTRAY, SOON, insert
from planners.free_flyer.next_impact.reoptimisation import Program, reoptimise
from planners.free_flyer.next_impact.replanner import replan
from planners.free_flyer.next_impact.retiming import FROZEN, retime
from planners.free_flyer.tracking.course import IMPACT
from planners.free_flyer.tracking.mpc import STAGES, Workspace

# What to do with the worlds.
START, OBSERVE, CONTROL, ACT, ADOPT, PREPARE, APPLY = range(7)
REPLAN_WINDOW = 20.0  # before an impact [s]


@compiled
def start_world(plan: PlanTable, memory: WorldMemory, options: Options, k: int) -> None:
    """Forget the last episode of world k."""
    memory.time[k] = 0.0
    open_filters(plan, memory, options, k)
    forget_hits(plan, memory, k)
    start_strikes(plan, memory, k, 0.0)
    memory.wanted[k] = math.inf
    for i in range(memory.counts.shape[1]):
        memory.counts[k, i] = 0
    for r in range(plan.robots):
        memory.push[k, r, 0] = memory.push[k, r, 1] = 0.0
        memory.shifted[k, r, 3 * STAGES] = 0.0
        for i in range(memory.course.shape[2]):
            memory.course[k, r, i] = 0.0
    set_clocks(plan, memory, k, 0.0)


@compiled
def adopt_world(plan: PlanTable, memory: WorldMemory, k: int) -> None:
    """Let world k follow a new plan from now on; what was learned of its objects stays."""
    now = memory.time[k]
    start_strikes(plan, memory, k, now)
    for r in range(plan.robots):
        go_back(plan, memory, k, r, now, now)


@compiled
def observe_world(
    plan: PlanTable, memory: WorldMemory, options: Options, program: Program, c: int, k: int, joint: np.ndarray
) -> int:
    """Update the estimates, take note of contacts and missed impacts, look ahead.

    Args:
        plan: what is followed.
        memory: of all worlds.
        options: which parts of the loop are on.
        program: of all threads.
        c: thread.
        k: world.
        joint: everything measured once, shape (N, 7 n + r + 3).

    Returns:
        The object whose coming impact's correction is due, or END.
    """
    now = joint[k, BODY_SIZE * len(plan.body) + plan.robots] * plan.horizon
    if not math.isfinite(now):
        now = memory.time[k] + plan.period
    remember_before(plan, memory, k)
    update_estimates(plan, memory, k, joint, now)
    for r in range(plan.robots):
        if memory.touch[k, r] != NOBODY:
            take_contact(plan, memory, k, r, now)
    take_misses(plan, memory, options, k, now)
    learn_from_hits(plan, memory, options, k, now)
    look_ahead(plan, memory, options, program, c, k, now)
    remember_positions(plan, memory, k, now)
    return find_due(plan, memory, k, now)


@compiled
def remember_positions(plan: PlanTable, memory: WorldMemory, k: int, now: float) -> None:
    """Keep where the bodies of world k are seen, every half second."""
    at = int(now / PAST_PERIOD + ROUND_OFF)
    if at < memory.past.shape[1] and now - at * PAST_PERIOD < plan.period - ROUND_OFF:
        for i in range(memory.past.shape[2]):
            memory.past[k, at, i, 0], memory.past[k, at, i, 1] = memory.filter[k, i, 0], memory.filter[k, i, 1]


@compiled
def control_world(
    plan: PlanTable, memory: WorldMemory, options: Options, workspace: Workspace, c: int, k: int, actions: np.ndarray
) -> None:
    """Replan where it is time to, and write each robot's action.

    Args:
        plan: what is followed.
        memory: of all worlds.
        options: which parts of the loop are on.
        workspace: of all threads.
        c: thread.
        k: world.
        actions: body-frame forces and torque over their limits, written, shape (N, r, 3).
    """
    take_corrections(plan, memory, options, k)
    for r in range(plan.robots):
        o = replan_robot(plan, memory, options, k, r)
        track(plan, memory, options, workspace, c, k, r, o, actions)


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


@compiled
def take_corrections(plan: PlanTable, memory: WorldMemory, options: Options, k: int) -> None:
    """Take the corrections that are due as they are now; the courses to their impacts are planned anew."""
    now = memory.time[k]
    due = find_due(plan, memory, k, now)
    while due != END:
        memory.strike[k, due, DECIDED] = 1.0
        if not options.once:
            memory.strike[k, due, REPLANNED] = -math.inf
        due = find_due(plan, memory, k, now)


@compiled
def replan_robot(plan: PlanTable, memory: WorldMemory, options: Options, k: int, r: int) -> int:
    """Replan robot r's course where it is time to; return the object it is to hit, or END."""
    now = memory.time[k]
    o = find_strike(memory, k, r)
    if o != END:
        strike = memory.strike[k, o]
        event, _, _ = find_next_event(plan, memory, k, r)
        if strike[INSERTED] == 0.0 and strike[TIME] > event + ROUND_OFF:
            o = END
        elif should_replan(memory, options, k, r, o, now):
            replan(plan, memory, options, k, r, o, now)
    return o


@compiled
def should_replan(memory: WorldMemory, options: Options, k: int, r: int, o: int, now: float) -> bool:
    """Return whether the course of robot r to its impact on object o is to be planned anew."""
    strike = memory.strike[k, o]
    time = strike[TIME]
    settled = now >= strike[LAST] + SETTLE - ROUND_OFF
    near = time - REPLAN_WINDOW <= now + ROUND_OFF or memory.course[k, r, IMPACT] > 0.0
    due = strike[REPLANNED] == -math.inf if options.once else now >= strike[REPLANNED] + REPLAN_PERIOD - ROUND_OFF
    return settled and near and due and now <= time - REPLAN_LAST + ROUND_OFF


@compiled
def look_ahead(
    plan: PlanTable, memory: WorldMemory, options: Options, program: Program, c: int, k: int, now: float
) -> None:
    """Move or insert the coming impacts of world k, where options say so and the objects' flight is known."""
    for o in range(len(plan.first)):
        strike = memory.strike[k, o]
        settled = now >= strike[LAST] + SETTLE - ROUND_OFF
        if not settled or strike[INSERTED] > 0.0 or now < strike[LOOKED] + REPLAN_PERIOD - ROUND_OFF:
            continue
        strike[LOOKED] = now
        if options.reoptimise and strike[LAST] > strike[OPTIMISED] and strike[IMPACT_INDEX] != END:
            strike[OPTIMISED] = now
            if reoptimise(plan, memory, program, c, k, o, now):
                memory.counts[k, REOPTIMISED] += 1
                set_clocks(plan, memory, k, now)
            else:
                memory.counts[k, NO_OPTIMUM] += 1
                # Its rows are on the safe side: a new plan is wanted if the flight does go astray, but sooner.
                strike[ASTRAY] = min(strike[ASTRAY], now - LONG_ASTRAY + SOON)
        if options.retime and strike[LAST] > 0.0 and strike[IMPACT_INDEX] != END and now <= strike[TIME] - FROZEN:
            retime(plan, memory, k, o, now)
        if options.insert and strike[LAST] > 0.0:
            insert(plan, memory, options, k, o, now)


@compiled
def run_experts(
    plan: tuple,
    memory: tuple,
    options: tuple,
    workspace: tuple,
    program: tuple,
    joint: np.ndarray,
    actions: np.ndarray,
    due: np.ndarray,
    phase: int,
    c: int,
    first: int,
    end: int,
) -> None:
    """Start, observe or control the worlds from first to before end; plain tuples pass three times faster from Python.

    A tracker that is no compiled one is called between PREPARE and APPLY of each robot.

    Args:
        plan, memory, options, workspace, program: the fields of PlanTable, WorldMemory, Options, Workspace, Program.
        joint: everything measured once, shape (N, 7 n + r + 3).
        actions: written by CONTROL, ACT and APPLY, shape (N, r, 3).
        due: object whose coming impact's correction is due, or END, written by START and OBSERVE, shape (N,).
        phase: START, OBSERVE, CONTROL; ACT: observe and control, and start where time is 0; ADOPT: go on with a new
            plan; PREPARE, APPLY: control one robot.
        c: thread; of PREPARE and APPLY the robot, which has the workspace's row of its number.
        first, end: range of worlds.
    """
    plan_, memory_ = PlanTable(*plan), WorldMemory(*memory)
    options_, workspace_, program_ = Options(*options), Workspace(*workspace), Program(*program)
    clock = joint.shape[1] - 3
    for k in range(first, end):
        if phase == START or (phase == ACT and joint[k, clock] == 0.0):
            start_world(plan_, memory_, options_, k)
            due[k] = END
        if phase == ADOPT:
            adopt_world(plan_, memory_, k)
        if phase in (OBSERVE, ACT):
            due[k] = observe_world(plan_, memory_, options_, program_, c, k, joint)
        if phase in (CONTROL, ACT):
            control_world(plan_, memory_, options_, workspace_, c, k, actions)
        if phase == PREPARE:
            prepare_robot(plan_, memory_, options_, workspace_, k, c)
        if phase == APPLY:
            apply_solution(plan_, memory_, options_, workspace_, c, k, c, workspace_.target[c], actions)

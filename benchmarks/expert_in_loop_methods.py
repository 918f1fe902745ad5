"""The closed loops and tracking problems that benchmarks/expert_in_loop.py times."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

from impact_envs import parallel_env, vector_env
from impact_envs.compiled import compiled
from impact_envs.errors import InputError
from impact_envs.free_flyer.schema import FreeFlyerScenario
from planners.errors import SolverFailed
from planners.free_flyer.belief.options import Options
from planners.free_flyer.belief.world_memory import NO_OBJECT, find_next_event, find_strike
from planners.free_flyer.closed_loop.tracker import fill_reference
from planners.free_flyer.expert import FreeFlyerExpert
from planners.free_flyer.expert_batch import FreeFlyerExpertBatch
from planners.free_flyer.next_impact.desired_velocity import ROUND_OFF
from planners.free_flyer.tracking.casadi_mpc import (
    build_casadi_tracking,
    build_published_tracking,
    has_fatrop,
    solve_casadi_tracking,
    solve_published_tracking,
)
from planners.free_flyer.tracking.mpc import (
    NO_JUMP,
    TrackingProblem,
    Workspace,
    build_tracking_problem,
    make_workspace,
    solve_tracking,
)
from planners.plan import Plan

SEED = 0
AGAIN = 200  # solves of one problem that are timed together
OURS = "ours"
PUBLISHED = "published MPC, ipopt"
REFERENCE = f"reference MPC, {'fatrop' if has_fatrop() else 'ipopt'}"
FILLED = ("state", "states", "inputs", "durations", "node", "jump")  # of a workspace, what defines the problem


class Loop(NamedTuple):
    """A closed loop.

    Attributes:
        batch: number of worlds.
        run: plays so many control periods from reset and returns their CPU time [s].
        acts: CPU times of the expert's part of each period of the last run [s].
    """

    batch: int
    run: Callable[[int], float]
    acts: list[float]


class Problems(NamedTuple):
    """The tracking problems of one robot in one episode, in order.

    Attributes:
        problem: what stays the same.
        workspace: one problem per row.
    """

    problem: TrackingProblem
    workspace: Workspace


def make_batch(scenario: FreeFlyerScenario, plan: Plan, batch: int, mpc: bool) -> Loop:
    """Return the loop of many worlds in one thread, tracking by MPC or by LQR."""
    envs = vector_env(scenario, num_envs=batch, threads=1)
    expert = FreeFlyerExpertBatch(scenario, plan, batch, options=Options(mpc=mpc))
    acts: list[float] = []

    def run(steps: int) -> float:
        acts.clear()
        observations, _ = envs.reset(seed=SEED)
        begin = time.process_time()
        for _ in range(steps):
            before = time.process_time()
            actions = expert.act(observations)
            acts.append(time.process_time() - before)
            observations = envs.step(actions)[0]
        return time.process_time() - begin

    return Loop(batch, run, acts)


def play(env: Any, act: Callable[[Any], Any], observations: Any, steps: int, acts: list[float]) -> tuple[Any, float]:
    """Step one world; return its observations and the CPU time [s]."""
    begin = time.process_time()
    for _ in range(steps):
        before = time.process_time()
        actions = act(observations)
        acts.append(time.process_time() - before)
        observations = env.step(actions)[0]
    return observations, time.process_time() - begin


def make_single(scenario: FreeFlyerScenario, plan: Plan) -> Loop:
    """Return the loop of one world through the doors that users take."""
    env, expert = parallel_env(scenario), FreeFlyerExpert(scenario, plan)
    acts: list[float] = []

    def run(steps: int) -> float:
        acts.clear()
        expert.reset(SEED)
        return play(env, expert.act, env.reset(seed=SEED)[0], steps, acts)[1]

    return Loop(1, run, acts)


def make_published(scenario: FreeFlyerScenario, plan: Plan) -> Loop:
    """Return the loop of one world with the published MPC as tracker: from the start, and round the first impact.

    In between, the expert flies by LQR, which is not timed.

    Raises:
        InputError: the plan has no impacts.
    """
    if not plan.impacts:
        raise InputError(f"the plan of {plan.scenario} has no impacts: nothing to track the published way")
    env, expert = parallel_env(scenario), FreeFlyerExpert(scenario, plan, options=Options(mpc=False))
    problems = [build_tracking_problem(robot, scenario.control_period) for robot in scenario.robots.values()]
    solvers, acts = [build_published_tracking(problem) for problem in problems], list[float]()
    impact = round(plan.impacts[0].time / scenario.control_period)

    def act(observations: Any) -> dict[str, np.ndarray]:
        actions = expert.act(observations)
        for r, name in enumerate(scenario.agents):
            fill(expert, r)
            try:
                first = solve_published_tracking(solvers[r], expert.workspace)
            except SolverFailed:
                first = np.zeros(3)  # as the published code
            actions[name] = np.clip(first / problems[r].limits, -1.0, 1.0)
            note_push(expert, r, actions[name], problems[r])
        return actions

    def run(steps: int) -> float:
        acts.clear()
        expert.reset(SEED)
        early = min((steps + 1) // 2, impact)
        observations, first = play(env, act, env.reset(seed=SEED)[0], early, acts)
        flown = max(impact - (steps - early) // 2 - early, 0)
        observations, _ = play(env, expert.act, observations, flown, [])
        return first + play(env, act, observations, steps - early, acts)[1]

    return Loop(1, run, acts)


def fill(expert: FreeFlyerExpert, r: int) -> None:
    """Write robot r's tracking problem into the expert's workspace, as the expert does."""
    table, memory, workspace = expert.table, expert.memory, expert.workspace
    o = find_strike(memory, 0, r)
    if o != NO_OBJECT:
        strike = memory.strike[0, o]
        if not strike["is_inserted"] and strike["time"] > find_next_event(table, memory, 0, r)[0] + ROUND_OFF:
            o = NO_OBJECT
    fill_reference(table, memory, workspace, 0, 0, r, o)
    z, heading = memory.filter[0, r], memory.heading[0, r]
    workspace.state[0] = *z["position"], heading["angle"], *z["velocity"], heading["rate"]


def note_push(expert: FreeFlyerExpert, r: int, action: np.ndarray, problem: TrackingProblem) -> None:
    """Tell the expert's estimator which acceleration an action will cause."""
    heading = expert.memory.heading[0, r]
    turned = heading["angle"] + heading["rate"] * problem.period / 2
    push = action[:2] * problem.limits[:2] * problem.gains[:2]
    c, s = np.cos(turned), np.sin(turned)
    expert.memory.push[0, r] = c * push[0] - s * push[1], s * push[0] + c * push[1]


def record_problems(scenario: FreeFlyerScenario, plan: Plan, steps: int) -> list[Problems]:
    """Play an episode and return every robot's tracking problems."""
    env, expert = parallel_env(scenario), FreeFlyerExpert(scenario, plan)
    robots = list(scenario.robots.values())
    found = [
        Problems(build_tracking_problem(robot, scenario.control_period), make_workspace(steps)) for robot in robots
    ]

    def act(observations: Any) -> Any:
        actions = expert.act(observations)
        k = len(acts)
        for r, (_, workspace) in enumerate(found):
            fill(expert, r)
            for name in FILLED:
                getattr(workspace, name)[k] = getattr(expert.workspace, name)[0]
        return actions

    expert.reset(SEED)
    acts: list[float] = []
    play(env, act, env.reset(seed=SEED)[0], steps, acts)
    return found


@compiled
def solve_again(workspace: Workspace, c: int, pilot: np.ndarray, count: int) -> bool:
    """Solve row c's tracking problem so many times; return whether it was solved."""
    solved = True
    for _ in range(count):
        solved = solve_tracking(workspace, c, pilot)
    return solved


class Solve(NamedTuple):
    """Hold the first input that one method found, over the limits, NaN if it failed, and its CPU time [s]."""

    method: str
    problem: int
    jumps: bool
    first: np.ndarray
    seconds: float


def solve_all(robots: list[Problems]) -> Iterator[Solve]:
    """Solve every problem by ours, by CasADi with the heading free, and in the published form."""
    count = 0
    for problem, workspace in robots:
        peers = {
            REFERENCE: (build_casadi_tracking(problem), solve_casadi_tracking),
            PUBLISHED: (build_published_tracking(problem), solve_published_tracking),
        }
        pilot = problem.row
        solve_again(workspace, 0, pilot, 1)  # compiles
        for k, node in enumerate(workspace.node.tolist()):
            begin = time.thread_time()
            solved = solve_again(workspace, k, pilot, AGAIN)
            seconds = (time.thread_time() - begin) / AGAIN
            first = workspace.solution[k, :3] / problem.limits if solved else np.full(3, np.nan)
            yield Solve(OURS, count, node != NO_JUMP, first, seconds)
            for name, (mpc, solve) in peers.items():
                try:
                    first = np.ravel(solve(mpc, workspace, k))[:3] / problem.limits
                except SolverFailed:
                    first = np.full(3, np.nan)
                yield Solve(name, count, node != NO_JUMP, first, mpc.seconds)
            count += 1


def time_solvers(robots: list[Problems]) -> list[dict[str, Any]]:
    """Return rows of how long all methods take for the same problems, and how far their first inputs are from ours."""
    solves, rows = list(solve_all(robots)), []
    ours = {solve.problem: solve.first for solve in solves if solve.method == OURS}
    for where, jumps in (("all", (False, True)), ("no impact ahead", (False,)), ("impact ahead", (True,))):
        base = np.nan
        for name in (OURS, REFERENCE, PUBLISHED):
            chosen = [solve for solve in solves if solve.method == name and solve.jumps in jumps]
            done = [solve for solve in chosen if np.isfinite(solve.first).all()]
            if not done:
                continue
            seconds = np.array([solve.seconds for solve in done])
            off = [np.abs(solve.first - ours[solve.problem]).max() for solve in done]
            base = seconds.mean() if name == OURS else base
            p50, p99 = np.percentile(seconds, [50, 99]) * 1e6
            near, far = np.nanpercentile(off, [50, 99])
            row = {"problems": where, "method": name, "solves": len(chosen), "failed": len(chosen) - len(done)}
            row |= {
                "mean [us]": seconds.mean() * 1e6,
                "p50 [us]": p50,
                "p99 [us]": p99,
                "mean / ours": seconds.mean() / base,
            }
            rows.append(row | {"off p50": near, "off p99": far})
    return rows

"""The closed loops and tracking problems that benchmarks/expert_in_loop.py times."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from impact_envs import parallel_env, vector_env
from impact_envs.compiled import compiled
from impact_envs.errors import InputError
from impact_envs.free_flyer.schema import FreeFlyerScenario
from planners import make_expert, make_expert_batch
from planners.errors import SolverFailed
from planners.free_flyer.tracking.casadi_mpc import CasadiTracker, has_fatrop
from planners.free_flyer.tracking.cvxpy_mpc import CvxpyTracker
from planners.free_flyer.tracking.lqr import solve_lqr
from planners.free_flyer.tracking.mpc import Workspace, make_workspace, solve_tracking
from planners.free_flyer.tracking.problem import NO_JUMP, TrackingProblem, TrackingTask
from planners.free_flyer.tracking.published_mpc import (
    PublishedTracker,
    build_published_tracking,
    solve_published_tracking,
)
from planners.free_flyer.tracking.trackers import MpcTracker
from planners.plan import Plan

SEED = 0
AGAIN = 200  # solves of one problem that are timed together
MPC, LQR = "mpc", "lqr"
CASADI, CVXPY = f"casadi, {'fatrop' if has_fatrop() else 'ipopt'}", "cvxpy, Clarabel"
PUBLISHED = "published MPC, ipopt"
METHODS = (MPC, LQR, CASADI, CVXPY, PUBLISHED)


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
        tasks: one a step.
    """

    problem: TrackingProblem
    tasks: list[TrackingTask]


class Recorder:
    """Track by the compiled MPC, and keep every tracking problem."""

    def reset(self, problems: Mapping[str, TrackingProblem]) -> None:
        self._mpc, self.robots = MpcTracker(), {name: Problems(problem, []) for name, problem in problems.items()}
        self._mpc.reset(problems)

    def track(self, robot: str, task: TrackingTask) -> np.ndarray:
        self.robots[robot].tasks.append(TrackingTask(*map(np.copy, task)))
        return self._mpc.track(robot, task)


class PublishedInPart:
    """Track by the published MPC where it is timed, by the compiled one in between."""

    timed = True

    def __init__(self) -> None:
        self._published, self._quick = PublishedTracker(), MpcTracker()

    def reset(self, problems: Mapping[str, TrackingProblem]) -> None:
        self._published.reset(problems)
        self._quick.reset(problems)

    def track(self, robot: str, task: TrackingTask) -> np.ndarray:
        return (self._published if self.timed else self._quick).track(robot, task)


def make_batch(scenario: FreeFlyerScenario, plan: Plan, batch: int, tracker: str) -> Loop:
    """Return the loop of many worlds in one thread."""
    envs = vector_env(scenario, num_envs=batch, threads=1)
    expert = make_expert_batch(scenario, batch, plan, options={"tracker": tracker})
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
    env, expert = parallel_env(scenario), make_expert(scenario, plan)
    acts: list[float] = []

    def run(steps: int) -> float:
        acts.clear()
        expert.reset(SEED)
        return play(env, expert.act, env.reset(seed=SEED)[0], steps, acts)[1]

    return Loop(1, run, acts)


def make_published(scenario: FreeFlyerScenario, plan: Plan) -> Loop:
    """Return the loop of one world with the published MPC as tracker: from the start, and round the first impact.

    In between, the expert flies by the compiled MPC, which is not timed.

    Raises:
        InputError: the plan has no impacts.
    """
    if not plan.impacts:
        raise InputError(f"the plan of {plan.scenario} has no impacts: nothing to track the published way")
    env, tracker, acts = parallel_env(scenario), PublishedInPart(), list[float]()
    expert = make_expert(scenario, plan, tracker=tracker)
    impact = round(plan.impacts[0].time / scenario.control_period)

    def run(steps: int) -> float:
        acts.clear()
        expert.reset(SEED)
        early = min((steps + 1) // 2, impact)
        tracker.timed = True
        observations, first = play(env, expert.act, env.reset(seed=SEED)[0], early, acts)
        tracker.timed = False
        flown = max(impact - (steps - early) // 2 - early, 0)
        observations, _ = play(env, expert.act, observations, flown, [])
        tracker.timed = True
        return first + play(env, expert.act, observations, steps - early, acts)[1]

    return Loop(1, run, acts)


def record_problems(scenario: FreeFlyerScenario, plan: Plan, steps: int) -> list[Problems]:
    """Play an episode and return every robot's tracking problems."""
    recorder = Recorder()
    env, expert = parallel_env(scenario), make_expert(scenario, plan, tracker=recorder)
    expert.reset(SEED)
    play(env, expert.act, env.reset(seed=SEED)[0], steps, [])
    return list(recorder.robots.values())


@compiled
def solve_again(workspace: Workspace, c: int, pilot: np.ndarray, count: int) -> bool:
    """Solve row c's tracking problem so many times; return whether it was solved."""
    solved = True
    for _ in range(count):
        solved = solve_tracking(workspace, c, pilot)
    return solved


@compiled
def feed_back_again(
    state: np.ndarray, states: np.ndarray, ax: float, ay: float, pilot: np.ndarray, first: np.ndarray, count: int
) -> None:
    """Compute one problem's LQR input so many times."""
    for _ in range(count):
        solve_lqr(state, states[0], ax, ay, pilot, first)


class Solve(NamedTuple):
    """Hold the first input that one method found, over the limits, NaN if it failed, and its CPU time [s]."""

    method: str
    problem: int
    jumps: bool
    first: np.ndarray
    seconds: float


def make_methods(problem: TrackingProblem) -> dict[str, Callable[[TrackingTask], tuple[np.ndarray, float]]]:
    """Return functions of a task that return the first input and the CPU time [s]; compiled ones loop for it."""
    workspace, pilot, first, names = make_workspace(), problem.row, np.zeros(3), {"robot": problem}
    published, casadi, cvxpy = build_published_tracking(problem), CasadiTracker(), CvxpyTracker()
    casadi.reset(names)
    cvxpy.reset(names)

    def by_mpc(task: TrackingTask) -> tuple[np.ndarray, float]:
        for column, value in zip(workspace, task, strict=False):
            column[0] = value
        begin = time.thread_time()
        solved = solve_again(workspace, 0, pilot, AGAIN)
        seconds = (time.thread_time() - begin) / AGAIN
        if not solved:
            raise SolverFailed(MPC, "not solved", "allow more Newton steps")
        return workspace.solution[0, :3].copy(), seconds

    def by_lqr(task: TrackingTask) -> tuple[np.ndarray, float]:
        (x, y), cos, sin = problem.gains[:2] * task.inputs[0, :2], np.cos(task.state[2]), np.sin(task.state[2])
        ax, ay = cos * x - sin * y, sin * x + cos * y
        begin = time.thread_time()
        feed_back_again(task.state, task.states, ax, ay, pilot, first, AGAIN)
        return first.copy(), (time.thread_time() - begin) / AGAIN

    def by_call(track: Callable[[TrackingTask], np.ndarray], task: TrackingTask) -> tuple[np.ndarray, float]:
        begin = time.thread_time()
        inputs = track(task)
        return inputs.ravel()[:3], time.thread_time() - begin

    return {
        MPC: by_mpc,
        LQR: by_lqr,
        CASADI: partial(by_call, partial(casadi.track, "robot")),
        CVXPY: partial(by_call, partial(cvxpy.track, "robot")),
        PUBLISHED: partial(by_call, partial(solve_published_tracking, published)),
    }


def solve_all(robots: list[Problems]) -> Iterator[Solve]:
    """Solve every problem by every method, each from its own last solution."""
    count = 0
    for problem, tasks in robots:
        methods = make_methods(problem)
        for solve in methods.values():
            solve(tasks[0])  # compiles
        for task in tasks:
            for name, solve in methods.items():
                try:
                    first, seconds = solve(task)
                except SolverFailed:
                    first, seconds = np.full(3, np.nan), np.nan
                yield Solve(name, count, task.node != NO_JUMP, first / problem.limits, seconds)
            count += 1


def time_solvers(robots: list[Problems]) -> list[dict[str, Any]]:
    """Return how long each method takes for the same problems, and how far its first inputs are from the MPC's."""
    solves, rows = list(solve_all(robots)), []
    reference = {solve.problem: solve.first for solve in solves if solve.method == MPC}
    for where, jumps in (("all", (False, True)), ("no impact ahead", (False,)), ("impact ahead", (True,))):
        base = np.nan
        for name in METHODS:
            chosen = [solve for solve in solves if solve.method == name and solve.jumps in jumps]
            done = [solve for solve in chosen if np.isfinite(solve.first).all()]
            if not done:
                continue
            seconds = np.array([solve.seconds for solve in done])
            off = [np.abs(solve.first - reference[solve.problem]).max() for solve in done]
            base = seconds.mean() if name == MPC else base
            p50, p99 = np.percentile(seconds, [50, 99]) * 1e6
            near, far = np.nanpercentile(off, [50, 99])
            row = {"problems": where, "method": name, "solves": len(chosen), "failed": len(chosen) - len(done)}
            row |= {
                "mean [us]": seconds.mean() * 1e6,
                "p50 [us]": p50,
                "p99 [us]": p99,
                "mean / mpc": seconds.mean() / base,
            }
            rows.append(row | {"off p50": near, "off p99": far})
    return rows

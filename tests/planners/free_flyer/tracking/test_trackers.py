"""All trackers fly the paper's scenarios; where nothing binds they agree; failures fall back and are counted."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import cvxpy as cp
import numpy as np
import pytest

import planners
from impact_envs import InputError, load_scenario, parallel_env, rollout
from impact_envs.rollout import Episode
from planners import SolverFailed, make_expert
from planners.free_flyer.belief.options import EXPERT
from planners.free_flyer.expert import FreeFlyerExpert
from planners.free_flyer.expert_batch import FreeFlyerExpertBatch
from planners.free_flyer.tracking.casadi_mpc import CasadiTracker
from planners.free_flyer.tracking.cvxpy_mpc import CvxpyMpc, CvxpyTracker, build_cvxpy_mpc, compute_stage
from planners.free_flyer.tracking.lqr import solve_lqr
from planners.free_flyer.tracking.problem import NO_JUMP, TrackingProblem, TrackingTask
from planners.free_flyer.tracking.trackers import TRACKERS, MpcTracker
from tests.frozen.freeze import get_plan

SEED = 1_000_000
DOCUMENT = Path(__file__).resolve().parents[4] / "docs" / "trackers.md"
SCENARIO = "throw_and_catch"
COMPILED = ("mpc", "lqr")


def make(tracker: Any, scenario: str = SCENARIO, suite: str = "nominal") -> FreeFlyerExpert:
    return make_expert(load_scenario(scenario).suite(suite), get_plan(scenario, suite), tracker=tracker)


@cache  # trackers by name fly in several tests
def fly(tracker: Any, scenario: str = SCENARIO, suite: str = "nominal", steps: int | None = None) -> Episode:
    env = parallel_env(load_scenario(scenario).suite(suite), max_cycles=steps)
    return rollout(env, make(tracker, scenario, suite), SEED)


class Recorder:
    """The compiled MPC, which keeps every task and first input."""

    def reset(self, problems: Mapping[str, TrackingProblem]) -> None:
        self.problems, self.found, self._mpc = problems, list[tuple[str, TrackingTask, np.ndarray]](), MpcTracker()
        self._mpc.reset(problems)

    def track(self, robot: str, task: TrackingTask) -> np.ndarray:
        inputs = self._mpc.track(robot, task)
        self.found.append((robot, TrackingTask(*map(np.copy, task)), inputs[0]))
        return inputs


class Failing:
    """A tracker whose solves all fail, apart from the first so many."""

    def __init__(self, good: int, failure: str = "raise") -> None:
        self.good, self.failure = good, failure

    def reset(self, problems: Mapping[str, TrackingProblem]) -> None:
        self.calls = 0

    def track(self, robot: str, task: TrackingTask) -> np.ndarray:
        self.calls += 1
        if self.calls <= self.good:
            return np.array([[0.3, 0.0, 0.0], [-0.3, 0.0, 0.0], [0.0, 0.15, 0.0]])
        if self.failure == "raise":
            raise SolverFailed("nothing", "it always fails", "choose another tracker")
        return np.full((2, 3), np.nan)


@pytest.fixture(scope="module")
def recorder() -> Recorder:
    """Return an episode's tracking problems where neither sensors nor bodies are as believed."""
    recorder = Recorder()
    assert fly(recorder, suite="all").success
    return recorder


def measure_gaps(recorder: Recorder, tracker: Any, impacts: bool, within: float = np.inf, every: int = 1) -> np.ndarray:
    """Return how far a tracker's first inputs are from the compiled MPC's, over the limits.

    Args:
        recorder: with the problems.
        tracker: to compare.
        impacts: take problems with an impact in the horizon, otherwise those without.
        within: take problems whose first input is below so much of the limits.
        every: take one problem of so many; an odd number takes both robots'.
    """
    tracker.reset(recorder.problems)
    gaps = []
    for robot, task, first in recorder.found[::every]:
        limits = recorder.problems[robot].limits
        if (task.node != NO_JUMP) == impacts and np.abs(first / limits).max() < within:
            gaps.append(np.abs((tracker.track(robot, task)[0] - first) / limits).max())
    return np.array(gaps)


class Feedback:
    """The compiled LQR as an object."""

    def reset(self, problems: Mapping[str, TrackingProblem]) -> None:
        self._problems = problems

    def track(self, robot: str, task: TrackingTask) -> np.ndarray:
        ax, ay = (task.states[1, 3:5] - task.states[0, 3:5]) / task.durations[0]
        first = np.zeros(3)
        solve_lqr(task.state, task.states[0], ax, ay, self._problems[robot].row, first)
        return first[None]


def check_flight(episode: Episode) -> None:
    assert episode.success
    assert episode.robustness >= 0.0
    assert episode.fallbacks == {}


def list_flights() -> list[Any]:
    """Return every tracker with a short and a long scenario; solvers called 2,000 times from Python are slow."""
    long = [pytest.param(t, "corridor", marks=() if t in COMPILED else pytest.mark.slow) for t in TRACKERS]
    return [*((tracker, SCENARIO) for tracker in TRACKERS), *long]


@pytest.mark.parametrize(("tracker", "scenario"), list_flights())
def test_every_tracker_keeps_the_promise_of_the_plan(tracker: str, scenario: str) -> None:
    episode, plan = fly(tracker, scenario), get_plan(scenario, "nominal")
    assert plan is not None
    check_flight(episode)
    assert episode.robustness >= plan.robustness - 0.01
    assert [(hit.a, hit.b) for hit in episode.impacts] == [(hit.robot, hit.object) for hit in plan.impacts]


@pytest.mark.slow
@pytest.mark.parametrize("scenario", ["obstacle_avoidance", "pong", "pingpong"])
@pytest.mark.parametrize("tracker", TRACKERS)
def test_every_tracker_succeeds_in_long_scenarios(tracker: str, scenario: str) -> None:
    check_flight(fly(tracker, scenario))


@pytest.mark.parametrize("suite", ["nominal", "all"])
def test_object_between_the_compiled_phases_acts_bit_for_bit_as_the_compiled_call(suite: str) -> None:
    whole, parts = fly("mpc", suite=suite), fly(MpcTracker(), suite=suite)
    for name, actions in whole.actions.items():
        np.testing.assert_array_equal(parts.actions[name], actions)


@pytest.mark.parametrize("tracker", [CasadiTracker(), Feedback()], ids=["casadi", "lqr"])
def test_trackers_agree_where_no_limit_binds_and_no_impact_is_ahead(recorder: Recorder, tracker: Any) -> None:
    gaps = measure_gaps(recorder, tracker, impacts=False, within=0.95, every=3)
    assert len(gaps) > 170
    assert gaps.max() < 0.01


def test_casadi_agrees_with_an_impact_ahead(recorder: Recorder) -> None:
    gaps = measure_gaps(recorder, CasadiTracker(), impacts=True, within=0.95)
    assert len(gaps) >= 15
    assert gaps.max() < 0.01


@pytest.mark.parametrize("impacts", [False, True])
def test_cvxpy_solves_the_problem_of_the_compiled_mpc_limits_and_impacts_included(
    recorder: Recorder, impacts: bool
) -> None:
    gaps = measure_gaps(recorder, CvxpyTracker(), impacts, every=1 if impacts else 3)
    assert len(gaps) >= (15 if impacts else 170)
    assert gaps.max() < 1e-5


def test_cvxpy_would_brake_before_an_impact_that_it_did_not_predict(recorder: Recorder) -> None:
    tracker, seen = CvxpyTracker(), 0
    tracker.reset(recorder.problems)
    for robot, task, first in recorder.found:
        if 1 <= task.node <= 5:
            blind = tracker.track(robot, task._replace(node=NO_JUMP))[0]
            seen += np.abs((blind - first) / recorder.problems[robot].limits).max() > 0.2
    assert seen >= 4


def test_stage_of_an_impact_is_the_jump_and_then_the_flow(recorder: Recorder) -> None:
    robot, task, _ = next(found for found in recorder.found if found[1].node == 4)
    A, _, c = compute_stage(recorder.problems[robot], task, 4)
    state = np.array([0.3, -0.1, 0.2, 0.05, -0.02, 0.1])
    after = state.copy()
    normal = np.array([task.normal[0], task.normal[1]])
    after[3:5] -= task.gain * (normal @ state[3:5] - task.object_speed) * normal  # Eq. 6, solved for the robot
    assert np.abs(after - state).max() > 0.01
    after[:3] += task.durations[4] * after[3:]
    np.testing.assert_allclose(A @ state + c, after, atol=1e-15)
    A, _, c = compute_stage(recorder.problems[robot], task, 3)
    assert (A[3:, 3:] == np.eye(3)).all()
    assert not c.any()


@pytest.mark.parametrize("tracker", ["casadi", "cvxpy"])
def test_second_episode_of_an_expert_is_the_first_again(tracker: str) -> None:
    expert, env = make(tracker), parallel_env(SCENARIO, max_cycles=60)
    one, two = rollout(env, expert, SEED), rollout(env, expert, SEED)
    for name, actions in one.actions.items():
        np.testing.assert_array_equal(two.actions[name], actions)


@pytest.mark.parametrize("failure", ["raise", "nan"])
def test_failing_tracker_is_flown_by_lqr_and_counted(failure: str) -> None:
    episode, lqr = fly(Failing(0, failure)), fly("lqr")
    assert episode.success
    steps, robots = len(next(iter(episode.actions.values()))), len(episode.actions)
    assert episode.fallbacks == {"lqr": steps * robots}
    for name, actions in lqr.actions.items():
        np.testing.assert_array_equal(episode.actions[name], actions)


def test_inputs_after_the_first_are_flown_where_later_solves_fail() -> None:
    robots, env = load_scenario(SCENARIO).agents, parallel_env(SCENARIO)
    expert = make_expert(SCENARIO, get_plan(SCENARIO, "nominal"), tracker=Failing(len(robots)))
    observations, _ = env.reset(seed=SEED)
    expert.reset(SEED)
    flown = []
    for _ in range(4):
        actions = expert.act(observations)
        flown.append(actions[robots[0]][:2])
        observations, *_ = env.step(actions)
    np.testing.assert_allclose(flown[:3], [[0.2, 0.0], [-0.2, 0.0], [0.0, 0.1]], atol=1e-12)
    assert expert.diagnostics().fallbacks == {"shifted_plan": 2 * len(robots), "lqr": len(robots)}


def test_examples_of_the_document_run(monkeypatch: pytest.MonkeyPatch) -> None:
    """The cone holds in every step, and would be left without it; what is beside it flies to success."""
    monkeypatch.setattr(planners, "make_plan", lambda scenario: get_plan(scenario.name, "nominal"))
    space: dict[str, Any] = {}
    for block in re.findall(r"```python\n(.*?)```", DOCUMENT.read_text(encoding="utf-8"), re.DOTALL):
        exec(block, space)
    largest, free = find_largest_force(space["episode"]), find_largest_force(fly("cvxpy"))
    assert largest <= space["F_MAX"] + 1e-6
    assert free > 1.2 * space["F_MAX"]
    check_flight(space["episode"])
    check_flight(rollout(parallel_env(SCENARIO), space["mine"], SEED))


def find_largest_force(episode: Episode) -> float:
    """Return the largest force of any robot of a scenario whose robots have 1.5 N an axis [N]."""
    assert {robot.force_limit for robot in load_scenario(SCENARIO).robots.values()} == {1.5}
    return max(np.hypot(*(1.5 * actions[:, :2].T)).max() for actions in episode.actions.values())


def test_constraint_that_cannot_be_kept_falls_back_and_is_counted() -> None:
    def build(problem: TrackingProblem) -> CvxpyMpc:
        mpc = build_cvxpy_mpc(problem)
        return mpc.add([mpc.variables["inputs"][0, 0] >= 2 * problem.limits[0]])

    episode = fly(CvxpyTracker(build), steps=60)
    assert episode.fallbacks["lqr"] == sum(map(len, episode.actions.values()))


def test_problem_beside_the_rules_for_parameters_is_refused() -> None:
    def build(problem: TrackingProblem) -> CvxpyMpc:
        mpc, weight = build_cvxpy_mpc(problem), cp.Parameter(nonneg=True)
        return mpc.add([weight * weight * cp.norm(mpc.variables["inputs"]) <= 1.0])

    with pytest.raises(InputError, match=r"of robot 'snap' breaks the rules for parameters \(DPP\)"):
        make(CvxpyTracker(build))


def test_tracker_by_name_argument_and_options() -> None:
    assert make(None).options == EXPERT
    assert make("lqr").options == replace(EXPERT, tracker="lqr")
    scenario, plan = load_scenario(SCENARIO), get_plan(SCENARIO, "nominal")
    assert plan is not None
    expert = FreeFlyerExpert(scenario, plan, options=replace(EXPERT, tracker="lqr"), tracker="casadi")
    assert expert.options.tracker == "casadi"
    assert make(Recorder()).options.tracker == "own"


@pytest.mark.parametrize(
    ("tracker", "message"),
    [
        ("mcp", r"tracker 'mcp' is unknown; did you mean 'mpc'\? choices: mpc, lqr, casadi, cvxpy"),
        (3, "tracker = 3 has no reset and track; choices: mpc, lqr, casadi, cvxpy, published, or a Tracker"),
    ],
)
def test_unknown_trackers_are_refused(tracker: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        make(tracker)


@pytest.mark.parametrize(("tracker", "label"), [("casadi", "'casadi'"), (MpcTracker(), "MpcTracker")])
def test_many_worlds_take_compiled_trackers_only(tracker: Any, label: str) -> None:
    scenario, plan = load_scenario(SCENARIO), get_plan(SCENARIO, "nominal")
    assert plan is not None
    assert FreeFlyerExpertBatch(scenario, plan, 2, tracker="lqr").count == 2
    with pytest.raises(InputError, match=f"tracker {label} follows one world; experts of many worlds take mpc or lqr"):
        FreeFlyerExpertBatch(scenario, plan, 2, tracker=tracker)


def test_domain_without_trackers_says_so() -> None:
    with pytest.raises(InputError, match="tracker = 'lqr': the expert of domain 'dual_arm' has no trackers"):
        make_expert("dual_arm_grasp", tracker="lqr")


def test_inputs_of_a_bad_shape_are_refused() -> None:
    class Flat(Failing):
        def track(self, robot: str, task: TrackingTask) -> np.ndarray:
            return np.zeros(3)

    with pytest.raises(InputError, match=r"tracker Flat returned inputs of shape \(3,\); \(n, 3\) with n from 1 to 10"):
        make(Flat(0))

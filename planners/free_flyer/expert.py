"""The free-flyers' expert: plan, estimate, retime and replan the course to every impact, track it by MPC."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from impact_envs.compiled import announce, bind
from impact_envs.errors import InputError
from impact_envs.free_flyer.observation import join_observations, make_joint_layout
from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.rollout import Diagnostics
from planners.correction import check_correction
from planners.free_flyer.belief.impact_parameters import NOW, find_row, get_pair
from planners.free_flyer.belief.options import Options, get_options, make_record
from planners.free_flyer.belief.plan_table import make_plan_table
from planners.free_flyer.belief.world_memory import COUNTERS, NO_OBJECT, make_world_memory
from planners.free_flyer.closed_loop.background import Background
from planners.free_flyer.closed_loop.features import FEATURES
from planners.free_flyer.closed_loop.world_loop import (
    ADOPT,
    APPLY,
    CONTROL,
    DECIDE,
    DESCRIBE,
    OBSERVE,
    PREPARE,
    START,
    run_experts,
)
from planners.free_flyer.next_impact.correction import CORRECTION_SIZE
from planners.free_flyer.next_impact.rest_qp import make_rest_qp
from planners.free_flyer.tracking.mpc import make_workspace
from planners.free_flyer.tracking.problem import build_tracking_problem
from planners.free_flyer.tracking.protocol import Tracker, call_tracker
from planners.free_flyer.tracking.trackers import check_tracker, find_tracker
from planners.plan import Plan

# Counters of normal operation, not counted as fallbacks.
ROUTINE = ("replans", "retimed", "reoptimised", "planned_anew", "avoided", "detours", "responded")


class PairEstimate(NamedTuple):
    """What is known of a pair of robot and object.

    Attributes:
        restitution: of the two.
        mass_ratio: of the object over the robot.
        restitution_spread, mass_ratio_spread: standard deviations.
    """

    restitution: float
    mass_ratio: float
    restitution_spread: float
    mass_ratio_spread: float


def check_plan(scenario: FreeFlyerScenario, plan: Plan) -> None:
    """Raise if a plan cannot be executed in a scenario.

    Args:
        scenario: to act in.
        plan: to execute.

    Raises:
        InputError: the plan is for other bodies or another horizon.
    """
    planned = {*plan.robots, *plan.objects}
    if planned != set(scenario.bodies):
        raise InputError(
            f"the plan is for {plan.scenario} with {', '.join(sorted(planned))}; "
            f"scenario {scenario.name} has {', '.join(sorted(scenario.bodies))}"
        )
    if not math.isclose(plan.horizon, scenario.horizon):
        raise InputError(f"the plan lasts {plan.horizon:g} s, scenario {scenario.name} lasts {scenario.horizon:g} s")


def check_options(options: Options, many: bool) -> None:
    """Raise unless the options name a tracker that there is.

    Args:
        options: of the expert.
        many: whether it is an expert of many worlds.

    Raises:
        InputError: they do not.
    """
    try:
        check_tracker(options.tracker, many)
    except InputError as error:
        raise InputError(f"expert.{error}") from None


class FreeFlyerExpert:
    """Execute a plan in closed loop: a Policy that also takes a correction of every impulse.

    Per control step: estimate; after a contact return to the plan, learn what the impact did and optimise what is left
    of the plan anew; move the next impact to when the object will be where it should be hit, or insert one; where that
    fails, ask for a new plan in the background; in the last 20 s before an impact replan the course to it from the
    predicted object; track by MPC. Everything is computed from the believed physics, the plan and observations. One
    world of `loop.run_experts`.

    Args:
        scenario: its true physics are not looked at.
        plan: to execute.
        variant: of `options.VARIANTS`, what the expert is compared with; the expert itself without.
        options: parts of the loop, instead of a variant's.
        tracker: a name of `trackers.TRACKERS` or an object, instead of the options'.

    Attributes:
        name: of the policy.
        correction_size, feature_size: of what `correct` takes and `features` returns.
        plan: that is executed.

    Raises:
        InputError: the plan is for other bodies or another horizon, or the variant or the tracker is unknown.

    Source: Verhagen & Tumova, Secs. VI and VII.
    """

    correction_size = CORRECTION_SIZE
    feature_size = FEATURES

    def __init__(
        self,
        scenario: FreeFlyerScenario,
        plan: Plan,
        variant: str | None = None,
        options: Options | None = None,
        tracker: str | Tracker | None = None,
    ) -> None:
        check_plan(scenario, plan)
        announce(run_experts)
        self.name, self.plan = variant or "expert", plan
        chosen = get_options(variant) if options is None else options
        name, self._tracker = find_tracker(chosen.tracker if tracker is None else tracker)
        self.options = replace(chosen, tracker=name)
        self._scenario = scenario.as_believed()
        self.table = make_plan_table(self._scenario, plan, weights=chosen.weights, respond=chosen.respond)
        robots = len(scenario.robots)
        self.memory = make_world_memory(self.table, 1)
        self.workspace = make_workspace(1 if self._tracker is None else robots)
        period = scenario.control_period
        self._problems = {
            name: build_tracking_problem(robot, period, chosen.weights) for name, robot in self._scenario.robots.items()
        }
        self._joint = np.zeros((1, make_joint_layout(scenario).size))
        self._actions, self._due = np.zeros((1, robots, 3)), np.full(1, NO_OBJECT)
        self._corrections, self._features = np.zeros((1, self.correction_size)), np.zeros((1, self.feature_size))
        self._planned = self.table
        self._background = Background(self._scenario, self.options)
        self._record = make_record(self.options)
        self._arrays = tuple(self.memory), self._record, tuple(self.workspace), tuple(make_rest_qp())
        self._bind()
        self.reset(0)
        self.control()  # no control step has to wait for the compiler
        self.reset(0)

    def reset(self, seed: int) -> None:
        """Forget the last episode.

        Args:
            seed: unused, the expert is deterministic.
        """
        self._seconds, self._solve_seconds = 0.0, list[float]()
        self.table = self._planned
        self._background.forget_world(0)
        if self._tracker is not None:
            self._tracker.reset(self._problems)
        self._run(START)

    def act(self, observations: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Return each robot's action in [-1, 1], shape (3,), from its observation."""
        self.observe(observations)
        return self.control()

    def diagnostics(self) -> Diagnostics:
        """Return computing times, fallbacks and replans since reset."""
        counts = dict(zip(COUNTERS, self.memory.counts[0].tolist(), strict=True))
        found = Diagnostics(list(self._solve_seconds), replans=counts["replans"])
        found.reoptimised.update({"same_sequence": counts["reoptimised"], "free_sequence": counts["planned_anew"]})
        found.fallbacks.update({name: n for name, n in counts.items() if n and name not in ROUTINE})
        return found

    def observe(self, observations: Mapping[str, np.ndarray]) -> None:
        """Update the estimates, take note of contacts and missed impacts, and see whether a correction is due.

        Args:
            observations: robot to its observation.
        """
        if self.options.plan_anew:
            table = self._background.poll_plan(self.table, self.memory, 0)
            if table is not None:
                self.table = table
                self._run(ADOPT)
        begin = time.perf_counter()
        self._join(observations)
        self._run(OBSERVE)
        self._seconds = time.perf_counter() - begin

    def _join(self, observations: Mapping[str, np.ndarray]) -> None:
        """Write what is measured once."""
        join_observations(self._scenario, observations, self._joint[0])

    @property
    def awaiting_correction(self) -> bool:
        """Return whether a correction is due in this control step, and not given yet; once per planned impact."""
        return bool(self._due[0] != NO_OBJECT)

    def correct(self, correction: np.ndarray) -> None:
        """Set the correction of the coming impact; then look whether another object's is due in this step, too.

        The desired velocity change of the object is multiplied by exp(0.5 c_0) and turned by 0.3 c_1 rad, and the
        impact comes 2 c_2 s later; less, where that promises less than the expert's own aim, see `correction`.

        Args:
            correction: c in [-1, 1], shape (3,); zero changes nothing, bit for bit.

        Raises:
            InputError: wrong shape, or no correction is awaited.
        """
        values = check_correction(correction, self.correction_size, self.awaiting_correction)
        self._corrections[0] = values
        self._run(DECIDE)

    def features(self) -> np.ndarray:
        """Return what a learner may see of the coming impact (of the one a correction is awaited for, if any).

        Returns:
            Shape (45,), see `features.write_features`. Zeros when no impact is to come.
        """
        self._run(DESCRIBE)
        return self._features[0].copy()

    def estimates(self) -> dict[tuple[str, str], PairEstimate]:
        """Return what is known of every pair of robot and object by now."""
        found = {}
        for r, robot in enumerate(self._scenario.robots):
            for o, item in enumerate(self._scenario.objects):
                restitution, ratio = get_pair(self.memory, 0, r, o)
                i = find_row(self.memory, r, o)
                variances = self.memory.pair_covariance[0, NOW, [i, i + 1], [i, i + 1]]
                spread = np.sqrt(np.maximum(variances, 0.0))
                found[robot, item] = PairEstimate(restitution, ratio, float(spread[0]), float(ratio * spread[1]))
        return found

    def control(self) -> dict[str, np.ndarray]:
        """Replan where it is time to, and return each robot's action.

        Returns:
            Robot to action in [-1, 1], shape (3,): body-frame forces and torque over their limits.
        """
        begin = time.perf_counter()
        if self._tracker is None:
            self._run(CONTROL)
        else:
            for r, name in enumerate(self._scenario.agents):
                self._run(PREPARE, r)
                call_tracker(self._tracker, name, self.workspace, r)
                self._run(APPLY, r)
        self._due[0] = NO_OBJECT
        self._solve_seconds.append(self._seconds + time.perf_counter() - begin)
        return dict(zip(self._scenario.agents, self._actions[0].copy(), strict=True))

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "_call"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._bind()

    def _bind(self) -> None:
        *arguments, first, _ = self._collect(START)
        self._call = bind(run_experts, *arguments, first, first)  # of no world

    def _run(self, phase: int, row: int = 0) -> None:
        self._call(*self._collect(phase, row))

    def _collect(self, phase: int, row: int = 0) -> tuple[Any, ...]:
        """Return the arguments of `run_experts`; their types are always the same."""
        arrays = self._joint, self._actions, self._due, self._corrections, self._features
        return tuple(self.table), *self._arrays, *arrays, phase, row, 0, 1

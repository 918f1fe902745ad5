"""Experts of many worlds of two arms at once, for vector environments."""

from __future__ import annotations

from typing import Any, cast

import numpy as np

from impact_envs.compiled import announce
from impact_envs.dual_arm.observation import ARM, make_joint_layout
from impact_envs.dual_arm.schema import DualArmScenario
from impact_envs.errors import InputError
from impact_envs.interface.threads import APART, Threads
from planners.correction import spread_corrections
from planners.dual_arm.control_memory import make_control, make_law, make_scratch
from planners.dual_arm.dense_qp import COMPILED
from planners.dual_arm.expert_memory import CORRECTION_SIZE, FEATURE_SIZE, make_expert_memory, make_rules
from planners.dual_arm.impact_prediction import load_impact_map
from planners.dual_arm.options import Options, get_options
from planners.dual_arm.reference_spreading import NO_MAP
from planners.dual_arm.world_loop import CONTROL, FEATURES, OBSERVE, run_experts
from planners.observations import read_observations
from planners.reading_gate import COUNTS


class DualArmExpertBatch:
    """The expert of N worlds; world k acts as DualArmExpert does, and starts anew with an observation of time 0.

    One of zeros alone is no observation. A control period is ``observe``, then ``correct`` for worlds that await a
    correction, then ``control``; ``act`` is observe and control. What is not answered counts as zero.

    Args:
        scenario: its true physics are not looked at.
        count: N.
        variant: of `options.VARIANTS`; the expert itself without.
        options: instead of the variant's.
        threads: that share the worlds.

    Attributes:
        correction_size, feature_size: of what `correct` takes and `features` returns for a world.
        threads: that share the worlds.
        arrays: that `run_experts` takes first.

    Raises:
        InputError: unknown variant, a solver that is not compiled, or options that do not fit the scenario.
    """

    correction_size = CORRECTION_SIZE
    feature_size = FEATURE_SIZE

    def __init__(
        self,
        scenario: DualArmScenario,
        count: int,
        variant: str | None = None,
        options: Options | None = None,
        threads: int = 1,
    ) -> None:
        if count < 1:
            raise InputError(f"count = {count}: at least 1 world is needed")
        chosen = get_options(variant) if options is None else options
        if chosen.solver != COMPILED:
            raise InputError(f"expert.solver = {chosen.solver}: many worlds at once take {COMPILED} only")
        announce(run_experts)
        believed = scenario.as_believed()
        found = load_impact_map(believed, chosen) if chosen.controller.impact_map else None
        law, impact_map = make_law(believed, chosen.controller, found), found or NO_MAP
        self.count, self.size = count, make_joint_layout(scenario).size
        self.threads, self._threads = min(threads, count), Threads(threads, count)
        self._fresh = make_control(law, 1), make_expert_memory(believed, chosen, 1)
        self._control, self._expert = make_control(law, count), make_expert_memory(believed, chosen, count)
        fixed = law, make_rules(believed, chosen), impact_map.heights, impact_map.weights
        self.arrays: tuple[np.ndarray, ...] = (
            *fixed,
            self._control,
            self._expert,
            make_scratch(law, self._threads.rows),
        )
        self._nothing = np.zeros((count, 0, 0))
        self._unread = np.zeros((count, self.size))
        self._run(OBSERVE, self._unread, self._nothing)  # compiles
        self.forget_worlds(np.ones(count, bool))

    @property
    def counts(self) -> dict[str, np.ndarray]:
        """Return how often what happened since each world's start, name to shape (N,)."""
        judged = {name: self._expert["counts"][:, i] for i, name in enumerate(COUNTS)}
        return {"slack": self._control["slack"], "last_torque": self._control["held"], **judged}

    @property
    def awaiting_correction(self) -> np.ndarray:
        """Return which worlds await a correction in this control period, shape (N,)."""
        return self._expert["awaiting"] > 0

    def act(self, observations: np.ndarray) -> np.ndarray:
        """Return every world's joint action; call once per control period.

        Args:
            observations: joint ones, as `vector_env` returns them, shape (N, 31).

        Returns:
            Joint torques over their limits, in [-1, 1], shape (N, 6).

        Raises:
            InputError: observations of another shape.
        """
        self.observe(observations)
        return self.control()

    def observe(self, observations: np.ndarray) -> np.ndarray:
        """Read this period's measurements; return which worlds await a correction, shape (N,).

        Args:
            observations: see `act`.

        Raises:
            InputError: observations of another shape.
        """
        joint = read_observations(observations, self.count, self.size)
        starts = (joint[:, -1] == 0.0) & joint[:, : 2 * ARM.size].any(axis=1)
        if starts.any():
            self.forget_worlds(starts)
        self._run(OBSERVE, joint, self._nothing)
        return self.awaiting_correction

    def features(self) -> np.ndarray:
        """Return what a learner may see of every world's grasp, as `DualArmExpert.features`, shape (N, 22)."""
        features = np.empty((self.count, 1, FEATURE_SIZE))
        self._run(FEATURES, self._unread, features)
        return features[:, 0]

    def correct(self, worlds: np.ndarray, corrections: np.ndarray) -> np.ndarray:
        """Set the corrections of grip and load of some worlds, as DualArmExpert does.

        Args:
            worlds: that await one: a mask, shape (N,) bool, or their numbers, shape (m,).
            corrections: clipped to [-1, 1], shape (m, 2); zero changes nothing, bit for bit.

        Returns:
            Which worlds still await a correction, shape (N,) bool.

        Raises:
            InputError: another shape, a value that is not finite, or a world that awaits none.
        """
        spread = spread_corrections(worlds, corrections, self.awaiting_correction, CORRECTION_SIZE)
        given = ~np.isnan(spread[:, 0])
        self._expert["answer"][given] = spread[given]
        self._expert["awaiting"][given] = 0
        return self.awaiting_correction

    def control(self) -> np.ndarray:
        """Return every world's joint action, in [-1, 1], shape (N, 6)."""
        actions = np.empty((self.count, 2, 3))
        self._run(CONTROL, self._unread, actions)
        return actions.reshape(self.count, -1)

    def forget_worlds(self, worlds: np.ndarray) -> None:
        """Forget the episodes of some worlds, a mask, shape (N,)."""
        self._control[worlds], self._expert[worlds] = self._fresh

    def close(self) -> None:
        """Let the threads go; the next act starts new ones."""
        self._threads.close()

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        *fixed, _, _, scratch = self.arrays
        self.arrays = *fixed, self._control, self._expert, scratch  # copying makes others of them

    def _run(self, part: int, joint: np.ndarray, output: np.ndarray) -> None:
        call = cast(Any, run_experts)

        def run(thread: int, first: int, end: int) -> None:
            call(*self.arrays, joint, output, part, APART * thread, first, end)

        self._threads.share(run)

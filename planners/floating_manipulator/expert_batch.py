"""Experts of many floating manipulators at once, for vector environments."""

from __future__ import annotations

from typing import Any

import numpy as np

from impact_envs.compiled import announce, bind
from impact_envs.errors import InputError
from impact_envs.floating_manipulator.observation import make_layout
from impact_envs.floating_manipulator.schema import FloatingManipulatorScenario
from impact_envs.interface.threads import Threads
from planners.correction import spread_corrections
from planners.floating_manipulator.correction import get_correction_size, get_feature_size
from planners.floating_manipulator.options import Options, get_options, make_record
from planners.floating_manipulator.world_loop import CONTROL, CORRECT, FEATURES, FOLLOW, OBSERVE, START, run_experts
from planners.floating_manipulator.world_memory import (
    COUNTERS,
    make_expert_memory,
    make_expert_scratch,
    make_expert_table,
)
from planners.observations import read_observations

NONE = np.empty((0, 0))  # stands for an array that a part of the control period does not use


class FloatingManipulatorExpertBatch:
    """The expert of N worlds; world k acts as FloatingManipulatorExpert does, and starts anew with time 0.

    One of zeros alone is no observation. ``act`` is ``observe`` and ``control``; corrections come between them.

    Args:
        scenario: its true physics are not looked at.
        count: N.
        variant: of `options.VARIANTS`; the expert itself without.
        options: instead of the variant's.
        threads: that share the worlds.

    Attributes:
        count: N.
        correction_size, feature_size: of what `correct` takes and `features` returns, per world.
        memory: of all worlds.
        threads: that share the worlds.

    Raises:
        InputError: the variant or the form of the coefficients is unknown, or there is no world.
    """

    def __init__(
        self,
        scenario: FloatingManipulatorScenario,
        count: int,
        variant: str | None = None,
        options: Options | None = None,
        threads: int = 1,
    ) -> None:
        if count < 1:
            raise InputError(f"count = {count}: at least 1 world is needed")
        announce(run_experts)
        self.count, self.size = count, make_layout(scenario).size
        self.correction_size, self.feature_size = get_correction_size(scenario), get_feature_size(scenario)
        chosen = get_options(variant) if options is None else options
        table = make_expert_table(scenario.as_believed(), chosen)
        self.memory = make_expert_memory(table, chosen, count)
        self._arrays = table, self.memory, make_record(chosen)
        self._action_size = sum(len(limits) for limits in scenario.largest_commands.values())
        self.threads, self._threads = min(threads, count), Threads(threads, count)
        self._scratch = [make_expert_scratch(table) for _ in range(self.threads)]
        self._bind()
        self._run(START)

    @property
    def counts(self) -> dict[str, np.ndarray]:
        """Return how often what happened since each world's start, name to shape (N,)."""
        return {name: self.memory.counts[name] for name in COUNTERS}

    def act(self, observations: np.ndarray) -> np.ndarray:
        """Return every world's joint action; corrections that are awaited count as zero.

        Args:
            observations: joint ones, as `vector_env` returns them, shape (N, 2 n + 22).

        Returns:
            In [-1, 1], of the arm, then of the base where it is actuated, shape (N, n) or (N, n + 3).

        Raises:
            InputError: observations of another shape.
        """
        actions = np.empty((self.count, self._action_size))
        self._run(
            FOLLOW | OBSERVE | CONTROL, joint=read_observations(observations, self.count, self.size), actions=actions
        )
        return actions

    def observe(self, observations: np.ndarray) -> np.ndarray:
        """Read this control step's measurements.

        Args:
            observations: as for `act`.

        Returns:
            Which worlds await a correction now, shape (N,) bool.

        Raises:
            InputError: observations of another shape.
        """
        self._run(FOLLOW | OBSERVE, joint=read_observations(observations, self.count, self.size))
        return self.awaiting_correction

    @property
    def awaiting_correction(self) -> np.ndarray:
        """Return in which worlds a correction is due in this control step, and not given yet, shape (N,) bool."""
        return self.memory.state["is_awaited"].copy()

    def features(self) -> np.ndarray:
        """Return what a learner may observe of each world, shape (N, 2 n + 27); see `correction.write_features`."""
        values = np.empty((self.count, self.feature_size))
        self._run(FEATURES, values=values)
        return values

    def correct(self, worlds: np.ndarray, corrections: np.ndarray) -> np.ndarray:
        """Set the corrections of some worlds until their next ones are awaited, as FloatingManipulatorExpert does.

        Args:
            worlds: that await one: a mask, shape (N,) bool, or their numbers, shape (m,).
            corrections: clipped to [-1, 1], shape (m, n + 2); zero changes nothing, bit for bit.

        Returns:
            Which worlds still await a correction, shape (N,) bool.

        Raises:
            InputError: other shapes, a number that is not finite, or a world that awaits no correction.
        """
        awaiting, size = self.awaiting_correction, self.correction_size
        self._run(CORRECT, values=spread_corrections(worlds, corrections, awaiting, size))
        return self.awaiting_correction

    def control(self) -> np.ndarray:
        """Return every world's joint action in [-1, 1], as `act` does."""
        actions = np.empty((self.count, self._action_size))
        self._run(CONTROL, actions=actions)
        return actions

    def close(self) -> None:
        """Let the threads go; the next step starts new ones."""
        self._threads.close()

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "_call"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._bind()

    def collect(self, thread: int) -> tuple[Any, ...]:
        """Return what every call of `run_experts` by a thread takes before the observations."""
        return *self._arrays, self._scratch[thread]

    def _bind(self) -> None:
        self._call = bind(run_experts, *self.collect(0), NONE, NONE, NONE, START, 0, 0)  # of no world

    def _run(self, parts: int, joint: np.ndarray = NONE, values: np.ndarray = NONE, actions: np.ndarray = NONE) -> None:
        """Do parts of the control period of all worlds."""

        def run(thread: int, first: int, end: int) -> None:
            self._call(*self.collect(thread), joint, values, actions, parts, first, end)

        self._threads.share(run)

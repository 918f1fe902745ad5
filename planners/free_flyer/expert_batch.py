"""Experts of many worlds at once, for vector environments."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any, cast

import numpy as np

from impact_envs.compiled import announce
from impact_envs.errors import InputError
from impact_envs.free_flyer.observation import make_joint_layout
from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.free_flyer.sensing import COS, SIN, TIME, find_shared_place
from impact_envs.interface.threads import APART, Threads
from planners.correction import spread_corrections
from planners.free_flyer.belief.options import Options, get_options, make_record
from planners.free_flyer.belief.plan_table import PlanTable, make_plan_table
from planners.free_flyer.belief.world_memory import COUNTERS, NO_OBJECT, make_world_memory
from planners.free_flyer.closed_loop.background import Background
from planners.free_flyer.closed_loop.features import FEATURES
from planners.free_flyer.closed_loop.world_loop import (
    ACT,
    ADOPT,
    CONTROL,
    DECIDE,
    DESCRIBE,
    RECEIVE,
    START,
    run_experts,
)
from planners.free_flyer.expert import check_plan
from planners.free_flyer.next_impact.correction import CORRECTION_SIZE
from planners.free_flyer.next_impact.rest_qp import make_rest_qp
from planners.free_flyer.tracking.mpc import make_workspace
from planners.free_flyer.tracking.protocol import Tracker
from planners.free_flyer.tracking.trackers import check_compiled
from planners.observations import read_observations
from planners.plan import Plan


class FreeFlyerExpertBatch:
    """The expert of N worlds; world k acts as FreeFlyerExpert does, and starts anew with an observation of time 0.

    One of zeros alone is no observation. A control step is ``observe(observations)``, then ``correct`` as long as a
    world awaits a correction, then ``control()``; ``act`` is observe and control.

    Args:
        scenario: its true physics are not looked at.
        plan: to execute.
        count: N.
        variant: of `options.VARIANTS`; the expert itself without.
        options: parts of the loop, instead of a variant's.
        tracker: a name of `trackers.COMPILED`, instead of the options'.
        threads: that share the worlds.

    Attributes:
        correction_size, feature_size: of what `correct` takes and `features` returns of each world.
        due: object whose coming impact's correction is due in each world, or NO_OBJECT, shape (N,).
        threads: that share the worlds.
        plans_anew: whether worlds ask for new plans in the background.
        tables: what `run_experts` takes between plan and observations.

    Raises:
        InputError: the plan is for other bodies or another horizon, or the variant is unknown, or the tracker
            is not a compiled one.
    """

    correction_size = CORRECTION_SIZE
    feature_size = FEATURES

    def __init__(
        self,
        scenario: FreeFlyerScenario,
        plan: Plan,
        count: int,
        variant: str | None = None,
        options: Options | None = None,
        tracker: str | Tracker | None = None,
        threads: int = 1,
    ) -> None:
        check_plan(scenario, plan)
        if count < 1:
            raise InputError(f"count = {count}: at least 1 world is needed")
        announce(run_experts)
        self.count, self.robots = count, len(scenario.robots)
        self.size = make_joint_layout(scenario).size
        self._clock = find_shared_place(len(scenario.bodies), self.robots) + TIME
        believed, chosen = scenario.as_believed(), get_options(variant) if options is None else options
        self._table = make_plan_table(believed, plan, weights=chosen.weights, respond=chosen.respond)
        self._own = dict[int, PlanTable]()
        self.memory = make_world_memory(self._table, count)
        self.threads, self._threads = min(threads, count), Threads(threads, count)
        chosen = replace(chosen, tracker=check_compiled(chosen.tracker if tracker is None else tracker))
        self._background = Background(believed, chosen)
        workspace, qp = make_workspace(self._threads.rows), make_rest_qp(self._threads.rows)
        self.plans_anew = chosen.plan_anew
        self.tables = tuple(self.memory), make_record(chosen), tuple(workspace), tuple(qp)
        self._joint, self._actions = np.zeros((count, self.size)), np.zeros((count, self.robots, 3))
        self.due, self._features = np.full(count, NO_OBJECT), np.zeros((count, self.feature_size))
        self._corrections = np.full((count, self.correction_size), np.nan)
        self._run(self._table, START, 0, 0, count)

    @property
    def counts(self) -> dict[str, np.ndarray]:
        """Return how often what happened since each world's start, name to shape (N,)."""
        return {name: self.memory.counts[name] for name in COUNTERS}

    @property
    def awaiting_correction(self) -> np.ndarray:
        """Return in which worlds a correction is due in this control step, and not given yet, shape (N,) bool."""
        return self.due != NO_OBJECT

    def act(self, observations: np.ndarray) -> np.ndarray:
        """Return every world's joint action: ``observe`` and ``control`` in one go.

        Args:
            observations: joint ones, as `vector_env` returns them, shape (N, 7 bodies + robots + 3).

        Returns:
            In [-1, 1], shape (N, 3 robots).

        Raises:
            InputError: observations of another shape.
        """
        self._receive(observations)
        return self._act(ACT)

    def observe(self, observations: np.ndarray) -> np.ndarray:
        """Update the estimates of every world, and see where a correction is due.

        Args:
            observations: as ``act`` takes them.

        Returns:
            Which worlds await a correction, shape (N,) bool.

        Raises:
            InputError: observations of another shape.
        """
        self._receive(observations)
        self._share(RECEIVE)
        return self.awaiting_correction

    def features(self) -> np.ndarray:
        """Return what a learner may see of every world, see `features.write_features`, shape (N, 45)."""
        self._features = np.empty((self.count, self.feature_size))
        self._share(DESCRIBE)
        return self._features

    def correct(self, worlds: np.ndarray, corrections: np.ndarray) -> np.ndarray:
        """Set the corrections of coming impacts, as FreeFlyerExpert does; then look for further ones in this step.

        Args:
            worlds: that await one: a mask, shape (N,) bool, or their numbers, shape (m,).
            corrections: clipped to [-1, 1], shape (m, 3); zero changes nothing, bit for bit.

        Returns:
            Which worlds await a correction, shape (N,) bool.

        Raises:
            InputError: another shape, a value that is not finite, or a world that awaits none.
        """
        awaiting, size = self.awaiting_correction, self.correction_size
        self._corrections = spread_corrections(worlds, corrections, awaiting, size)
        self._share(DECIDE)
        return self.awaiting_correction

    def control(self) -> np.ndarray:
        """Replan where it is time to, and return every world's joint action; corrections not given count as zero.

        Returns:
            In [-1, 1], shape (N, 3 robots).
        """
        return self._act(CONTROL)

    def _act(self, phase: int) -> np.ndarray:
        self._actions = np.empty((self.count, self.robots, 3))
        self._share(phase)
        self.due[:] = NO_OBJECT
        self._finish()
        return self._actions.reshape(self.count, -1)

    def _receive(self, observations: np.ndarray) -> None:
        """Take observations; forget the episodes that are over, and take new plans over."""
        joint = self._joint = self._read(observations)
        for k in np.flatnonzero((joint[:, self._clock] == 0.0) & joint[:, [COS, SIN]].any(axis=1)).tolist():  # starts
            self.forget_world(k)
        if self.plans_anew:
            for k in self._background.find_busy(self.memory).tolist():
                self.poll_plan(k)

    def _read(self, observations: np.ndarray) -> np.ndarray:
        return read_observations(observations, self.count, self.size)

    def _finish(self) -> None:
        """Do what comes after the actions."""

    def forget_world(self, k: int) -> None:
        """Forget the plan of its own and the questions of world k, whose episode starts."""
        self._own.pop(k, None)
        self._background.forget_world(k)
        self.memory.wanted[k] = np.inf

    def poll_plan(self, k: int) -> None:
        """Let world k ask for a new plan, or take one over, where it is time to."""
        table = self._background.poll_plan(self._own.get(k, self._table), self.memory, k)
        if table is not None:
            self._own[k] = table
            self._run(table, ADOPT, 0, k, k + 1)

    def find_wake(self, k: int) -> float:
        """Return from when on world k must be polled, inf if there is nothing to wait for [s]."""
        return self._background.find_wake(k) if self.plans_anew else math.inf

    def split_worlds(self, first: int, end: int) -> Iterator[tuple[PlanTable, int, int]]:
        """Yield the plans that worlds from first to before end follow, each with its range of worlds, in order."""
        for k in sorted(k for k in self._own if first <= k < end):
            if first < k:
                yield self._table, first, k
            yield self._own[k], k, k + 1
            first = k + 1
        if first < end:
            yield self._table, first, end

    def _share(self, phase: int) -> None:
        """Run a phase of every world; threads share the worlds."""

        def run(thread: int, first: int, end: int) -> None:
            for table, start, stop in self.split_worlds(first, end):
                self._run(table, phase, APART * thread, start, stop)

        self._threads.share(run)

    def _run(self, table: PlanTable, phase: int, thread: int, first: int, end: int) -> None:
        arrays = self._joint, self._actions, self.due, self._corrections, self._features
        cast(Any, run_experts)(tuple(table), *self.tables, *arrays, phase, thread, first, end)

    def close(self) -> None:
        """Let the threads and the background's process go; the next act starts new ones."""
        self._background.close()
        self._threads.close()

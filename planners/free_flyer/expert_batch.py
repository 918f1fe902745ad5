"""Experts of many worlds at once, for vector environments."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any, cast

import numpy as np

from impact_envs.agent_vectors import REAL
from impact_envs.compiled import announce
from impact_envs.errors import InputError
from impact_envs.free_flyer.observation import make_joint_layout
from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.free_flyer.sensing import COS, SIN, TIME, find_shared_place
from planners.free_flyer.belief.options import Options, get_options, make_record
from planners.free_flyer.belief.plan_table import PlanTable, make_plan_table
from planners.free_flyer.belief.world_memory import COUNTERS, NO_OBJECT, make_world_memory
from planners.free_flyer.closed_loop.background import Background
from planners.free_flyer.closed_loop.world_loop import ACT, ADOPT, START, run_experts
from planners.free_flyer.expert import check_plan
from planners.free_flyer.next_impact.rest_qp import make_rest_qp
from planners.free_flyer.tracking.mpc import make_workspace
from planners.free_flyer.tracking.protocol import Tracker
from planners.free_flyer.tracking.trackers import check_compiled
from planners.plan import Plan


class FreeFlyerExpertBatch:
    """The expert of N worlds; world k acts as FreeFlyerExpert does, and starts anew with an observation of time 0.

    One of zeros alone is no observation.

    Args:
        scenario: its true physics are not looked at.
        plan: to execute.
        count: N.
        variant: of `options.VARIANTS`; the expert itself without.
        options: parts of the loop, instead of a variant's.
        tracker: a name of `trackers.COMPILED`, instead of the options'.
        threads: that share the worlds.

    Raises:
        InputError: the plan is for other bodies or another horizon, or the variant is unknown, or the tracker
            is not a compiled one.
    """

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
        self._threads = min(threads, count)
        chosen = replace(chosen, tracker=check_compiled(chosen.tracker if tracker is None else tracker))
        self._background = Background(believed, chosen)
        workspace, qp = make_workspace(self._threads), make_rest_qp(self._threads)
        self._plan_anew = chosen.plan_anew
        self._arrays = tuple(self.memory), make_record(chosen), tuple(workspace), tuple(qp)
        self._due = np.full(count, NO_OBJECT)
        self._run(self._table, np.zeros((count, self.size)), np.zeros((count, self.robots, 3)), START, 0, 0, count)
        self._pool: ThreadPoolExecutor | None = None

    @property
    def counts(self) -> dict[str, np.ndarray]:
        """Return how often what happened since each world's start, name to shape (N,)."""
        return {name: self.memory.counts[name] for name in COUNTERS}

    def act(self, observations: np.ndarray) -> np.ndarray:
        """Return every world's joint action.

        Args:
            observations: joint ones, as `vector_env` returns them, shape (N, 7 bodies + robots + 3).

        Returns:
            In [-1, 1], shape (N, 3 robots).

        Raises:
            InputError: observations of another shape.
        """
        joint = self._check(observations)
        actions = np.empty((self.count, self.robots, 3))
        for k in np.flatnonzero((joint[:, self._clock] == 0.0) & joint[:, [COS, SIN]].any(axis=1)).tolist():  # starts
            self._own.pop(k, None)
            self._background.forget_world(k)
            self.memory.wanted[k] = np.inf
        if self._plan_anew:
            for k in self._background.find_busy(self.memory).tolist():
                table = self._background.poll_plan(self._own.get(k, self._table), self.memory, k)
                if table is not None:
                    self._own[k] = table
                    self._run(table, joint, actions, ADOPT, 0, k, k + 1)

        def share(thread: int) -> None:
            first, end = thread * self.count // self._threads, (thread + 1) * self.count // self._threads
            for k in sorted(k for k in self._own if first <= k < end):
                self._run(self._table, joint, actions, ACT, thread, first, k)
                self._run(self._own[k], joint, actions, ACT, thread, k, k + 1)
                first = k + 1
            self._run(self._table, joint, actions, ACT, thread, first, end)

        if self._threads == 1:
            share(0)
        else:
            self._pool = self._pool or ThreadPoolExecutor(self._threads)
            list(self._pool.map(share, range(self._threads)))
        return actions.reshape(self.count, -1)

    def _check(self, observations: np.ndarray) -> np.ndarray:
        """Return observations as float64, or raise InputError."""
        needed = f"real numbers of shape ({self.count}, {self.size}) are needed"
        try:
            joint = np.asarray(observations)
        except (ValueError, TypeError):  # of different lengths
            raise InputError(f"observations: {needed}") from None
        if joint.shape != (self.count, self.size) or joint.dtype.kind not in REAL:
            raise InputError(f"observations have shape {joint.shape}, {joint.dtype}; {needed}")
        return np.ascontiguousarray(joint, dtype=np.float64)

    def _run(
        self, table: PlanTable, joint: np.ndarray, actions: np.ndarray, phase: int, thread: int, first: int, end: int
    ) -> None:
        cast(Any, run_experts)(tuple(table), *self._arrays, joint, actions, self._due, phase, thread, first, end)

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_pool": None}

    def close(self) -> None:
        """Let the threads and the background's process go; the next act starts new ones."""
        self._background.close()
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None

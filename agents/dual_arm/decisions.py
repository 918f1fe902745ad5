"""Two arms with their expert, from decision to decision: what a ResidualVectorEnv of them is made of."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, cast

import numpy as np

from agents.dual_arm.decision_loop import ADVANCE, OBSERVE, REST, make_progress, run_until_due
from impact_envs.compiled import announce
from impact_envs.dual_arm.batch import make_batch
from impact_envs.dual_arm.schema import DualArmScenario
from impact_envs.stl.verdict import judge
from planners.dual_arm.expert_batch import DualArmExpertBatch

# Control periods between two looks whether somebody pressed Ctrl-C, each thread: some .2 s.
PATIENCE = 5_000


class DualArmDecisions:
    """N worlds and their experts, run from one awaited correction to the next; world k is ResidualEnv's, bit for bit.

    Args:
        scenario: with the true physics.
        experts: of N worlds; their threads share the worlds.
        max_cycles: truncate earlier than the horizon [control periods].

    Attributes:
        experts: of the worlds.
        batch: the worlds.

    Raises:
        InputError: more worlds than fit into memory.
    """

    def __init__(self, scenario: DualArmScenario, experts: DualArmExpertBatch, max_cycles: int | None = None) -> None:
        announce(run_until_due)
        self.scenario, self.experts, self.count = scenario, experts, experts.count
        self._threads = experts.threads
        self.batch = make_batch(scenario, self.count, max_cycles, threads=self._threads)
        self._output, self.progress = self.batch.make_output(agents=False), make_progress(self.count)
        self._pool: ThreadPoolExecutor | None = None

    @property
    def awaiting_correction(self) -> np.ndarray:
        """Return which worlds await a correction, shape (N,) bool."""
        return self.experts.awaiting_correction & ~self.over

    @property
    def over(self) -> np.ndarray:
        """Return which episodes are at their end, shape (N,) bool."""
        return self.batch.over

    @property
    def failed(self) -> np.ndarray:
        """Return which simulations failed, shape (N,) bool."""
        return self.batch.failed

    @property
    def decided(self) -> np.ndarray:
        """Return where a learner has nothing to bootstrap: at the horizon, or failed, shape (N,) bool."""
        return self.batch.decided

    @property
    def steps(self) -> np.ndarray:
        """Return the control periods since each world's last start or answer, shape (N,)."""
        return self.progress.steps

    def judge(self) -> tuple[np.ndarray, np.ndarray]:
        """Return robustness [m] and success of every world, if its episode ended now, both of shape (N,)."""
        return judge(self.batch.outcome)

    def describe_failures(self) -> np.ndarray:
        """Return why each world failed, "" where it did not, shape (N,) of texts."""
        return self.batch.describe_failures()

    def features(self) -> np.ndarray:
        """Return what a learner may see of every world, shape (N, 22)."""
        return self.experts.features()

    def take_rewards(self, worlds: np.ndarray) -> np.ndarray:
        """Return the rewards of some worlds since they were last taken, zero of the others, shape (N,) [m]."""
        found = np.where(worlds, self.progress.rewards, 0.0)
        self.progress.rewards[worlds] = 0.0
        return found

    def start(self, worlds: np.ndarray, seeds: Sequence[int] | np.ndarray) -> None:
        """Start an episode in some worlds and run it to the first awaited correction.

        Args:
            worlds: mask, shape (N,) bool.
            seeds: of their episodes, in their order, shape (m,).
        """
        self.batch.seed(np.flatnonzero(worlds), seeds)
        self.batch.start(worlds, self._output)
        self.experts.forget_worlds(worlds)
        self.progress.rewards[worlds], self.progress.steps[worlds] = 0.0, 0
        self.progress.todo[worlds] = OBSERVE
        self._run()

    def answer(self, worlds: np.ndarray, corrections: np.ndarray) -> None:
        """Give some worlds the correction they await, and run them to the next one or to the end.

        Args:
            worlds: mask, shape (N,) bool; all await one.
            corrections: in [-1, 1], shape (N, 2).
        """
        self.experts.correct(worlds, corrections[worlds])
        self.progress.steps[worlds] = 0
        self.progress.todo[worlds] = ADVANCE
        self._run()

    def close(self) -> None:
        """Let the threads go."""
        self.experts.close()
        self.batch.close()
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_pool": None}

    def _run(self) -> None:
        """Run until every world rests."""
        while (self.progress.todo != REST).any():
            if self._threads == 1:
                self._run_share(0)
            else:
                self._pool = self._pool or ThreadPoolExecutor(self._threads)
                list(self._pool.map(self._run_share, range(self._threads)))

    def _run_share(self, thread: int) -> None:
        first, end = thread * self.count // self._threads, (thread + 1) * self.count // self._threads
        world, expert = self.batch.collect(self._output), self.experts.arrays
        cast(Any, run_until_due)(
            *world, *expert, tuple(self.progress), self.scenario.steps, PATIENCE, thread, first, end
        )

"""Worlds with their experts, run from one awaited correction to the next: what a ResidualVectorEnv is made of."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np

from agents.progress import ADVANCE, ANSWER, BEGIN, OBSERVE, POLL, REST, Progress, make_progress
from impact_envs.interface.threads import Threads
from impact_envs.stl.verdict import judge

# Seconds that a call of the compiled loop takes at most, about: Ctrl-C is answered between two.
PATIENCE = 0.2
PIECES = 8  # of the worlds that each thread runs, about


class Loop(Protocol):
    """The compiled loop of a domain."""

    def run(self, thread: int, first: int, end: int) -> None:
        """Run the worlds from first to before end until they rest or are to be polled; for PATIENCE, about."""

    def forget(self, worlds: np.ndarray) -> None:
        """Forget what worlds whose episodes start, a mask, shape (N,), did outside of compiled code."""

    def poll(self, k: int) -> None:
        """Do what world k needs outside of compiled code before it observes."""


class Decisions:
    """N worlds and their experts; world k is ResidualEnv's, bit for bit.

    Args:
        batch: the worlds, of ``vector_env``.
        experts: of these worlds, from ``make_expert_batch``; their threads share the worlds.
        make_loop: takes batch, experts, what the worlds write to and how far they are.

    Attributes:
        batch, experts: as given.
        steps: control periods since each world's last start or answer, shape (N,).
    """

    def __init__(self, batch: Any, experts: Any, make_loop: Callable[[Any, Any, Any, Progress], Loop]) -> None:
        self.batch, self.experts = batch, experts
        self._output = batch.make_output(agents=False)
        self._progress = make_progress(self._output.joint, batch.action_shape, experts.correction_size)
        self._loop = make_loop(batch, experts, self._output, self._progress)
        self.steps = self._progress.steps
        self._threads = Threads(experts.threads, len(self.steps))

    @property
    def awaiting_correction(self) -> np.ndarray:
        """Return which worlds await a correction, shape (N,) bool."""
        return self.experts.awaiting_correction & ~self.batch.over

    def judge(self) -> tuple[np.ndarray, np.ndarray]:
        """Return robustness [m] and success of every world, if its episode ended now, both of shape (N,)."""
        return judge(self.batch.outcome)

    def take_rewards(self, worlds: np.ndarray) -> np.ndarray:
        """Return the rewards of some worlds since they were last taken, zero of the others, shape (N,) [m]."""
        found = np.where(worlds, self._progress.rewards, 0.0)
        self._progress.rewards[worlds] = 0.0
        return found

    def start(self, worlds: np.ndarray, seeds: Sequence[int] | np.ndarray) -> None:
        """Start an episode in some worlds and run it to the first awaited correction.

        Args:
            worlds: mask, shape (N,) bool.
            seeds: of their episodes, in their order, shape (m,).
        """
        self.batch.seed(np.flatnonzero(worlds), seeds)
        self.batch.start(worlds, self._output)
        self._loop.forget(worlds)
        self._progress.rewards[worlds], self._progress.steps[worlds] = 0.0, 0
        self._progress.todo[worlds] = BEGIN
        self._run()

    def answer(self, worlds: np.ndarray, corrections: np.ndarray) -> None:
        """Give some worlds the correction they await, and run them to the next one or to the end.

        Args:
            worlds: mask, shape (N,) bool; all await one.
            corrections: in [-1, 1], shape (N, correction size); the rows of these worlds count.
        """
        self._progress.corrections[worlds] = corrections[worlds]
        self._progress.steps[worlds] = 0
        self._progress.todo[worlds] = ANSWER
        self._run()

    def close(self) -> None:
        """Let threads and processes go."""
        self._threads.close()
        self.experts.close()
        self.batch.close()

    def _run(self) -> None:
        """Run until every world rests."""
        todo = self._progress.todo
        while (todo != REST).any():
            while np.isin(todo, (BEGIN, ANSWER, OBSERVE, ADVANCE)).any():
                self._advance()
            for k in np.flatnonzero(todo == POLL).tolist():
                self._loop.poll(k)
                todo[k] = OBSERVE

    def _advance(self) -> None:
        """Run the worlds for a while, shared by the threads."""
        count, threads = len(self.steps), self._threads
        if threads.number == 1:
            self._loop.run(0, 0, count)
            return
        # Decisions take differently long: whoever is done takes the next piece.
        pieces = min(PIECES * threads.number, count)
        left = iter([(i * count // pieces, (i + 1) * count // pieces) for i in range(pieces)])

        def run(thread: int) -> None:
            for first, end in left:
                self._loop.run(thread, first, end)

        threads.work(run, stop=lambda: list(left))  # no further piece is taken

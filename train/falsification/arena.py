"""Play many episodes of one policy at once, each in a world with chosen numbers."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from impact_envs.domain import find_part
from impact_envs.errors import InputError
from impact_envs.interface.threads import Threads
from planners import list_variants
from train.evaluation.batch_player import Ends, check_batched, make_batch_policy, play_worlds
from train.evaluation.case import Case


class Played(NamedTuple):
    """Episodes of n worlds.

    Attributes:
        places: of the disturbances in their ranges, shape (n, names).
        seeds: shape (n,).
        robustness: shape (n,) [m].
        success: shape (n,) bool.
        causes: why each failed, shape (n,) of texts; "" where it did not.
    """

    places: np.ndarray
    seeds: np.ndarray
    robustness: np.ndarray
    success: np.ndarray
    causes: np.ndarray


@dataclass(frozen=True)
class _Lane:
    """A batch of worlds and who acts in them, for one thread."""

    worlds: Any
    batch: Any
    policy: Any


class Arena:
    """Worlds of a case with one policy: lanes of them, each played by a thread of its own.

    Threads that share every control step of one batch would wait for each other at each; lanes meet at the end of an
    episode. Worlds do not depend on each other, so it makes no difference which lane plays which.

    Args:
        case: with its plan.
        policy: name of one that plays many worlds at once.
        wide: worlds that are played together.
        threads: lanes that share them.

    Raises:
        InputError: the domain has no chosen worlds, the suite draws nothing, or the policy does not fit.
    """

    def __init__(self, case: Case, policy: str, wide: int, threads: int = 1) -> None:
        pinned = find_part("train", case.scenario.domain, "PINNED")
        if pinned is None:
            raise InputError(f"scenario '{case.scenario.name}': worlds of its domain cannot be chosen")
        check_batched(policy)
        if policy == "oracle":
            known = ", ".join(["expert", *list_variants(case.scenario), "zero"])
            raise InputError(
                "policy 'oracle' is told what its seed draws; a search chooses that itself; "
                f"choices: {known}, or the folder of a checkpoint"
            )
        self._case, self._policy, self._make = case, policy, pinned
        self.worlds = pinned(case.scenario)
        self.names: tuple[str, ...] = self.worlds.names
        if not self.names:
            raise InputError(
                f"suite '{case.suite}' of scenario '{case.scenario.name}' draws nothing from a range; "
                f"choices: {', '.join(_list_drawing(case, pinned)) or 'none'}; or give ranges with --vary"
            )
        self.wide, self._threads = wide, Threads(threads, wide)
        self._size = -(-wide // self._threads.number)
        self._lanes: list[_Lane] = []
        self.episodes = 0

    def play(self, places: np.ndarray, seeds: np.ndarray) -> Played:
        """Play an episode in each of some worlds.

        Args:
            places: shape (n, names).
            seeds: shape (n,).
        """
        if not self._lanes:  # a search may be refused before anything is made, or planned
            self._lanes = [self._make_lane() for _ in range(self._threads.number)]
        parts: list[Played | None] = [None] * max(self._threads.number, -(-len(places) // self._size))
        ends, stopped = [k * len(places) // len(parts) for k in range(len(parts) + 1)], threading.Event()

        def work(thread: int) -> None:
            for part in range(thread, len(parts), len(self._lanes)):
                chosen = slice(ends[part], ends[part + 1])
                if chosen.start < chosen.stop and not stopped.is_set():
                    parts[part] = self._play(self._lanes[thread], places[chosen], seeds[chosen], stopped.is_set)

        if len(self._lanes) == 1:
            work(0)
        else:
            self._threads.work(work, stopped.set)
        self.episodes += len(places)
        return Played(*(np.concatenate(column) for column in zip(*filter(None, parts), strict=True)))

    def close(self) -> None:
        """Let the threads go."""
        self._threads.close()
        for lane in self._lanes:
            lane.policy.close()
            lane.batch.close()

    def _play(self, lane: _Lane, places: np.ndarray, seeds: np.ndarray, is_stopped: Callable[[], bool]) -> Played:
        count = len(places)
        filling = np.arange(self._size) % count
        lane.worlds.pin(places[filling])
        ends = play_worlds(lane.batch, lane.policy, seeds[filling].astype(np.int64), count, is_stopped)
        causes = self._describe(ends, lane.batch)
        return Played(places, seeds, ends.robustness[:count], ends.success[:count], causes[:count])

    def _make_lane(self) -> _Lane:
        scenario = self._case.scenario
        worlds = self._make(scenario)
        batch = find_part("impact_envs", scenario.domain, "BATCH")(worlds, self._size, None, threads=1)
        return _Lane(worlds, batch, make_batch_policy(self._policy, self._case, self._size, 1, batch.action_shape))

    def _describe(self, ends: Ends, batch: Any) -> np.ndarray:
        """Return which part of the formula was broken the most, and after how many impacts; or what ended it."""
        formula = self._case.scenario.specification
        intervals = ends.joint[:, batch.task.joint_layout["robustness"]].reshape(len(ends.joint), -1, 2)
        texts = np.full(len(ends.success), "", object)
        for k in np.flatnonzero(~ends.success):
            part = str(formula.conjuncts()[int(np.argmin(intervals[k, :, 0]))])
            texts[k] = ends.failure[k] or f"{part}, {ends.impacts[k]} impacts"
        return texts


def _list_drawing(case: Case, pinned: Callable[[Any], Any]) -> list[str]:
    """Return the suites of a scenario that draw something from a range."""
    return [name for name in case.scenario.list_suites() if pinned(case.scenario.suite(name)).names]

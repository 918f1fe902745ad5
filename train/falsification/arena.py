"""Play many episodes of one policy at once, each in a world with chosen numbers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from impact_envs.domain import find_part
from impact_envs.errors import InputError
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
class _Room:
    """A batch of worlds and who acts in them."""

    worlds: Any
    batch: Any
    policy: Any


class Arena:
    """Worlds of a case with one policy, of two sizes: wide for the search, narrow for a few worlds.

    Args:
        case: with its plan.
        policy: name of one that plays many worlds at once.
        wide, narrow: worlds that are played together.
        threads: that share them.

    Raises:
        InputError: the domain has no chosen worlds, the suite draws nothing, or the policy does not fit.
    """

    def __init__(self, case: Case, policy: str, wide: int, narrow: int, threads: int = 1) -> None:
        pinned = find_part("train", case.scenario.domain, "PINNED")
        if pinned is None:
            raise InputError(f"scenario '{case.scenario.name}': worlds of its domain cannot be chosen")
        check_batched(policy)
        if policy == "oracle":
            raise InputError("policy 'oracle' is told what its seed draws; a search chooses that itself")
        self._case, self._policy, self._make, self._threads = case, policy, pinned, threads
        self.worlds = pinned(case.scenario)
        self.names: tuple[str, ...] = self.worlds.names
        if not self.names:
            raise InputError(
                f"suite '{case.suite}' of scenario '{case.scenario.name}' draws nothing from a range; choose another"
            )
        self.wide, self._narrow, self._rooms = wide, narrow, dict[int, _Room]()
        self.episodes = 0

    def play(self, places: np.ndarray, seeds: np.ndarray) -> Played:
        """Play an episode in each of some worlds.

        Args:
            places: shape (n, names).
            seeds: shape (n,).
        """
        size = self._narrow if len(places) <= self._narrow else self.wide
        parts = [self._play(places[k : k + size], seeds[k : k + size], size) for k in range(0, len(places), size)]
        self.episodes += len(places)
        return Played(*(np.concatenate(column) for column in zip(*parts, strict=True)))

    def close(self) -> None:
        """Let the threads go."""
        for room in self._rooms.values():
            room.policy.close()
            room.batch.close()

    def _play(self, places: np.ndarray, seeds: np.ndarray, size: int) -> Played:
        room, count = self._find_room(size), len(places)
        filling = np.arange(size) % count
        room.worlds.pin(places[filling])
        ends = play_worlds(room.batch, room.policy, seeds[filling].astype(np.int64))
        causes = self._describe(ends, room.batch)
        return Played(places, seeds, ends.robustness[:count], ends.success[:count], causes[:count])

    def _find_room(self, size: int) -> _Room:
        if size not in self._rooms:
            scenario = self._case.scenario
            worlds = self._make(scenario)
            batch = find_part("impact_envs", scenario.domain, "BATCH")(worlds, size, None, threads=self._threads)
            policy = make_batch_policy(self._policy, self._case, size, self._threads, batch.action_shape)
            self._rooms[size] = _Room(worlds, batch, policy)
        return self._rooms[size]

    def _describe(self, ends: Ends, batch: Any) -> np.ndarray:
        """Return which part of the formula was broken the most, and after how many impacts; or what ended it."""
        formula = self._case.scenario.specification
        intervals = ends.joint[:, batch.task.joint_layout["robustness"]].reshape(len(ends.joint), -1, 2)
        texts = np.full(len(ends.success), "", object)
        for k in np.flatnonzero(~ends.success):
            part = str(formula.conjuncts()[int(np.argmin(intervals[k, :, 0]))])
            texts[k] = ends.failure[k] or f"{part}, {ends.impacts[k]} impacts"
        return texts

"""The mildest failures: one of each cause, every disturbance moved back towards nominal while it still fails."""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from train.falsification.arena import Arena, Played

STEPS = 8  # places tried at once between a disturbance and nominal
ROUNDS = 2  # of that, each in an eighth of the range of the one before


@dataclass(frozen=True)
class Counterexample:
    """A world in which a policy fails.

    Attributes:
        cause: which part of the formula, after how many impacts.
        seed: of its episode.
        robustness: of that [m].
        values: of the disturbances, by dotted key of the scenario.
        moved: those among them that are not nominal: with any of them nearer to it, the episode succeeds.
        found: failures of this cause in the search.
        places: of the disturbances in their ranges, shape (names,).
        failure_rate: of other seeds in this world.
    """

    cause: str
    seed: int
    robustness: float
    values: Mapping[str, float]
    moved: tuple[str, ...]
    found: int
    places: np.ndarray
    failure_rate: float = math.nan


def find_counterexamples(arena: Arena, played: Played, most: int, fresh: np.ndarray) -> list[Counterexample]:
    """Return the mildest failure of the most frequent causes; causes that come to the same are one.

    Args:
        arena: where to play on.
        played: episodes of the search.
        most: causes at most.
        fresh: seeds on which the failure rates are measured.
    """
    causes, counts = np.unique(played.causes[~played.success].astype(str), return_counts=True)
    left = [(causes[place], int(counts[place])) for place in np.argsort(-counts, kind="stable")]
    found: dict[tuple[str, ...], Counterexample] = {}
    while left and len(found) < most:
        count = most - len(found)
        tried, left = left[:count], left[count:]
        starts = np.array([_find_mildest(arena, played, cause) for cause, _ in tried])
        for one in _make_all(arena, played.places[starts], played.seeds[starts], [count for _, count in tried]):
            key = (one.cause, *one.moved)
            found[key] = replace(found[key], found=found[key].found + one.found) if key in found else one
    return _measure_rates(arena, list(found.values()), fresh)


def minimise(arena: Arena, places: np.ndarray, seeds: np.ndarray) -> np.ndarray:
    """Move places towards nominal as far as the episodes of their seeds still fail.

    Whole disturbances are taken away first, that one whose loss leaves the least robustness; then each of the others
    is moved part of the way. What is tried next in all worlds is played together.

    Args:
        arena: where to play.
        places: of worlds in which the episodes fail, shape (n, names).
        seeds: of the episodes, shape (n,).

    Returns:
        Places of worlds in which they fail too, shape (n, names).
    """
    results = np.array(places)
    searches = {k: _minimise(row, arena.worlds.nominal) for k, row in enumerate(results.copy())}
    answers: dict[int, Played | None] = dict.fromkeys(searches)
    while searches:
        tried = {}
        for k in list(searches):
            try:
                tried[k] = searches[k].send(answers[k])
            except StopIteration as end:
                results[k] = end.value
                del searches[k]
        if tried:
            counts = [len(rows) for rows in tried.values()]
            played = arena.play(np.concatenate(list(tried.values())), np.repeat(seeds[list(tried)], counts))
            parts = zip(*(np.split(column, np.cumsum(counts)[:-1]) for column in played), strict=True)
            answers = dict(zip(tried, (Played(*part) for part in parts), strict=True))
    return results


def _minimise(places: np.ndarray, nominal: np.ndarray) -> Generator[np.ndarray, Any, np.ndarray]:
    """Yield places to play, shape (m, names), be sent what came of it, and return the mildest that fail."""
    while (left := np.flatnonzero(places != nominal)).size:
        tried = np.repeat(places[None], len(left), axis=0)
        tried[np.arange(len(left)), left] = nominal[left]
        played = yield tried
        if played.success.all():
            break
        places = tried[int(np.argmin(np.where(played.success, np.inf, played.robustness)))]
    for name in np.flatnonzero(places != nominal):
        for _ in range(ROUNDS):
            tried = np.repeat(places[None], STEPS - 1, axis=0)
            tried[:, name] += np.arange(1, STEPS) / STEPS * (nominal[name] - places[name])
            succeeded = np.flatnonzero((yield tried).success)
            # The farthest step before the episode succeeds for the first time.
            farthest = int(succeeded[0]) if len(succeeded) else len(tried)
            places = tried[farthest - 1] if farthest > 0 else places
    return places


def _find_mildest(arena: Arena, played: Played, cause: str) -> int:
    """Return the number of the episode next to nominal that failed by a cause."""
    chosen = np.flatnonzero((played.causes == cause) & ~played.success)
    distances = np.abs(played.places[chosen] - arena.worlds.nominal).sum(axis=1)
    return int(chosen[np.argmin(distances)])


def _make_all(arena: Arena, places: np.ndarray, seeds: np.ndarray, counts: Sequence[int]) -> Iterator[Counterexample]:
    """Yield worlds made milder, whose rates of failure are still to be measured."""
    final = arena.play(minimise(arena, places, seeds), seeds)
    usual = arena.worlds.list_values(arena.worlds.nominal)
    for k, count in enumerate(counts):
        values = arena.worlds.list_values(final.places[k])
        yield Counterexample(
            cause=str(final.causes[k]),
            seed=int(seeds[k]),
            robustness=float(final.robustness[k]),
            values=values,
            moved=tuple(name for name in values if values[name] != usual[name]),
            found=count,
            places=final.places[k],
        )


def _measure_rates(arena: Arena, found: Sequence[Counterexample], fresh: np.ndarray) -> list[Counterexample]:
    """Return counterexamples with their rates of failure on fresh seeds."""
    if not found:
        return []
    places = np.repeat([one.places for one in found], len(fresh), axis=0)
    success = arena.play(places, np.tile(fresh, len(found))).success.reshape(len(found), -1)
    return [replace(one, failure_rate=float(np.mean(~row))) for one, row in zip(found, success, strict=True)]

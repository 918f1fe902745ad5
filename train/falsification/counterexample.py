"""The mildest failures: one of each cause, every disturbance moved back towards nominal while it still fails."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

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
        failure_rate: of other seeds in this world.
    """

    cause: str
    seed: int
    robustness: float
    values: Mapping[str, float]
    moved: tuple[str, ...]
    found: int
    failure_rate: float


def find_counterexamples(arena: Arena, played: Played, most: int, fresh: np.ndarray) -> list[Counterexample]:
    """Return the mildest failure of the most frequent causes; causes that come to the same are one.

    Args:
        arena: where to play on.
        played: episodes of the search.
        most: causes at most.
        fresh: seeds on which the failure rates are measured.
    """
    causes, counts = np.unique(played.causes[~played.success].astype(str), return_counts=True)
    found: dict[tuple[str, ...], Counterexample] = {}
    for place in np.argsort(-counts, kind="stable"):
        if len(found) == most:
            break
        chosen = np.flatnonzero((played.causes == causes[place]) & ~played.success)
        distances = np.abs(played.places[chosen] - arena.worlds.nominal).sum(axis=1)
        start = chosen[np.argmin(distances)]
        one = _make(arena, played.places[start], int(played.seeds[start]), int(counts[place]), fresh)
        key = (one.cause, *one.moved)
        found[key] = replace(found[key], found=found[key].found + one.found) if key in found else one
    return list(found.values())


def minimise(arena: Arena, places: np.ndarray, seed: int) -> np.ndarray:
    """Move places towards nominal as far as the episode of a seed still fails.

    Whole disturbances are taken away first, that one whose loss leaves the least robustness; then each of the others
    is moved part of the way.

    Args:
        arena: where to play.
        places: of a world in which the episode fails, shape (names,).
        seed: of the episode.

    Returns:
        Places of a world in which it fails too, shape (names,).
    """
    nominal, places = arena.worlds.nominal, np.array(places)
    while (left := np.flatnonzero(places != nominal)).size:
        tried = np.repeat(places[None], len(left), axis=0)
        tried[np.arange(len(left)), left] = nominal[left]
        played = arena.play(tried, np.full(len(left), seed))
        if played.success.all():
            break
        places = tried[int(np.argmin(np.where(played.success, np.inf, played.robustness)))]
    for name in np.flatnonzero(places != nominal):
        for _ in range(ROUNDS):
            places = _approach(arena, places, int(name), seed)
    return places


def _approach(arena: Arena, places: np.ndarray, name: int, seed: int) -> np.ndarray:
    """Move one place to the farthest of some steps towards nominal before the episode succeeds."""
    shares = np.arange(1, STEPS) / STEPS
    target = arena.worlds.nominal[name]
    tried = np.repeat(places[None], len(shares), axis=0)
    tried[:, name] += shares * (target - places[name])
    succeeded = np.flatnonzero(arena.play(tried, np.full(len(shares), seed)).success)
    first = int(succeeded[0]) if len(succeeded) else len(shares)
    return tried[first - 1] if first > 0 else places


def _make(arena: Arena, places: np.ndarray, seed: int, count: int, fresh: np.ndarray) -> Counterexample:
    places = minimise(arena, places, seed)
    final = arena.play(places[None], np.array([seed]))
    others = arena.play(np.repeat(places[None], len(fresh), axis=0), fresh)
    values = arena.worlds.list_values(places)
    usual = arena.worlds.list_values(arena.worlds.nominal)
    moved = tuple(name for name in values if values[name] != usual[name])
    return Counterexample(
        cause=str(final.causes[0]),
        seed=seed,
        robustness=float(final.robustness[0]),
        values=values,
        moved=moved,
        found=count,
        failure_rate=float(np.mean(~others.success)),
    )

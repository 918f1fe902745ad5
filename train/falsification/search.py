"""Look for worlds with little robustness: at random, then by cross-entropy or CMA-ES."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from train.falsification.arena import Arena, Played

Method = Literal["random", "cross_entropy", "cma"]


@dataclass(frozen=True)
class SearchOptions:
    """Say how to look for failures.

    Attributes:
        method: after the random part; cma needs the package cma.
        episodes: of the whole search.
        random_share: of them that are spread evenly over all ranges.
        seeds_each: episodes of one candidate, whose mean robustness is minimised: what one seed's noise does is luck.
        elite: share of a generation's candidates that the next one is drawn around.
        least_spread: of a place, so that the search does not stop at once.
        generations: of a long search, about.
        fewest, most: episodes of a generation: of few, drawing the next one tells too little; more than most gain
            nothing, for what a call costs is far below what the worlds do.
    """

    method: Method = "cross_entropy"
    episodes: int = 3000
    random_share: float = 0.4
    seeds_each: int = 4
    elite: float = 0.25
    least_spread: float = 0.05
    generations: int = 48
    fewest: int = 64
    most: int = 1024

    @property
    def width(self) -> int:
        """Return how many episodes are played together, those of a generation: a power of two."""
        wanted = max(1, self.episodes // self.generations)
        return min(max(1 << wanted.bit_length() - 1, self.fewest), self.most)


def search_failures(arena: Arena, seed: int, options: SearchOptions) -> Played:
    """Play candidates of worlds, generation by generation, and return all episodes.

    All candidates of a generation play the same seeds, and every generation fresh ones.

    Args:
        arena: where to play.
        seed: of the first episodes, and of the search's own random numbers.
        options: how to look.
    """
    rng, each = np.random.default_rng(seed), options.seeds_each
    count = max(1, arena.wide // each)
    found: list[Played] = []
    ask, tell = _spread(rng, count, len(arena.names)), _ignore
    generations = max(1, round(options.episodes / (count * each)))
    for number in range(generations):
        if number == max(1, round(options.random_share * generations)) and options.method != "random":
            ask, tell = _start(options, rng, count, found, each)
        candidates = ask()
        seeds = seed + number * each + np.tile(np.arange(each), count)
        found.append(arena.play(np.repeat(candidates, each, axis=0), seeds))
        tell(candidates, found[-1].robustness.reshape(count, each).mean(axis=1))
    return Played(*(np.concatenate(column) for column in zip(*found, strict=True)))


def _spread(rng: np.random.Generator, count: int, size: int) -> Callable[[], np.ndarray]:
    return lambda: rng.random((count, size))


def _ignore(candidates: np.ndarray, scores: np.ndarray) -> None:
    """Learn nothing."""


def _start(options: SearchOptions, rng: np.random.Generator, count: int, found: list[Played], each: int) -> Any:
    """Return the two functions of a search that starts at the worst candidates so far."""
    places = np.concatenate([played.places[::each] for played in found])
    scores = np.concatenate([played.robustness.reshape(-1, each).mean(axis=1) for played in found])
    if options.method == "cma":
        return _start_cma(rng, count, places[np.argmin(scores)])
    return _start_cross_entropy(options, rng, count, places, scores)


def _start_cross_entropy(
    options: SearchOptions, rng: np.random.Generator, count: int, places: np.ndarray, scores: np.ndarray
) -> Any:
    """Source: Rubinstein, "The cross-entropy method for combinatorial and continuous optimization" (1999)."""
    state: dict[str, np.ndarray] = {}

    def tell(candidates: np.ndarray, scores: np.ndarray) -> None:
        best = candidates[np.argsort(scores)[: max(2, round(options.elite * len(scores)))]]
        state["mean"], state["spread"] = best.mean(axis=0), np.maximum(best.std(axis=0), options.least_spread)

    def ask() -> np.ndarray:
        return np.clip(rng.normal(state["mean"], state["spread"], (count, len(state["mean"]))), 0.0, 1.0)

    tell(places, scores)
    return ask, tell


def _start_cma(rng: np.random.Generator, count: int, start: np.ndarray) -> Any:
    """Source: Hansen & Ostermeier, "Completely derandomized self-adaptation in evolution strategies" (2001)."""
    import cma

    settings = {"bounds": [0.0, 1.0], "popsize": count, "seed": int(rng.integers(1, 2**31)), "verbose": -9}
    strategy = cma.CMAEvolutionStrategy(start, 0.3, settings)

    def tell(candidates: np.ndarray, scores: np.ndarray) -> None:
        strategy.tell(list(candidates), list(scores))

    return lambda: np.array(strategy.ask()), tell

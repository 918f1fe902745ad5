"""Which points are tried next, by Optuna: a function of the trials before, the seed and nothing else."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
import optuna
from optuna.distributions import BaseDistribution, CategoricalDistribution, FloatDistribution, IntDistribution

from train.search.space import Choice, Point, Range, Space

DIGITS = 4  # of a number that is proposed: what a person can type again; a score is not known better
Sampler = Literal["tpe", "random"]


def propose(
    space: Space, tried: Sequence[tuple[Point, float | None]], count: int, seed: int, sampler: Sampler = "tpe"
) -> list[Point]:
    """Return the points of a round, none of which knows what another comes to.

    Args:
        space: to choose from.
        tried: points of the rounds before in the order of their numbers, with their scores; None of a trial that
            failed, which is taken for the worst.
        count: of points; the first ones are the same for any count.
        seed: of the search.
        sampler: tpe, by tree-structured Parzen estimators, or random.

    Source: Bergstra et al., "Algorithms for hyper-parameter optimization" (2011), in Optuna.
    """
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    distributions = {dimension.key: _describe(dimension) for dimension in space}
    study = optuna.create_study(direction="maximize", sampler=_make_sampler(sampler, seed, len(tried)))
    for point, score in tried:
        values = {dimension.key: _place(dimension, value) for dimension, (_, value) in zip(space, point, strict=True)}
        told = -math.inf if score is None else score
        study.add_trial(optuna.trial.create_trial(params=values, distributions=distributions, value=told))
    return [_read(space, study.ask(distributions).params) for _ in range(count)]


def _make_sampler(name: Sampler, seed: int, tried: int) -> optuna.samplers.BaseSampler:
    """Return a sampler whose draws follow from the search's seed and the number of trials before."""
    drawn = int(np.random.SeedSequence([seed, tried]).generate_state(1)[0])
    if name == "random":
        return optuna.samplers.RandomSampler(seed=drawn)
    # Points of a round that are not scored yet count as bad: the next ones keep away from them.
    return optuna.samplers.TPESampler(seed=drawn, constant_liar=True)


def _describe(dimension: Range | Choice) -> BaseDistribution:
    if isinstance(dimension, Choice):  # by their places: values may be lists, which Optuna does not take
        return CategoricalDistribution(tuple(range(len(dimension.values))))
    if dimension.whole:
        return IntDistribution(int(dimension.low), int(dimension.high), log=dimension.log)
    return FloatDistribution(dimension.low, dimension.high, log=dimension.log)


def _place(dimension: Range | Choice, value: Any) -> Any:
    return dimension.values.index(value) if isinstance(dimension, Choice) else value


def _read(space: Space, params: dict[str, Any]) -> Point:
    return tuple((dimension.key, _round(dimension, params[dimension.key])) for dimension in space)


def _round(dimension: Range | Choice, value: Any) -> Any:
    """Return a value as it is tried: numbers with few digits, within their range."""
    if isinstance(dimension, Choice):
        return dimension.values[value]
    if dimension.whole:
        return int(value)
    return min(max(float(f"{value:.{DIGITS}g}"), float(dimension.low)), float(dimension.high))

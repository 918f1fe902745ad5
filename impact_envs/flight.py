"""The robustness that a formula would reach if every body flew on as it moves now: potential of ``reward="progress"``.

The history so far counts: it is what the monitor remembers of a world, and a copy of that takes the predicted samples.
What is predicted is flight at constant velocity and rate of turning, without thrust, drift or impacts; bodies stop at
the bounds of their signals, which for positions are the solid walls of the world. Other bodies and solid obstacles do
not stop them. Between samples flight is straight, so that few samples suffice: they stand `SPACING` apart, and at the
first and the last sample of every interval of the formula. Formulas with temporal operators inside temporal operators
take every sample, because these remember one after another.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from impact_envs.compiled import compiled
from impact_envs.stl import Formula, Monitor
from impact_envs.stl.compiled_formula import (
    EXTREME,
    FIRST,
    KIND,
    LAST,
    POP,
    PUSH,
    UNTIL,
    CompiledFormula,
)
from impact_envs.stl.compiler import compile_formula
from impact_envs.stl.margin import Range
from impact_envs.stl.stepper import update_monitor
from impact_envs.stl.verdict import settle_tie

# Time between predicted samples: a body of .2 m/s flies 20 cm, less than the regions are wide [s].
SPACING = 1.0
# Time between predictions where nothing is hit: thrusters change a velocity by a few cm/s meanwhile [s].
EVERY = 1.0


class Flight(NamedTuple):
    """How a formula's signals go on by themselves.

    Attributes:
        period: between samples [s].
        every: samples between two predictions where nothing is hit; 0 where nothing is ever predicted.
        instants: samples that are predicted, ascending; with the last one the formula is decided, shape (m,).
        rates: columns of the sample that the formula reads and of their rates of change, -1 where constant,
            shape (c, 2).
        limits: least and greatest value of each, shape (c, 2).
    """

    period: float
    every: int
    instants: np.ndarray
    rates: np.ndarray
    limits: np.ndarray


def make_flight(
    formula: CompiledFormula,
    reach: int,
    period: float,
    signals: Sequence[str],
    rates: Mapping[str, str],
    bounds: Mapping[str, Range],
) -> Flight:
    """Return how a formula's signals go on.

    Args:
        formula: compiled for these signals.
        reach: last sample that it looks at.
        period: between samples [s].
        signals: names in the order of the sample, such as ``pop.x``.
        rates: a body's signal to its rate of change: ``x`` to ``vx``.
        bounds: of signals, which they do not leave.
    """
    at = {name: column for column, name in enumerate(signals)}
    read = sorted(set(formula.columns.tolist()))
    pairs = [(column, _find_rate(signals[column], at, rates)) for column in read]
    limits = [bounds.get(signals[column], (-math.inf, math.inf)) for column in read]
    return Flight(
        float(period),
        max(round(EVERY / period), 1),
        _choose_instants(formula, reach, max(round(SPACING / period), 1)),
        np.array(pairs, np.int64).reshape(-1, 2),
        np.array(limits, np.float64).reshape(-1, 2),
    )


def make_no_flight() -> Flight:
    """Return what takes the place of a flight where nothing is predicted."""
    return Flight(0.0, 0, np.zeros(0, np.int64), np.zeros((0, 2), np.int64), np.zeros((0, 2)))


def _find_rate(signal: str, at: Mapping[str, int], rates: Mapping[str, str]) -> int:
    body, _, name = signal.rpartition(".")
    return at[f"{body}.{rates[name]}"] if name in rates else -1


def _choose_instants(formula: CompiledFormula, reach: int, spacing: int) -> np.ndarray:
    rows = formula.root[~np.isin(formula.root[:, KIND], (PUSH, POP))]
    if not np.isin(rows[:, KIND], (EXTREME, UNTIL)).all():
        return np.arange(reach + 1)
    ends = rows[:, [FIRST, LAST]].ravel()
    return np.unique(np.concatenate([np.arange(0, reach, spacing), ends, [reach]])).astype(np.int64)


@compiled
def predict_robustness(
    formula: CompiledFormula,
    flight: Flight,
    memory: Any,
    spare: Any,
    signals: Any,
    flown: Any,
    k: int,
    count: int,
    known: float,
) -> float:
    """Return the robustness that world k would reach if its bodies flew on by themselves.

    Equation: s(t) = min(max(s + t ds/dt, lower), upper) for every signal s, t the time from now.

    Args:
        formula: compiled for these signals.
        flight: how they go on.
        memory: of the formula, shape (N, ``formula.size``).
        spare: takes its copy, of the same shape.
        signals: last sample, shape (N, signals).
        flown: takes predicted samples, of the same shape.
        k: world.
        count: number of the last sample.
        known: the robustness if the formula is decided [m].

    Returns:
        Robustness, not clipped [m].
    """
    for i in range(formula.size):
        spare[k, i] = memory[k, i]
    low = known
    for place in range(flight.instants.shape[0]):
        instant = flight.instants[place]
        if instant <= count:
            continue
        time = (instant - count) * flight.period
        for row in range(flight.rates.shape[0]):
            column, rate = flight.rates[row, 0], flight.rates[row, 1]
            value = float(signals[k, column])
            if rate >= 0:
                value += time * float(signals[k, rate])
                value = min(max(value, flight.limits[row, 0]), flight.limits[row, 1])
            flown[k, column] = value
        low, _ = update_monitor(formula, spare, k, instant, flown)
    return settle_tie(low)


class Forecast:
    """`predict_robustness` of the single environment.

    Args:
        formula: specification.
        monitor: that follows it.
        areas: regions and obstacles by name.
        bodies: what ``all`` stands for.
        rates: a body's signal to its rate of change: ``x`` to ``vx``.
        bounds: of signals, as the monitor's.
    """

    def __init__(
        self,
        formula: Formula,
        monitor: Monitor,
        areas: Mapping[str, Any],
        bodies: Sequence[str],
        rates: Mapping[str, str],
        bounds: Mapping[str, Range],
    ) -> None:
        parts = [name.rpartition(".") for name in monitor.formula.signals()]
        moving = [f"{body}.{rates[name]}" for body, _, name in parts if name in rates]
        names = self._names = tuple(dict.fromkeys((*monitor.formula.signals(), *moving)))
        # Another sample than the monitor's, the same memory: where it lies does not depend on the signals.
        self._formula = compile_formula(formula, monitor.period, areas, bodies, names, bounds)
        self._flight = make_flight(self._formula, monitor.reach, monitor.period, names, rates, bounds)
        self._spare, self._flown = np.zeros((1, self._formula.size)), np.zeros((1, len(names)))
        self.every = self._flight.every

    def predict(self, monitor: Monitor, signals: Mapping[str, float], count: int) -> float:
        """Return the robustness that would be reached [m].

        Args:
            monitor: that took the last sample.
            signals: at present.
            count: number of the last sample.
        """
        sample = np.array([[signals[name] for name in self._names]])
        known = monitor.interval[0]
        return predict_robustness(
            self._formula, self._flight, monitor.memory, self._spare, sample, self._flown, 0, count, known
        )

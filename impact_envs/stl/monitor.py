"""Online monitor: the interval of robustness still possible after the samples so far.

Source: Deshmukh, Donze, Ghosh, Jin, Juniwal & Seshia, Robust online monitoring of signal temporal logic,
Formal Methods in System Design 51 (2017): robust satisfaction intervals (RoSI).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from struct import pack_into
from typing import Any

import numpy as np

from impact_envs.compiled import bind
from impact_envs.errors import InputError, choices
from impact_envs.stl.compiler import compile_formula, read_parts
from impact_envs.stl.formula import Formula
from impact_envs.stl.margin import AreaLike, Range
from impact_envs.stl.stepper import start_monitor, update_world
from impact_envs.stl.term import compute_range, make_term
from impact_envs.stl.verdict import settle_tie


class Monitor:
    """Follow a formula's robustness at time 0 sample by sample.

    The interval holds the final robustness as long as signals stay within the bounds; its lower end never
    decreases, its upper end never increases; after the last sample the formula looks at both ends equal
    ``robustness`` of the trace to the last bit. A step takes time independent of intervals for Boolean combinations
    of temporal operators over predicates, of up to three alternating F and G, and of operators about one operator
    joined with predicates, as in F[0,20] (p & G[0,5] q) and G[0,20] (p U[0,5] q); for other operators inside
    operators, in proportion to the samples that the inner ones look ahead.

    This is the compiled evaluator of many worlds (stepper.py) with one.

    Args:
        formula: specification.
        period: between samples [s].
        areas: regions and obstacles by name.
        bodies: what ``all`` stands for.
        bounds: signals to intervals known beforehand, for example the world box; samples to come count as
            anything within. A signal without bounds may become anything.

    Attributes:
        interval: of robustness still possible, lower and upper end; at first what the bounds alone allow.
        ends: the same with ties marked: above zero where the formula holds, below where it does not.
        count: samples taken.
        reach: last sample that the formula looks at.

    Raises:
        FormulaError: an unknown area, or an interval without a sample.
        InputError: a period that is not positive, or bounds that are empty.
    """

    def __init__(
        self,
        formula: Formula,
        period: float,
        areas: Mapping[str, AreaLike],
        bodies: tuple[str, ...],
        bounds: Mapping[str, Range] | None = None,
    ) -> None:
        self.formula = formula.expand(bodies)
        self._names = self.formula.signals()
        self._compiled = compile_formula(formula, period, areas, bodies, self._names, bounds)
        self._possible = compute_range(make_term(self.formula, period, areas), bounds or {})
        self.period, self.reach, self._first = period, self.formula.reach(period), self.formula.first_look(period)
        self._memory = np.zeros((1, self._compiled.size))
        self._conjuncts = np.zeros((1, 2 * len(formula.conjuncts())))
        self._sample: Any = np.zeros((1, len(self._names)))
        self._format = f"{len(self._names)}d"
        self._bind()
        self.reset()

    def reset(self) -> None:
        """Forget all samples."""
        start_monitor(self._compiled, self._memory, 0)
        self.count = 0
        low, high = self.ends = self._possible
        self.interval = settle_tie(low), settle_tie(high)
        if self._first > 0:  # the parts say what is possible before the first sample counts
            self._update_world(*self._compiled, self._memory, 0, self._sample, self._conjuncts)

    @property
    def memory(self) -> np.ndarray:
        """Return what is remembered of the samples, as the compiled functions take it, shape (1, numbers)."""
        return self._memory

    @property
    def conjuncts(self) -> list[float]:
        """Return lower and upper end of the interval of every conjunct of the formula, one after another [m].

        Before the first sample of the formula they say nothing.
        """
        return self._conjuncts[0].tolist()

    @property
    def parts(self) -> np.ndarray:
        """Return the interval of every temporal operator that the formula is joined of, shape (parts, 2) [m].

        See ``describe_parts``.
        """
        return read_parts(self._compiled, self._memory)[0]

    @property
    def final(self) -> bool:
        """Return whether every sample the formula looks at has come; further samples change nothing."""
        return self.count > self.reach

    @property
    def verdict(self) -> bool | None:
        """Return the truth value as soon as it is decided.

        True when the lower end is above zero, False when the upper end is below, None before that. Where an end is
        exactly zero, ``in``, ``<=`` and ``>=`` hold, and ``not in``, ``<`` and ``>`` do not, as for ``satisfied``.
        """
        low, high = self.ends
        return True if low > 0 else False if high < 0 else None

    def update(self, sample: Mapping[str, float]) -> Range:
        """Take the next sample; the first one is at time 0.

        Args:
            sample: signals to values; signals the formula does not name are ignored.

        Returns:
            Lower and upper end of the robustness still possible.

        Raises:
            InputError: a signal is missing or not finite.
        """
        if self.count > self.reach:
            return self.interval
        try:
            values = [sample[name] for name in self._names]
        except KeyError as error:
            name = error.args[0]
            raise InputError(f"sample: signal '{name}' is missing; {choices(name, sample)}") from None
        if not math.isfinite(sum(values)):
            wrong = [(name, value) for name, value in zip(self._names, values, strict=True) if not math.isfinite(value)]
            name, value = wrong[0] if wrong else (self._names[0], values[0])
            raise InputError(f"sample: signal '{name}' is {value}; it must be finite")
        if self.count >= self._first:  # no sample before it changes anything
            pack_into(self._format, self._sample, 0, *values)
            known = self._memory, self.count, self._sample, self._conjuncts
            self.interval, self.ends = self._update_world(*self._compiled, *known)
        self.count += 1
        return self.interval

    def _bind(self) -> None:
        """Find the machine code of an update; what is remembered stays."""
        room = self._memory.copy(), 0, self._sample.copy(), self._conjuncts.copy()
        start_monitor(self._compiled, room[0], 0)
        self._update_world = bind(update_world, *self._compiled, *room)

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "_update_world"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._bind()

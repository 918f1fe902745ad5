"""Signal Temporal Logic formulas as trees of frozen dataclasses: what all of them tell (operator.py, predicate.py).

Source: Verhagen & Tumova, Definition 1: time-bounded STL over predicates mu(x) >= 0. Eventually, always, or
and implies are kept as nodes of their own, so that a formula prints as it was written.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Sequence
from typing import ClassVar

from impact_envs.errors import FormulaError, choices

SIGNALS = ("x", "y", "vx", "vy", "heading", "omega")
"""What a planar body offers: ``pop.x`` [m], ``pop.vx`` [m/s], ``pop.heading`` [rad], ``pop.omega`` [rad/s]"""

LARGEST = 1e9
"""Greatest size of a number in a formula or a scenario: products of several stay finite"""

SAMPLE_TOLERANCE = 1e-6
"""How far beside an interval's end a sample still counts [samples]: 0.3 s is sample 3 of a 0.1 s period"""

Interval = tuple[float, float]


class Formula:
    """An STL formula; ``str`` prints text that ``parse`` turns back into an equal formula."""

    _binding: ClassVar[int] = 6  # how tightly the printed form holds together; predicates most

    @property
    def children(self) -> tuple[Formula, ...]:
        """Return the direct subformulas, left to right."""
        return ()

    def rebuild(self, children: Sequence[Formula]) -> Formula:
        """Return the same operator over other subformulas.

        Args:
            children: as many as ``children`` has.
        """
        return self

    def walk(self) -> Iterator[Formula]:
        """Return an iterator over the formula and all its subformulas, parents first."""
        yield self
        for child in self.children:
            yield from child.walk()

    @property
    def is_temporal(self) -> bool:
        """Return whether there is a temporal operator in the formula; without one it speaks of one instant."""
        return any(child.is_temporal for child in self.children)

    def define(self) -> Formula:
        """Return an equal formula of simpler operators: how all that reads formulas takes operators it does not know.

        Raises:
            FormulaError: there is no simpler one.
        """
        raise FormulaError(f"operator {type(self).__name__} of '{self}' is not supported here")

    @property
    def horizon(self) -> float:
        """Return the latest time the formula looks at [s]."""
        return max((child.horizon for child in self.children), default=0.0)

    def reach(self, period: float) -> int:
        """Return the latest sample the formula looks at; a trace needs one sample more.

        Args:
            period: between samples [s].

        Raises:
            FormulaError: an interval contains no sample.
        """
        return max((child.reach(period) for child in self.children), default=0)

    def first_look(self, period: float) -> int:
        """Return the earliest sample the formula looks at; the left side of an until counts from now on.

        Args:
            period: between samples [s].

        Raises:
            FormulaError: an interval contains no sample.
        """
        return min((child.first_look(period) for child in self.children), default=0)

    def bodies(self) -> tuple[str, ...]:
        """Return the bodies named, in order of appearance; ``all`` is not among them."""
        return tuple(dict.fromkeys(body for child in self.children for body in child.bodies()))

    def areas(self) -> tuple[str, ...]:
        """Return the areas named, in order of appearance."""
        return tuple(dict.fromkeys(area for child in self.children for area in child.areas()))

    def signals(self) -> tuple[str, ...]:
        """Return the signals read, such as ``pop.x``, in order of appearance; without those of ``all``."""
        return tuple(dict.fromkeys(signal for child in self.children for signal in child.signals()))

    def conjuncts(self) -> tuple[Formula, ...]:
        """Return the formulas whose conjunction this is, with nested conjunctions opened."""
        return (self,)

    def expand(self, bodies: Sequence[str]) -> Formula:
        """Return the formula with ``all`` written out as a conjunction over the bodies.

        Args:
            bodies: names, in canonical order.

        Raises:
            FormulaError: ``all`` is used and there is no body.
        """
        return self.rebuild([child.expand(bodies) for child in self.children])

    def scale_time(self, factor: float) -> Formula:
        """Return the formula with every time multiplied by a factor.

        Args:
            factor: finite and positive.

        Raises:
            FormulaError: a factor that is not.
        """
        if not 0 < factor < math.inf:
            raise FormulaError(f"time factor {factor:g} must be finite and positive")
        return self.map_intervals(lambda interval: (factor * interval[0], factor * interval[1]))

    def move_to_samples(self, period: float) -> Formula:
        """Return the formula with every interval between two samples moved to the one before; others keep theirs.

        Args:
            period: between samples [s].
        """
        return self.map_intervals(lambda interval: move_to_sample(interval, period))

    def map_intervals(self, change: Callable[[Interval], Interval]) -> Formula:
        """Return the formula with other time intervals.

        Args:
            change: what becomes of an interval [s].
        """
        return self.rebuild([child.map_intervals(change) for child in self.children])

    def check_names(self, bodies: Collection[str], areas: Collection[str], signals: Collection[str] = SIGNALS) -> None:
        """Check that every name the formula uses exists.

        Args:
            bodies: known bodies.
            areas: known regions and obstacles.
            signals: what follows the dot in ``pop.x``.

        Raises:
            FormulaError: an unknown name, with the nearest one and the choices.
        """
        for kind, names, known in (
            ("body", self.bodies(), bodies),
            ("area", self.areas(), areas),
            ("signal", [signal.partition(".")[2] for signal in self.signals()], signals),
        ):
            for name in names:
                if name not in known:
                    raise FormulaError(f"{kind} '{name}' is unknown; {choices(name, known)}")

    def _enclosed(self, least: int) -> str:
        return str(self) if self._binding >= least else f"({self})"


def find_window(interval: Interval, period: float) -> tuple[int, int]:
    """Return the first and the last sample of an interval; the last is below the first where it contains none.

    Args:
        interval: start and end [s].
        period: between samples [s].
    """
    lower, upper = interval
    return math.ceil(lower / period - SAMPLE_TOLERANCE), math.floor(upper / period + SAMPLE_TOLERANCE)


def move_to_sample(interval: Interval, period: float) -> Interval:
    """Return an interval that contains a sample: as it is, or the sample before it.

    Args:
        interval: start and end [s].
        period: between samples [s].
    """
    first, last = find_window(interval, period)
    return interval if first <= last else (last * period, last * period)


def format_number(value: float) -> str:
    """Return the shortest text that reads back as the same number.

    Args:
        value: finite.
    """
    return repr(float(value)).removesuffix(".0")

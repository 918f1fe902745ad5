"""Signal Temporal Logic formulas as trees of frozen dataclasses: the operators (leaves: predicate.py).

Source: Verhagen & Tumova, Definition 1: time-bounded STL over predicates mu(x) >= 0. Eventually, always, or
and implies are kept as nodes of their own, so that a formula prints as it was written.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

from impact_envs.errors import FormulaError, choices

SIGNALS = ("x", "y", "vx", "vy", "heading", "omega")
"""What a planar body offers: ``pop.x`` [m], ``pop.vx`` [m/s], ``pop.heading`` [rad], ``pop.omega`` [rad/s]"""

SAMPLE_TOLERANCE = 1e-6
"""How far beside an interval's end a sample still counts [samples]: 0.3 s is sample 3 of a 0.1 s period."""


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
        return any(isinstance(node, Temporal) for node in self.walk())

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
        return self.rebuild([child.scale_time(factor) for child in self.children])

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


def format_number(value: float) -> str:
    """Return the shortest text that reads back as the same number.

    Args:
        value: finite.
    """
    return repr(float(value)).removesuffix(".0")


@dataclass(frozen=True)
class Not(Formula):
    """``not p``: rho = -rho_p (Eq. 2b)."""

    child: Formula
    _binding: ClassVar[int] = 5

    @property
    def children(self) -> tuple[Formula, ...]:
        """Return the negated formula."""
        return (self.child,)

    def rebuild(self, children: Sequence[Formula]) -> Formula:
        """Return the negation of another formula."""
        return Not(*children)

    def __str__(self) -> str:
        return f"not {self.child._enclosed(5)}"


@dataclass(frozen=True)
class _Junction(Formula):
    operands: tuple[Formula, ...]
    _sign: ClassVar[str]

    def __post_init__(self) -> None:
        if len(self.operands) < 2:
            raise FormulaError(f"{type(self).__name__} needs at least two operands, got {len(self.operands)}")

    @property
    def children(self) -> tuple[Formula, ...]:
        """Return the operands."""
        return self.operands

    def rebuild(self, children: Sequence[Formula]) -> Formula:
        """Return the same connective of other operands."""
        return type(self)(tuple(children))

    def __str__(self) -> str:
        return f" {self._sign} ".join(child._enclosed(self._binding + 1) for child in self.operands)


@dataclass(frozen=True)
class And(_Junction):
    """``p & q & ...``: rho = min over the operands (Eq. 2c)."""

    _binding: ClassVar[int] = 3
    _sign: ClassVar[str] = "&"

    def conjuncts(self) -> tuple[Formula, ...]:
        """Return the operands, with conjunctions among them opened."""
        return tuple(part for operand in self.operands for part in operand.conjuncts())


@dataclass(frozen=True)
class Or(_Junction):
    """``p | q | ...``: rho = max over the operands."""

    _binding: ClassVar[int] = 2
    _sign: ClassVar[str] = "|"


@dataclass(frozen=True)
class Implies(Formula):
    """``p -> q``, the same as ``not p | q``: rho = max(-rho_p, rho_q)."""

    left: Formula
    right: Formula
    _binding: ClassVar[int] = 1

    @property
    def children(self) -> tuple[Formula, ...]:
        """Return premise and conclusion."""
        return (self.left, self.right)

    def rebuild(self, children: Sequence[Formula]) -> Formula:
        """Return the implication between other formulas."""
        return Implies(*children)

    def __str__(self) -> str:
        return f"{self.left._enclosed(2)} -> {self.right._enclosed(1)}"

    def define(self) -> Formula:
        """Return ``not p | q``."""
        return Or((Not(self.left), self.right))


@dataclass(frozen=True)
class Temporal(Formula):
    """An operator over a closed time interval [lower, upper] ahead of now [s]."""

    interval: tuple[float, float]

    def __post_init__(self) -> None:
        check_interval(*self.interval)

    @property
    def horizon(self) -> float:
        """Return the interval's end plus what the subformulas look ahead [s]."""
        return self.interval[1] + super().horizon

    def window(self, period: float) -> tuple[int, int]:
        """Return the first and the last sample of the interval.

        Args:
            period: between samples [s].

        Raises:
            FormulaError: the interval contains no sample.
        """
        lower, upper = self.interval
        first = math.ceil(lower / period - SAMPLE_TOLERANCE)
        last = math.floor(upper / period + SAMPLE_TOLERANCE)
        if first > last:
            raise FormulaError(f"interval {self._bounds} s contains no sample at a period of {period:g} s")
        return first, last

    def reach(self, period: float) -> int:
        """Return the window's last sample plus what the subformulas look ahead."""
        return self.window(period)[1] + super().reach(period)

    def first_look(self, period: float) -> int:
        """Return the window's first sample plus what the subformulas leave out."""
        return self.window(period)[0] + super().first_look(period)

    def scale_time(self, factor: float) -> Formula:
        """Return the operator with its interval, and those inside, multiplied."""
        scaled: Any = super().scale_time(factor)
        lower, upper = self.interval
        return replace(scaled, interval=(factor * lower, factor * upper))

    @property
    def _bounds(self) -> str:
        return f"[{format_number(self.interval[0])},{format_number(self.interval[1])}]"


def check_interval(lower: float, upper: float) -> None:
    """Check the ends of a time interval.

    Args:
        lower: start [s].
        upper: end [s].

    Raises:
        FormulaError: not finite, before time 0, or ending before it starts.
    """
    text = f"interval [{format_number(lower)},{format_number(upper)}]"
    if not (math.isfinite(lower) and math.isfinite(upper)):
        raise FormulaError(f"{text} must have finite ends")
    if lower < 0:
        raise FormulaError(f"{text} starts before time 0")
    if upper < lower:
        raise FormulaError(f"{text} ends before it starts")


@dataclass(frozen=True)
class _Window(Temporal):
    child: Formula
    _binding: ClassVar[int] = 5
    _sign: ClassVar[str]

    @property
    def children(self) -> tuple[Formula, ...]:
        """Return the formula asked about in the interval."""
        return (self.child,)

    def rebuild(self, children: Sequence[Formula]) -> Formula:
        """Return the same operator over another formula."""
        return type(self)(self.interval, *children)

    def __str__(self) -> str:
        return f"{self._sign}{self._bounds} {self.child._enclosed(5)}"


@dataclass(frozen=True)
class Eventually(_Window):
    """``F[a,b] p``: p holds at some sample of the interval; rho = max over it."""

    _sign: ClassVar[str] = "F"


@dataclass(frozen=True)
class Always(_Window):
    """``G[a,b] p``: p holds at every sample of the interval; rho = min over it."""

    _sign: ClassVar[str] = "G"


@dataclass(frozen=True)
class Until(Temporal):
    """``p U[a,b] q``: q holds at some sample of the interval, and p from now up to and at that sample.

    Equation: rho(t) = max_{tau in t+[a,b]} min(rho_q(tau), min_{s in [t, tau]} rho_p(s)). Source: Eq. 2d.
    """

    left: Formula
    right: Formula
    _binding: ClassVar[int] = 4

    @property
    def children(self) -> tuple[Formula, ...]:
        """Return what must hold before, and what must come."""
        return (self.left, self.right)

    def rebuild(self, children: Sequence[Formula]) -> Formula:
        """Return the same operator over other formulas."""
        return Until(self.interval, *children)

    def first_look(self, period: float) -> int:
        """Return 0: the left side counts from now on."""
        return 0

    def __str__(self) -> str:
        return f"{self.left._enclosed(5)} U{self._bounds} {self.right._enclosed(4)}"

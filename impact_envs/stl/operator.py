"""The operators of a formula: each says how it is printed, how far it looks, and what it is by simpler ones."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

from impact_envs.errors import FormulaError
from impact_envs.stl.formula import LARGEST, Formula, Interval, find_window, format_number


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

    @property
    def is_temporal(self) -> bool:
        """Return True."""
        return True

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
        first, last = find_window(self.interval, period)
        if first > last:
            raise FormulaError(f"interval {self._bounds} s contains no sample at a period of {period:g} s")
        return first, last

    def reach(self, period: float) -> int:
        """Return the window's last sample plus what the subformulas look ahead."""
        return self.window(period)[1] + super().reach(period)

    def first_look(self, period: float) -> int:
        """Return the window's first sample plus what the subformulas leave out."""
        return self.window(period)[0] + super().first_look(period)

    def map_intervals(self, change: Callable[[Interval], Interval]) -> Formula:
        """Return the operator with another interval, also inside."""
        changed: Any = super().map_intervals(change)
        return replace(changed, interval=change(self.interval))

    @property
    def _bounds(self) -> str:
        return f"[{format_number(self.interval[0])},{format_number(self.interval[1])}]"


def check_interval(lower: float, upper: float) -> None:
    """Check the ends of a time interval.

    Args:
        lower: start [s].
        upper: end [s].

    Raises:
        FormulaError: not finite, before time 0, ending before it starts, or too late.
    """
    text = f"interval [{format_number(lower)},{format_number(upper)}]"
    if not (math.isfinite(lower) and math.isfinite(upper)):
        raise FormulaError(f"{text} must have finite ends")
    if lower < 0:
        raise FormulaError(f"{text} starts before time 0")
    if upper < lower:
        raise FormulaError(f"{text} ends before it starts")
    if upper > LARGEST:
        raise FormulaError(f"{text} ends after {LARGEST:g} s")


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

"""Statements about one instant: the leaves of a formula.

Source: Verhagen & Tumova, Definition 1 and Eq. 2a: a predicate is mu(x) >= 0, its robustness mu(x).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from impact_envs.errors import FormulaError, choices
from impact_envs.stl.formula import And, Formula, format_number

ALL = "all"
"""Stands for every body in ``all in area`` and ``speed(all) <= v``."""

RELATIONS = ("<=", "<", ">=", ">")


class Predicate(Formula):
    """A Boolean statement mu(x) >= 0 about one instant (mu(x) > 0 if ``strict``)."""

    @property
    def strict(self) -> bool:
        """Return whether the statement is false at a robustness of exactly zero."""
        return False


@dataclass(frozen=True)
class In(Predicate):
    """``body in area``: the body's centre lies in a closed convex area; negated: it does not.

    Equation: mu = min_f (b_f - H_f p), H p <= b the area's half-spaces with rows of unit length; negated:
    -mu.
    """

    body: str
    area: str
    negated: bool = False

    @property
    def strict(self) -> bool:
        """Return True for ``not in``: the boundary belongs to the area."""
        return self.negated

    def bodies(self) -> tuple[str, ...]:
        """Return the body, or nothing for ``all``."""
        return () if self.body == ALL else (self.body,)

    def areas(self) -> tuple[str, ...]:
        """Return the area."""
        return (self.area,)

    def signals(self) -> tuple[str, ...]:
        """Return the body's position."""
        return tuple(f"{body}.{axis}" for body in self.bodies() for axis in "xy")

    def expand(self, bodies: Sequence[str]) -> Formula:
        """Return the conjunction over bodies if this is about ``all``."""
        return _expand_body(self, bodies)

    def __str__(self) -> str:
        return f"{self.body} {'not ' * self.negated}in {self.area}"


class _Comparison(Predicate):
    """A quantity against a constant bound."""

    relation: str
    bound: float

    @property
    def strict(self) -> bool:
        """Return True for ``<`` and ``>``."""
        return self.relation in ("<", ">")

    @property
    def is_upper(self) -> bool:
        """Return True for ``<=`` and ``<``: the bound is an upper one."""
        return self.relation in ("<=", "<")

    def _check(self) -> None:
        if self.relation not in RELATIONS:
            raise FormulaError(f"relation '{self.relation}' is unknown; {choices(self.relation, RELATIONS)}")
        if not math.isfinite(self.bound):
            raise FormulaError(f"the bound {self.bound} of a comparison must be finite")


@dataclass(frozen=True)
class Distance(_Comparison):
    """``distance(a, b) >= 0.4``: Euclidean distance of centres [m]; mu = distance - bound, or minus that."""

    a: str
    b: str
    relation: str
    bound: float

    def __post_init__(self) -> None:
        self._check()

    def bodies(self) -> tuple[str, ...]:
        """Return both bodies."""
        return tuple(dict.fromkeys((self.a, self.b)))

    def signals(self) -> tuple[str, ...]:
        """Return both positions."""
        return tuple(f"{body}.{axis}" for body in self.bodies() for axis in "xy")

    def __str__(self) -> str:
        return f"distance({self.a}, {self.b}) {self.relation} {format_number(self.bound)}"


@dataclass(frozen=True)
class Speed(_Comparison):
    """``speed(body) <= 0.1``: Euclidean norm of the velocity [m/s]; mu = bound - speed, or minus that."""

    body: str
    relation: str
    bound: float

    def __post_init__(self) -> None:
        self._check()

    def bodies(self) -> tuple[str, ...]:
        """Return the body, or nothing for ``all``."""
        return () if self.body == ALL else (self.body,)

    def signals(self) -> tuple[str, ...]:
        """Return the body's velocity."""
        return tuple(f"{body}.{axis}" for body in self.bodies() for axis in ("vx", "vy"))

    def expand(self, bodies: Sequence[str]) -> Formula:
        """Return the conjunction over bodies if this is about ``all``."""
        return _expand_body(self, bodies)

    def __str__(self) -> str:
        return f"speed({self.body}) {self.relation} {format_number(self.bound)}"


@dataclass(frozen=True)
class Linear(_Comparison):
    """``pop.x + 2*pop.y <= 3``: a linear combination of signals; mu = bound - sum, or minus that.

    mu is not normalised: it has the unit of the sum, and 2*pop.x <= 2 is twice as robust as pop.x <= 1.
    ``terms`` pairs each signal with its coefficient; every signal once, no coefficient zero.
    """

    terms: tuple[tuple[str, float], ...]
    relation: str
    bound: float

    def __post_init__(self) -> None:
        self._check()
        if not self.terms:
            raise FormulaError("a comparison needs at least one signal such as pop.x")
        if len(dict(self.terms)) < len(self.terms):
            raise FormulaError("a signal appears twice among a comparison's terms")
        for signal, coefficient in self.terms:
            if coefficient == 0 or not math.isfinite(coefficient):
                raise FormulaError(f"coefficient {coefficient} of {signal} must be finite and not zero")

    def bodies(self) -> tuple[str, ...]:
        """Return the bodies whose signals are compared."""
        return tuple(dict.fromkeys(signal.partition(".")[0] for signal in self.signals()))

    def signals(self) -> tuple[str, ...]:
        """Return the signals compared."""
        return tuple(signal for signal, _ in self.terms)

    def __str__(self) -> str:
        words: list[str] = []
        for signal, coefficient in self.terms:
            size = "" if abs(coefficient) == 1 else f"{format_number(abs(coefficient))}*"
            sign = "-" if coefficient < 0 else "+"
            first = "-" if coefficient < 0 else ""
            words.append(f" {sign} {size}{signal}" if words else f"{first}{size}{signal}")
        return f"{''.join(words)} {self.relation} {format_number(self.bound)}"


def _expand_body(predicate: In | Speed, bodies: Sequence[str]) -> Formula:
    if predicate.body != ALL:
        return predicate
    each = tuple(replace(predicate, body=body) for body in bodies)
    if not each:
        raise FormulaError(f"'{predicate}' speaks of all bodies, but there is none")
    return each[0] if len(each) == 1 else And(each)

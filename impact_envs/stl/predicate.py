"""Statements about one instant: the leaves of a formula.

Source: Verhagen & Tumova, Definition 1 and Eq. 2a: a predicate is mu(x) >= 0, its robustness mu(x).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from impact_envs.errors import FormulaError, choices
from impact_envs.stl.formula import LARGEST, Formula, format_number
from impact_envs.stl.margin import AreaLike, AreaMargin, LinearMargin, Margin, NormMargin
from impact_envs.stl.operator import And

ALL = "all"
"""Stands for every body in ``all in area`` and ``speed(all) <= v``."""

OPPOSITES = {"<=": ">", "<": ">=", ">=": "<", ">": "<="}
"""Relations, and that which holds where the first one does not."""


class Predicate(Formula):
    """A Boolean statement mu(x) >= 0 about one instant (mu(x) > 0 if ``strict``)."""

    @property
    def strict(self) -> bool:
        """Return whether the statement is false at a robustness of exactly zero."""
        return False

    def margin(self, areas: Mapping[str, AreaLike]) -> Margin:
        """Return the predicate made numeric.

        Args:
            areas: regions and obstacles by name.

        Raises:
            FormulaError: an unknown area.
        """
        raise NotImplementedError

    def negate(self) -> Predicate:
        """Return the opposite predicate, whose robustness is minus that of this one."""
        raise NotImplementedError


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

    def margin(self, areas: Mapping[str, AreaLike]) -> Margin:
        """Return the margin of the area's half-spaces."""
        if self.area not in areas:
            raise FormulaError(f"area '{self.area}' is unknown; {choices(self.area, areas)}")
        H, b = (np.asarray(part, dtype=float).tolist() for part in areas[self.area].halfspaces())
        faces = tuple((offset, hx, hy) for offset, (hx, hy) in zip(b, H, strict=True))
        return AreaMargin(f"{self.body}.x", f"{self.body}.y", faces, -1.0 if self.negated else 1.0, self.strict)

    def negate(self) -> Predicate:
        """Return ``not in`` for ``in``, and the other way round."""
        return replace(self, negated=not self.negated)

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


class Comparison(Predicate):
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

    @property
    def sign(self) -> float:
        """Return 1 where the bound is an upper one, -1 where it is a lower one: of bound - quantity in mu."""
        return 1.0 if self.is_upper else -1.0

    def negate(self) -> Predicate:
        """Return the same comparison with the opposite relation."""
        return replace(self, relation=OPPOSITES[self.relation])  # type: ignore[type-var]

    def _check(self) -> None:
        if self.relation not in OPPOSITES:
            raise FormulaError(f"relation '{self.relation}' is unknown; {choices(self.relation, OPPOSITES)}")
        if not math.isfinite(self.bound):
            raise FormulaError(f"the bound {self.bound} of a comparison must be finite")
        if abs(self.bound) > LARGEST:
            raise FormulaError(f"the bound {self.bound:g} of a comparison is beyond {LARGEST:g}")


@dataclass(frozen=True)
class Distance(Comparison):
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

    def margin(self, areas: Mapping[str, AreaLike]) -> Margin:
        """Return the margin of the distance."""
        return NormMargin(
            (f"{self.a}.x", f"{self.a}.y"), (f"{self.b}.x", f"{self.b}.y"), self.bound, self.sign, self.strict
        )

    def signals(self) -> tuple[str, ...]:
        """Return both positions."""
        return tuple(f"{body}.{axis}" for body in self.bodies() for axis in "xy")

    def __str__(self) -> str:
        return f"distance({self.a}, {self.b}) {self.relation} {format_number(self.bound)}"


@dataclass(frozen=True)
class Speed(Comparison):
    """``speed(body) <= 0.1``: Euclidean norm of the velocity [m/s]; mu = bound - speed, or minus that."""

    body: str
    relation: str
    bound: float

    def __post_init__(self) -> None:
        self._check()

    def bodies(self) -> tuple[str, ...]:
        """Return the body, or nothing for ``all``."""
        return () if self.body == ALL else (self.body,)

    def margin(self, areas: Mapping[str, AreaLike]) -> Margin:
        """Return the margin of the speed."""
        return NormMargin((f"{self.body}.vx", f"{self.body}.vy"), None, self.bound, self.sign, self.strict)

    def signals(self) -> tuple[str, ...]:
        """Return the body's velocity."""
        return tuple(f"{body}.{axis}" for body in self.bodies() for axis in ("vx", "vy"))

    def expand(self, bodies: Sequence[str]) -> Formula:
        """Return the conjunction over bodies if this is about ``all``."""
        return _expand_body(self, bodies)

    def __str__(self) -> str:
        return f"speed({self.body}) {self.relation} {format_number(self.bound)}"


@dataclass(frozen=True)
class Linear(Comparison):
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
            if abs(coefficient) > LARGEST:
                raise FormulaError(f"coefficient {coefficient:g} of {signal} is beyond {LARGEST:g}")

    def bodies(self) -> tuple[str, ...]:
        """Return the bodies whose signals are compared."""
        return tuple(dict.fromkeys(signal.partition(".")[0] for signal in self.signals()))

    def margin(self, areas: Mapping[str, AreaLike]) -> Margin:
        """Return the margin of the linear combination."""
        return LinearMargin(self.terms, self.bound, self.sign, self.strict)

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


FUNCTIONS: dict[str, type[Any]] = {"distance": Distance, "speed": Speed}
"""Comparisons written as a function of bodies, ``speed(body) <= 0.1``; their fields are bodies, relation, bound."""


def make_comparison(function: str, bodies: Sequence[str], relation: str, bound: float) -> Predicate:
    """Make the comparison that compares a function of bodies.

    Args:
        function: one of ``FUNCTIONS``.
        bodies: its arguments; ``all`` where it takes a single body.
        relation: ``<=``, ``<``, ``>=`` or ``>``.
        bound: constant.

    Raises:
        FormulaError: another number of bodies than the function takes, or ``all`` among several.
    """
    kind = FUNCTIONS[function]
    count = len(fields(kind)) - 2
    if len(bodies) != count:
        raise FormulaError(f"{function} takes {count} bod{'ies' if count > 1 else 'y'}, got {len(bodies)}")
    if count > 1 and ALL in bodies:
        raise FormulaError(f"{function} takes the names of {count} bodies, not '{ALL}'")
    comparison: Comparison = kind(*bodies, relation, bound)
    return comparison


def make_margins(formula: Formula, areas: Mapping[str, AreaLike]) -> dict[Predicate, Margin]:
    """Make every predicate of a formula numeric.

    Args:
        formula: without ``all`` (see ``Formula.expand``).
        areas: regions and obstacles by name.

    Raises:
        FormulaError: an unknown area.
    """
    predicates = dict.fromkeys(node for node in formula.walk() if isinstance(node, Predicate))
    return {predicate: predicate.margin(areas) for predicate in predicates}


def _expand_body(predicate: In | Speed, bodies: Sequence[str]) -> Formula:
    if predicate.body != ALL:
        return predicate
    each = tuple(replace(predicate, body=body) for body in bodies)
    if not each:
        raise FormulaError(f"'{predicate}' speaks of all bodies, but there is none")
    return each[0] if len(each) == 1 else And(each)

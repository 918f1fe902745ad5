"""A formula in samples instead of seconds, with negations pushed down to the predicates.

There they turn a margin's sign: what is left is least and greatest of values, all monotone, so that the lower end
of an interval of robustness comes from lower ends only. Turning a sign is exact: the robustness stays the same to
the last bit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

from impact_envs.stl.formula import Always, And, Formula, Implies, Not, Or, Temporal
from impact_envs.stl.margin import (
    AreaLike,
    AreaMargin,
    LinearMargin,
    NormMargin,
    Range,
    combine_ranges,
    make_margin,
)
from impact_envs.stl.predicate import Predicate


@dataclass(frozen=True)
class Combination:
    """The least (``pick`` is min) or the greatest (max) of at least two terms."""

    pick: Callable[..., float]
    children: tuple[Term, ...]


@dataclass(frozen=True)
class Operator:
    """A temporal operator between samples ``first`` and ``last``.

    Of one term always (``pick`` is min) or eventually (max); of two until (max) or the negation of an until
    between the negated terms (min).
    """

    pick: Callable[..., float]
    first: int
    last: int
    children: tuple[Term, ...]


Leaf: TypeAlias = AreaMargin | LinearMargin | NormMargin
Term: TypeAlias = Leaf | Combination | Operator


def make_term(formula: Formula, period: float, areas: Mapping[str, AreaLike], negated: bool = False) -> Term:
    """Bring a formula, or its negation, into normal form.

    Args:
        formula: without ``all``.
        period: between samples [s].
        areas: regions and obstacles by name.
        negated: whether the negation is wanted.

    Raises:
        FormulaError: an unknown area, or an interval without a sample.
    """
    match formula:
        case Predicate():
            margin: Any = make_margin(formula, areas)
            return replace(margin, sign=-margin.sign) if negated else margin
        case Not(child):
            return make_term(child, period, areas, not negated)
        case Implies(left, right):
            return make_term(Or((Not(left), right)), period, areas, negated)
    children = tuple(make_term(child, period, areas, negated) for child in formula.children)
    pick = min if isinstance(formula, And | Always) != negated else max
    if isinstance(formula, Temporal):
        return Operator(pick, *formula.window(period), children)
    return Combination(pick, tuple(part for child in children for part in _open(child, pick)))


def _open(term: Term, pick: Callable[..., float]) -> tuple[Term, ...]:
    return term.children if isinstance(term, Combination) and term.pick is pick else (term,)


def is_state(term: Term) -> bool:
    """Return whether there is no temporal operator in a term."""
    if isinstance(term, Combination):
        return all(is_state(child) for child in term.children)
    return not isinstance(term, Operator)


def compute_range(state: Term, bounds: Mapping[str, Range]) -> Range:
    """Return an interval that holds a term without temporal operators for all signals within bounds."""
    if isinstance(state, Combination):
        return combine_ranges(state.pick, [compute_range(child, bounds) for child in state.children])
    assert not isinstance(state, Operator)
    return state.range(bounds)

"""Negation normal form: formulas in which only predicates are negated, as a planner reads them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from impact_envs.stl import Always, And, Eventually, Formula, Not, Or, Predicate, Temporal, Until


@dataclass(frozen=True)
class Release(Temporal):
    """``not (not p U[a,b] not q)``: q holds in the interval, or until and at an instant at which p holds.

    Equation: rho(t) = min_{tau in t+[a,b]} max(rho_q(tau), max_{s in [t, tau]} rho_p(s)). Source: the negation of
    Verhagen & Tumova, Eq. 2d.
    """

    left: Formula
    right: Formula
    _binding: ClassVar[int] = 5

    @property
    def children(self) -> tuple[Formula, ...]:
        """Return what releases, and what must hold until it does."""
        return (self.left, self.right)

    def rebuild(self, children: Sequence[Formula]) -> Formula:
        """Return the same operator over other formulas."""
        return Release(self.interval, *children)

    def __str__(self) -> str:
        until = Until(self.interval, *(compute_normal_form(child, negated=True) for child in self.children))
        return f"not ({until})"


def compute_normal_form(formula: Formula, negated: bool = False) -> Formula:
    """Return an equivalent formula of predicates, and, or, always, eventually, until and release.

    Nested conjunctions, disjunctions and eventuallies are merged: F[a,b] F[c,d] p = F[a+c,b+d] p.

    Args:
        formula: without ``all``.
        negated: whether its negation is meant.

    Returns:
        A formula with the same robustness on every signal in continuous time.

    Raises:
        FormulaError: an operator that planners do not take.

    Source: Verhagen & Tumova, Eq. (2) and the duals it defines.
    """
    match formula:
        case Predicate():
            return formula.negate() if negated else formula
        case Not(child):
            return compute_normal_form(child, not negated)
        case And(operands) | Or(operands):
            return _join(Or if isinstance(formula, And) == negated else And, [(part, negated) for part in operands])
        case Always(interval, child) | Eventually(interval, child):
            inner = compute_normal_form(child, negated)
            if isinstance(formula, Always) != negated:
                return Always(interval, inner)
            return _eventually(interval, inner)
        case Until(interval, left, right):
            parts = compute_normal_form(left, negated), compute_normal_form(right, negated)
            return Release(interval, *parts) if negated else Until(interval, *parts)
        case Release(interval, left, right):
            parts = compute_normal_form(left, negated), compute_normal_form(right, negated)
            return Until(interval, *parts) if negated else Release(interval, *parts)
    return compute_normal_form(formula.define(), negated)


def _join(kind: type[And] | type[Or], parts: list[tuple[Formula, bool]]) -> Formula:
    operands: list[Formula] = []
    for part, negated in parts:
        form = compute_normal_form(part, negated)
        operands += form.operands if isinstance(form, kind) else [form]
    return kind(tuple(operands))


def _eventually(interval: tuple[float, float], child: Formula) -> Formula:
    if isinstance(child, Eventually):
        (a, b), (c, d) = interval, child.interval
        return Eventually((a + c, b + d), child.child)
    return Eventually(interval, child)

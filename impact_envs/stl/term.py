"""A formula in samples instead of seconds, with negations pushed down to the predicates.

There they turn a margin's sign: what is left is least and greatest of values, all monotone, so that the lower end
of an interval of robustness comes from lower ends only. Turning a sign is exact: the robustness stays the same to
the last bit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import TypeAlias

from impact_envs.stl.formula import Formula
from impact_envs.stl.margin import AreaLike, Margin, Range, combine_ranges, mark_tie
from impact_envs.stl.operator import Always, And, Eventually, Not, Or, Until
from impact_envs.stl.predicate import Predicate

Pick: TypeAlias = Callable[..., float]  # min or max


@dataclass(frozen=True)
class Combination:
    """The least (``pick`` is min) or the greatest (max) of at least two terms."""

    pick: Pick
    children: tuple[Term, ...]


@dataclass(frozen=True)
class Operator:
    """A temporal operator between samples ``first`` and ``last``.

    Of one term always (``pick`` is min) or eventually (max); of two until (max) or the negation of an until
    between the negated terms (min).
    """

    pick: Pick
    first: int
    last: int
    children: tuple[Term, ...]


Term: TypeAlias = Margin | Combination | Operator


def make_term(formula: Formula, period: float, areas: Mapping[str, AreaLike], negated: bool = False) -> Term:
    """Bring a formula, or its negation, into normal form.

    Operators of a kind within each other are merged: F[a,b] F[c,d] p = F[a+c,b+d] p.

    Args:
        formula: without ``all``.
        period: between samples [s].
        areas: regions and obstacles by name.
        negated: whether the negation is wanted.

    Raises:
        FormulaError: an unknown area, an interval without a sample, or an operator that is not known here.
    """

    def make(child: Formula) -> Term:
        return make_term(child, period, areas, negated)

    match formula:
        case Predicate():
            margin = formula.margin(areas)
            return margin.negate() if negated else margin
        case Not(child):
            return make_term(child, period, areas, not negated)
        case And(operands) | Or(operands):
            pick = min if isinstance(formula, And) != negated else max
            return Combination(pick, tuple(part for child in operands for part in list_operands(make(child), pick)))
        case Always(_, child) | Eventually(_, child):
            pick = min if isinstance(formula, Always) != negated else max
            return _merge(Operator(pick, *formula.window(period), (make(child),)))
        case Until(_, left, right):
            return Operator(min if negated else max, *formula.window(period), (make(left), make(right)))
    return make(formula.define())


def list_operands(term: Term, pick: Pick) -> tuple[Term, ...]:
    """Return the terms of which a term is the least, or the greatest: itself if it is no such combination.

    Args:
        term: any.
        pick: min or max.
    """
    return term.children if isinstance(term, Combination) and term.pick is pick else (term,)


def _merge(outer: Operator) -> Operator:
    """Return one operator for two of a kind; one about a single sample is of every kind."""
    (inner,) = outer.children
    if isinstance(inner, Operator) and len(inner.children) == 1:
        pick = inner.pick if outer.first == outer.last else outer.pick
        if pick is inner.pick or inner.first == inner.last:
            return Operator(pick, outer.first + inner.first, outer.last + inner.last, inner.children)
    return outer


def split_operators(term: Term) -> Term:
    """Return an equal term with an outermost always of a conjunction, or eventually of a disjunction, taken apart.

    Args:
        term: any; operators of formulas without temporal operators stay whole.
    """
    if isinstance(term, Combination):
        opened = [part for child in term.children for part in list_operands(split_operators(child), term.pick)]
        return Combination(term.pick, tuple(opened))
    if not isinstance(term, Operator) or len(term.children) == 2:
        return term
    (inner,) = term.children
    if not isinstance(inner, Combination) or is_state(inner):
        return term
    parts = join_states(inner) if inner.pick is term.pick else _distribute(inner)
    if len(parts) == 1:
        return term
    each = [_merge(Operator(term.pick, term.first, term.last, (part,))) for part in parts]
    return split_operators(Combination(term.pick, tuple(each)))


def join_states(term: Combination) -> list[Term]:
    """Return the operands, those without temporal operators joined to one, the last.

    Args:
        term: any.
    """
    states = tuple(child for child in term.children if is_state(child))
    parts = [child for child in term.children if not is_state(child)]
    if states:
        parts.append(states[0] if len(states) == 1 else Combination(term.pick, states))
    return parts


def _distribute(term: Combination) -> list[Term]:
    """Return the operands of an equal term of the other pick, a | (b & c) = (a | b) & (a | c), if they part operators.

    Only over one operand, so that there are not many more operators than before.
    """
    inside = [child for child in term.children if isinstance(child, Combination) and not is_state(child)]
    if len(inside) != 1:
        return [term]
    rest = tuple(child for child in term.children if child is not inside[0])
    parts: list[Term] = [
        Combination(term.pick, (*rest, *list_operands(part, term.pick))) for part in join_states(inside[0])
    ]
    counts = [len(set(_walk_operators(part))) for part in (term, *parts)]
    return parts if counts[0] > max(counts[1:]) == 1 else [term]


def is_state(term: Term) -> bool:
    """Return whether there is no temporal operator in a term."""
    if isinstance(term, Combination):
        return all(is_state(child) for child in term.children)
    return not isinstance(term, Operator)


@dataclass(frozen=True)
class Join:
    """A Boolean combination of states and one operator over states: max(lower, min(upper, operator)).

    Attributes:
        operator: may stand more than once in the combination.
        lower, upper: states; None stands for -inf and inf.
    """

    operator: Operator
    lower: Term | None
    upper: Term | None


def find_join(term: Operator) -> Join | None:
    """Return the join that an operator is about, of an until its right side; None if it is about something else.

    Args:
        term: any.
    """
    *left, inner = term.children
    operators = set(_walk_operators(inner))
    if len(operators) != 1 or not all(map(is_state, left)):
        return None
    (operator,) = operators
    if not all(map(is_state, operator.children)):
        return None
    return Join(operator, _find_limit(inner, max), _find_limit(inner, min))


def _walk_operators(term: Term) -> Iterator[Operator]:
    """Yield the outermost operators in a term."""
    if isinstance(term, Operator):
        yield term
    elif isinstance(term, Combination):
        for child in term.children:
            yield from _walk_operators(child)


def _find_limit(term: Term, loses: Pick) -> Term | None:
    """Return a join's end: what it is where its operator is -inf, which ``loses`` in max, or inf; None if that too."""
    if isinstance(term, Operator):
        return None
    if not isinstance(term, Combination):
        return term
    limits = [_find_limit(child, loses) for child in term.children]
    rest = tuple(limit for limit in limits if limit is not None)
    if not rest or (len(rest) < len(limits) and term.pick is not loses):
        return None
    return rest[0] if len(rest) == 1 else Combination(term.pick, rest)


def other(pick: Pick) -> Pick:
    """Return max for min, min for max."""
    return min if pick is max else max


def compute_range(term: Term, bounds: Mapping[str, Range]) -> Range:
    """Return an interval that holds a term's robustness for all signals within bounds, ties marked (see ``TIE``).

    Args:
        term: any.
        bounds: signals to intervals; one that is missing may be anything.
    """
    if isinstance(term, Combination | Operator):
        # Of an until both sides count, each at its best instant.
        pick = other(term.pick) if isinstance(term, Operator) and len(term.children) == 2 else term.pick
        return combine_ranges(pick, [compute_range(child, bounds) for child in term.children])
    low, high = term.range(bounds)
    return mark_tie(low, term.strict), mark_tie(high, term.strict)

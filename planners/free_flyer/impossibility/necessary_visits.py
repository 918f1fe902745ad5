"""What every motion that keeps a formula does: at which moments, and for how long, which predicates hold.

Each is a consequence of the formula, never all of it: what is no visit is left out. A disjunction gives alternatives.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from impact_envs.stl import Always, And, Eventually, Formula, Or, Predicate, Until
from impact_envs.stl.formula import Interval, find_window
from planners.free_flyer.specification.negation_normal_form import Release

MOST_ALTERNATIVES = 64  # of a formula; with more, the disjunctions that have most of them are left out
MOST_NESTED = 5  # operators of time; a formula with more tells nothing: each may double what is read
MOST_INSTANTS = 6  # of a window at all instants of which something has to come in time


@dataclass(frozen=True, eq=False)
class Moment:
    """Hold an instant that a formula speaks of: in a window, and in another one counted from an earlier moment.

    Args:
        start: of the window [s].
        end: of the window [s].
        parent: earlier moment, if any.
        lower: least time since the parent [s].
        upper: greatest time since the parent [s].
    """

    start: float
    end: float
    parent: Moment | None = None
    lower: float = 0.0
    upper: float = 0.0

    @property
    def is_fixed(self) -> bool:
        """Return whether the window is one instant."""
        return self.start == self.end

    def shifted(self, lower: float, upper: float) -> Moment:
        """Return a moment so much later."""
        if lower == upper == 0.0:
            return self
        start, end = self.start + lower, self.end + upper
        return Moment(start, end) if self.is_fixed else Moment(start, end, self, lower, upper)

    def find_spread(self, other: Moment) -> float:
        """Return the greatest time that may lie between this moment and another one [s]."""
        most = max(self.end - other.start, other.end - self.start)
        for late, early in ((self, other), (other, self)):
            later = late.find_lag(early)
            most = most if later is None else min(most, later[1])
        return most

    def find_lag(self, early: Moment) -> tuple[float, float] | None:
        """Return the least and the greatest time since a moment that this one is counted from; None: it is not [s]."""
        lower = upper = 0.0
        moment: Moment | None = self
        while moment is not None:
            if moment is early:
                return lower, upper
            lower, upper, moment = lower + moment.lower, upper + moment.upper, moment.parent
        return None


@dataclass(frozen=True, eq=False)
class Visit:
    """Say that a predicate holds at a moment."""

    predicate: Predicate
    moment: Moment


@dataclass(frozen=True, eq=False)
class Stay:
    """Say that a predicate holds at all instants from start to end [s]."""

    predicate: Predicate
    start: float
    end: float


@dataclass(frozen=True, eq=False)
class Recurrence:
    """Say that within a span of every instant from start to end a predicate holds at some instant [s]."""

    predicate: Predicate
    start: float
    end: float
    span: float


Consequence = Visit | Stay | Recurrence
Alternative = tuple[Consequence, ...]


def move_to_samples(formula: Formula, period: float) -> Formula:
    """Return a formula with intervals from their first sample to their last one: it asks nothing of what is between.

    Args:
        formula: in normal form.
        period: between samples [s].
    """

    def shrink(interval: Interval) -> Interval:
        first, last = find_window(interval, period)
        return first * period, last * period

    return formula.map_intervals(shrink)


def list_alternatives(formulas: Iterable[Formula]) -> list[Alternative]:
    """Return the alternatives of a conjunction; every motion that keeps it does all of at least one of them.

    Args:
        formulas: conjuncts in normal form, without ``all``.
    """
    read = (formula for formula in formulas if _count_nested(formula) <= MOST_NESTED)
    return _combine([_hold_at(formula, Moment(0.0, 0.0)) for formula in read])


def _count_nested(formula: Formula) -> int:
    """Return how many operators of time are nested in each other."""
    return int(hasattr(formula, "interval")) + max(map(_count_nested, formula.children), default=0)


def _combine(parts: Sequence[list[Alternative]]) -> list[Alternative]:
    """Return the alternatives of a conjunction of parts."""
    kept = sorted(range(len(parts)), key=lambda k: len(parts[k]))
    count = 1
    chosen: list[int] = []
    for k in kept:
        if count * len(parts[k]) > MOST_ALTERNATIVES:
            break
        count *= len(parts[k])
        chosen.append(k)
    return [tuple(itertools.chain(*one)) for one in itertools.product(*(parts[k] for k in sorted(chosen)))]


def _hold_at(formula: Formula, moment: Moment) -> list[Alternative]:
    """Return what follows from a formula that holds at a moment."""
    match formula:
        case Predicate():
            return [(Visit(formula, moment),)]
        case And(operands):
            return _combine([_hold_at(part, moment) for part in operands])
        case Or(operands):
            return [one for part in operands for one in _hold_at(part, moment)]
        case Always((lower, upper), child):
            ends = moment.shifted(lower, lower), moment.shifted(upper, upper)
            if ends[0].end >= ends[1].start:
                return _combine([_hold_at(child, end) for end in ends])
            held = _hold_throughout(child, ends[0].end, ends[1].start)
            return held if moment.is_fixed else _combine([held, *(_hold_at(child, end) for end in ends)])
        case Eventually((lower, upper), child):
            return _hold_at(child, moment.shifted(lower, upper))
        case Until((lower, upper), left, right):
            comes = _hold_at(And((left, right)), moment.shifted(lower, upper))
            return _combine([comes, _hold_at(Always((0.0, lower), left), moment)]) if lower else comes
        case Release((lower, _), left, right):
            freed = _hold_at(left, moment.shifted(0.0, lower))
            return freed + _hold_at(right, moment.shifted(lower, lower))
    raise TypeError(f"{type(formula).__name__} is not in normal form")


def _hold_throughout(formula: Formula, start: float, end: float) -> list[Alternative]:
    """Return what follows from a formula that holds at all instants from start to end."""
    match formula:
        case Predicate():
            return [(Stay(formula, start, end), *(Visit(formula, Moment(time, time)) for time in (start, end)))]
        case And(operands):
            return _combine([_hold_throughout(part, start, end) for part in operands])
        case Always((lower, upper), child):
            return _hold_throughout(child, start + lower, end + upper)
    instants = [start, end]
    recurrence: list[Alternative] = [()]
    if isinstance(formula, Eventually) and formula.interval[1] > formula.interval[0]:
        # Instants whose windows follow upon each other ask for most visits.
        span = formula.interval[1] - formula.interval[0]
        steps = min(int((end - start) / span), MOST_INSTANTS - 2)
        instants = sorted({start, end, *(start + k * span for k in range(1, steps + 1))})
        if isinstance(formula.child, Predicate):
            first = formula.interval[0]
            recurrence = [(Recurrence(formula.child, start + first, end + first, span),)]
    return _combine([recurrence, *(_hold_at(formula, Moment(time, time)) for time in instants)])

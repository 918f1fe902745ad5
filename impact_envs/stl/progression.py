"""Formula progression: what of a formula is left to be done, once the beginning of the trace is known."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from impact_envs.errors import FormulaError
from impact_envs.stl.formula import Formula
from impact_envs.stl.operator import Always, And, Eventually, Not, Or, Temporal, Until
from impact_envs.stl.predicate import Predicate, make_margins
from impact_envs.stl.trace import Trace

PARTS = 8  # into which one subformula may fall apart, at most
DIGITS = 9  # of times [s]
Left = Formula | bool  # what is left: a formula, or how the past has decided it


def progress_formula(formula: Formula, trace: Trace, tolerance: float = 0.0) -> Left:
    """Return what is left of a formula at the last sample of a trace, in time that starts there.

    The trace holds samples 0 .. n, of which those before n are the past; n is also the first sample of what comes.
    For every continuation of the trace, the formula holds on all of it if and only if the returned one holds from
    sample n on. What missed a predicate by no more than the tolerance held it in the past.

    Args:
        formula: specification.
        trace: signals, shapes (n + 1,).
        tolerance: by which the past may have missed a predicate [unit of the predicates].

    Returns:
        The formula that is left, without ``all``; True or False where the past has decided it.

    Raises:
        FormulaError: unknown names, an interval without a sample, or what is left has no short form.
    """
    formula = formula.expand(trace.bodies)
    held = {}
    for predicate, margin in make_margins(formula, trace.areas).items():
        mu = margin.compute(trace.first(predicate.signals(), trace.length), np)
        mu = np.broadcast_to(mu, (trace.length,))
        held[predicate] = mu > -tolerance if predicate.strict else mu >= -tolerance
    return _Progression(trace.period, trace.length - 1, held).at(formula, 0)


@dataclass(frozen=True)
class _Progression:
    """Progress formulas from any sample k <= n on.

    Args:
        period: between samples [s].
        now: n.
        held: whether predicates held, shape (n + 1,).
        known: what is left of formulas at samples, as far as computed.
    """

    period: float
    now: int
    held: dict[Predicate, np.ndarray]
    known: dict[tuple[Formula, int], Left] = field(default_factory=dict)

    def at(self, formula: Formula, k: int) -> Left:
        """Return what is left at sample n of a formula that is meant at sample k."""
        key = formula, k
        if key not in self.known:
            self.known[key] = self._at(formula, k)
        return self.known[key]

    def _at(self, formula: Formula, k: int) -> Left:
        if k + formula.first_look(self.period) >= self.now:
            return _hasten(formula, self.period * (self.now - k))
        match formula:
            case Predicate():
                return bool(self.held[formula][k])
            case Not(child):
                return _negate(self.at(child, k))
            case And(operands):
                return _join(And, (self.at(part, k) for part in operands))
            case Or(operands):
                return _join(Or, (self.at(part, k) for part in operands))
            case Always(_, child):
                return self._over(And, formula, child, k)
            case Eventually(_, child):
                return self._over(Or, formula, child, k)
            case Until():
                return self._until(formula, k)
        return self.at(formula.define(), k)

    def _over(self, kind: type[And] | type[Or], formula: Temporal, child: Formula, k: int) -> Left:
        """Return the junction of what is left of the child at all samples of the operator's interval."""
        first, last = formula.window(self.period)
        # From here on the child looks at nothing but what comes, and the operator stays one.
        whole = max(self.now - child.first_look(self.period), k + first)
        parts = [self.at(child, s) for s in range(k + first, min(whole, k + last + 1))]
        if whole <= k + last:
            kept = min(whole, self.now)
            start = max(0.0, formula.interval[0] - self.period * (self.now - k))
            end = formula.interval[1] - self.period * (kept - k)
            later = _hasten(child, self.period * (self.now - kept))
            parts.append(replace(formula, interval=(_seconds(start), _seconds(end))).rebuild([later]))
        return _join(kind, parts)

    def _until(self, formula: Until, k: int) -> Left:
        first, last = formula.window(self.period)
        past = range(k, min(self.now, k + last + 1))
        choices: list[Left] = []
        so_far: Left = True
        for s in past:
            so_far = _join(And, (so_far, self.at(formula.left, s)))
            if s >= k + first:
                choices.append(_join(And, (so_far, self.at(formula.right, s))))
            if so_far is False:
                break
        if k + last >= self.now:
            start, end = (_seconds(max(0.0, t - self.period * (self.now - k))) for t in formula.interval)
            choices.append(_join(And, (so_far, replace(formula, interval=(start, end)))))
        return _join(Or, choices)


def _hasten(formula: Formula, time: float) -> Formula:
    """Return a formula that means so much later what this one means now; it looks at nothing before."""
    if time == 0.0:
        return formula
    if isinstance(formula, Temporal):
        start, end = formula.interval
        early = min(start, time)
        if isinstance(formula, Until) or early == time:
            return replace(formula, interval=(_seconds(max(0.0, start - time)), _seconds(end - time)))
        children = [_hasten(child, time - early) for child in formula.children]
        return replace(formula, interval=(0.0, _seconds(end - early))).rebuild(children)
    return formula.rebuild([_hasten(child, time) for child in formula.children])


def _seconds(time: float) -> float:
    return round(time, DIGITS)


def _negate(left: Left) -> Left:
    if isinstance(left, bool):
        return not left
    return left.child if isinstance(left, Not) else Not(left)


def _join(kind: type[And] | type[Or], parts: Iterable[Left]) -> Left:
    """Return the junction of what is left, without parts that others imply."""
    idle, found = kind is And, list[Formula]()
    for part in parts:
        if part is (not idle):
            return not idle
        for operand in part.operands if isinstance(part, kind) else [part]:
            if not isinstance(operand, bool):
                _add(kind, found, operand)
    if len(found) > PARTS:
        count = f"{len(found)} parts, at most {PARTS} are taken"
        raise FormulaError(f"what is left of '{found[0]}' and the like has {count}")
    return idle if not found else found[0] if len(found) == 1 else kind(tuple(found))


def _add(kind: type[And] | type[Or], found: list[Formula], part: Formula) -> None:
    """Add a part; of two windows on the same, one within the other, only one counts."""
    for i, other in enumerate(found):
        if part == other:
            return
        if not isinstance(part, Temporal) or type(part) is not type(other) or part.children != other.children:
            continue
        assert isinstance(other, Temporal)
        short, long = sorted((part, other), key=lambda window: window.interval[1] - window.interval[0])
        if long.interval[0] <= short.interval[0] and short.interval[1] <= long.interval[1]:
            found[i] = long if isinstance(part, Always) == (kind is And) else short
            return
    found.append(part)

"""Robust satisfaction intervals: what each part of a formula can still become, sample by sample.

Source: Deshmukh et al. 2017 (see monitor.py).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from impact_envs.stl.formula import Always, And, Formula, Implies, Not, Or, Temporal, Until
from impact_envs.stl.margin import Margin, Range, combine_ranges
from impact_envs.stl.predicate import Predicate
from impact_envs.stl.robustness import Semantics


class _State(Protocol):
    """A formula without temporal operators, on one sample."""

    def at(self, sample: Mapping[str, float]) -> float: ...

    def range(self, bounds: Mapping[str, Range]) -> Range: ...


@dataclass(frozen=True, slots=True)
class _Negated:
    child: _State

    def at(self, sample: Mapping[str, float]) -> float:
        return -self.child.at(sample)

    def range(self, bounds: Mapping[str, Range]) -> Range:
        low, high = self.child.range(bounds)
        return -high, -low


@dataclass(frozen=True, slots=True)
class _Picked:
    pick: Callable[..., float]
    children: tuple[_State, ...]

    def at(self, sample: Mapping[str, float]) -> float:
        return self.pick([child.at(sample) for child in self.children])

    def range(self, bounds: Mapping[str, Range]) -> Range:
        return combine_ranges(self.pick, (child.range(bounds) for child in self.children))


def _make_state(formula: Formula, margins: Mapping[Predicate, Margin]) -> _State:
    if isinstance(formula, Predicate):
        return margins[formula]
    children = tuple(_make_state(child, margins) for child in formula.children)
    match formula:
        case Not():
            return _Negated(*children)
        case Implies():
            return _Picked(max, (_Negated(children[0]), children[1]))
        case _:
            return _Picked(min if isinstance(formula, And) else max, children)


class Node(Protocol):
    """A formula at time 0; ``interval`` is what is possible after the samples given to ``update``."""

    interval: Range

    def update(self, k: int, sample: Mapping[str, float]) -> None:
        """Take sample k."""


class _Now:
    """A formula without temporal operators: decided by sample 0."""

    def __init__(self, state: _State, bounds: Mapping[str, Range]) -> None:
        self.state = state
        self.interval = state.range(bounds)

    def update(self, k: int, sample: Mapping[str, float]) -> None:
        if k == 0:
            value = self.state.at(sample)
            self.interval = (value, value)


class _Extreme:
    """Eventually or always: the extreme value so far, and whatever a sample to come can make of it."""

    def __init__(
        self, state: _State, window: tuple[int, int], pick: Callable[..., float], bounds: Mapping[str, Range]
    ) -> None:
        self.state, self.pick = state, pick
        self.first, self.last = window
        self.best = -math.inf if pick is max else math.inf
        self.interval = self.unseen = state.range(bounds)

    def update(self, k: int, sample: Mapping[str, float]) -> None:
        if not self.first <= k <= self.last:
            return
        pick = self.pick
        best = self.best = pick(self.best, self.state.at(sample))
        if k == self.last:
            self.interval = (best, best)
        else:
            low, high = self.unseen
            self.interval = (pick(best, low), pick(best, high))


class _Until:
    """Until: ``held`` is the least of the left side so far, ``best`` the best completion so far.

    The best completion to come is at most (and at the next sample at least) the least of what was held and
    what an unseen sample of either side can be.
    """

    def __init__(self, left: _State, right: _State, window: tuple[int, int], bounds: Mapping[str, Range]) -> None:
        self.left, self.right = left, right
        self.first, self.last = window
        self.held, self.best = math.inf, -math.inf
        self.interval = self.unseen = combine_ranges(min, (left.range(bounds), right.range(bounds)))

    def update(self, k: int, sample: Mapping[str, float]) -> None:
        if k > self.last:
            return
        self.held = min(self.held, self.left.at(sample))
        if k >= self.first:
            self.best = max(self.best, min(self.held, self.right.at(sample)))
        if k == self.last:
            self.interval = (self.best, self.best)
        else:
            low, high = self.unseen
            self.interval = (max(self.best, min(self.held, low)), max(self.best, min(self.held, high)))


class _Nested:
    """A temporal operator over temporal operators: offline semantics of both ends over the whole horizon.

    Each predicate keeps an array (2, reach + 1) of its ends, at first what the bounds allow. All operators
    but negation are monotone, so that they act on both ends alike; negation swaps the ends.
    """

    def __init__(
        self,
        formula: Formula,
        period: float,
        margins: Mapping[Predicate, Margin],
        bounds: Mapping[str, Range],
    ) -> None:
        self.formula, self.period = formula, period
        self.reach = formula.reach(period)
        self.margins = {node: margins[node] for node in formula.walk() if isinstance(node, Predicate)}
        self.ends = {
            predicate: np.repeat(np.array(margin.range(bounds))[:, None], self.reach + 1, axis=1)
            for predicate, margin in self.margins.items()
        }
        self._evaluate()

    def update(self, k: int, sample: Mapping[str, float]) -> None:
        if k > self.reach:
            return
        for predicate, margin in self.margins.items():
            self.ends[predicate][:, k] = margin.at(sample)
        self._evaluate()

    def _evaluate(self) -> None:
        semantics = Semantics(
            self.period,
            np,
            lambda predicate, count: self.ends[predicate][:, :count],
            lambda ends: -ends[::-1],
        )
        low, high = semantics.rho(self.formula, 1)[:, 0].tolist()
        self.interval = (low, high)


class _Opposite:
    """The negation of another node."""

    def __init__(self, child: Node) -> None:
        self.child = child
        self.interval = (-child.interval[1], -child.interval[0])

    def update(self, k: int, sample: Mapping[str, float]) -> None:
        self.child.update(k, sample)
        low, high = self.child.interval
        self.interval = (-high, -low)


class _Junction:
    """The least or the greatest of several nodes."""

    def __init__(self, children: tuple[Node, ...], pick: Callable[..., float]) -> None:
        self.children, self.pick = children, pick
        self.interval = combine_ranges(pick, [child.interval for child in children])

    def update(self, k: int, sample: Mapping[str, float]) -> None:
        lows, highs = [], []
        for child in self.children:
            child.update(k, sample)
            low, high = child.interval
            lows.append(low)
            highs.append(high)
        self.interval = (self.pick(lows), self.pick(highs))


def _is_temporal(formula: Formula) -> bool:
    return any(isinstance(node, Temporal) for node in formula.walk())


def make_node(
    formula: Formula, period: float, margins: Mapping[Predicate, Margin], bounds: Mapping[str, Range]
) -> Node:
    """Make the node that follows a formula.

    Args:
        formula: without ``all``.
        period: between samples [s].
        margins: the formula's predicates made numeric.
        bounds: signals to intervals known beforehand.

    Raises:
        FormulaError: an interval contains no sample.
    """
    if not _is_temporal(formula):
        return _Now(_make_state(formula, margins), bounds)
    if isinstance(formula, Temporal):
        if any(_is_temporal(child) for child in formula.children):
            return _Nested(formula, period, margins, bounds)
        window, states = formula.window(period), [_make_state(c, margins) for c in formula.children]
        if isinstance(formula, Until):
            return _Until(states[0], states[1], window, bounds)
        return _Extreme(states[0], window, min if isinstance(formula, Always) else max, bounds)
    nodes = tuple(make_node(child, period, margins, bounds) for child in formula.children)
    match formula:
        case Not():
            return _Opposite(*nodes)
        case Implies():
            return _Junction((_Opposite(nodes[0]), nodes[1]), max)
        case Or():
            return _Junction(nodes, max)
        case _:
            return _Junction(nodes, min)

"""The definition of the online monitor, as plain as it gets: the robustness of the samples, continued by their bounds.

Lower and upper end of an interval are a pair of rows (2, T), a column per instant. Of a predicate both are its value
at the samples that have come, and the ends of what it can be at those to come. All operators but negation are
monotone, so that they act on both rows alike; negation swaps them.
"""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from impact_envs.stl import Always, And, Eventually, Implies, Not, Or, Predicate, Until
from impact_envs.stl.predicate import make_margins


class Oracle:
    """Follow a formula's robustness at time 0; arguments and interval as for ``Monitor``."""

    def __init__(self, formula, period, areas, bodies, bounds=None):
        self.formula, self.period = formula.expand(bodies), period
        self.reach = self.formula.reach(period)
        self.margins = make_margins(self.formula, areas)
        self.ends = {
            predicate: np.repeat(np.array(margin.range(bounds or {}))[:, None], self.reach + 1, axis=1)
            for predicate, margin in self.margins.items()
        }
        self.count = 0

    @property
    def interval(self):
        return tuple(self.evaluate(self.formula, 1)[:, 0].tolist())

    def update(self, sample):
        if self.count <= self.reach:
            for predicate, margin in self.margins.items():
                self.ends[predicate][:, self.count] = margin.at(sample)
        self.count += 1
        return self.interval

    def evaluate(self, formula, count):
        """Return the ends at the first instants, shape (2, count)."""
        if isinstance(formula, Predicate):
            return self.ends[formula][:, :count]
        first, last = formula.window(self.period) if hasattr(formula, "interval") else (0, 0)
        parts = [self.evaluate(child, count + last) for child in formula.children]
        match formula:
            case Not():
                return -parts[0][::-1]
            case And():
                return np.min(parts, axis=0)
            case Or():
                return np.max(parts, axis=0)
            case Implies():
                return np.maximum(-parts[0][::-1], parts[1])
            case Eventually():
                return sliding_window_view(parts[0][:, first:], last - first + 1, axis=1).max(axis=-1)
            case Always():
                return sliding_window_view(parts[0][:, first:], last - first + 1, axis=1).min(axis=-1)
            case Until():
                left, right = parts
                ways = [
                    np.minimum(
                        right[:, t : t + count], sliding_window_view(left, t + 1, axis=1)[:, :count].min(axis=-1)
                    )
                    for t in range(first, last + 1)
                ]
                return np.max(ways, axis=0)
        raise TypeError(formula)

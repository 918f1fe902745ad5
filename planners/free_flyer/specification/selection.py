"""Read from a solution of a grid which predicates it satisfies, and when."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from planners.alternatives import read_marks
from planners.free_flyer.specification.grid import Grid, Time
from planners.free_flyer.specification.predicate_rows import Mark, MarkedTree
from planners.free_flyer.specification.requirement import Requirement
from planners.mixed_integer import Affine

TOLERANCE = 1e-6  # by which a solution may violate rows [their unit] and times may differ [s]
TIE = 1e-6  # times so little past the middle of two control steps round down [control periods]


@dataclass(frozen=True)
class Choices:
    """Hold the alternatives of a formula in a grid, to read from a solution which of them it takes.

    Args:
        grid: the grid.
        trees: of all conjuncts and solid obstacles.
        instants: variables that are instants [s].
        period: control period [s].
    """

    grid: Grid
    trees: tuple[MarkedTree, ...]
    instants: tuple[Affine, ...]
    period: float

    def read(self, x: np.ndarray, times: np.ndarray) -> tuple[Requirement, ...]:
        """Return the predicates that together satisfy the formula, with windows in numbers.

        Args:
            x: solution of the grid's model, shape (n,).
            times: final times of the grid's knots, which may differ a little from the solution's [s].

        Returns:
            The chosen predicates, and the solid obstacles. Single instants fall on control steps.
        """
        final = self._settle(x, times)
        marks = [mark for tree in self.trees for mark in read_marks(tree, x, TOLERANCE)]
        return tuple(need for mark in marks for need in self._read_mark(mark, final))

    def _settle(self, x: np.ndarray, times: np.ndarray) -> np.ndarray:
        """Return the solution with the final times of its knots; instants move along with them."""
        final = np.array(x, dtype=float)
        before = [_value(time, x) for time in self.grid.times]
        for time, value in zip(self.grid.times, times, strict=True):
            if isinstance(time, Affine) and list(time.coefficients.values()) == [1.0]:
                final[next(iter(time.coefficients))] = value - time.constant
        for instant in self.instants:
            ((i, _),) = instant.coefficients.items()
            moved = float(np.interp(x[i], before, times))
            knot = float(times[np.abs(times - moved).argmin()])
            final[i] = knot if abs(moved - knot) < TOLERANCE else self._round(moved)
        return final

    def _read_mark(self, mark: Mark, final: np.ndarray) -> Iterator[Requirement]:
        start = max(_value(window[0], final) for window in mark.windows)
        end = min(_value(window[1], final) for window in mark.windows)
        if mark.once:
            # Rounding may make a window end before it starts; its middle is then still the instant.
            middle = self._round(0.5 * (start + end))
            start = end = middle if start <= middle <= end or start >= end else 0.5 * (start + end)
        if start <= end:
            yield replace(mark.need, start=start, end=end)

    def _round(self, time: float) -> float:
        """Return the nearest control step; equal times computed differently must not fall on two steps."""
        return float(np.round(np.round(time / self.period - TIE) * self.period, 9))


def _value(time: Time, x: np.ndarray) -> float:
    return float(time.value(x) if isinstance(time, Affine) else time)

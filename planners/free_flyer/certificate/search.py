"""Proven bounds of the least value that a function takes over time, by bisection of its polynomials."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction

from planners.free_flyer.certificate.polynomial import Range
from planners.free_flyer.certificate.track import Cell

# Bounds of a function from bounds of the polynomials that it is made of.
Measure = Callable[[Sequence[Range]], Range]


@dataclass(frozen=True)
class Effort:
    """Say how far bounds are refined.

    Args:
        accuracy: bounds that are so near to each other are near enough [unit of the function].
        splits: bisections after which they are taken as they are: they hold, but may be far apart.
        nested_accuracy, nested_splits: the same of temporal operators within others, whose every bisection asks for
            bounds of what is inside; their accuracy cannot be better than that of the inside.
    """

    accuracy: Fraction = Fraction(1, 10**8)
    splits: int = 4000
    nested_accuracy: Fraction = Fraction(1, 10**6)
    nested_splits: int = 100


@dataclass(frozen=True)
class Bounds:
    """Bounds of a least value.

    Attributes:
        low: nothing is below.
        high: something is not above.
        time: where that is [s].
    """

    low: Fraction
    high: Fraction
    time: Fraction


def find_minimum(cells: Iterable[Cell], measure: Measure, effort: Effort) -> Bounds:
    """Return bounds of the least value of a function over some cells: the lowest is halved first.

    Args:
        cells: at least one.
        measure: bounds of the function from those of a cell's polynomials; exact where these are numbers.
        effort: when to stop.
    """
    best: Bounds | None = None
    heap: list[tuple[Fraction, int, Cell]] = []
    fresh, number, splits = list(cells), 0, 0
    while True:
        for cell in fresh:
            for place, time in ((0, cell.start), (-1, cell.end)):
                high = measure(cell.list_values(place))[1]
                if best is None or high < best.high:
                    best = Bounds(high, high, time)
            number += 1
            heapq.heappush(heap, (measure(cell.list_ranges())[0], number, cell))
        assert best is not None
        low, _, cell = heapq.heappop(heap)
        if best.high - low <= effort.accuracy or splits >= effort.splits or cell.start == cell.end:
            return Bounds(min(low, best.high), best.high, best.time)
        fresh, splits = list(cell.split()), splits + 1

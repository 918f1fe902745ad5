"""What the planners' grids have in common: bodies move from knot to knot at common times."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias

from planners.mixed_integer import Affine, Model

Time: TypeAlias = Affine | float  # [s]
Place: TypeAlias = tuple[int, float]  # piece, and fraction of its way


@dataclass(frozen=True)
class GridSize:
    """Hold the size of a grid.

    Args:
        impacts: number of impacts; of a constant grid, of boundaries.
        pieces: number of equally long pieces per leg between two events.
        passing: whether areas may be reached between events.
    """

    impacts: int
    pieces: int = 1
    passing: bool = False


class Grid(Protocol):
    """Motions along knots that all bodies pass at the same times.

    A knot is a point, or an axis-aligned box of points with `lower` and `upper`: then every point of the box is meant.
    Between knots bodies move uniformly, or are in the interpolation of the boxes.
    """

    @property
    def model(self) -> Model:
        """Return the model."""

    @property
    def rho(self) -> Affine:
        """Return the robustness [m]."""

    @property
    def pieces(self) -> int:
        """Return the number of pieces between two events."""

    @property
    def count(self) -> int:
        """Return the number of pieces of all legs."""

    @property
    def times(self) -> Sequence[Time]:
        """Return the times of the knots, of which the first and the last are numbers [s]."""

    @property
    def knots(self) -> Mapping[str, Sequence[Any]]:
        """Return every body's knots [m]."""


def interpolate(here: Any, there: Any, fraction: float) -> Any:
    """Return the linear interpolation of two expressions, points or boxes.

    Args:
        here: at fraction 0.
        there: at fraction 1.
        fraction: of the way.
    """
    if fraction in (0.0, 1.0):
        return there if fraction else here
    if hasattr(here, "lower"):
        ends = ((here.lower, there.lower), (here.upper, there.upper))
        return type(here)(*(interpolate(*end, fraction) for end in ends))
    return here + (there - here) * fraction


def refine(values: Sequence[Any], pieces: int) -> list[Any]:
    """Return the values at events, and between each two of them the ends of equally long pieces.

    Args:
        values: expressions, points or boxes at the events.
        pieces: number of pieces per leg.
    """
    fine = [values[0]]
    for here, there in itertools.pairwise(values):
        fine += [interpolate(here, there, i / pieces) for i in range(1, pieces + 1)]
    return fine


def find_place(grid: Grid, body: str, place: Place) -> Any:
    """Return where a body is, as a point or a box.

    Args:
        grid: the grid.
        body: its name.
        place: piece, and fraction of its way.
    """
    piece, fraction = place
    return interpolate(grid.knots[body][piece], grid.knots[body][piece + 1], fraction)

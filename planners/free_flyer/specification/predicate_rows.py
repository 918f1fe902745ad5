"""Rows of 'a state formula holds at these places of the grid, and on the line between them'."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol, TypeAlias

import numpy as np

from impact_envs.stl import And, Formula, Predicate
from planners.alternatives import AllOf, AnyOf
from planners.alternatives import Node as Tree
from planners.free_flyer.specification.direction import DIRECTIONS
from planners.free_flyer.specification.requirement import Requirement
from planners.mixed_integer import Affine, Model

Time: TypeAlias = Affine | float
Place: TypeAlias = tuple[int, float]  # piece, and fraction of its way


class Grid(Protocol):
    """Motions along knots that all bodies pass at the same times.

    A knot is a point, or an axis-aligned box of points with `lower` and `upper`, of which all are meant. Between
    knots bodies move uniformly, or are in the interpolation of the boxes.
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
        """Return the number of pieces."""

    @property
    def times(self) -> Sequence[Time]:
        """Return the times of the knots, the first and the last of them numbers [s]."""

    @property
    def knots(self) -> Mapping[str, Sequence[Any]]:
        """Return every body's knots [m]."""


@dataclass(frozen=True)
class Window:
    """Hold a window of time in which something has to hold.

    Args:
        start: [s].
        end: the very same expression for an instant [s].
        lead: time by which a piece has to end before the start to be out of it [s].
        lag: time by which a piece has to start after the end to be out of it [s].
    """

    start: Time
    end: Time
    lead: float
    lag: float

    @property
    def is_instant(self) -> bool:
        """Return whether it has no length."""
        if isinstance(self.start, Affine) or isinstance(self.end, Affine):
            return self.start is self.end
        return self.start == self.end

    def shifted(self, lower: float, upper: float) -> Window:
        """Return the window of all instants between `lower` and `upper` after one of this window."""
        start = self.start + lower
        return replace(self, start=start, end=start if self.is_instant and lower == upper else self.end + upper)


@dataclass(frozen=True)
class Mark:
    """Say that a predicate holds in the intersection of windows.

    Args:
        need: the predicate.
        windows: start and end [s].
        once: only one instant of the intersection is meant.
    """

    need: Requirement
    windows: tuple[tuple[Time, Time], ...]
    once: bool


Node: TypeAlias = Tree[Mark]


def interpolate(here: Any, there: Any, fraction: float) -> Any:
    """Return what lies between two expressions, points or boxes.

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


def find_place(grid: Grid, body: str, place: Place) -> Any:
    """Return where a body is, as a point or a box.

    Args:
        grid: the grid.
        body: name.
        place: piece and fraction.
    """
    piece, fraction = place
    return interpolate(grid.knots[body][piece], grid.knots[body][piece + 1], fraction)


def make_state_rows(
    grid: Grid,
    predicates: Mapping[Predicate, Requirement],
    formula: Formula,
    places: Sequence[Place],
    windows: tuple[tuple[Time, Time], ...],
    once: bool = False,
    reserve: float = 0.0,
) -> Node:
    """Return the rows of a state formula, marked with its predicates.

    Args:
        grid: the grid.
        predicates: what they require.
        formula: predicates, and, or.
        places: one place, or the two ends of a piece.
        windows: in whose intersection the bodies are there [s].
        once: whether one instant of it counts.
        reserve: as for `make_predicate_rows`.
    """
    if isinstance(formula, Predicate):
        need = predicates[formula]
        return AllOf((make_predicate_rows(grid, need, places, reserve),), (Mark(need, windows, once),))
    parts = [make_state_rows(grid, predicates, part, places, windows, once, reserve) for part in formula.children]
    return AllOf(tuple(parts)) if isinstance(formula, And) else AnyOf(tuple(parts))


def make_predicate_rows(grid: Grid, need: Requirement, places: Sequence[Place], reserve: float = 0.0) -> Node:
    """Return the rows of a predicate: what holds at both ends of a piece beyond one line also does in between.

    Args:
        grid: the grid.
        need: the predicate.
        places: one place, or the two ends of a piece.
        reserve: distance to keep from areas to avoid beyond the robustness [m].

    Returns:
        Rows; for "avoid" one alternative per face, for "apart" one per direction.
    """
    points = [{body: find_place(grid, body, place) for body in need.bodies} for place in places]
    if need.kind == "stay":
        return AllOf(tuple(row for point in points for row in _stay(grid, need, point)))
    if need.kind == "avoid":
        faces = zip(need.faces, need.bounds, strict=True)
        beyond = [[-_most(-face, point[need.body]) - bound for point in points] for face, bound in faces]
        return AnyOf(tuple(AllOf(tuple(_avoid(grid, need, distances, reserve))) for distances in beyond))
    (other,) = need.others
    pairs = [(point[need.body], point[other]) for point in points]
    return AnyOf(
        tuple(
            AllOf(tuple(grid.rho + need.distance + _most(side, p) + _most(-side, q) for p, q in pairs))
            for side in (*DIRECTIONS, *_fixed_directions(pairs))
        )
    )


def _most(normal: np.ndarray, place: Any) -> Time:
    """Return the greatest normal @ p of a point or a box."""
    if not hasattr(place, "lower"):
        return normal @ place
    ends = [(place.upper if n > 0.0 else place.lower)[d] * n for d, n in enumerate(normal) if n != 0.0]
    return sum(ends[1:], ends[0])


def _stay(grid: Grid, need: Requirement, point: Mapping[str, Any]) -> Iterator[Affine]:
    for f, bound in enumerate(need.bounds):
        total = _most(need.faces[f], point[need.body])
        for other, faces in need.others.items():
            total = total + _most(faces[f], point[other])
        yield total + grid.rho - bound


def _avoid(grid: Grid, need: Requirement, distances: Sequence[Time], reserve: float) -> Iterator[Time]:
    for beyond in distances:
        if need.clearance > 0.0:
            yield need.clearance - beyond
        if need.scored:
            yield grid.rho + (reserve if isinstance(beyond, Affine) else 0.0) - beyond


def _fixed_directions(pairs: Sequence[tuple[Any, Any]]) -> Iterator[np.ndarray]:
    """Return the directions between bodies whose places are fixed, where their distance then counts in full."""
    for here, there in pairs:
        places = [np.asarray(place) for place in (here, there) if not hasattr(place, "lower")]
        if len(places) == 2 and all(place.dtype != object for place in places):
            step = places[1] - places[0]
            yield step / max(float(np.linalg.norm(step)), 1e-9)

"""Rows of 'a state formula holds at these places of the grid, and on the lines between them'."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np

from impact_envs.stl import And, Formula, Predicate
from planners.alternatives import AllOf, AnyOf, Tree
from planners.free_flyer.specification.direction import DIRECTIONS
from planners.free_flyer.specification.grid import Grid, Place, Time, find_place
from planners.free_flyer.specification.requirement import Requirement
from planners.mixed_integer import Affine


@dataclass(frozen=True)
class TimeWindow:
    """Hold a window of time in which something has to hold.

    Args:
        start: [s].
        end: pass the same object as `start` to mean one instant [s].
        lead: a piece is outside the window if it ends this long before the start [s].
        lag: a piece is outside the window if it starts this long after the end [s].
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

    def shifted(self, lower: float, upper: float) -> TimeWindow:
        """Return the window of all instants that are `lower` to `upper` after an instant of this one [s]."""
        start = self.start + lower
        return replace(self, start=start, end=start if self.is_instant and lower == upper else self.end + upper)


@dataclass(frozen=True)
class Mark:
    """Say that a predicate holds in the intersection of windows.

    Args:
        need: the predicate.
        windows: start and end [s].
        once: it holds at one instant of the intersection, not at all of them.
    """

    need: Requirement
    windows: tuple[tuple[Time, Time], ...]
    once: bool


MarkedTree: TypeAlias = Tree[Mark]


def make_state_rows(
    grid: Grid,
    predicates: Mapping[Predicate, Requirement],
    formula: Formula,
    places: Sequence[Place],
    windows: tuple[tuple[Time, Time], ...],
    once: bool = False,
    reserve: float = 0.0,
) -> MarkedTree:
    """Return the rows of a state formula, marked with its predicates.

    Args:
        grid: the grid.
        predicates: what they require.
        formula: predicates, and, or.
        places: one place, or the two ends of a piece.
        windows: the bodies are there in their intersection [s].
        once: whether one instant of it is enough.
        reserve: as for `make_predicate_rows`.
    """
    if isinstance(formula, Predicate):
        need = predicates[formula]
        return AllOf((make_predicate_rows(grid, need, places, reserve),), (Mark(need, windows, once),))
    parts = [make_state_rows(grid, predicates, part, places, windows, once, reserve) for part in formula.children]
    return AllOf(tuple(parts)) if isinstance(formula, And) else AnyOf(tuple(parts))


def make_predicate_rows(grid: Grid, need: Requirement, places: Sequence[Place], reserve: float = 0.0) -> MarkedTree:
    """Return the rows of a predicate; what holds beyond one line at both ends of a piece holds in between as well.

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
        choices: list[MarkedTree] = [AllOf(tuple(_avoid(grid, need, distances, reserve))) for distances in beyond]
        # A slack of more than this leaves nothing of the area.
        gone = () if need.depth is None else (grid.rho + need.depth,)
        return AnyOf((*choices, *gone))
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
    return place.support(normal) if hasattr(place, "support") else normal @ place


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
    """Return the directions between bodies at fixed places: along them the whole distance counts."""
    for here, there in pairs:
        places = [np.asarray(place) for place in (here, there) if not hasattr(place, "lower")]
        if len(places) == 2 and all(place.dtype != object for place in places):
            step = places[1] - places[0]
            yield step / max(float(np.linalg.norm(step)), 1e-9)

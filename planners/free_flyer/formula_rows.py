"""Rows of the event grid for what a formula demands."""

from __future__ import annotations

from collections.abc import Sequence

from planners.free_flyer.event_grid import EventGrid, Point
from planners.free_flyer.requirement import Requirement
from planners.mixed_integer import Affine

FRACTIONS = (0.25, 0.5, 0.75)  # where on a piece an area may be reached in passing


def add_requirements(grid: EventGrid, needs: Sequence[Requirement], period: float, passing: bool) -> None:
    """Add what the formula and solid obstacles demand to an event grid.

    Args:
        grid: gets the rows.
        needs: requirements.
        period: control period, by which a piece has to miss a window [s].
        passing: whether an area may be reached in passing, between events.

    Raises:
        Infeasible: the variable bounds alone exclude a requirement.

    Source: Verhagen & Tumova, Eqs. (21), (22).
    """
    for need in needs:
        with grid.model.part(need.text, 100.0):
            if need.kind == "reach":
                _add_reach_rows(grid, need, passing)
            elif need.kind == "stay":
                _add_stay_rows(grid, need, period)
            else:
                _add_avoid_rows(grid, need, period)


def _outside_window(grid: EventGrid, need: Requirement, piece: int, period: float) -> list[list[Affine | float]]:
    """Return the alternatives 'piece ends before the window' and 'piece starts after it'."""
    if need.start <= 0.0 and need.end >= grid.times[-1]:  # type: ignore[operator]
        return []
    return [[grid.times[piece + 1] + period - need.start], [need.end + period - grid.times[piece]]]


def _inside(grid: EventGrid, need: Requirement, point: Point) -> list[Affine | float]:
    return [face @ point + grid.rho - bound for face, bound in zip(need.faces, need.bounds, strict=True)]


def _add_stay_rows(grid: EventGrid, need: Requirement, period: float) -> None:
    knots = grid.knots[need.body]
    for piece in range(grid.count):
        inside = [*_inside(grid, need, knots[piece]), *_inside(grid, need, knots[piece + 1])]
        if need.start == need.end == grid.times[-1]:
            inside = _inside(grid, need, knots[-1])
        grid.model.require_any([inside, *_outside_window(grid, need, piece, period)])


def _add_avoid_rows(grid: EventGrid, need: Requirement, period: float) -> None:
    knots = grid.knots[need.body]
    for piece in range(grid.count):
        alternatives = _outside_window(grid, need, piece, period)
        for face, bound in zip(need.faces, need.bounds, strict=True):
            rows: list[Affine | float] = []
            for point in (knots[piece], knots[piece + 1]):
                beyond = face @ point - bound
                fixed = not isinstance(beyond, Affine)
                rows.append(need.clearance - beyond)
                if need.scored:
                    rows.append(grid.rho + (0.0 if fixed else need.reserve) - beyond)
            alternatives.append(rows)
        grid.model.require_any(alternatives)


def _add_reach_rows(grid: EventGrid, need: Requirement, passing: bool) -> None:
    """Look for the object at events, on a piece that overlaps the window, or at fixed fractions of pieces."""
    knots, times = grid.knots[need.body], grid.times
    moments = [(times[k], knots[k]) for k in range(0, grid.count + 1, 1 if passing else grid.pieces)]
    alternatives = []
    for piece in range(grid.count):
        inside = [*_inside(grid, need, knots[piece]), *_inside(grid, need, knots[piece + 1])]
        alternatives.append([times[piece] - need.end, need.start - times[piece + 1], *inside])
        for fraction in FRACTIONS if passing and grid.fastest(need.body, piece) > 0.0 else ():
            point = knots[piece] + (knots[piece + 1] - knots[piece]) * fraction
            moments.append((times[piece] + grid.duration(piece) * fraction, point))
    for time, point in moments:
        alternatives.append([need.start - time, time - need.end, *_inside(grid, need, point)])
    grid.model.require_any(alternatives)

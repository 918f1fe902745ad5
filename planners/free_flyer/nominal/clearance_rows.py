"""Rows of the event grid that keep bodies apart, added where a solution brings them too close."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable

import numpy as np

from impact_envs.free_flyer.schema import FreeFlyerScenario, Object
from planners.free_flyer.nominal.event_grid import EventGrid
from planners.free_flyer.reserves import Reserves
from planners.free_flyer.specification.direction import AXES
from planners.mixed_integer import Affine, evaluate

COARSE = 1e-3  # so that rounded diagonal contacts still count as clear of both axes [m]
TOLERANCE = 1e-5  # by which separations may be too short [m]
Place = tuple[str, str, int]  # two bodies, and the piece they are on


def solve_apart(
    grid: EventGrid, scenario: FreeFlyerScenario, reserves: Reserves, solve: Callable[[], np.ndarray]
) -> np.ndarray:
    """Solve a grid repeatedly, each time with more rows for bodies that came too close, until all are apart.

    Rows are never removed, so bounds and infeasibility that are proven on the way hold for the whole problem. With one
    object all bodies are near each other, and they get all rows at once.

    Args:
        grid: gets the rows.
        scenario: radii.
        reserves: clearances.
        solve: returns a point of the grid's model, shape (n,).

    Returns:
        The first point that keeps all bodies apart, shape (n,).

    Raises:
        Infeasible: they cannot all be kept apart.
    """
    if len(grid.objects) == 1 and not grid.apart:
        pairs = itertools.combinations(scenario.bodies, 2)
        add_clearance_rows(grid, scenario, reserves, [(*pair, piece) for pair in pairs for piece in range(grid.count)])
    while True:
        x = solve()
        # Existing rows may be violated by round-off.
        conflicts = [place for place in find_conflicts(grid, scenario, reserves, x) if place not in grid.apart]
        if not conflicts:
            return x
        add_clearance_rows(grid, scenario, reserves, conflicts)


def add_clearance_rows(
    grid: EventGrid, scenario: FreeFlyerScenario, reserves: Reserves, places: Iterable[Place]
) -> None:
    """Keep bodies apart along one axis during each of the pieces.

    On a piece two bodies move linearly relative to each other, so what separates them along an axis at both ends
    separates them in between. A robot that hits stands at contact distance at that end, where only the side of its
    impact is possible: it neither overtakes the object nor changes sides between two own impacts.

    Args:
        grid: gets the rows.
        scenario: radii.
        reserves: clearances.
        places: pairs of bodies, and the pieces.

    Raises:
        Infeasible: the variable bounds exclude every axis.
    """
    for first, second, piece in places:
        grid.apart.add((first, second, piece))
        grid.model.require_any(
            [
                [_wanted(grid, scenario, (first, second), knot, apart, reserves) - apart for knot, apart in ends]
                for ends in _separations(grid, first, second, piece)
            ]
        )


def find_conflicts(grid: EventGrid, scenario: FreeFlyerScenario, reserves: Reserves, x: np.ndarray) -> list[Place]:
    """Return the places at which a point has less separation than `add_clearance_rows` asks for.

    Args:
        grid: meaning of the point.
        scenario: radii.
        reserves: clearances.
        x: point of the grid's model, shape (n,).
    """
    places = {name: evaluate(knots, x) for name, knots in grid.knots.items()}
    found = []
    for first, second in itertools.combinations(scenario.bodies, 2):
        far = scenario.body(first).radius + scenario.body(second).radius + reserves.clearance
        apart = (places[second] - places[first]) @ AXES.T
        near = np.minimum(apart[1:], apart[:-1]).max(axis=1) < far
        for piece in np.flatnonzero(near):
            if _is_short(grid, scenario, reserves, (first, second, int(piece)), x):
                found.append((first, second, int(piece)))
    return found


def _is_short(grid: EventGrid, scenario: FreeFlyerScenario, reserves: Reserves, place: Place, x: np.ndarray) -> bool:
    first, second, piece = place
    lacks = [
        [_wanted(grid, scenario, (first, second), knot, apart, reserves) - apart for knot, apart in ends]
        for ends in _separations(grid, first, second, piece)
    ]
    return float(evaluate(lacks, x).max(axis=1).min()) > TOLERANCE


def _separations(grid: EventGrid, first: str, second: str, piece: int) -> list[list[tuple[int, Affine | float]]]:
    """Return, per axis of the grid, the two ends of a piece and the separation there."""
    gaps = [(knot, grid.knots[second][knot] - grid.knots[first][knot]) for knot in (piece, piece + 1)]
    return [[(knot, axis @ gap) for knot, gap in gaps] for axis in grid.axes]


def _wanted(
    grid: EventGrid,
    scenario: FreeFlyerScenario,
    pair: tuple[str, str],
    knot: int,
    apart: Affine | float,
    reserves: Reserves,
) -> Affine | float:
    """Return the separation wanted along one axis: contact at own impacts, no more than given at fixed ends."""
    first, second = (scenario.body(name) for name in pair)
    touching = first.radius + second.radius
    # A diagonal contact counts as clear of both its axes.
    nearest, far = touching * np.sqrt(0.5) - COARSE, touching + reserves.clearance
    if not isinstance(apart, Affine):
        # Otherwise bodies that are clear along another axis might meet before they are clear along this one.
        widest = float(np.abs(np.array(grid.knots[pair[0]][knot] - grid.knots[pair[1]][knot], dtype=float)).max())
        # The place where a robot comes to a halt may be nearer to the start of another body than bodies ever are.
        return min(max(float(apart), touching if widest >= touching else min(nearest, widest)), far)
    if knot == grid.count:
        far = touching + reserves.wall
    if isinstance(first, Object):
        # Objects may start, and stay, closer to each other than the reserve.
        start = float(np.abs(np.subtract(first.start, second.start)).max())
        return min(far, max(start, nearest))
    event, rest = divmod(knot, grid.pieces)
    if isinstance(second, Object) and not rest and 1 <= event <= len(grid.hits):
        return far - (far - nearest) * grid.hits[event - 1][pair]
    return far

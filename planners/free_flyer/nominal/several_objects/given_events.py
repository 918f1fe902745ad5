"""What is given of the objects done so far, and the rows that keep a grid close to it."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from planners.free_flyer.nominal.event_grid import EventGrid
from planners.free_flyer.nominal.event_sequence import Word
from planners.mixed_integer import Affine, Model

NEAR = 1e-6  # of given numbers, so that rounded rows hold [m, s]


@dataclass(frozen=True)
class Done:
    """Hold what is given of the objects done so far.

    Args:
        word: who hits what.
        times: of these impacts, shape (k,) [s].
        knots: of every body up to the last of these impacts, each shape (n k + 1, 2) [m].
    """

    word: Word
    times: np.ndarray
    knots: Mapping[str, np.ndarray]


def pin_events(grid: EventGrid, done: Done, events: int) -> None:
    """Bound times and places closely around their given numbers, up to so many events."""
    bound_values(grid.model, grid.times[grid.pieces :: grid.pieces], done.times[:events])
    for name, places in done.knots.items():
        for d in range(2):
            bound_values(grid.model, [knot[d] for knot in grid.knots[name]], places[: events * grid.pieces + 1, d])


def pin_later(grid: EventGrid, done: Done, gap: int, impacts: int, name: str) -> None:
    """Keep the other objects on their given flights during the impacts of one, and after these; robots are free.

    Args:
        grid: gets the rows.
        done: what is given.
        gap: number of events before the impacts.
        impacts: their number.
        name: of the object that is hit.
    """
    if gap == len(done.word):
        return
    times = grid.times[:: grid.pieces]
    bound_values(grid.model, times[gap + impacts + 1 :], done.times[gap:])
    before, after = (np.concatenate([[0.0], done.times])[k] for k in (gap, gap + 1))
    for other in grid.objects:
        if other == name:
            continue
        path, places = grid.path(other), done.knots[other][:: grid.pieces]
        velocity = (places[gap + 1] - places[gap]) / (after - before)
        for event, d in itertools.product(range(gap + 1, gap + impacts + 1), range(2)):
            miss = path[event][d] - (places[gap][d] + (times[event] - before) * velocity[d])
            if isinstance(miss, Affine) and miss.coefficients:
                grid.model.require(miss - NEAR)
                grid.model.require(-miss - NEAR)
        for d in range(2):
            bound_values(grid.model, [place[d] for place in path[gap + impacts + 1 :]], places[gap + 1 :, d])


def bound_values(model: Model, expressions: Sequence[Affine | float], values: np.ndarray) -> None:
    """Bound those expressions that are variables."""
    for expression, value in zip(expressions, values, strict=False):
        if isinstance(expression, Affine) and list(expression.coefficients.values()) == [1.0]:
            (index,) = expression.coefficients
            place = float(value) - expression.constant
            model.lower[index] = max(model.lower[index], place - NEAR)
            model.upper[index] = min(model.upper[index], place + NEAR)

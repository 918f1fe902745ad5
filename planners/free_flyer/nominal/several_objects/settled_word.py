"""Several objects at the same time: any straight flights of one sequence of impacts, then their greatest robustness.

A search for the least path cost of a sequence proves how good its points are, which takes long where robots work for
several objects at once. Here the first point is enough. Objects keep their velocity while another one is hit once the
shares of time of their flights are given; these are those of a point where they need not.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from planners.errors import PlanningError
from planners.free_flyer.nominal.clearance_rows import solve_apart
from planners.free_flyer.nominal.event_grid import EventGrid
from planners.free_flyer.nominal.event_sequence import Word
from planners.free_flyer.nominal.least_cost import straighten_flight
from planners.free_flyer.nominal.task import NominalTask, PlanOptions
from planners.free_flyer.nominal.word_grid import WordGrid
from planners.free_flyer.specification.direction import DIRECTIONS
from planners.free_flyer.specification.grid import GridSize
from planners.mixed_integer import evaluate
from planners.solvers import solve


def settle_words(
    task: NominalTask,
    words: Sequence[Word],
    pieces: int,
    rho: tuple[float, float],
    find_time_left: Callable[[], float],
    options: PlanOptions,
) -> WordGrid | None:
    """Return a grid with a point of the first word that has one; None: none was found.

    Args:
        task: what is asked; its objects start and end at rest.
        words: tried in turn.
        pieces: per leg.
        rho: robustness to keep, and its bound [m].
        find_time_left: returns the time left [s].
        options: of the search.
    """
    if any(any(body.start_velocity) or not body.rest for body in task.scenario.objects.values()):
        return None  # objects that fly before their first impact have no share to be given
    for word in words:
        limit = find_time_left()
        if limit <= 0.0:
            break
        try:
            return settle_word(task, word, pieces, rho, limit, options.search.settled_nodes)
        except PlanningError:
            continue
    return None


def settle_word(
    task: NominalTask, word: Word, pieces: int, rho: tuple[float, float], limit: float, nodes: int
) -> WordGrid:
    """Return the grid of a word and its most robust point with the alternatives of its first point.

    Args:
        task, pieces, rho: as for `settle_words`.
        word: who hits what.
        limit: of each solution [s].
        nodes: of branch and bound in each solution.

    Raises:
        PlanningError: no such point was found.
    """
    size = GridSize(len(word), pieces, passing=True)
    grid, choices = replace(task, sharp=True).build(size, rho, word)
    grid = replace(grid, axes=DIRECTIONS)
    find_point = partial(_find_point, task, grid, limit, nodes)
    moments = spread_events(task, grid, find_point(), limit)
    for name in grid.objects:
        straighten_flight(grid, name, word, moments, rests=True)
    x = solve_apart(grid, task.scenario, task.reserves, find_point)
    model = grid.model
    for index in np.flatnonzero(model.integer):
        model.lower[index] = model.upper[index] = float(np.round(x[index]))
    model.objective = -grid.rho
    return WordGrid(task, grid, choices, solve_apart(grid, task.scenario, task.reserves, find_point))


def spread_events(task: NominalTask, grid: EventGrid, x: np.ndarray, limit: float) -> np.ndarray:
    """Return the times of events that keep the alternatives of a point, as far from each other as may be.

    A first point has some events in a cluster, and flights whose shares of time are extreme leave no way to keep bodies
    apart.

    Args:
        task: what is asked.
        grid: meaning of the point; it stays as it is.
        x: the point, shape (n,).
        limit: of the solution [s].

    Returns:
        Times, ends included, shape (K + 2,) [s].
    """
    model, times = grid.model, grid.times[:: grid.pieces]
    spread = replace(model, lower=list(model.lower), upper=list(model.upper), integer=list(model.integer))
    spread.inequalities = list(model.inequalities)
    for index in np.flatnonzero(model.integer):
        spread.lower[index] = spread.upper[index] = float(np.round(x[index]))
    least = spread.variable(0.0, task.scenario.horizon)
    for before, after in itertools.pairwise(times):
        spread.require(least - (after - before))
    spread.objective = -least
    return evaluate(times, solve(spread, limit, solver=task.solver, work=task.work).x)


def _find_point(task: NominalTask, grid: EventGrid, limit: float, nodes: int) -> np.ndarray:
    """Return the first point, or the best one where only an objective is left to decide, shape (n,)."""
    model = grid.model
    gap = 0.0 if model.objective.coefficients else math.inf
    return solve(model, limit, gap, task.solver, work=task.work, nodes=nodes).x

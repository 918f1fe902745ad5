"""An object that rests where another one has to go, or on its way, is put aside first and brought home afterwards.

Objects that are moved one after another never pass each other where each of them rests in the other's area. Here one
of them is thrown and caught somewhere aside, the other one moves as it would alone, and the first goes on from there.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping

import numpy as np

from planners.errors import PlanningError, SolverFailed
from planners.free_flyer.nominal.clearance_rows import add_clearance_rows
from planners.free_flyer.nominal.event_grid import EventGrid, build_event_grid
from planners.free_flyer.nominal.event_sequence import ANYBODY
from planners.free_flyer.nominal.several_objects.composition import (
    append_object,
    finish_early,
    free_numbers,
    restrict_demands,
)
from planners.free_flyer.nominal.several_objects.given_events import NEAR, Done, bound_values
from planners.free_flyer.nominal.task import NominalTask, PlanOptions
from planners.free_flyer.nominal.word_grid import WordGrid
from planners.free_flyer.specification.formula_rows import add_demands

ASIDE = 2  # impacts that put an object aside: a throw and a catch


def give_way(
    task: NominalTask,
    ways: Mapping[str, np.ndarray],
    max_impacts: int,
    pieces: int,
    rho: tuple[float, float],
    find_time_left: Callable[[], float],
    options: PlanOptions,
) -> WordGrid | None:
    """Return a grid with a point where one object gives way to another; None: none was found.

    Args:
        task: what is asked; its objects start and end at rest.
        ways: object to where it is at its own events when it is moved alone, ends included, each shape (k + 2, 2) [m].
        max_impacts: greatest number of impacts of all objects together.
        pieces: per leg.
        rho: robustness to keep, and its bound [m].
        find_time_left: returns the time left [s].
        options: of the search.
    """
    if any(any(body.start_velocity) or not body.rest for body in task.scenario.objects.values()):
        return None
    numbers = {name: len(way) - 2 for name, way in ways.items()}
    for straight, aside in itertools.permutations(ways, 2):
        if ASIDE + sum(numbers.values()) > max_impacts or find_time_left() <= 0.0:
            break
        try:
            done = _put_aside(
                task, straight, ways[straight], aside, numbers[aside], pieces, rho[0], find_time_left(), options
            )
            objects = [straight, aside]
            for name in (name for name in numbers if name not in (straight, aside)):
                objects.append(name)
                allowed = range(numbers[name], max_impacts - len(done.word) + 1)
                done = append_object(task, done, objects, allowed, pieces, rho[0], find_time_left, options)
            return free_numbers(task, done, pieces, (options.least, rho[1]), find_time_left())
        except PlanningError:
            continue
    return None


def _put_aside(
    task: NominalTask,
    straight: str,
    way: np.ndarray,
    aside: str,
    home: int,
    pieces: int,
    rho: float,
    limit: float,
    options: PlanOptions,
) -> Done:
    """Return what is done once an object was put aside, another one has gone its way, and the first one is home.

    Args:
        task, pieces, options: as for `give_way`.
        straight: object that keeps its way.
        way: where it is at its own events, shape (k + 2, 2) [m].
        aside: object that gives way.
        home: number of impacts that bring it home afterwards.
        rho: robustness to keep [m].
        limit: of the solution [s].

    Raises:
        PlanningError: there is no such plan.
    """
    scenario, moves = task.scenario, len(way) - 2
    if limit <= 0.0:
        raise SolverFailed("composition", "no time is left", "raise the time limit")
    word = (*((ANYBODY, aside),) * ASIDE, *((ANYBODY, straight),) * moves, *((ANYBODY, aside),) * home)
    grid = build_event_grid(scenario, len(word), (rho - NEAR, rho), task.reserves, pieces, word=word, sharp=True)
    _keep_way(grid, straight, way)
    path = grid.path(aside)
    for event, d in itertools.product(range(ASIDE + 1, ASIDE + moves + 2), range(2)):
        grid.model.require_equal(path[event][d] - path[ASIDE][d])
    add_demands(grid, restrict_demands(task, (straight, aside)), scenario.control_period, passing=True)
    flights = range(ASIDE * pieces, (ASIDE + moves + 1) * pieces)
    pair = tuple(name for name in scenario.bodies if name in (straight, aside))
    add_clearance_rows(grid, scenario, task.reserves, [(pair[0], pair[1], piece) for piece in flights])
    return finish_early(task, grid, len(word), limit, options)


def _keep_way(grid: EventGrid, name: str, way: np.ndarray) -> None:
    """Bound an object's places at its own events closely around its way; when it is there stays free."""
    path, events = grid.path(name), range(ASIDE + 1, ASIDE + len(way) - 1)
    for d in range(2):
        bound_values(grid.model, [path[event][d] for event in events], way[1:-1, d])

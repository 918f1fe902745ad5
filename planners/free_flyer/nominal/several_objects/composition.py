"""Several objects one after another: what objects need alone is put together in time, without a search over sequences.

The model of all objects at once has a binary for every side of every obstacle on every leg of every body: with
obstacles it takes minutes. Here an object's impacts come between or after those of the objects before it, whose times
and flights are given numbers; what is left to decide is hardly more than for one object. Afterwards all numbers are
free again, and only the alternatives (who hits, on which side to pass) are kept: a linear model.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.stl import And
from planners.errors import Infeasible, PlanningError, SolverFailed
from planners.free_flyer.nominal.clearance_rows import add_clearance_rows, solve_apart
from planners.free_flyer.nominal.event_grid import EventGrid, build_event_grid
from planners.free_flyer.nominal.event_sequence import ANYBODY, Word
from planners.free_flyer.nominal.least_cost import read_word, straighten_flight
from planners.free_flyer.nominal.leg_times import Correction
from planners.free_flyer.nominal.several_objects.given_events import NEAR, Done, pin_events, pin_later
from planners.free_flyer.nominal.several_objects.sequence_search import list_parts_about
from planners.free_flyer.nominal.task import NominalTask, PlanOptions
from planners.free_flyer.nominal.word_grid import WordGrid
from planners.free_flyer.specification.direction import DIRECTIONS
from planners.free_flyer.specification.formula_rows import add_demands
from planners.free_flyer.specification.grid import GridSize
from planners.free_flyer.specification.requirement import Demands, read_demands
from planners.mixed_integer import Affine, evaluate
from planners.solvers import solve


def compose_objects(
    task: NominalTask,
    numbers: Mapping[str, int],
    max_impacts: int,
    pieces: int,
    rho: tuple[float, float],
    find_time_left: Callable[[], float],
    options: PlanOptions,
) -> WordGrid | None:
    """Return a grid with a point of objects that are moved one after another; None: none was found.

    Orders of the objects are tried in turn; in each, an object is done as early as may be, so that there is time for
    the next one.

    Args:
        task: what is asked; its objects start and end at rest.
        numbers: object to the impacts that it needs alone; objects of which nothing is asked are left out.
        max_impacts: greatest number of impacts of all objects together.
        pieces: per leg.
        rho: robustness to keep, and its bound [m].
        find_time_left: returns the time left [s].
        options: of the search.

    Raises:
        Infeasible: in every order the first objects leave no time for the others, which less robustness hardly changes.
    """
    if any(any(body.start_velocity) or not body.rest for body in task.scenario.objects.values()):
        return None  # objects that fly while others are hit need straight flights
    known: dict[tuple[str, ...], Done | PlanningError] = {}
    open_orders = False
    for order in itertools.permutations(numbers):
        try:
            done = _append_in_order(task, order, numbers, max_impacts, pieces, rho[0], find_time_left, known, options)
        except PlanningError as error:
            if find_time_left() <= 0.0:
                return None
            # An object that has no plan even as the first one may have one of less robustness.
            open_orders |= not isinstance(error, Infeasible) or error is known[order[:1]]
            continue
        try:
            return free_numbers(task, done, pieces, (options.least, rho[1]), find_time_left())
        except PlanningError:
            open_orders = True
    if open_orders:
        return None
    raise Infeasible("composition", "no time is left for the last objects", "raise the horizon")


def _append_in_order(
    task: NominalTask,
    order: tuple[str, ...],
    numbers: Mapping[str, int],
    max_impacts: int,
    pieces: int,
    rho: float,
    find_time_left: Callable[[], float],
    known: dict[tuple[str, ...], Done | PlanningError],
    options: PlanOptions,
) -> Done:
    """Return what is done once all objects of an order are done; orders that begin alike share their beginning.

    Args:
        order: names of the objects.
        known: first objects of orders to what is done of them, or to why nothing is; gets more.
        task, numbers, max_impacts, pieces, rho, find_time_left, options: as for `compose_objects`.

    Raises:
        PlanningError: some object cannot be done.
    """
    done = Done((), np.zeros(0), {name: np.zeros((0, 2)) for name in task.scenario.bodies})
    for place, name in enumerate(order):
        first = order[: place + 1]
        if first not in known:
            later = sum(numbers[other] for other in order[place + 1 :])
            allowed = range(numbers[name], max_impacts - len(done.word) - later + 1)
            try:
                known[first] = append_object(task, done, first, allowed, pieces, rho, find_time_left, options)
            except PlanningError as error:
                known[first] = error
        found = known[first]
        if isinstance(found, PlanningError):
            raise found
        done = found
    return done


def is_large(task: NominalTask, numbers: Mapping[str, int], pieces: int, options: PlanOptions) -> bool:
    """Return whether the model of one sequence of all impacts has too many alternatives to be solved often.

    Args:
        task, numbers, pieces, options: as for `compose_objects`.
    """
    robot = next(iter(task.scenario.robots))
    word = tuple((robot, name) for name, count in numbers.items() for _ in range(count))
    try:
        grid, _ = task.build(GridSize(len(word), pieces, passing=True), (0.0, options.least), word)
    except PlanningError:
        return False
    return sum(grid.model.integer) > options.compose.binaries


def append_object(
    task: NominalTask,
    done: Done,
    objects: Sequence[str],
    allowed: range,
    pieces: int,
    rho: float,
    find_time_left: Callable[[], float],
    options: PlanOptions,
) -> Done:
    """Return what is done with the impacts of one more object, the last of `objects`, as early as may be.

    Its impacts come after all others or, where they find no time there, while another object flies.

    Args:
        task, pieces, find_time_left, options: as for `compose_objects`.
        done: what is done of the other objects.
        objects: these and this one.
        allowed: numbers of impacts, of which the first few are tried.
        rho: robustness to keep [m].

    Raises:
        Infeasible: proven for all that were tried.
        SolverFailed: no such impacts were found.
    """
    failure: PlanningError | None = None
    demands = restrict_demands(task, objects)
    numbers, gaps = allowed[: options.compose.more_impacts + 1], range(len(done.word), -1, -1)
    for impacts, gap in itertools.product(numbers, gaps):
        limit = find_time_left()
        if limit <= 0.0:
            failure = SolverFailed("composition", "no time is left", "raise the time limit")
            break
        try:
            return _append_impacts(task, demands, done, objects[-1], impacts, gap, pieces, rho, limit, options)
        except Infeasible as error:
            failure = failure or error
        except PlanningError as error:
            failure = error if failure is None or isinstance(failure, Infeasible) else failure
    raise failure or SolverFailed("composition", "no number of impacts is left", "allow more impacts")


def _append_impacts(
    task: NominalTask,
    demands: Demands,
    done: Done,
    name: str,
    impacts: int,
    gap: int,
    pieces: int,
    rho: float,
    limit: float,
    options: PlanOptions,
) -> Done:
    """Return what is done with so many impacts of an object after the first few (`gap`) of the others."""
    scenario = task.scenario
    word = (*done.word[:gap], *((ANYBODY, name),) * impacts, *done.word[gap:])
    grid = build_event_grid(scenario, len(word), (rho - NEAR, rho), task.reserves, pieces, word=word, sharp=True)
    grid = replace(grid, axes=DIRECTIONS)  # a flight may pass a resting object at a slant
    for correction in task.corrections:
        correction.add_to(grid)
    pin_events(grid, done, gap)
    pin_later(grid, done, gap, impacts, name)
    add_demands(grid, demands, scenario.control_period, passing=True)
    first = gap * pieces
    add_clearance_rows(grid, scenario, task.reserves, list_places(scenario, range(first, grid.count)))
    return finish_early(task, grid, gap + impacts, limit, options)


def finish_early(task: NominalTask, grid: EventGrid, event: int, limit: float, options: PlanOptions) -> Done:
    """Return what is done where an event of a grid comes as early as may be, with the bodies apart.

    Args:
        task: what is asked.
        grid: with all its rows but those of bodies that pass each other.
        event: number of the event.
        limit: of each solution [s].
        options: of the composition.

    Raises:
        PlanningError: the grid has no such point, or none was found.
    """
    chosen, time = options.compose, grid.times[event * grid.pieces]
    assert isinstance(time, Affine)
    grid.model.objective = time

    def solve_once() -> np.ndarray:
        seconds = min(limit, chosen.longest)
        return solve(grid.model, seconds, chosen.gap, task.solver, work=task.work, nodes=chosen.nodes).x

    x = solve_apart(grid, task.scenario, task.reserves, solve_once)
    return read_done(grid, read_word(grid, x), x)


def read_done(grid: EventGrid, word: Word, x: np.ndarray) -> Done:
    last = len(word) * grid.pieces
    times = evaluate(grid.times[:: grid.pieces], x)[1:-1]
    return Done(word, times, {name: evaluate(knots[: last + 1], x) for name, knots in grid.knots.items()})


def free_numbers(task: NominalTask, done: Done, pieces: int, rho: tuple[float, float], limit: float) -> WordGrid:
    """Return the grid of a word and its most robust point with the alternatives that the given numbers take.

    Raises:
        PlanningError: there is none within the time limit.
    """
    size = GridSize(len(done.word), pieces, passing=True)
    grid, choices = replace(task, sharp=True).build(size, rho, done.word)
    grid = replace(grid, axes=DIRECTIONS)
    add_clearance_rows(grid, task.scenario, task.reserves, list_places(task.scenario, range(grid.count)))
    model = grid.model
    bounds = list(model.lower), list(model.upper)
    pin_events(grid, done, len(done.word))
    model.objective = -grid.rho
    x = solve(model, limit, 1.0, task.solver, work=task.work).x
    model.lower, model.upper = bounds
    for index in np.flatnonzero(model.integer):
        model.lower[index] = model.upper[index] = float(np.round(x[index]))
    moments = evaluate(grid.times[::pieces], x)
    for name in grid.objects:
        straighten_flight(grid, name, done.word, moments, rests=True)
    return WordGrid(task, grid, choices, solve(model, limit, solver=task.solver, work=task.work).x)


def add_corrections(found: WordGrid, corrections: Iterable[Correction], time_limit: float) -> WordGrid:
    """Return a grid whose alternatives are given, with more time or room at some events, and its most robust point.

    Args:
        found: the grid; it gets the rows.
        corrections: least times between events, and room for impacts.
        time_limit: wall time [s].

    Raises:
        Infeasible: there is not so much time or room.
    """
    grid, task = found.grid, found.task
    for correction in corrections:
        correction.add_to(grid)
    return replace(found, x=solve(grid.model, time_limit, solver=task.solver, work=task.work).x)


def list_places(scenario: FreeFlyerScenario, pieces: range) -> Iterator[tuple[str, str, int]]:
    for pair, piece in itertools.product(itertools.combinations(scenario.bodies, 2), pieces):
        yield (*pair, piece)


def restrict_demands(task: NominalTask, objects: Sequence[str]) -> Demands:
    """Return what is demanded of robots and some objects."""
    scenario = task.scenario
    parts = tuple(list_parts_about(scenario.specification.expand(scenario.bodies), {*scenario.robots, *objects}))
    formula = parts[0] if len(parts) == 1 else And(parts)
    fields = {field: getattr(scenario, field) for field in FreeFlyerScenario.model_fields}
    return read_demands(FreeFlyerScenario(**fields | {"formula": str(formula)}), task.reserves.wall)

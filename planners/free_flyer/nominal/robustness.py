"""Stage A: the greatest robustness, and the fewest impacts that attain it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass, replace

from planners.budget import Budget
from planners.errors import Infeasible, PlanningError, SolverFailed
from planners.free_flyer.nominal.composition import compose_objects, is_large
from planners.free_flyer.nominal.event_sequence import Hitter, Word
from planners.free_flyer.nominal.least_cost import CostOptimum, minimise_path_cost
from planners.free_flyer.nominal.screening import exclude_size
from planners.free_flyer.nominal.sequence_search import lengthen_words, restrict_to_object, search_words
from planners.free_flyer.nominal.task import NominalTask, PlanOptions
from planners.free_flyer.nominal.word_grid import WordGrid, solve_word_grid
from planners.free_flyer.specification.grid import GridSize
from planners.free_flyer.specification.requirement import read_demands
from planners.free_flyer.specification.robustness_bound import compute_geometric_bound

TOLERANCE = 1e-6  # of the robustness: solvers stop within this of the optimum [m]
MANY = 2  # pieces per leg, above which events of little path cost are found along with the robustness


@dataclass(frozen=True)
class RobustnessOptimum:
    """Hold the result of stage A.

    Args:
        size: fewest impacts that attain the robustness, and the pieces per leg that robots need for it.
        rho: greatest robustness [m].
        bound: what no plan of any kind can exceed [m].
        words: who hits what, least path cost first; empty: anybody anything.
        cost_bound: no word has a smaller path cost [m^2/s].
        events: that attain the robustness at any path cost, for when there is no time for the least; of several
            objects only where they need more impacts than one by one.
        found: grid of objects that are moved one after another, whose alternatives are kept.
    """

    size: GridSize
    rho: float
    bound: float
    words: tuple[Word, ...] = ()
    cost_bound: float = 0.0
    events: CostOptimum | None = None
    found: WordGrid | None = None


def maximise_robustness(
    task: NominalTask, max_impacts: int, budget: Budget, options: PlanOptions, fewest: int = 0
) -> RobustnessOptimum:
    """Return the greatest robustness and the fewest impacts that attain it (stage A).

    Every number of impacts is solved to proven optimality or infeasibility (as far as the time limit allows), until
    one attains the geometric bound, which holds for every number. Legs of several pieces are tried for numbers that
    are infeasible without them, and for the first number whose plan does not attain the bound.

    Args:
        task: what is asked.
        max_impacts: greatest number of impacts tried.
        budget: time.
        options: when to stop.
        fewest: least number of impacts tried.

    Raises:
        Infeasible: no plan within max_impacts.
        SolverFailed: out of time.
    """
    ceiling = compute_geometric_bound(task.scenario, task.demands, task.solver)
    problem = f"plan of {task.scenario.name}"
    if ceiling < options.least:
        status = f"fixed starts, goals and areas allow a robustness of {ceiling * task.frame.length:.3g} m at most"
        raise Infeasible(problem, status, "move them, or relax the formula")
    if min(options.pieces) > MANY:
        found = _attain_bound(task, order_sizes(options, fewest, max_impacts), ceiling, budget, options)
        if found is not None:
            return found
    best: RobustnessOptimum | None = None
    progress, length = budget.progress, task.frame.length
    progress.bound = ceiling * length
    for size in order_sizes(options, fewest, max_impacts):
        impacts, pieces = size.impacts, size.pieces
        progress.impacts, progress.pieces = impacts, pieces
        if best is not None and pieces > best.size.pieces and impacts > best.size.impacts:
            continue
        if best is not None and not options.thorough and impacts > best.size.impacts + 1:
            break
        # Once there is a plan, the search for a more robust one with more impacts must leave time to finish it.
        share = 0.5
        limit = budget.left if best is None else share * budget.limit - budget.elapsed
        if limit <= 0.0:
            if best is None:
                raise SolverFailed(problem, "time limit reached", "raise the time limit")
            break
        least = options.least if best is None else best.rho
        try:
            found = _solve_size(task, size, (least, ceiling), limit, options)
        except Infeasible:
            continue
        except SolverFailed:
            if best is None:
                raise
            break
        if best is None or found.rho > best.rho + TOLERANCE:
            best = replace(found, rho=ceiling) if ceiling - found.rho <= TOLERANCE else found
            progress.robustness = best.rho * length
        if best.rho >= options.enough * ceiling:
            break
    if best is None:
        status = f"proven infeasible with up to {max_impacts} impacts and the planner's reserves"
        raise Infeasible(problem, status, "allow more impacts or time, move the areas, or relax the formula")
    return best


def order_sizes(options: PlanOptions, fewest: int, most: int) -> list[GridSize]:
    """Return the sizes of grids in the order in which they are tried."""
    numbers = itertools.product(options.order_numbers(fewest, most), options.pieces)
    return [GridSize(impacts, pieces, passing=True) for impacts, pieces in numbers]


def _attain_bound(
    task: NominalTask, sizes: Sequence[GridSize], ceiling: float, budget: Budget, options: PlanOptions
) -> RobustnessOptimum | None:
    """Return the first size with a plan whose robustness is the bound; None: none was found.

    With the robustness given, a model of many pieces is decided several times as quickly.
    """
    for size in sizes:
        if budget.left <= 0.0:
            break
        try:
            limit = 0.3 * budget.left
            found = _solve_size(task, size, (max(ceiling - TOLERANCE, options.least), ceiling), limit, options)
        except PlanningError:
            continue
        return replace(found, rho=ceiling)
    return None


def _solve_size(
    task: NominalTask, size: GridSize, rho: tuple[float, float], time_limit: float, options: PlanOptions
) -> RobustnessOptimum:
    """Return the greatest robustness, between two numbers, of plans of one size."""
    if options.thorough and (size.impacts >= options.many_impacts or size.pieces > MANY):
        exclude_size(task, size, rho, time_limit)
    found = solve_word_grid(task, size, rho, time_limit, options.robustness_gap)
    best, events = found.rho, None
    if len(task.scenario.objects) == 1:
        # Where legs have many pieces, the search for the least path cost may take longer than there is time.
        cheap = size.pieces > MANY
        with suppress(SolverFailed):
            events = found.reduce_cost(best) if cheap else found.read()
    return RobustnessOptimum(size, best, rho[1], events=events)


def maximise_jointly(task: NominalTask, max_impacts: int, budget: Budget, options: PlanOptions) -> RobustnessOptimum:
    """Return the optimum for several objects, starting from those of each object alone.

    What the objects attain alone bounds what they attain together, in robustness and in number of impacts. First a
    word is sought that attains both bounds; only if there is none are all words open (see `maximise_robustness`).

    Args:
        task, max_impacts, budget, options: as for `maximise_robustness`.

    Raises:
        Infeasible: no plan within max_impacts.
        SolverFailed: out of time.
    """
    ceiling = compute_geometric_bound(task.scenario, task.demands, task.solver)
    rho, pieces, progress = ceiling, 1, budget.progress
    alone: dict[str, tuple[NominalTask, RobustnessOptimum]] = {}
    for name in task.scenario.objects:
        scenario = restrict_to_object(task.scenario, name)
        if scenario is None:
            continue
        own = replace(task, scenario=scenario, demands=read_demands(scenario, task.reserves.wall))
        progress.about, progress.robustness = f"{name} alone", None
        optimum = maximise_robustness(own, max_impacts, budget, replace(options, expected=None))
        rho, pieces = min(rho, optimum.rho), max(pieces, optimum.size.pieces)
        alone[name] = own, optimum
    progress.about, progress.robustness, progress.bound = "all objects", None, ceiling * task.frame.length
    numbers = {name: optimum.size.impacts for name, (_, optimum) in alone.items()}
    large = options.thorough and is_large(task, numbers, pieces, options)
    if large:
        composed = _compose(task, numbers, max_impacts, pieces, (rho, ceiling), budget, options)
        if composed is not None:
            return composed
    hits: list[tuple[float, Hitter]] = []
    for own, optimum in alone.values():
        events = optimum.events
        if events is None or options.thorough:
            # Where this takes long, its events are as good a start as any.
            limit = budget.left if events is None or not options.thorough else budget.left / 8
            with suppress(PlanningError) if events is not None and options.thorough else nullcontext():
                events = minimise_path_cost(own, optimum.size, optimum.rho, options.cost, limit)
        assert events is not None
        hits += zip(events.sequence.times[1:-1], events.sequence.hitters, strict=True)
    seed = tuple(hitter for _, hitter in sorted(hits))
    if len(seed) <= max_impacts:
        size = GridSize(len(seed), pieces)
        share = 4 if options.thorough else 2
        end = budget.elapsed + 0.4 * budget.left if options.thorough else math.inf
        lost = options.search.lost if options.thorough else None
        left = lambda: min(budget.left / share, end - budget.elapsed)  # noqa: E731 - the clock of this search
        found = search_words(task, size, options.joint * rho, seed, left, options, lost)
        if found.words:
            return RobustnessOptimum(size, rho, ceiling, found.words, found.bound)
    if options.thorough:
        composed = None if large else _compose(task, numbers, max_impacts, pieces, (rho, ceiling), budget, options)
        if composed is not None:
            return composed
        longer = _find_longer(task, max_impacts, (rho, ceiling), max(pieces, MANY), seed, budget, options)
        if longer is not None:
            return longer
        shallow = (
            _find_shallow(task, (rho, ceiling), pieces, seed, budget, options) if len(seed) <= max_impacts else None
        )
        if shallow is not None:
            return shallow
    fewest = len(seed) if options.expected is None else min(len(seed), options.expected)
    return maximise_robustness(task, max_impacts, budget, options, fewest)


def _compose(
    task: NominalTask,
    numbers: Mapping[str, int],
    max_impacts: int,
    pieces: int,
    rho: tuple[float, float],
    budget: Budget,
    options: PlanOptions,
) -> RobustnessOptimum | None:
    """Return the optimum of objects one after another, as robust as may be; None: none was found.

    Args:
        task, max_impacts, budget, options: as for `maximise_jointly`.
        numbers: object to the impacts that it needs alone.
        pieces: per leg.
        rho: least robustness that the objects attain alone, and its bound [m].
    """
    end, shares = budget.elapsed + options.compose.time * budget.left, options.compose.shares
    for left, share in zip(range(len(shares), 0, -1), shares, strict=True):
        part = budget.share((end - budget.elapsed) / left)
        kept = max(options.least, share * rho[0]), rho[1]
        found = compose_objects(task, numbers, max_impacts, pieces, kept, lambda part=part: part.left, options)  # type: ignore[misc]
        if found is not None:
            return RobustnessOptimum(GridSize(len(found.grid.hits), pieces), found.rho, rho[1], found=found)
    return None


def _find_shallow(
    task: NominalTask, rho: tuple[float, float], pieces: int, seed: Word, budget: Budget, options: PlanOptions
) -> RobustnessOptimum | None:
    """Return words of as many impacts as the objects need one by one, with less robustness; None: none was found."""
    quick = replace(options.cost, wishes=options.cost.wishes[-1:])
    hasty = replace(options, cost=quick, search=replace(options.search, improve=False))
    size = GridSize(len(seed), pieces)
    for share in options.search.shallow_shares:
        kept = max(options.least, share * options.joint * rho[0])
        found = search_words(task, size, kept, seed, lambda: budget.left / 6, hasty)
        if found.words:
            return RobustnessOptimum(size, kept, rho[1], found.words)
    return None


def _find_longer(
    task: NominalTask,
    max_impacts: int,
    rho: tuple[float, float],
    pieces: int,
    seed: Word,
    budget: Budget,
    options: PlanOptions,
) -> RobustnessOptimum | None:
    """Return the optimum of words with more impacts than the objects need one by one; None: none was found."""
    end = budget.elapsed + 0.7 * budget.left
    most = min(max_impacts - len(seed), options.search.most_longer)
    for extra, share in itertools.product(range(1, most + 1), options.search.longer_shares):
        if budget.elapsed >= end:
            break
        size, kept = GridSize(len(seed) + extra, pieces), share * options.joint * rho[0]
        found = lengthen_words(task, size, kept, seed, lambda: end - budget.elapsed, options)
        if found.words:
            return RobustnessOptimum(size, kept, rho[1], found.words, events=found.events)
    return None

"""Stage A: the greatest robustness, and the fewest impacts that attain it."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

from planners.budget import Budget
from planners.errors import Infeasible, PlanningError, SolverFailed
from planners.free_flyer.nominal.event_sequence import Word
from planners.free_flyer.nominal.least_cost import CostOptimum
from planners.free_flyer.nominal.leg_times import Correction
from planners.free_flyer.nominal.object_way import find_object_way, list_merges
from planners.free_flyer.nominal.screening import exclude_size, is_size_excluded
from planners.free_flyer.nominal.task import NominalTask, PlanOptions
from planners.free_flyer.nominal.word_grid import WordGrid, solve_word_grid
from planners.free_flyer.specification.grid import GridSize
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
        fewer: optima of fewer impacts or pieces that are less robust, the most robust one first.
        complete: whether all sizes that were to be tried are decided.
        corrections: where objects are hit, if that was given.
    """

    size: GridSize
    rho: float
    bound: float
    words: tuple[Word, ...] = ()
    cost_bound: float = 0.0
    events: CostOptimum | None = None
    found: WordGrid | None = None
    fewer: tuple[RobustnessOptimum, ...] = ()
    complete: bool = True
    corrections: tuple[Correction, ...] = ()


def maximise_robustness(
    task: NominalTask, max_impacts: int, budget: Budget, options: PlanOptions, fewest: int = 0
) -> RobustnessOptimum:
    """Return the greatest robustness and the fewest impacts that attain it (stage A).

    Every number of impacts is solved to proven optimality or infeasibility (as far as the time limit allows), until
    one attains the geometric bound, which holds for every number. Legs of several pieces are tried for numbers that
    are infeasible without them, and for the first number whose plan does not attain the bound. Where the pauses of each
    solution are limited, numbers that they do not decide are passed over.

    Args:
        task: what is asked.
        max_impacts: greatest number of impacts tried.
        budget: time.
        options: when to stop.
        fewest: least number of impacts tried.

    Raises:
        Infeasible: no plan within max_impacts.
        SolverFailed: out of time, or no number with a plan and some undecided.
    """
    ceiling = compute_geometric_bound(task.scenario, task.demands, task.solver)
    problem = f"plan of {task.scenario.name}"
    if ceiling < options.least:
        status = f"fixed starts, goals and areas allow a robustness of {ceiling * task.frame.length:.3g} m at most"
        raise Infeasible(problem, status, "move them, or relax the formula")
    if min(options.pieces) > MANY and options.pauses is None:
        found = _attain_bound(task, order_sizes(options, fewest, max_impacts), ceiling, budget, options)
        if found is not None:
            return found
    best: RobustnessOptimum | None = None
    complete = True
    progress, length = budget.progress, task.frame.length
    progress.bound = ceiling * length
    for size in order_sizes(options, fewest, max_impacts):
        impacts, pieces = size.impacts, size.pieces
        progress.impacts, progress.pieces = impacts, pieces
        if best is not None and pieces > best.size.pieces and impacts > best.size.impacts:
            continue
        hasty = not options.thorough or options.pauses is not None
        if best is not None and hasty and impacts > best.size.impacts + 1:
            complete = False
            break
        # Once there is a plan, the search for a more robust one with more impacts must leave time to finish it.
        share = 0.5
        limit = budget.left if best is None else share * budget.limit - budget.elapsed
        if limit <= 0.0:
            if best is None:
                raise SolverFailed(problem, "time limit reached", "raise the time limit")
            complete = False
            break
        least = options.least if best is None else best.rho
        try:
            found = _solve_size(task, size, (least, ceiling), limit, options)
        except Infeasible:
            continue
        except SolverFailed:
            complete = False
            if options.pauses is not None:
                continue
            if best is None:
                raise
            break
        complete = complete and found.complete
        if best is None or found.rho > best.rho + TOLERANCE:
            fewer = () if best is None else (best, *best.fewer)
            best = replace(found, rho=ceiling if ceiling - found.rho <= TOLERANCE else found.rho, fewer=fewer)
            progress.robustness = best.rho * length
        if best.rho >= options.enough * ceiling:
            complete = True
            break
    if best is None and not complete:
        status = f"some numbers of impacts are undecided after {options.pauses} pauses of the solver"
        raise SolverFailed(problem, status, "raise the time limit")
    if best is None:
        status = f"proven infeasible with up to {max_impacts} impacts and the planner's reserves"
        raise Infeasible(problem, status, "allow more impacts or time, move the areas, or relax the formula")
    return replace(best, complete=complete)


def maximise_on_way(task: NominalTask, max_impacts: int, budget: Budget, options: PlanOptions) -> RobustnessOptimum:
    """Return the optimum with hits near the turns of the only object's shortest way.

    One hit for every two near turns is tried first, then one for each of more and more of them.

    Args:
        task: what is asked.
        max_impacts: greatest number of impacts tried.
        budget: time.
        options: when to stop.

    Raises:
        SolverFailed: there is none; that proves nothing.
    """
    ceiling = compute_geometric_bound(task.scenario, task.demands, task.solver)
    way = find_object_way(task.scenario, task.demands, task.reserves.wall)
    problem = f"plan of {task.scenario.name}"
    if way is None:
        raise SolverFailed(problem, "the formula names no place for the object", "name one")

    def is_possible(merged: frozenset[int]) -> bool:
        size = GridSize(way.impacts - len(merged), 1, passing=True)
        guided = replace(task, corrections=way.place_hits(merged))
        return budget.left > 0.0 and not is_size_excluded(guided, size, (options.least, ceiling), budget.left)

    pairs = [pair for pair in way.pairs if is_possible(frozenset([pair]))]
    for merged in itertools.islice(list_merges(pairs), options.most_merges):
        impacts = way.impacts - len(merged)
        if impacts > max_impacts or not is_possible(merged):
            continue
        guided, found = replace(task, corrections=way.place_hits(merged)), list[RobustnessOptimum]()
        for pieces in options.pieces:
            least = max((one.rho for one in found), default=options.least)
            if budget.left <= 0.0 or (found and least >= options.enough * ceiling):
                break
            budget.progress.impacts, budget.progress.pieces = impacts, pieces
            size, share = GridSize(impacts, pieces, passing=True), options.attempt_share if found else 1.0
            with suppress(PlanningError):
                one = _solve_size(guided, size, (least, ceiling), share * budget.left, options)
                found.append(replace(one, corrections=guided.corrections))
        if found:
            full = found[-1].rho >= ceiling - TOLERANCE
            return replace(found[-1], rho=ceiling if full else found[-1].rho, fewer=tuple(found[-2::-1]), complete=full)
    status = "no plan with hits near the turns of the object's shortest way"
    raise SolverFailed(problem, "time limit reached" if budget.left <= 0.0 else status, "raise the time limit")


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
    found = solve_word_grid(task, size, rho, time_limit, options.robustness_gap, pauses=options.pauses)
    best, events = found.rho, None
    if len(task.scenario.objects) == 1:
        # Where legs have many pieces, the search for the least path cost may take longer than there is time.
        cheap = size.pieces > MANY
        with suppress(SolverFailed):
            events = found.reduce_cost(best) if cheap else found.read()
    return RobustnessOptimum(size, best, rho[1], events=events, complete=found.proven)

"""Stage A for several objects: from what each of them attains alone to sequences of impacts on all of them."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from contextlib import nullcontext, suppress
from dataclasses import replace

import numpy as np

from planners.budget import Budget
from planners.errors import PlanningError, SolverFailed
from planners.free_flyer.nominal.event_sequence import Hitter, Word
from planners.free_flyer.nominal.least_cost import minimise_path_cost
from planners.free_flyer.nominal.robustness import MANY, RobustnessOptimum, maximise_robustness
from planners.free_flyer.nominal.several_objects.composition import compose_objects, is_large
from planners.free_flyer.nominal.several_objects.giving_way import give_way
from planners.free_flyer.nominal.several_objects.sequence_search import (
    lengthen_words,
    list_neighbours,
    restrict_to_object,
    search_words,
)
from planners.free_flyer.nominal.several_objects.settled_word import settle_words
from planners.free_flyer.nominal.task import NominalTask, PlanOptions
from planners.free_flyer.specification.grid import GridSize
from planners.free_flyer.specification.requirement import read_demands
from planners.free_flyer.specification.robustness_bound import compute_geometric_bound


def maximise_jointly(task: NominalTask, max_impacts: int, budget: Budget, options: PlanOptions) -> RobustnessOptimum:
    """Return the optimum for several objects, starting from those of each object alone.

    What the objects attain alone bounds what they attain together, in robustness and in number of impacts. First a
    word is sought that attains both bounds; only if there is none are all words open (see `maximise_robustness`).

    Args:
        task, max_impacts, budget, options: as for `maximise_robustness`.

    Raises:
        Infeasible: no plan within max_impacts.
        SolverFailed: out of time, or no plan with few impacts where only these are tried.
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
        most = max_impacts if options.few is None else min(max_impacts, options.few)
        optimum = maximise_robustness(own, most, budget, replace(options, expected=None))
        if options.thorough:
            optimum = _prefer_small(optimum, options.search.nearly)
        rho, pieces = min(rho, optimum.rho), max(pieces, optimum.size.pieces)
        alone[name] = own, optimum
    progress.about, progress.robustness, progress.bound = "all objects", None, ceiling * task.frame.length
    numbers = {name: optimum.size.impacts for name, (_, optimum) in alone.items()}
    large = options.thorough and is_large(task, numbers, pieces, options)
    done = options.simple is False  # what is simple was tried before
    if large and not done:
        composed = _compose(task, numbers, max_impacts, pieces, (rho, ceiling), budget, options)
        if composed is not None:
            return composed
    hits: list[tuple[float, Hitter]] = []
    ways: dict[str, np.ndarray] = {}
    for name, (own, optimum) in alone.items():
        events = optimum.events
        if events is None or options.thorough:
            # Where this takes long, its events are as good a start as any.
            limit = budget.left if events is None or not options.thorough else budget.left / 16
            with suppress(PlanningError) if events is not None and options.thorough else nullcontext():
                events = minimise_path_cost(own, optimum.size, optimum.rho, options.cost, limit)
        assert events is not None
        hits += zip(events.sequence.times[1:-1], events.sequence.hitters, strict=True)
        ways[name] = events.sequence.paths[name]
    seed = tuple(hitter for _, hitter in sorted(hits))
    if len(seed) <= max_impacts and not done:
        size = GridSize(len(seed), pieces)
        share = 4 if options.thorough else 2
        lost = options.search.lost if options.thorough else None
        found = search_words(task, size, options.joint * rho, seed, lambda: budget.left / share, options, lost)
        if found.words:
            return RobustnessOptimum(size, rho, ceiling, found.words, found.bound)
    if options.thorough:
        composed = (
            None if large or done else _compose(task, numbers, max_impacts, pieces, (rho, ceiling), budget, options)
        )
        if composed is None and not done and len(seed) <= max_impacts:
            composed = _settle(task, seed, pieces, (rho, ceiling), budget, options)
        if composed is None and not options.simple:
            composed = _give_way(task, ways, max_impacts, pieces, (rho, ceiling), budget, options)
        if composed is not None:
            return composed
    if options.thorough and not options.simple:
        longer = _find_longer(task, max_impacts, (rho, ceiling), max(pieces, MANY), seed, budget, options)
        if longer is not None:
            return longer
        shallow = (
            _find_shallow(task, (rho, ceiling), pieces, seed, budget, options) if len(seed) <= max_impacts else None
        )
        if shallow is not None:
            return shallow
    if options.few is not None:
        status = f"no sequence found with up to {options.few} impacts of each object"
        raise SolverFailed(f"plan of {task.scenario.name}", status, "allow more impacts")
    fewest = len(seed) if options.expected is None else min(len(seed), options.expected)
    return maximise_robustness(task, max_impacts, budget, options, fewest)


def _prefer_small(optimum: RobustnessOptimum, share: float) -> RobustnessOptimum:
    """Return the optimum of the smallest grid that attains a share of the greatest robustness."""
    near = [one for one in (optimum, *optimum.fewer) if one.rho >= share * optimum.rho]
    return min(near, key=lambda one: (one.size.impacts + 1) * one.size.pieces)


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


def _settle(
    task: NominalTask, seed: Word, pieces: int, rho: tuple[float, float], budget: Budget, options: PlanOptions
) -> RobustnessOptimum | None:
    """Return the optimum of the seed or of a word near it, whatever its path cost; None: none was found."""
    part = budget.share(0.8 * budget.left)
    kept = max(options.least, options.compose.shares[-1] * rho[0]), rho[1]
    words = list(dict.fromkeys([seed, *list_neighbours(task.scenario, seed)]))[: options.search.settled]
    found = settle_words(task, words, pieces, kept, lambda: part.left, options)
    if found is None:
        return None
    return RobustnessOptimum(GridSize(len(seed), pieces), found.rho, rho[1], found=found)


def _give_way(
    task: NominalTask,
    ways: Mapping[str, np.ndarray],
    max_impacts: int,
    pieces: int,
    rho: tuple[float, float],
    budget: Budget,
    options: PlanOptions,
) -> RobustnessOptimum | None:
    """Return the optimum of objects one of which gives way to another, as robust as may be; None: none was found.

    Args:
        task, max_impacts, pieces, rho, budget, options: as for `_compose`.
        ways: object to its places at its own events when it is moved alone [m].
    """
    part = budget.share(0.5 * budget.left)
    kept = max(options.least, options.compose.shares[-1] * rho[0]), rho[1]
    found = give_way(task, ways, max_impacts, pieces, kept, lambda: part.left, options)
    if found is None:
        return None
    return RobustnessOptimum(GridSize(len(found.grid.hits), pieces), found.rho, rho[1], found=found)


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

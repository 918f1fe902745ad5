"""Stage A for several objects: from what each of them attains alone to sequences of impacts on all of them."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from contextlib import nullcontext, suppress
from dataclasses import dataclass, replace

import numpy as np

from planners.budget import Budget
from planners.errors import Infeasible, PlanningError, SolverFailed
from planners.free_flyer.nominal.event_sequence import ANYBODY, Hitter, Word
from planners.free_flyer.nominal.least_cost import minimise_path_cost
from planners.free_flyer.nominal.object_way import count_turns
from planners.free_flyer.nominal.robustness import MANY, RobustnessOptimum, maximise_on_way, maximise_robustness
from planners.free_flyer.nominal.several_objects.composition import compose_objects, is_large
from planners.free_flyer.nominal.several_objects.giving_way import give_way
from planners.free_flyer.nominal.several_objects.sequence_search import (
    lengthen_words,
    list_orders,
    restrict_to_object,
    search_words,
)
from planners.free_flyer.nominal.several_objects.settled_word import settle_words
from planners.free_flyer.nominal.task import NominalTask, PlanOptions
from planners.free_flyer.nominal.word_grid import WordGrid
from planners.free_flyer.specification.grid import GridSize
from planners.free_flyer.specification.requirement import read_demands
from planners.free_flyer.specification.robustness_bound import compute_geometric_bound

Alone = Mapping[str, tuple[NominalTask, RobustnessOptimum]]  # object to its task and its optimum


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
    ceiling, progress = compute_geometric_bound(task.scenario, task.demands, task.solver), budget.progress
    alone = _maximise_alone(task, max_impacts, budget, options)
    progress.about, progress.robustness, progress.bound = "all objects", None, ceiling * task.frame.length
    rho = min([ceiling, *(optimum.rho for _, optimum in alone.values())])
    pieces = max([1, *(optimum.size.pieces for _, optimum in alone.values())])
    numbers = {name: optimum.size.impacts for name, (_, optimum) in alone.items()}
    places = [place for _, optimum in alone.values() for place in optimum.corrections]
    guided = replace(task, corrections=(*task.corrections, *places))
    search = _JointSearch(guided, max_impacts, budget, options, numbers, pieces, rho, ceiling)
    found = search.find(alone)
    if found is not None:
        return replace(found, corrections=guided.corrections)
    if options.few is not None or options.simple:
        few = "" if options.few is None else f" with up to {options.few} impacts of each object"
        status = f"no {'simple ' if options.simple else ''}sequence found{few}"
        raise SolverFailed(f"plan of {task.scenario.name}", status, "allow more impacts")
    fewest = sum(numbers.values())
    fewest = fewest if options.expected is None else min(fewest, options.expected)
    return maximise_robustness(task, max_impacts, budget, options, fewest)


def _maximise_alone(task: NominalTask, max_impacts: int, budget: Budget, options: PlanOptions) -> Alone:
    """Return the optima of those objects of which something is asked, each without the others.

    Raises:
        PlanningError: one of them has no plan.
    """
    alone: dict[str, tuple[NominalTask, RobustnessOptimum]] = {}
    most = max_impacts if options.few is None else min(max_impacts, options.few)
    for name in task.scenario.objects:
        scenario = restrict_to_object(task.scenario, name)
        if scenario is None:
            continue
        own = replace(task, scenario=scenario, demands=read_demands(scenario, task.reserves.wall))
        budget.progress.about, budget.progress.robustness = f"{name} alone", None
        brief = replace(options, expected=None, enough=min(options.enough, options.enough_alone))
        optimum = _maximise_one(own, most, max_impacts, budget, brief)
        optimum = _prefer_small(optimum, options.search.nearly) if options.thorough else optimum
        alone[name] = replace(own, corrections=optimum.corrections), optimum
    return alone


def _maximise_one(task: NominalTask, few: int, most: int, budget: Budget, options: PlanOptions) -> RobustnessOptimum:
    """Return the optimum of one object alone; where its shortest way turns, hits near these turns are tried, too.

    Args:
        task: of the object.
        few: greatest number of impacts anywhere.
        most: greatest number near the turns.
        budget, options: as for `maximise_robustness`.

    Raises:
        PlanningError: no plan.
    """
    turns = count_turns(task.scenario, task.demands, task.reserves.wall) if options.thorough else 0
    guided = replace(options, pieces=options.guided_pieces, pauses=options.brief_pauses)
    if turns >= options.many_turns:
        with suppress(PlanningError):
            return maximise_on_way(task, most, budget.share(options.attempt_share * budget.left), guided)
    try:
        return maximise_robustness(task, few, budget, options)
    except PlanningError:
        if 0 < turns < options.many_turns and options.few is None:
            with suppress(PlanningError):
                return maximise_on_way(task, most, budget.share(options.attempt_share * budget.left), guided)
        raise


def _prefer_small(optimum: RobustnessOptimum, share: float) -> RobustnessOptimum:
    """Return the optimum of the smallest grid that attains a share of the greatest robustness."""
    near = [one for one in (optimum, *optimum.fewer) if one.rho >= share * optimum.rho]
    return min(near, key=lambda one: (one.size.impacts + 1) * one.size.pieces)


@dataclass(frozen=True)
class _JointSearch:
    """Hold what is known when sequences of impacts on all objects are sought.

    Args:
        task, max_impacts, budget, options: as for `maximise_jointly`.
        numbers: object to the impacts that it needs alone.
        pieces: per leg, the most that an object needs alone.
        rho: least robustness that the objects attain alone [m].
        ceiling: no plan has more [m].
    """

    task: NominalTask
    max_impacts: int
    budget: Budget
    options: PlanOptions
    numbers: Mapping[str, int]
    pieces: int
    rho: float
    ceiling: float

    def find(self, alone: Alone) -> RobustnessOptimum | None:
        """Return the optimum of the first search that finds one, the quick ones first; None: none does."""
        options = self.options
        done = options.simple is False  # what is simple was tried before
        large = options.thorough and not done and is_large(self.task, self.numbers, self.pieces, options)
        found = self._compose() if large else None
        if found is not None:
            return found
        seed, ways = self._join(alone)
        if options.near_words and not done and len(seed) <= self.max_impacts:
            found = self._search_words(seed)
        if options.thorough and not done:
            found = found or (None if large else self._compose()) or self._settle(seed)
        if options.thorough and not options.simple:
            found = found or self._give_way(ways) or self._find_longer(seed) or self._find_shallow(seed)
        return found

    def _join(self, alone: Alone) -> tuple[Word, dict[str, np.ndarray]]:
        """Return all impacts of the objects alone in the order of their times, and where each object goes [m]."""
        hits: list[tuple[float, Hitter]] = []
        ways: dict[str, np.ndarray] = {}
        for name, (own, optimum) in alone.items():
            events = optimum.events
            if events is None or self.options.thorough:
                # Where this takes long, its events are as good a start as any.
                spare = events is not None and self.options.thorough
                limit = self.budget.left / 16 if spare else self.budget.left
                with suppress(PlanningError) if spare else nullcontext():
                    events = minimise_path_cost(own, optimum.size, optimum.rho, self.options.cost, limit)
            assert events is not None
            hits += zip(events.sequence.times[1:-1], events.sequence.hitters, strict=True)
            ways[name] = events.sequence.paths[name]
        return tuple(hitter for _, hitter in sorted(hits)), ways

    def _search_words(self, seed: Word) -> RobustnessOptimum | None:
        """Return the words of least path cost that attain both bounds; None: none was found."""
        options, size = self.options, GridSize(len(seed), self.pieces)
        share, lost = (4, options.search.lost) if options.thorough else (2, None)
        rho = options.joint * self.rho
        found = search_words(self.task, size, rho, seed, lambda: self.budget.left / share, options, lost)
        return RobustnessOptimum(size, self.rho, self.ceiling, found.words, found.bound) if found.words else None

    def _compose(self) -> RobustnessOptimum | None:
        """Return the optimum of objects one after another, as robust as may be; None: none was found."""
        budget, options = self.budget, self.options
        end, shares = budget.elapsed + options.compose.time * budget.left, options.compose.shares
        for left, share in zip(range(len(shares), 0, -1), shares, strict=True):
            part = budget.share((end - budget.elapsed) / left)
            limits = self.numbers, self.max_impacts, self.pieces, self._keep(share)
            try:
                found = self._read(compose_objects(self.task, *limits, lambda part=part: part.left, options))  # type: ignore[misc]
            except Infeasible:
                break
            if found is not None:
                return found
        return None

    def _settle(self, seed: Word) -> RobustnessOptimum | None:
        """Return the optimum of the seed's order or of one near it, whoever hits and whatever the cost; None: none.

        Robots may turn at every event, those of other objects included, so one piece a leg mostly does.
        """
        if len(seed) > self.max_impacts:
            return None
        options, part = self.options, self.budget.share(self.options.search.settling_time * self.budget.left)
        orders = itertools.islice(list_orders([name for _, name in seed]), options.search.settled)
        words = [tuple((ANYBODY, name) for name in order) for order in orders]
        kept = self._keep(0.0)
        for pieces in sorted({1, self.pieces}):
            found = settle_words(self.task, words, pieces, kept, lambda: part.left, options)
            if found is not None:
                return self._read(found)
        return None

    def _give_way(self, ways: Mapping[str, np.ndarray]) -> RobustnessOptimum | None:
        """Return the optimum of objects one of which gives way to another; None: none was found."""
        part, kept = self.budget.share(0.5 * self.budget.left), self._keep(self.options.compose.shares[-1])
        limits = self.max_impacts, self.pieces, kept
        return self._read(give_way(self.task, ways, *limits, lambda: part.left, self.options))

    def _keep(self, share: float) -> tuple[float, float]:
        """Return a share of the least robustness that objects attain alone, and the bound [m]."""
        return max(self.options.least, share * self.rho), self.ceiling

    def _read(self, found: WordGrid | None) -> RobustnessOptimum | None:
        """Return the optimum of a grid whose alternatives are kept."""
        if found is None:
            return None
        size = GridSize(len(found.grid.hits), found.grid.pieces)
        return RobustnessOptimum(size, found.rho, self.ceiling, found=found)

    def _find_shallow(self, seed: Word) -> RobustnessOptimum | None:
        """Return words of as many impacts as the objects need one by one, with less robustness; None: none found."""
        if len(seed) > self.max_impacts:
            return None
        options = self.options
        quick = replace(options.cost, wishes=options.cost.wishes[-1:])
        hasty = replace(options, cost=quick, search=replace(options.search, improve=False))
        size = GridSize(len(seed), self.pieces)
        for share in options.search.shallow_shares:
            kept = self._keep(share * options.joint)[0]
            found = search_words(self.task, size, kept, seed, lambda: self.budget.left / 6, hasty)
            if found.words:
                return RobustnessOptimum(size, kept, self.ceiling, found.words)
        return None

    def _find_longer(self, seed: Word) -> RobustnessOptimum | None:
        """Return words with more impacts than the objects need one by one; None: none was found."""
        budget, options, pieces = self.budget, self.options, max(self.pieces, MANY)
        end = budget.elapsed + 0.7 * budget.left
        most = min(self.max_impacts - len(seed), options.search.most_longer)
        for extra, share in itertools.product(range(1, most + 1), options.search.longer_shares):
            if budget.elapsed >= end:
                break
            size, kept = GridSize(len(seed) + extra, pieces), share * options.joint * self.rho
            found = lengthen_words(self.task, size, kept, seed, lambda: end - budget.elapsed, options)
            if found.words:
                return RobustnessOptimum(size, kept, self.ceiling, found.words, events=found.events)
        return None

"""Make one attempt at a plan: impacts of most robustness, then least path cost, smooth motions, a check."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial

from planners.budget import Budget, Clock, get_clock, use_clock
from planners.errors import PlanningError, SolverFailed
from planners.free_flyer.nominal.event_sequence import Word
from planners.free_flyer.nominal.finishing import (
    correct_word,
    plan_composed,
    plan_events,
    plan_found,
    plan_long_ways,
    plan_patiently,
)
from planners.free_flyer.nominal.robustness import MANY, RobustnessOptimum, maximise_on_way, maximise_robustness
from planners.free_flyer.nominal.screening import screen_task
from planners.free_flyer.nominal.several_objects.joint_robustness import maximise_jointly
from planners.free_flyer.nominal.task import NominalTask, PlanOptions
from planners.plan import Plan


@dataclass
class Climber:
    """Hold one attempt.

    Args:
        task: with its reserves.
        max_impacts: greatest number of impacts.
        budget: time.
        options: with the numbers of pieces per leg.
        hurry: there is a plan already, so nothing slow is tried.
        rho: greatest robustness of the event grid, once it is known [m].
        failure: of the best motions, where less robust ones were found.
        brief: whether few remedies are tried for hasty motions.
        longest: time for the search for impacts [s].
        fewest: least number of impacts, with one object.
        guided: whether the only object is hit near the turns of its shortest way.
        optimum: of the event grid, once it is known; an earlier attempt may have it.
    """

    task: NominalTask
    max_impacts: int
    budget: Budget
    options: PlanOptions
    hurry: bool = False
    rho: float | None = None
    failure: PlanningError | None = None
    brief: bool = False
    longest: float = math.inf
    fewest: int = 0
    guided: bool = False
    optimum: RobustnessOptimum | None = None

    def climb(self) -> Plan:
        """Return a plan.

        Raises:
            PlanningError: there is none.
        """
        task, options, budget = self.task, self.options, self.budget
        if options.screen:
            with budget.stage("screening"):
                screen_task(task, self.max_impacts, options)
        search: Callable[..., RobustnessOptimum] = maximise_jointly
        if self.guided:
            search = maximise_on_way
        elif len(task.scenario.objects) == 1:
            search = partial(maximise_robustness, fewest=self.fewest)
        with budget.stage("robustness"):
            # An attempt leaves time for the next one.
            part = budget.share(min(self._find_time_to_search(), self.longest))
            optimum = self.optimum = self.optimum or search(task, self.max_impacts, part, options)
            if optimum.corrections:
                task = self.task = replace(task, corrections=optimum.corrections)
            if self.guided:
                search = partial(maximise_robustness, fewest=optimum.size.impacts)
            self.rho = optimum.rho
            late = optimum.found is not None or get_clock().stopped
            quick = None if late else quicken_legs(task, optimum, search, part, options)
        return self._finish(optimum, quick)

    def plan_hastily(self) -> Plan:
        """Return a plan with the impacts of a search that was interrupted: they are worth a few seconds more.

        Raises:
            PlanningError: there are none, or no smooth motions were found, not even with the least of the reserves.
        """
        task, optimum, options = self.task, self.optimum, replace(self.options, words=1, turns=self.options.turns[:1])
        if optimum is None:
            raise SolverFailed("smoothing", "no impacts were found", "raise the time limit")
        options = replace(options, patience=options.brief_patience, less=options.brief_less)
        with use_clock(Clock(get_clock().read)):
            budget = self.budget.share(options.haste)
            if optimum.found is not None:
                return plan_composed(task, optimum, optimum.found, budget, options)
            try:
                return plan_events(task, optimum, [], budget, replace(options, thorough=False))
            except PlanningError:
                if optimum.events is None:
                    raise
            for _ in range(options.halvings):
                task = replace(task, reserves=replace(task.reserves.halved(), underway=1.0))
            word = optimum.events.sequence.hitters
            return correct_word(task, optimum, word, self.budget.share(options.haste), options)

    def _find_time_to_search(self) -> float:
        """Return how long this attempt may look for impacts [s]."""
        options, left = self.options, self.budget.left
        if len(self.task.scenario.objects) == 1:
            return options.attempt_share * left
        if options.simple and left > options.kept * self.budget.limit:
            return options.simple_share * (left - options.kept * self.budget.limit)
        return options.joint_share * left

    def _finish(self, optimum: RobustnessOptimum, quick: tuple[NominalTask, RobustnessOptimum] | None) -> Plan:
        """Return a plan with the impacts that were found."""
        task, options, budget = self.task, self.options, self.budget
        if optimum.found is not None:
            # What takes longer to find may have motions at once.
            part = budget.share(options.attempt_share * budget.left) if options.simple else budget
            plan = plan_composed(task, optimum, optimum.found, part, options)
            seconds = Counter(budget.stages) + Counter(part.stages if part is not budget else {})
            return replace(plan, solve_seconds=budget.seconds, stage_seconds=dict(seconds))
        if quick is not None:
            try:
                return plan_events(*quick, [], budget, options)
            except PlanningError:
                pass  # the plan with all reserves is left
        if self.brief:
            return self._finish_briefly(optimum)
        rough: list[Word] = []
        plans: list[Plan] = []
        try:
            if self.hurry and optimum.events is not None:
                rough.append(optimum.events.sequence.hitters)
                raise SolverFailed("smoothing", "there is a plan already", "raise the time limit")
            if optimum.events is not None and (optimum.size.pieces > MANY or optimum.words):
                return plan_long_ways(task, optimum, optimum.events, rough, budget, options)
            if options.thorough and optimum.events is not None:
                return plan_events(task, optimum, rough, budget, replace(options, words=1, turns=options.turns[:1]))
            return plan_events(task, optimum, rough, budget, options)
        except PlanningError as error:
            self.failure = error
            if not options.thorough:
                raise
        if self.hurry:
            with suppress(PlanningError):
                plans.append(plan_patiently(task, optimum, rough, self.failure, budget, options))
        elif not optimum.words and optimum.events is not None:
            # Where the motions are too quick, what they need is soon known; other sequences take longer to find.
            word = rough[0] if rough else optimum.events.sequence.hitters
            with suppress(PlanningError):
                plans.append(correct_word(task, optimum, word, budget, options))
            if not plans:
                with suppress(PlanningError):
                    plans.append(plan_events(task, optimum, rough, budget, options))
        if max((plan.robustness for plan in plans), default=0.0) < options.satisfying * optimum.rho:
            plans += self._plan_fewer(optimum)
        if not plans and self.hurry:
            raise self.failure
        if not plans:
            plans.append(plan_patiently(task, optimum, rough, self.failure, budget, options))
        return max(plans, key=lambda plan: plan.robustness)

    def _finish_briefly(self, optimum: RobustnessOptimum) -> Plan:
        """Return a plan of one object where that takes little time; what takes longer is left to later attempts."""
        hasty = replace(self.options, words=1, turns=self.options.turns[:1])
        rough: list[Word] = []
        try:
            if optimum.events is not None and optimum.size.pieces > MANY:
                return plan_found(self.task, optimum, optimum.events, self.budget, hasty)
            return plan_events(self.task, optimum, rough, self.budget, hasty)
        except PlanningError as error:
            self.failure = error
        plans: list[Plan] = []
        words = rough or ([optimum.events.sequence.hitters] if optimum.events is not None else [])
        for word in words[:1]:
            with suppress(PlanningError):
                plans.append(correct_word(self.task, optimum, word, self.budget, self.options))
        plans = plans or self._plan_fewer(optimum)
        if not plans:
            raise self.failure
        return plans[0]

    def _plan_fewer(self, optimum: RobustnessOptimum) -> list[Plan]:
        """Return the most robust plan with fewer impacts than a sequence that is too quick, if there is one."""
        hasty = replace(self.options, words=1, turns=self.options.turns[:1])
        for other in optimum.fewer:
            rough: list[Word] = []
            with suppress(PlanningError):
                return [plan_events(self.task, other, rough, self.budget, hasty)]
            for word in rough[:1]:
                with suppress(PlanningError):
                    return [correct_word(self.task, other, word, self.budget, self.options)]
        return []


def quicken_legs(
    task: NominalTask,
    optimum: RobustnessOptimum,
    search: Callable[..., RobustnessOptimum],
    budget: Budget,
    options: PlanOptions,
) -> tuple[NominalTask, RobustnessOptimum] | None:
    """Return the task with less margin of speed and its optimum, if that margin costs much of the robustness.

    No more impacts are tried than the optimum has.
    """
    if not options.thorough or optimum.rho >= options.deep * optimum.bound:
        return None
    quick = replace(task, reserves=task.reserves.quickened())
    try:
        found = search(quick, optimum.size.impacts, budget.share(budget.left / 2), options)
    except PlanningError:
        return None
    quick = replace(quick, corrections=found.corrections or task.corrections)
    return (quick, found) if found.rho >= options.deeper * optimum.rho else None

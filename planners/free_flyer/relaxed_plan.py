"""Plan what can be planned of a task that has no plan: the minimally violating one (`impact plan --relax`)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from impact_envs.errors import InputError
from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.stl import Formula
from planners.budget import Budget, Work
from planners.errors import PlanningError
from planners.free_flyer.frame import find_frame
from planners.free_flyer.given_up import GivenUp, list_given_up, measure, measure_missed
from planners.free_flyer.impossibility.reach import Kept
from planners.free_flyer.impossibility.reason import find_impossibility
from planners.free_flyer.nominal.diagnosis import find_relaxation, list_amounts
from planners.free_flyer.nominal.object_way import find_most_impacts
from planners.free_flyer.nominal.planner import make_free_flyer_plan
from planners.free_flyer.nominal.task import NominalTask, PlanOptions
from planners.free_flyer.nominal.ways import count_pieces
from planners.free_flyer.reserves import Reserves
from planners.free_flyer.specification.loosening import list_conjuncts, loosen
from planners.free_flyer.specification.requirement import read_demands
from planners.plan import Plan


@dataclass(frozen=True)
class RelaxationOptions:
    """Choose how a relaxed task is planned.

    Args:
        unrelaxed: share of the time for a plan that gives up nothing.
        finding: share of the time left for the least loosening.
        slacks: factors of the time that legs lose by starting and stopping, tried in turn: without it impacts come
            earliest, and whether robots are that quick is found out when motions are smoothed.
        factors: of this loosening, tried in turn: the least one leaves motions no room.
        room: by which what is loosened is loosened more, in a world of robots of 0.2 m [m].
        trial: share of the time left that one task more may take.
        tolerance: share of what is given up within which less is no longer looked for.
    """

    unrelaxed: float = 0.3
    finding: float = 0.25
    slacks: tuple[float, ...] = (0.0, 1.0)
    factors: tuple[float, ...] = (1.0, 1.2, 1.5)
    room: float = 0.02
    trial: float = 0.5
    tolerance: float = 0.05


@dataclass(frozen=True)
class RelaxedPlan:
    """Hold a plan of a relaxed task.

    Args:
        plan: checked against the relaxed task.
        scenario: the relaxed task.
        given_up: conjuncts that the plan misses; empty: it gives up nothing.
        robustness: of the formula as it was asked [m].
        bound: no plan misses its only conjunct that is given up by less; None: nothing is proven [m].
        tried: plans that give up less, in the same proportions, were looked for down to this price and not found; the
            weighted sum of metres [m].
    """

    plan: Plan
    scenario: FreeFlyerScenario
    given_up: tuple[GivenUp, ...]
    robustness: float
    bound: float | None = None
    tried: float = 0.0


def make_relaxed_plan(
    scenario: FreeFlyerScenario,
    weights: Sequence[float] = (),
    max_impacts: int | None = None,
    time_limit: float = 60.0,
    solver: str = "highs",
    options: PlanOptions = PlanOptions(),  # noqa: B008 - frozen
    relaxation: RelaxationOptions = RelaxationOptions(),
) -> RelaxedPlan:
    """Plan a task or, where there is no plan, the one that asks for least less: the weighted loosening is least.

    Conjuncts of the formula are loosened: areas to be in grow, areas to avoid shrink, bounds move. Times, limits and
    solid obstacles stay.

    Args:
        scenario: as it is believed.
        weights: price of a metre of loosening, of each conjunct in their order; none: the scenario's, or 1 each.
        max_impacts, time_limit, solver, options: as for `make_free_flyer_plan`.
        relaxation: how the relaxed task is planned.

    Returns:
        The plan, which the independent simulation has confirmed for the relaxed task, and what it gives up.

    Raises:
        InputError: bad weights, or as `make_free_flyer_plan`.
        Infeasible: no loosening of the formula gives a plan.
        SolverFailed: none was found in time.
    """
    conjuncts = list_conjuncts(scenario)
    prices = check_weights(weights or scenario.weights, conjuncts)
    scenario = scenario.model_copy(update={"weights": ()})  # parts of the formula have no prices of their own
    budget = Budget(time_limit)
    given = {"max_impacts": max_impacts, "solver": solver}
    brief = replace(options, diagnosis=0.0)
    try:
        plan = make_free_flyer_plan(scenario, time_limit=relaxation.unrelaxed * time_limit, options=brief, **given)  # type: ignore[arg-type]
        return RelaxedPlan(plan, scenario, (), plan.robustness)
    except PlanningError as error:
        failure = error
    reserves = Reserves()
    for _ in range(options.halvings):
        reserves = reserves.halved()
    calm = replace(options, diagnosis=0.0, halvings=0)
    search = _Search(scenario, prices, given, reserves, calm, relaxation, budget)
    for slack in relaxation.slacks:
        if budget.left > 0.0 and search.best is None:
            search.find(slack)
    if search.best is None:
        search.find_rest()
    if search.best is None:
        status = f"{failure.status}; and with less asked for no plan was found within {time_limit:g} s, either"
        raise type(failure)(failure.problem, status, failure.remedy) from failure
    return search.finish()


@dataclass
class _Search:
    """Look for the plan that gives up least.

    Args:
        scenario: as it was asked for.
        prices: of the conjuncts.
        given: options of every plan.
        reserves: that plans keep.
        options: of plans.
        relaxation: how the relaxed task is planned.
        budget: time.
        best: plan that gives up least so far.
        task: of this plan.
        least: greatest loosening of the only conjunct that is loosened that is proven to be too little [m].
        low: greatest price for which a plan was looked for and not found.
    """

    scenario: FreeFlyerScenario
    prices: Sequence[float]
    given: dict[str, Any]
    reserves: Reserves
    options: PlanOptions
    relaxation: RelaxationOptions
    budget: Budget
    best: Plan | None = None
    task: FreeFlyerScenario | None = None
    least: float | None = None
    low: float = 0.0

    @property
    def most_impacts(self) -> int:
        """Return the greatest number of impacts."""
        given = self.given["max_impacts"]
        return find_most_impacts(self.scenario) if given is None else given

    def find(self, slack: float) -> None:
        """Find the least loosening, a plan with it or a little more, and then by bisection plans with less."""
        relaxation = self.relaxation
        reserves = replace(self.reserves, slack=slack * self.reserves.slack)
        limit = relaxation.finding * self.budget.left
        solver, scenario = self.given["solver"], self.scenario
        try:
            amounts = _find_amounts(scenario, self.prices, self.most_impacts, reserves, limit, solver, self.options)
        except PlanningError:
            return
        total = self._price(amounts)
        if total <= 0.0:
            return
        low = self._prove(amounts) * total
        if sum(amount > 0.0 for amount in amounts) == 1:
            self.least = low / self.prices[int(np.argmax(amounts))]
        for factor in relaxation.factors:
            if self._try([factor * amount for amount in amounts], reserves):
                break
            low = factor * total
        while self.best is not None and self.budget.left > 0.0:
            high = self._price([one.missed for one in measure_missed(scenario, self.best)])
            if high - low <= relaxation.tolerance * high:
                break
            middle = 0.5 * (low + high)
            if not self._try([middle / total * amount for amount in amounts], reserves):
                low = middle
        self.low = low

    def find_rest(self) -> None:
        """Find a plan that hits nothing: it takes hardly any time, and is better than none."""
        limit, solver = self.relaxation.finding * self.budget.limit, self.given["solver"]
        with suppress(PlanningError):
            amounts = _find_amounts(self.scenario, self.prices, 0, self.reserves, limit, solver, self.options)
            self._try(amounts, self.reserves, limit)

    def _price(self, amounts: Sequence[float]) -> float:
        """Return the price of missing conjuncts by so much."""
        return sum(price * max(0.0, amount) for price, amount in zip(self.prices, amounts, strict=True))

    def _prove(self, amounts: Sequence[float]) -> float:
        """Return the greatest share of a loosening with which places, times and speeds still leave no plan."""
        low, high = 0.0, 1.0
        for _ in range(12):
            middle = 0.5 * (low + high)
            task = loosen(self.scenario, [middle * amount for amount in amounts])
            demands = read_demands(task, self.reserves.wall)
            if find_impossibility(task, demands, self.most_impacts, Kept()) is None:
                high = middle
            else:
                low = middle
        return low

    def _try(self, amounts: Sequence[float], reserves: Reserves, limit: float | None = None) -> bool:
        """Return whether the loosened task has a plan that gives up less than the best one, and keep it."""
        limit = self.relaxation.trial * self.budget.left if limit is None else limit
        if limit <= 0.0:
            return False
        room = self.relaxation.room * find_frame(self.scenario).length
        task = loosen(self.scenario, [amount + room if amount > 0.0 else 0.0 for amount in amounts])
        try:
            plan = make_free_flyer_plan(task, time_limit=limit, reserves=reserves, options=self.options, **self.given)
        except PlanningError:
            return False
        price, best = (
            math.inf if one is None else self._price([part.missed for part in measure_missed(self.scenario, one)])
            for one in (plan, self.best)
        )
        if price < best:
            self.best, self.task = plan, task
        return price < best

    def finish(self) -> RelaxedPlan:
        """Return the best plan, of which there is one."""
        assert self.best is not None
        assert self.task is not None
        given_up = tuple(list_given_up(self.scenario, self.best))
        bound = self.least if len(given_up) == 1 and self.least else None
        return RelaxedPlan(self.best, self.task, given_up, measure(self.scenario, self.best), bound, self.low)


def check_weights(weights: Sequence[float], conjuncts: Sequence[Formula]) -> list[float]:
    """Return one weight for each conjunct.

    Raises:
        InputError: another number of them, or one that is not positive.
    """
    if not weights:
        return [1.0] * len(conjuncts)
    if len(weights) != len(conjuncts):
        listed = "; ".join(map(str, conjuncts))
        raise InputError(f"{len(weights)} weights for {len(conjuncts)} conjuncts: {listed}")
    for weight in weights:
        if not 0.0 < weight < float("inf"):
            raise InputError(f"weight {weight:g}: a positive number is needed")
    return list(weights)


def _find_amounts(
    scenario: FreeFlyerScenario,
    weights: Sequence[float],
    most: int,
    reserves: Reserves,
    time_limit: float,
    solver: str,
    options: PlanOptions,
) -> list[float]:
    """Return by how much each conjunct has to be loosened [m]; zeros: nothing was found.

    Raises:
        Infeasible: even without the formula there is no plan.
    """
    frame = find_frame(scenario)
    inside = frame.enter(scenario)
    demands = read_demands(inside, reserves.wall)
    task = NominalTask(inside, demands, reserves, solver, Work(), frame)
    pieces = min(count_pieces(inside, demands, reserves.wall) or 1, options.most_pieces)
    found = find_relaxation(task, most, options.least, time_limit, pieces, weights)
    return list_amounts(task, found)

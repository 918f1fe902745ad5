"""Plan what can be planned of a task that has no plan: the minimally violating one (`impact plan --relax`)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from impact_envs.errors import InputError
from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.stl import Formula
from planners.budget import Budget, Work
from planners.errors import PlanningError
from planners.free_flyer.frame import find_frame
from planners.free_flyer.nominal.diagnosis import find_relaxation, list_amounts
from planners.free_flyer.nominal.planner import make_free_flyer_plan
from planners.free_flyer.nominal.task import NominalTask, PlanOptions
from planners.free_flyer.nominal.ways import count_pieces
from planners.free_flyer.reserves import Reserves
from planners.free_flyer.specification.loosening import list_conjuncts, loosen
from planners.free_flyer.specification.requirement import read_demands
from planners.free_flyer.validation import compute_robustness
from planners.plan import Plan


@dataclass(frozen=True)
class RelaxationOptions:
    """Choose how a relaxed task is planned.

    Args:
        unrelaxed: share of the time for a plan that gives up nothing.
        finding: share of the time left for the least loosening.
        factors: of this loosening, tried in turn: the least one leaves motions no room.
        room: by which what is loosened is loosened more, in a world of robots of 0.2 m [m].
    """

    unrelaxed: float = 0.3
    finding: float = 0.4
    factors: tuple[float, ...] = (1.0, 1.15, 1.5)
    room: float = 0.02


@dataclass(frozen=True)
class GivenUp:
    """Say what a plan gives up of a formula.

    Args:
        conjunct: as the user wrote it.
        missed: by how much it is missed [m].
    """

    conjunct: str
    missed: float


@dataclass(frozen=True)
class RelaxedPlan:
    """Hold a plan of a relaxed task.

    Args:
        plan: checked against the relaxed task.
        scenario: the relaxed task.
        given_up: conjuncts that the plan misses; empty: it gives up nothing.
        robustness: of the formula as it was asked [m].
    """

    plan: Plan
    scenario: FreeFlyerScenario
    given_up: tuple[GivenUp, ...]
    robustness: float


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
    most = 3 + 3 * len(scenario.objects) if max_impacts is None else max_impacts
    amounts = _find_amounts(scenario, prices, most, reserves, relaxation.finding * budget.left, solver, options)
    if not any(amounts):
        raise failure
    room = relaxation.room * find_frame(scenario).length
    for left, factor in zip(range(len(relaxation.factors), 0, -1), relaxation.factors, strict=True):
        if budget.left <= 0.0:
            break
        task = loosen(scenario, [factor * amount + room if amount > 0.0 else 0.0 for amount in amounts])
        try:
            calm = replace(brief, halvings=0)
            part = budget.left / left
            plan = make_free_flyer_plan(task, time_limit=part, reserves=reserves, options=calm, **given)  # type: ignore[arg-type]
        except PlanningError as error:
            failure = error
            continue
        return RelaxedPlan(plan, task, tuple(list_given_up(scenario, plan)), measure(scenario, plan))
    raise failure


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


def list_given_up(scenario: FreeFlyerScenario, plan: Plan) -> list[GivenUp]:
    """Return the conjuncts of a scenario's formula that a plan misses, with how much it misses them by.

    Args:
        scenario: as it was asked for.
        plan: of its robots and objects.
    """
    found = []
    for conjunct in list_conjuncts(scenario):
        fields = {field: getattr(scenario, field) for field in FreeFlyerScenario.model_fields}
        missed = -measure(FreeFlyerScenario(**fields | {"formula": str(conjunct)}), plan)
        if missed > 0.0:
            found.append(GivenUp(str(conjunct), missed))
    return found


def measure(scenario: FreeFlyerScenario, plan: Plan) -> float:
    """Return the robustness of a scenario's formula over a plan's curves at the control steps [m]."""
    times = np.linspace(0.0, scenario.horizon, round(scenario.horizon / scenario.control_period) + 1)
    curves = plan.robots | plan.objects
    return compute_robustness(scenario, times, {name: curve.position(times) for name, curve in curves.items()})

"""Experts: optimisation and control. Two doors: make_plan and make_expert."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from impact_envs.errors import InputError, choices
from impact_envs.scenario import Scenario, load_scenario
from planners.errors import Infeasible, PlanningError, SolverFailed

if TYPE_CHECKING:
    from planners.plan import Plan

__all__ = ["Infeasible", "PlanningError", "SolverFailed", "make_expert", "make_plan"]

# Planners by objective and expert of each domain, loaded with their solvers when first used.
PLANNERS = {
    "free_flyer": {
        "robustness": ("planners.free_flyer.event_milp", "make_free_flyer_plan"),
        "impact_uncertainty": ("planners.free_flyer.impact_robust", "make_impact_robust_plan"),
    }
}
EXPERTS = {"free_flyer": ("planners.free_flyer.expert", "FreeFlyerExpert")}


def make_plan(scenario: str | Path | Scenario, objective: str = "robustness", **options: Any) -> Plan:
    """Plan a scenario as it is believed to be, and check the plan by an independent simulation.

    Args:
        scenario: a shipped name, the path of a TOML file, or a Scenario.
        objective: what to maximise; free flyers have "robustness" and "impact_uncertainty".
        options: of the domain's planner (``max_impacts``, ``time_limit``, ``solver``).

    Returns:
        A validated Plan with its proven bound.

    Raises:
        InputError: bad scenario or option.
        Infeasible: no plan exists within the limits.
        SolverFailed: a solver stopped early, or the plan failed the check.
    """
    loaded = load_scenario(scenario)
    objectives = _of_domain(PLANNERS, loaded)
    if objective not in objectives:
        raise InputError(f"objective '{objective}' is unknown; {choices(objective, objectives)}")
    module, name = objectives[objective]
    return getattr(import_module(module), name)(loaded.as_believed(), **options)


def make_expert(scenario: str | Path | Scenario, plan: Plan | None = None) -> Any:
    """Make the expert policy of a scenario; it never sees the true physics.

    Args:
        scenario: a shipped name, the path of a TOML file, or a Scenario.
        plan: to execute; planned now without one.

    Returns:
        A Policy that also takes corrections (see agents.residual).

    Raises:
        InputError, PlanningError: as make_plan; InputError also when the plan is another scenario's.
    """
    loaded = load_scenario(scenario)
    module, name = _of_domain(EXPERTS, loaded)
    if plan is None:
        plan = make_plan(loaded)
    elif set(plan.robots) != set(loaded.agents):
        raise InputError(
            f"the plan is for {plan.scenario} with {', '.join(plan.robots)}; "
            f"scenario {loaded.name} has {', '.join(loaded.agents)}"
        )
    return getattr(import_module(module), name)(loaded.as_believed(), plan)


def _of_domain(table: dict[str, Any], scenario: Scenario) -> Any:
    if scenario.domain not in table:
        raise InputError(f"no expert for domain '{scenario.domain}'; {choices(scenario.domain, table)}")
    return table[scenario.domain]

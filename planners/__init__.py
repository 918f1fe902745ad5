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

__all__ = [
    "Infeasible",
    "PlanningError",
    "SolverFailed",
    "check_planned",
    "has_planner",
    "list_variants",
    "make_expert",
    "make_expert_batch",
    "make_plan",
]

# Planners by objective and expert of each domain, loaded with their solvers when first used.
PLANNERS = {
    "free_flyer": {
        "robustness": ("planners.free_flyer.nominal.planner", "make_free_flyer_plan"),
        "impact_uncertainty": ("planners.free_flyer.robust.planner", "make_impact_robust_plan"),
    }
}
EXPERTS = {
    "dual_arm": ("planners.dual_arm.expert", "make_dual_arm_expert"),
    "floating_manipulator": ("planners.floating_manipulator.expert", "make_floating_manipulator_expert"),
    "free_flyer": ("planners.free_flyer.expert", "FreeFlyerExpert"),
}
# Experts' published forms and baselines, by the names they go by as policies.
VARIANTS = {
    "dual_arm": ("published", "no_impact_map", "no_interim_phase", "no_synchronisation"),
    "floating_manipulator": ("published", "printed", "measured_base"),
    "free_flyer": (
        "one_replan",
        "paper_expert",
        "with_learning",
        "with_retiming",
        "with_drift",
        "with_insertion",
        "with_reoptimisation",
    ),
}


def make_plan(scenario: str | Path | Scenario, objective: str = "robustness", **options: Any) -> Plan:
    """Plan a scenario as it is believed to be, and check the plan by an independent simulation.

    Args:
        scenario: a shipped name, the path of a TOML file, or a Scenario.
        objective: what to maximise; free flyers have "robustness" and "impact_uncertainty".
        options: of the domain's planner (``max_impacts``, ``time_limit``, ``solver``, ``reserves``, ``options``).

    Returns:
        A validated Plan with its proven bound.

    Raises:
        InputError: bad scenario or option.
        Infeasible: no plan exists within the limits.
        SolverFailed: a solver stopped early, or the plan failed the check.
    """
    loaded = load_scenario(scenario)
    check_planned(loaded)
    objectives = PLANNERS[loaded.domain]
    if objective not in objectives:
        raise InputError(f"objective '{objective}' is unknown; {choices(objective, objectives)}")
    module, name = objectives[objective]
    return getattr(import_module(module), name)(loaded.as_believed(), **options)


def make_expert(scenario: str | Path | Scenario, plan: Plan | None = None, variant: str | None = None) -> Any:
    """Make the expert policy of a scenario; it never sees the true physics.

    Args:
        scenario: a shipped name, the path of a TOML file, or a Scenario.
        plan: to execute; planned now without one, where the domain has a planner.
        variant: a published form or baseline to compare the expert with, see list_variants.

    Returns:
        A Policy that also takes corrections (see agents.residual), where the variant does.

    Raises:
        InputError, PlanningError: as make_plan; InputError also when the plan is another scenario's, or the variant is
            unknown.
    """
    loaded = load_scenario(scenario)
    module, name = EXPERTS[loaded.domain]
    variants = list_variants(loaded)
    if variant is not None and variant not in variants:
        raise InputError(f"domain '{loaded.domain}' has no variant '{variant}'; {choices(variant, variants)}")
    if not has_planner(loaded):
        if plan is not None:
            check_planned(loaded)
        return getattr(import_module(module), name)(loaded.as_believed(), variant)
    if plan is None:
        plan = make_plan(loaded)
    elif set(plan.robots) != set(loaded.agents):
        raise InputError(
            f"the plan is for {plan.scenario} with {', '.join(plan.robots)}; "
            f"scenario {loaded.name} has {', '.join(loaded.agents)}"
        )
    return getattr(import_module(module), name)(loaded.as_believed(), plan, variant)


def make_expert_batch(
    scenario: str | Path | Scenario,
    count: int,
    plan: Plan | None = None,
    variant: str | None = None,
    threads: int = 1,
) -> Any:
    """Make the experts of the worlds of a vector environment: ``actions = experts.act(observations)``.

    Args:
        scenario: a shipped name, the path of a TOML file, or a Scenario; of discs.
        count: how many worlds.
        plan: to execute; planned now without one.
        variant: what the expert is compared with, see list_variants.
        threads: that share the worlds.

    Returns:
        A FreeFlyerExpertBatch; world k acts as make_expert's policy does.

    Raises:
        InputError, PlanningError: as make_expert; InputError also for a domain whose expert knows one world only.
    """
    loaded: Any = load_scenario(scenario)
    check_planned(loaded)
    from planners.free_flyer.expert_batch import FreeFlyerExpertBatch

    chosen = make_plan(loaded) if plan is None else plan
    return FreeFlyerExpertBatch(loaded.as_believed(), chosen, count, variant, threads=threads)


def list_variants(scenario: Scenario) -> tuple[str, ...]:
    """Return the published forms and baselines of a scenario's expert."""
    return VARIANTS.get(scenario.domain, ())


def has_planner(scenario: Scenario) -> bool:
    """Return whether a scenario's expert executes a plan made beforehand."""
    return scenario.domain in PLANNERS


def check_planned(scenario: Scenario) -> None:
    """Raise unless a scenario can be planned.

    Raises:
        InputError: its domain has no planner.
    """
    if not has_planner(scenario):
        raise InputError(
            f"scenario '{scenario.name}' has domain '{scenario.domain}', whose expert follows no plan; "
            f"domains with a planner: {', '.join(PLANNERS)}"
        )

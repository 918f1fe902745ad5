"""Experts: optimisation and control. Two doors: make_plan and make_expert."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from impact_envs.domain import find_part, list_domains, load_attribute
from impact_envs.errors import InputError, check_count, choices
from impact_envs.scenario import Scenario, load_scenario
from planners.errors import Infeasible, PlanningError, SolverFailed
from planners.options import list_options as flatten
from planners.options import replace_options

if TYPE_CHECKING:
    from planners.free_flyer.tracking.protocol import Tracker
    from planners.plan import Plan

__all__ = [
    "Infeasible",
    "PlanningError",
    "SolverFailed",
    "check_options",
    "check_oracle",
    "check_planned",
    "has_planner",
    "list_options",
    "list_variants",
    "make_expert",
    "make_expert_batch",
    "make_oracle",
    "make_oracle_batch",
    "make_plan",
]


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
    objectives = find_part("planners", loaded.domain, "PLANNERS")
    if objective not in objectives:
        raise InputError(f"objective '{objective}' is unknown; {choices(objective, objectives)}")
    return load_attribute(objectives[objective])(loaded.as_believed(), **options)


def make_expert(
    scenario: str | Path | Scenario,
    plan: Plan | None = None,
    variant: str | None = None,
    options: Mapping[str, Any] | None = None,
    tracker: str | Tracker | None = None,
) -> Any:
    """Make the expert policy of a scenario; it never sees the true physics.

    Args:
        scenario: a shipped name, the path of a TOML file, or a Scenario.
        plan: to execute; by default planned now, where the domain has a planner.
        variant: a published form or baseline to compare the expert with, see list_variants; default: the expert.
        options: dotted name to value, see list_options, for example ``{"retiming.frozen": 3.0}``.
        tracker: what follows the courses of free-flyers: a name or an object, see docs/trackers.md.

    Returns:
        A Policy that also takes corrections (see agents.residual), where the variant does.

    Raises:
        InputError, PlanningError: as make_plan; InputError also when the plan is another scenario's, or the variant or
            an option is unknown, or the expert has no trackers to choose from.
    """
    loaded = load_scenario(scenario)
    arguments = _choose(loaded, variant, options)
    if tracker is not None:
        if "tracker" not in list_options(loaded, variant):
            raise InputError(
                f"tracker = {tracker!r}: the expert of domain '{loaded.domain}' has no trackers to choose from"
            )
        arguments["tracker"] = tracker
    make = find_part("planners", loaded.domain, "EXPERT")
    if not has_planner(loaded):
        if plan is not None:
            check_planned(loaded)
        return make(loaded.as_believed(), **arguments)
    if plan is None:
        plan = make_plan(loaded)
    else:
        check_plan(loaded, plan)
    return make(loaded.as_believed(), plan, **arguments)


def make_expert_batch(
    scenario: str | Path | Scenario,
    count: int,
    plan: Plan | None = None,
    variant: str | None = None,
    options: Mapping[str, Any] | None = None,
    threads: int = 1,
) -> Any:
    """Make the experts of the worlds of a vector environment: ``actions = experts.act(observations)``.

    Args:
        scenario: a shipped name, the path of a TOML file, or a Scenario.
        count: how many worlds.
        plan: to execute; by default planned now, where the domain has a planner.
        variant: what the expert is compared with, see list_variants.
        options: as make_expert.
        threads: that share the worlds.

    Returns:
        The domain's batch of experts; world k acts as make_expert's policy does.

    Raises:
        InputError, PlanningError: as make_expert; InputError also for a domain whose expert knows one world only.
    """
    loaded = load_scenario(scenario)
    check_count("count", count)
    check_count("threads", threads)
    make = find_part("planners", loaded.domain, "EXPERT_BATCH")
    if make is None:
        raise InputError(f"scenario '{loaded.name}': the expert of domain '{loaded.domain}' knows one world only")
    arguments = _choose(loaded, variant, options)
    if not has_planner(loaded):
        if plan is not None:
            check_planned(loaded)
        return make(loaded.as_believed(), count, **arguments, threads=threads)
    if plan is None:
        plan = make_plan(loaded)
    else:
        check_plan(loaded, plan)
    return make(loaded.as_believed(), plan, count, **arguments, threads=threads)


def make_oracle(
    scenario: str | Path | Scenario, plan: Plan | None = None, options: Mapping[str, Any] | None = None
) -> Any:
    """Make the expert that is told the true physics of every episode: it bounds what learning can gain.

    It does not look for the truth: whoever judges it calls ``tell(physics)`` after ``reset``.

    Args:
        scenario: a shipped name, the path of a TOML file, or a Scenario.
        plan: to execute; by default planned now.
        options: as make_expert.

    Raises:
        InputError, PlanningError: as make_expert; InputError also where a domain's expert cannot be told.
    """
    loaded = load_scenario(scenario)
    check_oracle(loaded)
    plan, chosen = _prepare(loaded, plan, options)
    return find_part("planners", loaded.domain, "ORACLE")(loaded.as_believed(), plan, **chosen)


def make_oracle_batch(
    scenario: str | Path | Scenario,
    count: int,
    plan: Plan | None = None,
    options: Mapping[str, Any] | None = None,
    threads: int = 1,
) -> Any:
    """Make the oracles of the worlds of a vector environment; see make_oracle and make_expert_batch.

    ``tell(physics)`` takes what ``scenario.draw_many`` returns for all worlds, before their first observations.
    """
    loaded = load_scenario(scenario)
    check_oracle(loaded)
    plan, chosen = _prepare(loaded, plan, options)
    make = find_part("planners", loaded.domain, "ORACLE_BATCH")
    return make(loaded.as_believed(), plan, count, **chosen, threads=threads)


def check_oracle(scenario: Scenario) -> None:
    """Raise unless a scenario's expert can be told the truth.

    Raises:
        InputError: its domain has no oracle.
    """
    if find_part("planners", scenario.domain, "ORACLE") is None:
        told = [name for name in list_domains() if find_part("planners", name, "ORACLE")]
        raise InputError(
            f"scenario '{scenario.name}': the expert of domain '{scenario.domain}' cannot be told the truth; "
            f"domains with an oracle: {', '.join(told)}"
        )


def _prepare(scenario: Scenario, plan: Plan | None, options: Mapping[str, Any] | None) -> tuple[Plan, dict[str, Any]]:
    """Return the plan to execute, made now if none is given, and options as the oracle's maker takes them."""
    chosen = _choose(scenario, None, options)
    chosen.pop("variant")
    if plan is None:
        return make_plan(scenario), chosen
    check_plan(scenario, plan)
    return plan, chosen


def check_plan(scenario: Scenario, plan: Plan) -> None:
    """Raise unless a plan was made for a scenario of this name, with these robots and objects.

    Raises:
        InputError: it is no Plan, or another scenario's.
    """
    if not (hasattr(plan, "robots") and hasattr(plan, "objects")):
        raise InputError(f"plan = {plan!r:.60}: a Plan is needed, from make_plan or Plan.load")
    bodies = (*plan.robots, *plan.objects)
    if plan.scenario != scenario.name or set(bodies) != set(scenario.bodies):
        raise InputError(
            f"the plan is for {plan.scenario} with {', '.join(bodies)}; "
            f"scenario {scenario.name} has {', '.join(scenario.bodies)}"
        )


def _choose(scenario: Scenario, variant: str | None, options: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return variant and options as the expert's maker takes them."""
    variants = list_variants(scenario)
    if variant is not None and variant not in variants:
        raise InputError(f"domain '{scenario.domain}' has no variant '{variant}'; {choices(variant, variants)}")
    if not options:
        return {"variant": variant}
    get_options = find_part("planners", scenario.domain, "OPTIONS")
    if get_options is None:
        raise InputError(f"the expert of domain '{scenario.domain}' has no options, got {', '.join(options)}")
    return {"variant": variant, "options": replace_options(get_options(variant), options)}


def check_options(
    scenario: Scenario, options: Mapping[str, Any], variant: str | None = None, many: bool = False
) -> None:
    """Raise unless a scenario's expert has the options, and they fit.

    Args:
        scenario: whose expert it is.
        options: dotted name to value.
        variant: of the expert.
        many: whether it is an expert of many worlds.

    Raises:
        InputError: as make_expert, or as make_expert_batch.
    """
    chosen, check = _choose(scenario, variant, options), find_part("planners", scenario.domain, "CHECK_OPTIONS")
    if check is not None and "options" in chosen:
        check(chosen["options"], many)


def list_options(scenario: Scenario, variant: str | None = None) -> dict[str, Any]:
    """Return the options of a scenario's expert by dotted names, with their values."""
    get_options = find_part("planners", scenario.domain, "OPTIONS")
    return flatten(get_options(variant)) if get_options else {}


def list_variants(scenario: Scenario) -> tuple[str, ...]:
    """Return the published forms and baselines of a scenario's expert."""
    return tuple(find_part("planners", scenario.domain, "VARIANTS") or ())


def has_planner(scenario: Scenario) -> bool:
    """Return whether a scenario's expert executes a plan made beforehand."""
    return find_part("planners", scenario.domain, "PLANNERS") is not None


def check_planned(scenario: Scenario) -> None:
    """Raise unless a scenario can be planned.

    Raises:
        InputError: its domain has no planner.
    """
    if not has_planner(scenario):
        planned = [name for name in list_domains() if find_part("planners", name, "PLANNERS")]
        raise InputError(
            f"scenario '{scenario.name}' has domain '{scenario.domain}', whose expert follows no plan; "
            f"domains with a planner: {', '.join(planned)}"
        )

"""The worlds that an evaluation or a run plays in: a scenario in a suite, with values changed by the user."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from impact_envs.domain import find_part
from impact_envs.errors import InputError, choices
from impact_envs.scenario import Scenario, load_scenario
from planners import check_options, check_oracle, check_planned, list_variants
from train.evaluation.own_policy import is_own

if TYPE_CHECKING:
    from planners.plan import Plan

# First seeds of tuning, of the report on what was tuned, and of evaluations; training uses those below. Kept apart.
TUNING_SEEDS, REPORT_SEEDS, EVALUATION_SEEDS = 1_000_000, 1_500_000, 2_000_000
BUILT_IN = ("expert", "oracle", "zero", "random")
EXPERT = "expert."  # how a changed value of the expert begins


@dataclass(frozen=True)
class Case:
    """A world to be judged in, and how the expert is set for it.

    Attributes:
        scenario: in its suite, with changed values.
        suite: name of the suite.
        settings: all changed values, dotted name to value; names of the expert's options begin with ``expert.``.
        plan: of the believed scenario; None if no policy follows one, or it is still to be made.
        objective: of the plan that is made where none is given.
    """

    scenario: Scenario
    suite: str
    settings: Mapping[str, Any] = field(default_factory=dict)
    plan: Plan | None = None
    objective: str = "robustness"

    @property
    def options(self) -> dict[str, Any]:
        """Return the changed options of the expert, as planners.make_expert takes them."""
        return {key.removeprefix(EXPERT): value for key, value in self.settings.items() if key.startswith(EXPERT)}


def make_case(
    scenario: str | Path | Scenario, suite: str = "nominal", settings: Mapping[str, Any] | None = None
) -> Case:
    """Make a case; values are changed after the suite has its say.

    Args:
        scenario: a shipped name, the path of a TOML file, or a Scenario.
        suite: mismatch suite of the true world.
        settings: dotted name to value: ``expert.NAME`` of the expert, others of the scenario.

    Raises:
        ScenarioError: the scenario, the suite or a name is unknown, or a value does not fit.
    """
    settings = dict(settings or {})
    world = {key: value for key, value in settings.items() if not key.startswith(EXPERT)}
    loaded = load_scenario(scenario).suite(suite)
    return Case(loaded.override(world) if world else loaded, suite, settings)


def make_cases(
    scenarios: Sequence[str | Path | Scenario], suites: Sequence[str], settings: Mapping[str, Any] | None = None
) -> list[Case]:
    """Make a case of every scenario in every suite; see make_case.

    Raises:
        InputError: as make_case, or a list that is empty or names something twice.
    """
    loaded = [load_scenario(scenario) for scenario in scenarios]
    check_names("scenario", [scenario.name for scenario in loaded])
    check_names("suite", suites)
    return [make_case(scenario, suite, settings) for scenario in loaded for suite in suites]


def check_names(kind: str, names: Sequence[str]) -> None:
    """Raise if there is no name, or one twice."""
    if not names:
        raise InputError(f"no {kind} to evaluate; name at least one")
    for place, name in enumerate(names):
        if name in names[:place]:
            raise InputError(f"{kind} '{name}' is given twice; {choices('', sorted(set(names)))}")


def list_changes(scenario: Scenario, suite: str) -> dict[str, Any]:
    """Return what a suite changes: dotted keys of the scenario to values or ranges."""
    shipped = tomllib.loads(scenario.suite_file.read_text()) if scenario.suite_file else {}
    changes: dict[str, Any] = {**shipped, **scenario.suites}.get(suite, {})
    return changes


def has_expert(policy: str) -> bool:
    """Return whether a policy of this name has an expert, and so options and mostly a plan."""
    if policy in ("zero", "random") or is_own(policy):
        return False
    if policy == "expert" or not Path(policy).is_dir():
        return True
    from agents.shared_actor import is_shared  # imported here: the expert alone needs no torch

    return not is_shared(Path(policy))


def check_settings(case: Case, policies: Sequence[str], many: bool = False) -> None:
    """Raise unless the experts of the policies are there, and have the changed options.

    Args:
        case: world to be judged in.
        policies: that play.
        many: whether they play many worlds at once.

    Raises:
        InputError: an option is unknown or its value does not fit, or no policy has an expert, or none can be told the
            truth.
    """
    if "oracle" in policies:
        check_oracle(case.scenario)
    if not case.options:
        return
    variants = list_variants(case.scenario)
    experts = [policy for policy in policies if has_expert(policy)]
    if not experts:
        raise InputError(f"{EXPERT}{next(iter(case.options))}: policy {', '.join(policies)} has no expert to set")
    for policy in experts:
        check_options(case.scenario, case.options, policy if policy in variants else None, many)


def check_plan(case: Case, policies: Sequence[str]) -> None:
    """Raise unless the plan that is given or asked for can be followed.

    Raises:
        InputError: it does not fit the scenario, whose expert may follow none, or no policy has an expert.
    """
    if case.plan is None and case.objective == "robustness":
        return
    if not any(map(has_expert, policies)):
        raise InputError(f"policy {', '.join(policies)} has no expert that follows a plan")
    check_planned(case.scenario)
    if case.plan is not None:
        find_part("planners", case.scenario.domain, "CHECK_PLAN")(case.scenario, case.plan)


def is_built_in(policy: str, scenario: Scenario) -> bool:
    """Return whether a policy of this name needs no checkpoint in a scenario."""
    return is_own(policy) or policy in (*BUILT_IN, *list_variants(scenario))

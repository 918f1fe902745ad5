"""Plans that were made elsewhere or before, and what they break."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from impact_envs.errors import InputError, choices
from train.evaluation.case import Case

if TYPE_CHECKING:
    from planners.free_flyer.published.violation import Violation
    from planners.plan import Plan


class GivenPlan(NamedTuple):
    """A plan that was made elsewhere or before.

    Attributes:
        path: where it is from.
        plan: with the scenario's names.
        names: of bodies in the file that differ from the scenario's.
        violations: what it breaks.
    """

    path: Path
    plan: Plan
    names: dict[str, str]
    violations: tuple[Violation, ...]

    def describe(self) -> dict[str, Any]:
        """Return names, violations and whether it may be flown, as they are printed."""
        return {
            "renamed": self.names,
            "accepted": not any(one.refused for one in self.violations),
            "violations": [asdict(one) for one in self.violations],
        }

    def admit(self, force: bool) -> Plan:
        """Return the plan after saying what it breaks, one line each on standard error.

        Args:
            force: whether it is flown whatever it breaks.

        Raises:
            InputError: it breaks too much.
        """
        refused = [one for one in self.violations if one.refused]
        if refused and not force:
            more = f" and {len(refused) - 1} more" if len(refused) > 1 else ""
            raise InputError(
                f"plan {self.path}: {refused[0]}{more}; impact plan --check lists all, --force flies it all the same"
            )
        for old, new in self.names.items():
            print(f"plan {self.path}: its {old} is {new}", file=sys.stderr)
        for one in self.violations:
            print(f"plan {self.path}: {one}", file=sys.stderr)
        return self.plan


def check_plan_options(plan: Path | Sequence[str] | None, rename: tuple[str, ...], force: bool) -> None:
    """Raise if something is said of a plan to execute and there is none.

    Raises:
        InputError: naming the option.
    """
    for option, wanted in (("--rename", rename), ("--force", force)):
        if wanted and not plan:
            raise InputError(f"{option} needs --plan, a plan to execute")


def load_plan(path: Path, scenario: Any, rename: tuple[str, ...] = ()) -> GivenPlan:
    """Return the plan of a JSON file, or of a folder of published CSV files, and what it breaks.

    Args:
        path: file or folder.
        scenario: that it is for.
        rename: names of bodies in a published plan, each PLAN=SCENARIO.

    Raises:
        InputError: it does not hold a plan, or not one for the scenario.
    """
    from planners import check_plan, check_planned
    from planners.free_flyer.published.violation import list_violations

    check_planned(scenario)
    given = _parse_names(rename)
    if path.is_dir():
        from planners.free_flyer.published.conversion import convert_published_plan
        from planners.free_flyer.published.names import match_names
        from planners.free_flyer.published.plan_file import read_published_plan

        published = read_published_plan(path)
        try:
            names = match_names(published, scenario, given)
            plan = convert_published_plan(published, scenario, names)
        except InputError as error:
            raise InputError(f"plan {path}: {error}") from None
    else:
        from planners.plan import Plan

        if rename:
            raise InputError(f"--rename {' '.join(rename)}: {path} is no folder of published plan files")
        plan, names = Plan.load(path), {}
        check_plan(scenario, plan)
    changed = {old: new for old, new in names.items() if old != new}
    return GivenPlan(path, plan, changed, list_violations(scenario, plan))


def load_plans(
    cases: Sequence[Case], texts: Sequence[str], rename: tuple[str, ...] = (), force: bool = False
) -> dict[str, Plan]:
    """Return the plans that the user gives scenarios, by the scenarios' names, after saying what they break.

    Args:
        cases: to be judged in.
        texts: PATH of the plan of the only scenario, or SCENARIO=PATH each.
        rename: names of bodies in a published plan, each PLAN=SCENARIO; for one plan.
        force: whether a plan is flown whatever it breaks.

    Raises:
        InputError: a text names no scenario of these, or one twice; or its plan cannot be read, does not fit or breaks
            too much.
    """
    scenarios = {case.scenario.name: case.scenario for case in reversed(cases)}  # each in its first suite
    paths = _name_plans(texts, [*reversed(scenarios)])
    if rename and len(paths) > 1:
        raise InputError(f"--rename {' '.join(rename)}: is for one plan, got {len(paths)}")
    return {name: load_plan(path, scenarios[name], rename).admit(force) for name, path in paths.items()}


def _name_plans(texts: Sequence[str], scenarios: Sequence[str]) -> dict[str, Path]:
    """Return scenarios to paths; the path of a file may have an = of its own where there is one scenario."""
    if len(texts) == len(scenarios) == 1 and not texts[0].startswith(f"{scenarios[0]}="):
        named = "=" in texts[0] and "/" not in texts[0].partition("=")[0]
        if not named or Path(texts[0]).exists():
            return {scenarios[0]: Path(texts[0])}
    paths = dict[str, Path]()
    for text in texts:
        name, equals, path = text.partition("=")
        if not equals or not path:
            raise InputError(f"--plan {text}: is for one scenario, got {', '.join(scenarios)}: SCENARIO=PATH each")
        if name not in scenarios:
            raise InputError(f"--plan {text}: scenario '{name}' is not asked for; {choices(name, scenarios)}")
        if name in paths:
            raise InputError(f"--plan {text}: scenario '{name}' has a plan already: {paths[name]}")
        paths[name] = Path(path)
    return paths


def _parse_names(texts: tuple[str, ...]) -> dict[str, str]:
    names: dict[str, str] = {}
    for text in texts:
        old, equals, new = (part.strip() for part in text.partition("="))
        if not (old and equals and new):
            raise InputError(f"--rename {text}: expected PLAN=SCENARIO, for example snap=pop")
        if old in names:
            raise InputError(f"--rename {text}: '{old}' is renamed twice, to '{names[old]}' before")
        names[old] = new
    return names

"""The ``impact certify`` command."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar

from tyro.conf import Positional, arg

from impact_envs.domain import find_part
from impact_envs.errors import InputError
from impact_envs.scenario import list_scenarios, load_scenario


@dataclass
class Command:
    """Check a plan file in exact arithmetic over continuous time, by none of the planner's code.

    Exit code 0: everything is confirmed; 1: something is refused; 2: the file or the scenario is no plan's.
    """

    extras: ClassVar[tuple[str, ...]] = ()
    plan: Annotated[Positional[Path], arg(metavar="PLAN")]
    """JSON file that impact plan --out wrote."""
    scenario: str | None = None
    """Shipped name or TOML file; without, the shipped scenario that the plan names."""
    suite: str = "nominal"
    """Suite that the plan was made in, where it shortens the horizon."""
    json: bool = False

    def run(self) -> dict[str, Any]:
        """Return every check with what was found, and the robustness at the samples and over continuous time."""
        loaded = load_scenario(self.scenario or find_scenario(self.plan))
        scenario = loaded.suite(self.suite)
        certify = find_part("planners", scenario.domain, "CERTIFICATE")
        if certify is None:
            raise InputError(f"scenario '{scenario.name}': plans of domain '{scenario.domain}' cannot be certified")
        certificate = certify(self.plan, scenario, loaded)
        result = {"plan": str(self.plan), "scenario": scenario.name, **certificate.to_dict()}
        if certificate.deviation is not None:
            result["warning"] = (
                f"that it bears deviations up to {certificate.deviation:.4g} m/s is not certified: how a robot leaves "
                "its responses to meet the object is found in flight, and is not in the file"
            )
        return result


def find_scenario(path: Path) -> str:
    """Return the name of the shipped scenario that a plan file is for.

    Raises:
        InputError: the file cannot be read, names none, or another one.
    """
    name = read_scenario_name(path)
    if name not in list_scenarios():
        raise InputError(
            f"plan file {path}: scenario '{name}' is not a shipped one; name its file: --scenario FILE.toml"
        )
    return name


def read_scenario_name(path: Path) -> str:
    """Return the name of the scenario that a plan file is for.

    Raises:
        InputError: the file cannot be read, or names none.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"plan file {path}: cannot be read: {error.strerror}") from None
    except (ValueError, RecursionError):
        raise InputError(f"plan file {path}: not JSON of a plan") from None
    name = content.get("scenario") if isinstance(content, dict) else None
    if not isinstance(name, str):
        raise InputError(f"plan file {path}: names no scenario")
    return name

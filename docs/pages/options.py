"""The table of an expert's options, by domain: every number that somebody chose, with unit, value and meaning."""

from __future__ import annotations

from functools import reduce
from typing import Any

from docs.pages.comments import read_comments, split_comment
from docs.pages.table import make_table
from impact_envs import list_scenarios, load_scenario
from impact_envs.domain import find_part
from planners import list_options, list_variants


def write_options() -> str:
    """Return variants and options of each domain's expert, as ``--policy`` and ``--set`` take them."""
    scenarios = {scenario.domain: scenario for scenario in map(load_scenario, reversed(list_scenarios()))}
    parts = []
    for domain, scenario in scenarios.items():
        options = find_part("planners", domain, "OPTIONS")(None)
        rows = [
            [f"`expert.{name}`", f"`{value}`", *reversed(_read_meaning(options, name))]
            for name, value in list_options(scenario).items()
        ]
        variants = ", ".join(f"`{variant}`" for variant in list_variants(scenario))
        table = make_table(("option", "default", "unit", "meaning"), rows)
        parts.append(f"## `{domain}`\n\nVariants: {variants}.\n\n{table}")
    return "\n".join(parts)


def _read_meaning(options: Any, name: str) -> tuple[str, str]:
    """Return meaning and unit of an option by its dotted name."""
    *path, last = name.split(".")
    return split_comment(read_comments(type(reduce(getattr, path, options))).get(last, ""))

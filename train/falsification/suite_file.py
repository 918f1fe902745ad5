"""Counterexamples as suites of a scenario file, which every command takes."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from impact_envs.domain import find_scenarios
from impact_envs.errors import InputError
from impact_envs.file import write_atomically
from train.evaluation.case import EXPERT, Case, list_changes
from train.falsification.counterexample import Counterexample


def write_suites(case: Case, source: str, found: Sequence[Counterexample], path: Path) -> list[str]:
    """Write a copy of a scenario's file with a suite for each counterexample.

    The suites are those of the case, with its changed values, and every range narrowed to the counterexample's value.

    Args:
        case: that was searched.
        source: shipped name or file of its scenario.
        found: counterexamples.
        path: file to write.

    Returns:
        The suites' names.

    Raises:
        InputError: the scenario's file has suites of these names.
    """
    text = read_source(source)
    data = tomllib.loads(text)
    names = name_suites(found)
    taken = set(names) & set(data.get("suites", {}))
    if taken:
        raise InputError(f"{source}: has a suite '{min(taken)}' already; rename it")
    if "name" not in data:
        text = f"name = {json.dumps(case.scenario.name)}\n{text}"
    changed = {key: value for key, value in case.settings.items() if not key.startswith(EXPERT)}
    base = list_changes(case.scenario, case.suite) | changed
    for name, one in zip(names, found, strict=True):
        values = base | {key: {"uniform": [value, value]} for key, value in one.values.items()}
        moved = ", ".join(f"{key.removeprefix('true.')} {one.values[key]:.4g}" for key in one.moved) or "nothing"
        text += f"\n# {one.cause}. Not nominal: {moved}. Seed {one.seed}: robustness {one.robustness:.4g} m.\n"
        text += f"# Fails on {100 * one.failure_rate:.0f} % of other seeds.\n[suites.{name}]\n"
        text += "".join(f"{json.dumps(key)} = {_write(value)}\n" for key, value in values.items())
    write_atomically(path, text.encode())
    return names


def name_suites(found: Sequence[Counterexample]) -> list[str]:
    """Return the names of the counterexamples' suites, in their order."""
    return [f"break_{number}" for number in range(1, len(found) + 1)]


def read_source(source: str) -> str:
    """Return the text of a scenario's file.

    Args:
        source: shipped name or path.
    """
    shipped = {file.stem: file for file in find_scenarios()}
    return shipped.get(source, Path(source)).read_text(encoding="utf-8")


def _write(value: Any) -> str:
    """Return a value as TOML writes it."""
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{key} = {_write(item)}" for key, item in value.items()) + " }"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_write, value))}]"
    return json.dumps(value)  # numbers, texts and truth are written alike

"""The API page has every public name of the packages that a user imports."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "api.md"
# Names for those who extend the packages, and parts of formulas that nobody makes but the parser.
LEFT_OUT = {
    "planners": {"check_options", "check_oracle", "check_planned", "has_planner", "make_oracle", "make_oracle_batch"},
}


@pytest.mark.parametrize("package", ["impact_envs", "planners", "agents"])
def test_every_public_name_is_on_the_page(package: str) -> None:
    text = PAGE.read_text(encoding="utf-8")
    for name in set(import_module(package).__all__) - LEFT_OUT.get(package, set()):
        assert f".{name}\n" in text, f"{package}.{name}"

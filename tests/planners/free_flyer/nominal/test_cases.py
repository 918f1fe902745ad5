"""Tasks that others found to fail, each for its kind; they lie beside the repository."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from planners import make_plan
from planners.budget import Clock, use_clock

FOLDERS = [up / "shared" / "cases" for up in Path(__file__).resolve().parents]
FOLDER = next((folder for folder in FOLDERS if folder.is_dir()), FOLDERS[0])
LIMIT = 60.0  # of planning, by the process's own time [s]
LEAST = {"swap_equal": 0.45, "moving_polygon": 0.3, "mp_slow": 0.3}  # of bounds of 0.5 [m]


@pytest.mark.slow
@pytest.mark.skipif(not FOLDER.is_dir(), reason="shared/cases is not beside the repository")
@pytest.mark.parametrize(("name", "least"), LEAST.items())
def test_a_plan_of_at_least_this_robustness_is_found(name: str, least: float) -> None:
    with use_clock(Clock(time.process_time)):
        plan = make_plan(FOLDER / f"{name}.toml", time_limit=LIMIT)
    assert plan.robustness >= least - 1e-6
    assert plan.validated

"""The benchmark of start-up runs whole processes and refuses one that fails."""

import runpy
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[2] / "benchmarks" / "startup.py"


def test_processes_take_time_and_failures_are_named():
    measure = runpy.run_path(str(SCRIPT))["measure"]
    cpu, wall = measure(("-c", "sum(range(3_000_000))"))
    assert 0.01 < cpu < 60.0
    assert wall > 0.0
    with pytest.raises(SystemExit, match="exit code 3"):
        measure(("-c", "raise SystemExit(3)"))

import json
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from impact_envs import load_scenario
from tests.frozen.freeze import get_plan

LOOPS = ["batch, LQR", "batch, MPC", "one world, MPC", "one world, published MPC by ipopt"]


@pytest.fixture(scope="module")
def benchmark(load_benchmark: Callable[[str], ModuleType]) -> ModuleType:
    return load_benchmark("expert_in_loop")


@pytest.fixture
def methods(benchmark: ModuleType) -> Any:
    return sys.modules["expert_in_loop_methods"]


def test_a_small_run_writes_everything(
    benchmark: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "rates.json"
    benchmark.main(benchmark.Args(batch=3, steps=4, published_steps=2, repeats=2, out=out))
    record = json.loads(out.read_text())
    assert [row["loop"] for row in record["rows"]] == LOOPS
    assert [(run["method"], run["batch"], run["steps"]) for run in record["runs"]] == 2 * [
        (LOOPS[0], 3, 4),
        (LOOPS[1], 3, 4),
        (LOOPS[2], 1, 4),
        (LOOPS[3], 1, 2),
    ]
    assert all(0.0 < row["act p50 [us]"] <= row["act p99 [us]"] for row in record["rows"])
    assert [len(record["acts"][name]) for name in LOOPS] == [8, 8, 8, 4]
    assert record["rows"][3]["over published"] == 1.0
    solves = [row for row in record["solves"] if row["problems"] == "all"]
    assert [row["method"].split(",")[0] for row in solves] == ["mpc", "lqr", "casadi", "cvxpy", "published MPC"]
    assert [row["solves"] for row in solves] == 5 * [8]  # two robots
    assert solves[0]["off p99"] == 0.0
    assert max(row["off p99"] for row in solves[1:4]) < 0.01  # no impact is near, no limit binds
    assert all(row["failed"] == 0 for row in solves)
    assert all(check["met"] in (True, False) for check in record["checks"])
    assert {check["what"] for check in record["checks"]} >= {"published MPC, ipopt / mpc, all"}
    printed = capsys.readouterr().out
    assert "load before" in printed
    assert "| batch, LQR" in printed
    assert f"{record['rows'][0]['env-steps/s']:,.0f}" in printed


def test_published_mpc_hits_as_ours_does(methods: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Half a second after the first impact, at 9.7 s, all bodies are where our tracker brings them."""
    scenario, envs, make = load_scenario("throw_and_catch"), list[Any](), methods.parallel_env
    plan = get_plan(scenario.name, "nominal")
    monkeypatch.setattr(methods, "parallel_env", lambda scenario: envs.append(make(scenario)) or envs[-1])
    for loop, steps in ((methods.make_published(scenario, plan), 20), (methods.make_single(scenario, plan), 102)):
        assert loop.run(steps) > 0.0
        assert len(loop.acts) == steps
    published, ours = (env.model.state() for env in envs)
    assert np.hypot(*ours[2, 2:4]) > 0.05  # it was hit
    np.testing.assert_allclose(published[:, :2], ours[:, :2], atol=0.02)
    np.testing.assert_allclose(published[2, 2:4], ours[2, 2:4], atol=0.01)

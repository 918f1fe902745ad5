import json
import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from impact_envs.errors import InputError

SCRIPT = Path(__file__).resolve().parents[2] / "benchmarks" / "planner.py"


@pytest.fixture(scope="module")
def benchmark() -> ModuleType:
    spec = spec_from_file_location("planner_benchmark", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


def test_one_round_gives_a_row(benchmark: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "times.json"
    rows = benchmark.main(benchmark.Args(scenarios=("throw_and_catch",), repeats=1, miqp_repeats=0, out=out))
    (row,) = rows
    assert row["scenario"] == "throw_and_catch"
    assert float(row["ours [s]"]) > 0.0
    assert row["rho / bound [m]"] == "0.2500 / 0.2500"
    assert [float(part) > 0.0 for part in row["Bezier first / optimal [s]"].split("/")] == [True, True]
    assert float(row["off Eq. 5 [m/s]"]) > 0.0
    assert 10.0 < float(row["memory [MB]"]) < 4000.0
    assert row["MIQP, SCIP [s]"] == row["ratio, SCIP"] == "-"
    printed = capsys.readouterr().out
    assert "load" in printed
    assert f"| {' | '.join(row.values())} |" in printed
    record = json.loads(out.read_text())
    assert {run["method"] for run in record["runs"]} >= {"ours", "ours, e = 1", "Bezier first", "Bezier", "memory"}


def test_a_peer_out_of_time_gives_a_lower_bound(benchmark: ModuleType) -> None:
    runs = [
        benchmark.Run("pong", "ours, e = 1", 0.4),
        benchmark.Run("pong", "ours, e = 1", 0.5),
        benchmark.Run("pong", "ours, e = 1", 9.0),
        benchmark.Run("pong", "MIQP scip", 60.0, benchmark.LATE, facts={"gap": 0.05}),
    ]
    (row,) = benchmark.make_rows(runs)
    assert row["ours, e = 1 [s]"] == "0.5"
    assert row["MIQP, SCIP [s]"] == "> 60 (gap 5.0%)"
    assert row["ratio, SCIP"] == "> 120"


def test_ctrl_c_keeps_what_is_measured(benchmark: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []

    def interrupt(*_: Any, **options: Any) -> dict[str, Any]:
        calls.append(options)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return {"seconds": 0.25}

    monkeypatch.setattr(benchmark, "plan_bezier", interrupt)
    rows = benchmark.main(benchmark.Args(scenarios=("throw_and_catch",), memory=False, miqp_repeats=0))
    assert len(calls) == 2
    assert [row["Bezier first / optimal [s]"] for row in rows] == ["0.25 / -"]
    assert float(rows[0]["ours [s]"]) > 0.0


def test_a_failure_is_a_cell_and_a_line(benchmark: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any, **__: Any) -> None:
        raise InputError("no such form")

    monkeypatch.setattr(benchmark, "make_plan", refuse)
    run = benchmark.measure(benchmark.Job("pong", "ours", lambda: benchmark.plan_ours(None)), 60.0)
    assert run.status == "pong, ours: no such form"
    (row,) = benchmark.make_rows([run])
    assert row["ours [s]"] == "failed"


def test_bad_arguments_are_refused(benchmark: ModuleType) -> None:
    with pytest.raises(InputError, match="repeats 0"):
        benchmark.main(benchmark.Args(repeats=0))

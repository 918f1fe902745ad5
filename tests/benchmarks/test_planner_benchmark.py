import json
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest


@pytest.fixture(scope="module")
def benchmark(load_benchmark: Callable[[str], ModuleType]) -> ModuleType:
    return load_benchmark("planner")


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

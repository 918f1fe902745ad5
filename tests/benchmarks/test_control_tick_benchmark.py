import json
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

import pytest


@pytest.fixture(scope="module")
def benchmark(load_benchmark: Callable[[str], ModuleType]) -> ModuleType:
    return load_benchmark("control_tick")


def test_one_round_times_all_methods_in_all_phases(
    benchmark: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "times.json"
    rows = benchmark.main(benchmark.Args(repeats=1, every=400, worlds=2, out=out))
    methods = [
        "ours",
        "goldfarb_idnani",
        "daqp",
        "cvxpy, Clarabel",
        *(["cvxpy, OSQP", "OSQP"] if find_spec("osqp") else []),
    ]
    assert [(row["phase"], row["method"]) for row in rows] == [
        (phase, method) for phase in ("ante", "interim", "post") for method in methods
    ]
    for row in rows:
        assert 0.0 < float(row["p50 [us]"]) <= float(row["p99 [us]"])
        assert float(row["off [N m]"]) < 0.05
    assert all(row["ratio"] == "1.0" for row in rows if row["method"] == "ours")
    printed = capsys.readouterr().out
    assert "load" in printed and f"| {' | '.join(rows[0].values())} |" in printed
    record = json.loads(out.read_text())
    assert sum(len(times["cpu"]) for times in record["times"] if times["method"] == "ours") == 2200
    assert set(record["episodes"]) == {"one world", "vector_env, 1 world", "vector_env, 2 worlds"}
    assert all(f"| {name} | " in printed for name in record["episodes"])

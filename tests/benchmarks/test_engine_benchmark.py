import json
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest


@pytest.fixture(scope="module")
def benchmark(load_benchmark: Callable[[str], ModuleType]) -> ModuleType:
    return load_benchmark("engine")


@pytest.fixture(autouse=True)
def no_peers(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("vmas", "mpe2", "mpe2.simple_spread_v3"):
        monkeypatch.setitem(sys.modules, name, None)


def test_a_small_run_writes_everything(
    benchmark: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, plot = tmp_path / "rates.json", tmp_path / "rates.png"
    arguments = benchmark.Args(batches=(1, 2), looped=1, steps=3, repeats=2, growth=False, out=out, plot=plot)
    benchmark.main(arguments)
    record = json.loads(out.read_text())
    measured = {(run["setting"], run["method"], run["batch"]) for run in record["runs"]}
    for setting in ("2+1", "4+3"):
        assert {name for _, name, batch in measured if batch == 2} >= {"ours, compiled step", "ours, vector_env"}
        assert (setting, "ours, PettingZoo", 1) in measured
        assert (setting, "pymunk, bare", 1) in measured
        assert (setting, "pymunk, bare", 2) not in measured
    assert all(run["seconds"] > 0.0 for run in record["runs"])
    assert len(record["runs"]) == 2 * len(measured)
    assert [row["overflow"] for row in record["episodes"]] == [0, 0]
    assert plot.read_bytes().startswith(b"\x89PNG")
    printed = capsys.readouterr().out
    assert "VMAS transport is left out" in printed
    assert "pip install vmas mpe2" in printed
    assert "load before" in printed
    assert "| 2+1     | VMAS transport            |" in printed
    line, agent_steps = (line for line in printed.splitlines() if line.startswith("| 4+3     | pymunk, bare"))
    assert agent_steps.count("|") == line.count("|")
    assert line.rstrip(" |").endswith("-")

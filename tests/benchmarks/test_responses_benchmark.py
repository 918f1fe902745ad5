"""The benchmark of flown responses plays its ways in the same worlds and writes its rows."""

import json
import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

from planners.plan import Plan

SCRIPT = Path(__file__).resolve().parents[2] / "benchmarks" / "responses.py"


def load_benchmark():
    spec = spec_from_file_location("responses_benchmark", SCRIPT)
    benchmark = module_from_spec(spec)
    sys.modules[spec.name] = benchmark  # dataclasses look their module up
    spec.loader.exec_module(benchmark)
    return benchmark


def test_ways_are_flown_and_written(tmp_path, capsys):
    benchmark, out, name = load_benchmark(), tmp_path / "rows.json", "throw_and_catch"
    ways = ("responses", "no responses")
    arguments = {"scenarios": (name,), "worlds": 20, "seed": 1_000_000, "ways": ways, "plans": tmp_path, "out": out}
    rows = benchmark.main(benchmark.Args(**arguments))
    assert json.loads(out.read_text()) == rows
    flown, alone = rows
    assert [row["flown"] for row in rows] == list(ways)
    assert (flown["violations"], flown["left"]) == (0, 0)
    assert alone["left"] > 0
    assert "responses" in capsys.readouterr().out
    plan = Plan.load(tmp_path / f"{name}.json")
    assert flown["deviation"] == plan.deviation

"""The benchmark of flown responses plays its ways in the same worlds and writes its rows."""

import json

from planners.plan import Plan


def test_ways_are_flown_and_written(load_benchmark, tmp_path, capsys):
    benchmark, out, name = load_benchmark("responses"), tmp_path / "rows.json", "throw_and_catch"
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

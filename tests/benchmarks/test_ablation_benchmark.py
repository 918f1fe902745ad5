"""A suite is taken apart part by part, and the oracle is played beside the expert; a table of few episodes."""

import json
from pathlib import Path

import pytest

from impact_envs import InputError, load_scenario

PLANS = Path(__file__).resolve().parents[1] / "frozen" / "plans"


def test_every_part_is_left_out_once(load_benchmark):
    benchmark, scenario = load_benchmark("ablation"), load_scenario("pong")
    worlds = dict(benchmark.list_rows(scenario, "hard"))
    assert worlds["all parts"].true == scenario.suite("hard").true
    assert worlds["no part"].true == scenario.true
    parts = scenario._suites()["hard"]
    assert len(worlds) == len(parts) + 2
    for part in parts:
        name = part.removeprefix("true.")
        kept, default = worlds[f"without {name}"].true, getattr(scenario.true, name)
        assert getattr(kept, name) == default
        gone = {other for other in type(kept).model_fields if getattr(kept, other) == getattr(scenario.true, other)}
        assert {other.removeprefix("true.") for other in parts} & gone <= {name, "drift_turn", "velocity_measured"}
    with pytest.raises(InputError, match="suite 'hrd' is unknown; did you mean 'hard'"):
        list(benchmark.list_rows(scenario, "hrd"))


def test_shares_of_the_gap(load_benchmark):
    benchmark = load_benchmark("ablation")
    rows = [{"parts": "all parts", "success": 0.5}, {"parts": "without x", "success": 0.6}]
    rows.append({"parts": "no part", "success": 1.0})
    benchmark.add_shares(rows)
    assert [row["closes"] for row in rows] == pytest.approx([0.0, 0.2, 1.0])


def test_rows_are_played_and_written(load_benchmark, tmp_path, capsys):
    benchmark, out = load_benchmark("ablation"), tmp_path / "rows.json"
    chosen = ("all parts", "without drift")
    rows = benchmark.main(benchmark.Args("throw_and_catch", seeds=2, seed=1_000_000, plans=PLANS, rows=chosen, out=out))
    assert json.loads(out.read_text()) == rows
    assert [row["parts"] for row in rows] == list(chosen)
    assert all(0 <= row["success"] <= 1 and 0 <= row["success, offset told"] <= 1 for row in rows)
    assert "without drift" in capsys.readouterr().out


def test_the_oracle_is_played_beside_the_expert(load_benchmark, capsys):
    benchmark = load_benchmark("oracle")
    (row,) = benchmark.main(benchmark.Args(("throw_and_catch",), ("all",), 2, 1_000_000, plans=PLANS))
    assert row["expert success"] == row["oracle success"] == 1.0
    assert "throw_and_catch" in capsys.readouterr().out

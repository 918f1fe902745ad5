"""Scenarios of robots alone are planned; a table of few of them; all of them are scenarios."""

from __future__ import annotations

import json

import pytest

from impact_envs.errors import InputError


def test_robots_alone_are_planned(load_benchmark, tmp_path, capsys):
    benchmark = load_benchmark("robots_only")
    rows = benchmark.main(benchmark.Args(names=("narrow_passage",), out=tmp_path / "rows.json"))
    assert rows[0].bound >= rows[0].robustness > 0.0
    assert json.loads((tmp_path / "rows.json").read_text())[0]["name"] == "narrow_passage"
    assert "narrow_passage" in capsys.readouterr().out
    with pytest.raises(InputError, match="scenario 'narow_passage' is unknown"):
        benchmark.main(benchmark.Args(names=("narow_passage",)))


def test_every_scenario_of_robots_alone_is_one(load_benchmark):
    benchmark = load_benchmark("robots_only")
    for name in benchmark.TASKS:
        scenario = benchmark.make_scenario(name)
        assert scenario.specification.horizon <= scenario.horizon


def test_a_corner_is_passed_between_the_segments_of_a_motion(load_benchmark):
    """Segments of 3 s leave no time at which both faces of the wall are kept; shorter ones do."""
    row = load_benchmark("robots_only").plan_scenario("reach_avoid", 60.0)
    assert row.robustness == pytest.approx(row.bound, abs=1e-5)

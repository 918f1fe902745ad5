"""Rooms in a row: the object turns twice at every wall, one of them is planned and flown, bad numbers are refused."""

from __future__ import annotations

import json

import pytest

from impact_envs.errors import InputError
from planners.free_flyer.nominal.object_way import count_turns
from planners.free_flyer.specification.requirement import read_demands


def test_an_object_turns_twice_at_every_wall(load_benchmark):
    benchmark = load_benchmark("rooms")
    for walls in (1, 4):
        scenario = benchmark.make_rooms(walls, 2)
        assert count_turns(scenario, read_demands(scenario, 0.05), 0.05) == 2 * walls


def test_rooms_are_planned_and_written(load_benchmark, tmp_path, capsys):
    benchmark = load_benchmark("rooms")
    (row,) = benchmark.main(benchmark.Args(walls=(2,), robots=(2,), out=tmp_path / "rows.json"))
    assert row.bound >= row.robustness > 0.0
    assert row.impacts >= 4
    assert json.loads((tmp_path / "rows.json").read_text())[0]["walls"] == 2
    assert "robustness / bound" in capsys.readouterr().out
    with pytest.raises(InputError, match="walls"):
        benchmark.main(benchmark.Args(walls=(0,)))

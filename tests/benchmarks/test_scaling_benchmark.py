"""The model of an evaluation on many cores: what it must say whatever was measured."""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType

import pytest

from train.evaluation.case import TUNING_SEEDS


@pytest.fixture(scope="module")
def scaling(load_benchmark: Callable[[str], ModuleType]) -> ModuleType:
    return load_benchmark("scaling")


def test_more_cores_help_until_the_one_that_asks_is_the_bound(scaling: ModuleType) -> None:
    costs = scaling.Costs(shard=1e-3, row=2e-5, table=0.0, start=2.0)
    found = [scaling.model_time(100_000, 2e-3, 100, cores, costs) for cores in (1, 2, 64, 1000, 100_000)]
    assert found[0] == (pytest.approx(202.0), "playing")
    assert found[1] == (pytest.approx(102.0), "playing")
    assert [time for time, _ in found] == sorted((time for time, _ in found), reverse=True)
    assert found[-1] == (pytest.approx(1000 * 1e-3 + 100_000 * 2e-5), "handing out")


def test_shards_fewer_than_cores_are_named(scaling: ModuleType) -> None:
    costs = scaling.Costs(shard=1e-6, row=1e-6, table=0.0, start=0.1)
    assert scaling.model_time(1000, 0.1, 100, 1000, costs) == (pytest.approx(10.1), "too few shards")
    assert scaling.model_time(1000, 1e-4, 1, 1000, costs)[1] == "starting workers"


def test_rows_are_measured(scaling: ModuleType) -> None:
    seconds, rows = scaling.play_rows("throw_and_catch/zero", 3)
    assert [row["seed"] for row in rows] == [TUNING_SEEDS, TUNING_SEEDS + 1, TUNING_SEEDS + 2]
    assert 0.0 <= seconds < 10.0  # the clock of processor time may be coarse
    assert 300 < scaling.measure_memory(rows) < 10_000
    assert all(cost >= 0.0 for cost in scaling.measure_writing(rows))

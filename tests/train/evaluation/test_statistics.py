"""Intervals against published and independent values, pairing by hand-made rows."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import binomtest

from train.evaluation.metrics import summarize
from train.evaluation.statistics import (
    compare,
    compute_median_interval,
    compute_solve_times,
    compute_wilson_interval,
)


def make_rows(robustness: dict[str, list[float]], **changes: object) -> pd.DataFrame:
    """One scenario and suite; policies with robustness by seed."""
    rows = [
        {
            "scenario": "s",
            "suite": "nominal",
            "policy": policy,
            "seed": seed,
            "success": value > 0,
            "robustness": value,
            "effort": float(seed),
            "impacts": 2,
            "fallbacks": 1,
            "fallback_kinds": json.dumps({"hold": 1}),
            "solve_ms": [1.0, 3.0],
            "wall_seconds": 0.1,
        }
        | changes
        for policy, values in robustness.items()
        for seed, value in enumerate(values)
    ]
    return pd.DataFrame(rows)


@pytest.mark.parametrize(
    ("successes", "trials", "low", "high"),
    # R. G. Newcombe, "Two-sided confidence intervals for the single proportion", Stat. in Med. 17 (1998).
    [(81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (0, 20, 0.0, 0.1611), (1, 29, 0.0061, 0.1718)],
)
def test_wilson_interval_is_the_published_one(successes: int, trials: int, low: float, high: float) -> None:
    assert compute_wilson_interval(successes, trials) == pytest.approx((low, high), abs=6e-5)


@settings(max_examples=50, deadline=None)
@given(st.integers(1, 400), st.data())
def test_wilson_interval_agrees_with_scipy_and_holds_the_rate(trials: int, data: st.DataObject) -> None:
    successes = data.draw(st.integers(0, trials))
    low, high = compute_wilson_interval(successes, trials)
    other = binomtest(successes, trials).proportion_ci(method="wilson")
    assert (low, high) == pytest.approx((other.low, other.high), abs=1e-12)
    assert 0 <= low <= successes / trials <= high <= 1


def test_wilson_interval_without_trials_says_nothing() -> None:
    assert compute_wilson_interval(0, 0) == (0.0, 1.0)


def test_median_interval_covers_the_true_median_about_as_often_as_it_says() -> None:
    rng = np.random.default_rng(5)
    samples = rng.exponential(size=(60, 40))
    intervals = [compute_median_interval(sample) for sample in samples]
    covered = np.mean([low <= np.log(2) <= high for low, high in intervals])
    assert covered >= 0.85


def test_median_interval_is_reproducible_and_shifts_with_the_data() -> None:
    values = np.random.default_rng(0).normal(size=30)
    low, high = compute_median_interval(values)
    assert (low, high) == compute_median_interval(values)
    assert low < np.median(values) < high
    assert compute_median_interval(values + 2.0) == pytest.approx((low + 2.0, high + 2.0))
    assert compute_median_interval([0.3]) == (0.3, 0.3)
    assert compute_median_interval([0.25] * 8) == (0.25, 0.25)


def test_solve_times_are_percentiles_and_none_without_a_solve() -> None:
    assert compute_solve_times(range(101)) == {"p50": 50.0, "p99": 99.0, "max": 100.0}
    assert compute_solve_times([]) == {"p50": None, "p99": None, "max": None}


def test_summary_of_a_hand_made_table() -> None:
    rows = make_rows({"expert": [0.2, 0.4, -0.1, 0.3], "zero": [-1.0, -2.0, -3.0, -4.0]})
    expert, zero = summarize(rows)
    assert (expert["policy"], zero["policy"]) == ("expert", "zero")
    assert (expert["episodes"], expert["successes"], expert["success_rate"]) == (4, 3, 0.75)
    assert expert["robustness_median"] == pytest.approx(0.25)
    assert expert["effort_median"] == 1.5
    assert expert["solve_ms"] == {"p50": 2.0, "p99": 3.0, "max": 3.0}
    assert expert["fallbacks"] == {"hold": 4}
    assert zero["success_rate"] == 0.0
    json.dumps([expert, zero], allow_nan=False)


def test_pairs_share_seeds_whatever_the_order_of_the_rows() -> None:
    rows = make_rows({"expert": [0.1, 0.2, 0.3, 0.4], "learned": [0.2, 0.2, 0.25, 0.7]})
    shuffled = pd.concat([rows[:4], rows[4:].sample(frac=1.0, random_state=3)])
    (pair,) = compare(shuffled)
    assert (pair["a"], pair["b"], pair["episodes"]) == ("learned", "expert", 4)
    assert pair["difference_median"] == pytest.approx(0.05)
    assert pair["difference_mean"] == pytest.approx(0.0875)
    assert (pair["win_rate"], pair["tie_rate"]) == (0.5, 0.25)
    assert pair["ci"][0] <= pair["difference_median"] <= pair["ci"][1]


def test_a_policy_paired_with_its_own_episodes_differs_by_exactly_zero() -> None:
    values = list(np.random.default_rng(1).normal(size=20))
    (pair,) = compare(make_rows({"expert": values, "copy": values}))
    assert (pair["difference_median"], pair["ci"], pair["tie_rate"]) == (0.0, [0.0, 0.0], 1.0)


def test_only_shared_seeds_are_paired() -> None:
    rows = make_rows({"expert": [0.1, 0.2, 0.3], "learned": [0.2, 0.3, 0.4]})
    rows.loc[rows["policy"] == "learned", "seed"] += 2
    (pair,) = compare(rows)
    assert pair["episodes"] == 1
    rows.loc[rows["policy"] == "learned", "seed"] += 10
    assert compare(rows) == []


def test_worlds_are_never_mixed() -> None:
    here = make_rows({"expert": [0.1, 0.2], "zero": [-1.0, -1.0]})
    there = make_rows({"expert": [0.5, 0.6], "zero": [-2.0, -2.0]}, suite="mass")
    table = pd.concat([here, there])
    assert [(row["suite"], row["policy"]) for row in summarize(table)] == [
        ("nominal", "expert"),
        ("nominal", "zero"),
        ("mass", "expert"),
        ("mass", "zero"),
    ]
    assert [pair["difference_median"] for pair in compare(table)] == pytest.approx([-1.15, -2.55])

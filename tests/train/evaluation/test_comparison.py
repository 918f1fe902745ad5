"""The comparison's numbers where they are known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from impact_envs import InputError
from train.cli.compare import Command
from train.cli.printing import show
from train.evaluation.comparison import (
    Origin,
    compare_groups,
    compute_crossed_interval,
    compute_improvements,
    compute_worst_means,
    name_group,
)

EPISODES = 40


def make_rows(**shifts: float) -> pd.DataFrame:
    """Return episodes whose robustness is the expert's, which is drawn, plus a shift."""
    base = np.random.default_rng(0).normal(0.3, 0.2, EPISODES)
    return pd.DataFrame(
        {"scenario": "pong", "suite": "hard", "policy": policy, "seed": seed, "robustness": rho + shift,
         "success": rho + shift > 0}
        for policy, shift in shifts.items()
        for seed, rho in enumerate(base)
    )  # fmt: skip


def find(table: list[dict], policy: str) -> dict:
    return next(row for row in table if row["policy"] == policy)


def test_runs_of_one_policy_are_told_by_their_seeds() -> None:
    assert name_group("runs/pong_hard/seed3") == name_group("runs/pong_hard/seed12") == "runs/pong_hard"
    assert name_group("runs/pong_seed4") == "runs/pong"
    assert name_group("expert") == "expert"


def test_a_constant_shift_is_the_gain() -> None:
    rows = make_rows(expert=0.0, each=0.01, **{"runs/a/seed0": 0.03, "runs/a/seed1": 0.05})
    origins = {"each": Origin("constant_per_impact", 7.0), "runs/a/seed0": Origin("ppo", 10.0)}
    table = compare_groups(rows, origins | {"runs/a/seed1": Origin("ppo", 20.0)})
    learned = find(table, "runs/a")
    assert (learned["runs"], learned["episodes"], learned["cpu_seconds"]) == (2, EPISODES, 15.0)
    assert learned["gain"] == pytest.approx(0.04)
    assert learned["gain_over_constant"] == pytest.approx(0.03)
    assert learned["gain_ci"] == pytest.approx([0.03, 0.05])  # which of the two runs one drew is all that is unsure
    assert learned["improvement"] == 1.0
    assert learned["constant"] == "each"
    assert learned["earned"]
    assert find(table, "expert")["gain"] is None
    assert find(table, "each")["gain_over_constant"] is None
    assert not find(table, "each")["earned"]


def test_what_does_not_beat_the_constant_is_not_earned() -> None:
    rows = make_rows(expert=0.0, each=0.06, **{"runs/a/seed0": 0.03, "runs/a/seed1": 0.05})
    learned = find(compare_groups(rows, constant="each"), "runs/a")
    assert learned["gain_ci"][0] > 0.0
    assert not learned["earned"]


def test_runs_on_the_same_seeds_do_not_narrow_the_interval_of_success() -> None:
    one = find(compare_groups(make_rows(**{"a/seed0": 0.0})), "a")
    many = find(compare_groups(make_rows(**{f"a/seed{n}": 0.0 for n in range(5)})), "a")
    assert one["success_ci"] == many["success_ci"]


def test_the_interval_covers_the_mean_as_often_as_it_says() -> None:
    rng, covered = np.random.default_rng(0), 0
    for _ in range(60):
        values = rng.normal(size=(6, 1)) + rng.normal(size=(1, 30)) + rng.normal(size=(6, 30))
        low, high = compute_crossed_interval(values, lambda resampled: resampled.mean(axis=-1))
        covered += low <= 0.0 <= high
    assert covered >= 48  # 95 % of 60 is 57; so few runs make a bootstrap a little short


def test_the_worst_and_the_better() -> None:
    assert compute_worst_means(np.arange(40.0)) == 0.5
    assert compute_worst_means(np.array([3.0, 1.0])) == 1.0
    assert compute_improvements(np.array([1.0, 0.0, -1.0, -1.0])) == 0.375


def test_the_table_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    show({"groups": compare_groups(make_rows(expert=0.0, **{"a/seed0": 0.1}))})
    assert "Worst 5 %" in capsys.readouterr().out


def test_a_folder_without_an_evaluation_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        Command((tmp_path,)).run()

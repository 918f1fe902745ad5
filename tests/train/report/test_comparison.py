"""The report's table of learned policies."""

from __future__ import annotations

import re

import numpy as np
import pandas as pd
import pytest

from train.evaluation.comparison import Origin
from train.report import comparison
from train.report.tables import Look

LABELS = ("expert", "runs/constant", "runs/pong/seed0", "runs/pong/seed1")
LOOKS = {label: Look(label.rpartition("/")[2], "#000000") for label in LABELS}


def make_episodes(gain: float) -> pd.DataFrame:
    """Return episodes in which the runs are better than expert and constant by a gain [m]."""
    noise = np.random.default_rng(0).normal(scale=0.01, size=40)
    offsets = dict(zip(LABELS, (0.0, 0.0, gain, gain), strict=True))
    return pd.DataFrame(
        {
            "scenario": "pong", "suite": "hard", "policy": label, "seed": np.arange(40),
            "robustness": 0.2 + noise * (1 + place) + offset, "success": True,
        }
        for place, (label, offset) in enumerate(offsets.items())
    ).explode(["seed", "robustness"]).astype({"robustness": float})  # fmt: skip


@pytest.mark.parametrize("gain", [0.05, -0.05])
def test_runs_stand_in_one_row_and_only_an_earned_gain_is_bold(gain: float, monkeypatch: pytest.MonkeyPatch) -> None:
    origins = {LABELS[1]: Origin("constant", 10.0), LABELS[2]: Origin("ppo", 20.0), LABELS[3]: Origin("ppo", 40.0)}
    monkeypatch.setattr(comparison, "read_origins", lambda _: origins)
    page = comparison.write_comparison(make_episodes(gain), LOOKS)
    heads = re.findall(r'<th scope="row"><span class="policy" title="([^"]*)"', page)
    assert heads == ["expert", "runs/constant", "runs/pong"]
    last = page[page.index('title="runs/pong"') :]
    assert ("<b>" in last) == (gain > 0)
    assert '<td class="number">2</td>' in last
    assert '<td class="number">30</td>' in last  # mean of the training times
    assert page.count("<b>") == (gain > 0)


def test_without_learned_policies_a_sentence_says_so() -> None:
    page = comparison.write_comparison(make_episodes(0.0), {"expert": LOOKS["expert"]})
    assert "None of these policies was learned" in page

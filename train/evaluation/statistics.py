"""Intervals, percentiles and paired differences of an evaluation's episodes."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import pandas as pd

GROUP = ["scenario", "suite", "policy"]
Interval = tuple[float, float]


def compute_wilson_interval(successes: int, trials: int, confidence: float = 0.95) -> Interval:
    """Return the Wilson score interval of a success probability.

    (p + z²/2n ± z √(p(1-p)/n + z²/4n²)) / (1 + z²/n), p = successes / trials.

    Args:
        successes: number of successes.
        trials: number of independent trials n.
        confidence: two-sided confidence level.

    Returns:
        Lower and upper end, in [0, 1]; (0, 1) without any trial.

    Source: E. B. Wilson, "Probable inference, the law of succession, and statistical inference", JASA 22
    (1927).
    """
    from scipy.stats import norm  # here: it takes half a second, which a single episode need not wait

    if trials == 0:
        return 0.0, 1.0
    z = float(norm.ppf(0.5 + confidence / 2))
    p, scale = successes / trials, 1 + z * z / trials
    center = (p + z * z / (2 * trials)) / scale
    half = z * math.sqrt(p * (1 - p) / trials + z * z / (4 * trials * trials)) / scale
    # Rounding must not push p itself out of the interval at 0 and 1.
    return max(0.0, min(p, center - half)), min(1.0, max(p, center + half))


def compute_median_interval(values: Sequence[float] | np.ndarray | pd.Series, confidence: float = 0.95) -> Interval:
    """Return the percentile-bootstrap interval of the median; the resampling has its own fixed seed.

    Args:
        values: independent samples, shape (n,), n >= 1.
        confidence: two-sided confidence level.

    Returns:
        Lower and upper end in the unit of the values; for one sample both are the sample.

    Source: B. Efron, "Bootstrap methods: another look at the jackknife", Annals of Statistics 7 (1979).
    """
    from scipy.stats import bootstrap

    samples = np.asarray(values, dtype=float)
    if samples.size == 1:
        return float(samples[0]), float(samples[0])
    interval = bootstrap(
        (samples,),
        np.median,
        n_resamples=4000,
        batch=500,
        confidence_level=confidence,
        method="percentile",
        rng=np.random.default_rng(0),
    ).confidence_interval
    return float(interval.low), float(interval.high)


def compute_solve_times(samples: Iterable[float]) -> dict[str, float | None]:
    """Return the percentiles of solve times.

    Args:
        samples: solve times [ms], pooled over whatever is to be summed up.

    Returns:
        ``p50``, ``p99`` and ``max`` [ms]; None each where nothing was solved.
    """
    times = np.fromiter(samples, dtype=float)
    if times.size == 0:
        return {"p50": None, "p99": None, "max": None}
    p50, p99 = np.percentile(times, [50, 99])
    return {"p50": round(float(p50), 3), "p99": round(float(p99), 3), "max": round(float(times.max()), 3)}


def compare(rows: pd.DataFrame) -> list[dict[str, Any]]:
    """Compare every two policies on the seeds they share, scenario by scenario and suite by suite.

    The difference is robustness(a) - robustness(b) on the same seed; b is the policy that appears first.

    Args:
        rows: one row per episode, columns as metrics.make_row writes them.

    Returns:
        One JSON object per scenario, suite and pair with at least one shared seed.
    """
    table = []
    for (scenario, suite), group in rows.groupby(["scenario", "suite"], sort=False, observed=True):
        for b, a in combinations(group["policy"].unique(), 2):
            paired = _pair(group, a, b)
            if len(paired):
                names = {"scenario": scenario, "suite": suite, "a": a, "b": b}
                table.append({**names, **compare_pairs(paired)})
    return table


def compare_pairs(paired: pd.DataFrame) -> dict[str, Any]:
    """Sum up the paired differences of two policies.

    Args:
        paired: one row per shared seed; columns robustness_a, robustness_b [m], success_a, success_b.

    Returns:
        ``episodes, difference_median, ci, difference_mean, win_rate, tie_rate, success_difference``.
    """
    difference = (paired["robustness_a"] - paired["robustness_b"]).to_numpy(dtype=float)
    success = paired["success_a"].astype(float) - paired["success_b"].astype(float)
    return {
        "episodes": len(difference),
        "difference_median": float(np.median(difference)),
        "ci": list(compute_median_interval(difference)),
        "difference_mean": float(np.mean(difference)),
        "win_rate": float(np.mean(difference > 0)),
        "tie_rate": float(np.mean(difference == 0)),
        "success_difference": float(success.mean()),
    }


def _pair(group: pd.DataFrame, a: str, b: str) -> pd.DataFrame:
    columns = ["seed", "robustness", "success"]
    left, right = (group.loc[group["policy"] == policy, columns] for policy in (a, b))
    return left.merge(right, on="seed", suffixes=("_a", "_b"), validate="one_to_one")

"""Learned policies of several training seeds beside the expert and the best constant, with intervals over both.

What is uncertain of a learned policy is which training seed and which episodes one happened to take. An interval
resamples both, crossed: training seeds with replacement, and evaluation seeds with replacement, the same ones for every
policy; each scenario in each suite apart (the strata). Percentiles of the resampled statistic bound it.

Source: Agarwal et al., "Deep reinforcement learning at the edge of the statistical precipice" (2021), whose `rliable`
resamples training seeds alone.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from train.evaluation.paired import compute_interquartile_mean, compute_interquartile_means
from train.evaluation.statistics import compute_wilson_interval

if TYPE_CHECKING:
    import pandas as pd

RESAMPLES, TOGETHER = 2000, 100  # of the bootstrap, and how many at once
CONFIDENCE = 0.95
WORST = 0.05  # share of the episodes that the worst are
EXPERT = "expert"
# A training seed's folder, and what it is one of.
RUN = re.compile(r"^(.*?)[/_.-]?seed[_-]?\d+$")


@dataclass(frozen=True)
class Origin:
    """What a checkpoint says of itself.

    Attributes:
        algorithm: of its training.
        cpu_seconds: that this took, None where nobody counted [s].
    """

    algorithm: str
    cpu_seconds: float | None


@dataclass(frozen=True)
class Table:
    """Episodes of one group of policies in one scenario and suite: R runs on the same E seeds.

    Attributes:
        robustness: shape (R, E) [m].
        success: shape (R, E) bool.
        seeds: of the episodes, ascending, shape (E,).
    """

    robustness: np.ndarray
    success: np.ndarray
    seeds: np.ndarray


def name_group(label: str) -> str:
    """Return what a policy is a run of: ``runs/pong`` of ``runs/pong/seed3``, and itself where it names no seed."""
    found = RUN.match(label)
    return (found[1] or "seeds") if found else label


def compare_groups(
    rows: pd.DataFrame, origins: Mapping[str, Origin] | None = None, constant: str | None = None
) -> list[dict[str, Any]]:
    """Compare policies, those of several training seeds together, with the expert and the best constant.

    Args:
        rows: one row per episode: scenario, suite, policy, seed, robustness [m], success.
        origins: of the policies that are checkpoints, by their names.
        constant: the policy that is the best constant; without, the one whose algorithm is ``constant_per_impact``,
            or else ``constant``; of several the most robust.

    Returns:
        One JSON object per scenario, suite and group in the order of the rows: ``runs``, ``episodes`` (of each run),
        ``success_rate``, ``success_ci`` (Wilson's, of as many trials as there are evaluation seeds: runs on the same
        seeds are no further trials), ``iqm`` and ``worst`` of robustness, ``gain`` over the expert and
        ``gain_over_constant`` (interquartile means of the paired differences) [m], each with ``_ci``;
        ``improvement``: probability of more robustness than the expert on the same seed, ties by half;
        ``cpu_seconds``: mean of the runs' training; ``constant``: which one; ``earned``: both gains' intervals exclude
        zero from below. None where there is nothing to compare with.
    """
    origins = origins or {}
    table = []
    for key, here in rows.groupby(["scenario", "suite"], sort=False, observed=True):
        scenario, suite = cast(Any, key)
        labels = list(here["policy"].unique())
        groups: dict[str, list[str]] = {}
        for label in labels:
            groups.setdefault(name_group(label), []).append(label)
        best = constant if constant in labels else _find_constant(here, labels, origins)
        references = {name: here[here["policy"] == name] for name in (EXPERT, best) if name in labels}
        for group, members in groups.items():
            spent = [found.cpu_seconds for label in members if (found := origins.get(label))]
            entry = {"scenario": scenario, "suite": suite, "policy": group, "runs": len(members)}
            entry |= _describe(make_table(here, members))
            against_expert = members != [EXPERT] and EXPERT in references
            entry |= _describe_gain("gain", here, members, references[EXPERT] if against_expert else None)
            entry |= _describe_improvement(here, members, references[EXPERT] if against_expert else None)
            against_best = best is not None and members != [best]
            entry |= _describe_gain("gain_over_constant", here, members, references[best] if against_best else None)
            known = [seconds for seconds in spent if seconds is not None]
            entry["cpu_seconds"] = float(np.mean(known)) if known else None
            entry["constant"] = best
            lows = [entry[f"{name}_ci"][0] if entry[f"{name}_ci"] else None for name in ("gain", "gain_over_constant")]
            entry["earned"] = all(low is not None and low > 0.0 for low in lows)
            table.append(entry)
    return table


def make_table(rows: pd.DataFrame, members: Sequence[str]) -> Table:
    """Arrange the episodes of some policies by run and seed; seeds that not all of them played are left out.

    Args:
        rows: of one scenario in one suite.
        members: the policies.
    """
    chosen = rows[rows["policy"].isin(members)]
    robustness = chosen.pivot(index="policy", columns="seed", values="robustness").loc[list(members)]
    success = chosen.pivot(index="policy", columns="seed", values="success").loc[list(members)]
    played = ~robustness.isna().any(axis=0)
    return Table(
        robustness.loc[:, played].to_numpy(float),
        success.loc[:, played].to_numpy(bool),
        robustness.columns[played].to_numpy(),
    )


def compute_crossed_interval(
    values: np.ndarray, statistic: Callable[[np.ndarray], np.ndarray], confidence: float = CONFIDENCE
) -> tuple[float, float]:
    """Return the percentile-bootstrap interval of a statistic over runs and episodes; it has its own fixed seed.

    Args:
        values: shape (R, E).
        statistic: of all values of resampled tables, shape (B, R E), over the last axis.
        confidence: two-sided.

    Returns:
        Lower and upper end.

    Source: Owen, "The pigeonhole bootstrap", Annals of Applied Statistics 1 (2007).
    """
    rng, (runs, episodes), found = np.random.default_rng(0), values.shape, []
    for _ in range(RESAMPLES // TOGETHER):
        i, j = rng.integers(runs, size=(TOGETHER, runs, 1)), rng.integers(episodes, size=(TOGETHER, 1, episodes))
        found.append(statistic(values[i, j].reshape(TOGETHER, -1)))
    tail = (1.0 - confidence) / 2.0
    low, high = np.quantile(np.concatenate(found), [tail, 1.0 - tail])
    return float(low), float(high)


def compute_worst_means(values: np.ndarray) -> np.ndarray:
    """Return the means of the worst 5 % of some values, of at least one, shape (..., n), over the last axis."""
    count = max(1, int(np.ceil(WORST * values.shape[-1])))
    return np.mean(np.partition(values, count - 1, axis=-1)[..., :count], axis=-1)


def compute_improvements(differences: np.ndarray) -> np.ndarray:
    """Return the shares of differences above zero, ties by half, shape (..., n), over the last axis."""
    return np.mean(differences > 0, axis=-1) + 0.5 * np.mean(differences == 0, axis=-1)


def _find_constant(rows: pd.DataFrame, labels: Sequence[str], origins: Mapping[str, Origin]) -> str | None:
    """Return the best constant among some policies, None if there is none."""
    for algorithm in ("constant_per_impact", "constant"):
        found = [label for label in labels if label in origins and origins[label].algorithm == algorithm]
        if found:
            means = rows[rows["policy"].isin(found)].groupby("policy", observed=True)["robustness"].mean()
            return str(means.idxmax())
    return None


def _describe(table: Table) -> dict[str, Any]:
    rate, episodes = float(np.mean(table.success)), len(table.seeds)
    return {
        "episodes": episodes,
        "success_rate": rate,
        "success_ci": list(compute_wilson_interval(round(rate * episodes), episodes)),
        "iqm": compute_interquartile_mean(table.robustness.ravel()),
        "iqm_ci": list(compute_crossed_interval(table.robustness, compute_interquartile_means)),
        "worst": float(compute_worst_means(table.robustness.ravel())),
        "worst_ci": list(compute_crossed_interval(table.robustness, compute_worst_means)),
    }


def _pair(rows: pd.DataFrame, members: Sequence[str], reference: pd.DataFrame) -> np.ndarray:
    """Return the differences of robustness on shared seeds, shape (R, E) [m]."""
    table = make_table(rows, members)
    theirs = reference.set_index("seed")["robustness"]
    shared = np.isin(table.seeds, theirs.index)
    return table.robustness[:, shared] - theirs.loc[table.seeds[shared]].to_numpy(float)


def _describe_gain(
    name: str, rows: pd.DataFrame, members: Sequence[str], reference: pd.DataFrame | None
) -> dict[str, Any]:
    if reference is None or (pairs := _pair(rows, members, reference)).size == 0:
        return {name: None, f"{name}_ci": None}
    interval = compute_crossed_interval(pairs, compute_interquartile_means)
    return {name: compute_interquartile_mean(pairs.ravel()), f"{name}_ci": list(interval)}


def _describe_improvement(rows: pd.DataFrame, members: Sequence[str], expert: pd.DataFrame | None) -> dict[str, Any]:
    if expert is None or (pairs := _pair(rows, members, expert)).size == 0:
        return {"improvement": None, "improvement_ci": None}
    interval = compute_crossed_interval(pairs, compute_improvements)
    return {"improvement": float(compute_improvements(pairs.ravel())), "improvement_ci": list(interval)}

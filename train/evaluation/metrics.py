"""What an evaluation measures: one table, from which rows, summaries, files and printed tables are made.

A new metric is a new line in ``METRICS``, or in the METRICS of a domain's folder in ``train``.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Mapping
from functools import cache, partial
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, FiniteFloat, Json, create_model

from impact_envs.domain import find_part
from impact_envs.rollout import Episode
from train.evaluation.metric import (
    UNKNOWN,
    Aggregate,
    Metric,
    Pair,
    SolveTimes,
    mean,
    median,
    signed,
    write_interval,
)
from train.evaluation.statistics import GROUP, compute_median_interval, compute_solve_times, compute_wilson_interval

if TYPE_CHECKING:
    import pandas as pd

    from planners.plan import Plan


def _compute_success_interval(values: pd.Series) -> list[float]:
    return list(compute_wilson_interval(int(values.sum()), len(values)))


def _write_success_interval(row: Mapping[str, Any]) -> str:
    low, high = row["success_ci"]
    return f"{100 * row['success_rate']:.0f} % [{100 * low:.0f}, {100 * high:.0f}]"


def _compute_median(values: pd.Series) -> float:
    return float(np.median(values.to_numpy(dtype=float)))


def _compute_quantile(values: pd.Series) -> float:
    return float(np.quantile(values.to_numpy(dtype=float), 0.05))


def _add_counts(values: Iterable[str]) -> dict[str, int]:
    """Add counts that are JSON text, one of each episode."""
    total: Counter[str] = Counter()
    for counts in values:
        total.update(json.loads(counts))
    return dict(sorted(total.items()))


def _write_counts(row: Mapping[str, Any]) -> str:
    return ", ".join(f"{kind}: {count}" for kind, count in row["fallbacks"].items()) or "none"


def _list_solve_ms(episode: Episode, scenario: Any) -> list[float]:
    return [round(1e3 * float(seconds), 3) for seconds in episode.solve_seconds]


def _compute_solve_quantile(episode: Episode, scenario: Any, name: str) -> float | None:
    return compute_solve_times(_list_solve_ms(episode, scenario))[name]


def _write_solve_times(row: Mapping[str, Any]) -> str:
    times = [row["solve_ms"][name] for name in ("p50", "p99", "max")]
    if times[0] is None:
        return UNKNOWN
    return " / ".join(
        f"{value:.2g}" if value < 1 else f"{value:.1f}" if value < 100 else f"{value:.0f}" for value in times
    )


METRICS = (
    Metric(
        "success", "", lambda episode, scenario: bool(episode.success),
        (
            Aggregate(
                "successes", lambda values: int(values.sum()), int, "Success",
                lambda row: f"{row['successes']}/{row['episodes']}", "text",
                bar=lambda row: (row["success_rate"], *row["success_ci"]),
            ),
            Aggregate("success_rate", lambda values: int(values.sum()) / len(values)),
            Aggregate(
                "success_ci", _compute_success_interval, Pair, "95 % interval", _write_success_interval, "interval"
            ),
        ),
        required=True, kind=bool,
    ),
    Metric(
        "robustness", "m", lambda episode, scenario: float(episode.robustness),
        (
            Aggregate(
                "robustness_median", _compute_median, title="Robustness",
                write=lambda row: signed(row["robustness_median"]),
            ),
            Aggregate(
                "robustness_ci", lambda values: list(compute_median_interval(values)), Pair, "95 % interval",
                lambda row: write_interval(row["robustness_ci"]), "interval",
            ),
            Aggregate(
                "robustness_q05", _compute_quantile, title="5 % quantile",
                write=lambda row: signed(row["robustness_q05"]), detail=True,
            ),
            Aggregate("robustness_mean", lambda values: float(np.mean(values.to_numpy(dtype=float)))),
        ),
        required=True, kind=FiniteFloat,
    ),
    Metric(
        "effort", "N s", lambda episode, scenario: float(episode.effort),
        (median("effort_median", "Effort"),), required=True, kind=FiniteFloat | None,  # unknown where played in batches
    ),
    Metric(
        "impacts", "", lambda episode, scenario: len(episode.impacts),
        (mean("impacts_mean", "Impacts", 1),), required=True, kind=int,
    ),
    Metric("steps", "", lambda episode, scenario: len(episode.times) - 1, kind=int),
    Metric("replans", "", lambda episode, scenario: int(episode.replans), kind=int),
    Metric(
        "fallbacks", "", lambda episode, scenario: int(sum(episode.fallbacks.values())),
        (
            Aggregate(
                "fallbacks_per_episode", lambda values: float(values.mean()), title="Fallbacks per episode",
                write=lambda row: f"{row['fallbacks_per_episode']:.1f}", hint=_write_counts,
            ),
        ),
        required=True, kind=int,
    ),
    Metric(
        "fallback_kinds", "", lambda episode, scenario: json.dumps(dict(sorted(episode.fallbacks.items()))),
        (Aggregate("fallbacks", _add_counts, dict[str, int]),), required=True, kind=Json[dict[str, int]],
    ),
    Metric(
        "failure", "", lambda episode, scenario: episode.failure,
        (
            Aggregate(
                "failures", lambda values: int((values != "").sum()), int, "Simulations failed",
                lambda row: str(row["failures"]), detail=True,
            ),
        ),
        kind=str,
    ),
    *(
        Metric(f"solve_ms_{name}", "ms", partial(_compute_solve_quantile, name=name))
        for name in ("p50", "p99", "max")
    ),
    Metric(
        "solve_ms", "ms", _list_solve_ms,
        (
            Aggregate(
                "solve_ms", lambda values: compute_solve_times(time for times in values for time in times),
                SolveTimes, "Solve time p50 / p99 / max", _write_solve_times,
            ),
        ),
        required=True, kind=list[FiniteFloat],
    ),
    Metric(
        "wall_seconds", "s", lambda episode, scenario: episode.wall_seconds,
        (mean("wall_seconds_mean"),), kind=FiniteFloat | None,
    ),
)  # fmt: skip


def list_columns() -> list[tuple[str, Aggregate]]:
    """Return the aggregates that tables show, each under its title with its unit."""
    return [
        (f"{a.title} [{metric.unit}]" if metric.unit and a.cell == "number" else a.title, a)
        for metric in METRICS
        for a in metric.aggregates
        if a.title
    ]


def find_metrics(domain: str) -> tuple[Metric, ...]:
    """Return what a domain measures besides METRICS."""
    return find_part("train", domain, "METRICS") or ()


def measure(metrics: Iterable[Metric], episode: Episode, scenario: Any, plan: Plan | None = None) -> dict[str, Any]:
    """Return the numbers of an episode by the metrics' names.

    Args:
        metrics: what is measured.
        episode: what happened.
        scenario: where.
        plan: that was followed.
    """
    return {
        metric.name: metric.compute(episode, scenario, plan) if metric.of_plan else metric.compute(episode, scenario)
        for metric in metrics
    }


def make_row(episode: Episode, scenario: Any, suite: str, policy: str, plan: Plan | None = None) -> dict[str, Any]:
    """Return an episode's tidy row.

    Args:
        episode: what happened.
        scenario: where, in its suite.
        suite: name of the suite.
        policy: label of the policy.
        plan: that it followed.

    Returns:
        One JSON object; ``fallback_kinds`` is JSON text, ``solve_ms`` the list of all solve times [ms].
    """
    key = {"scenario": episode.scenario, "suite": suite, "policy": policy, "seed": episode.seed}
    return key | measure((*METRICS, *find_metrics(scenario.domain)), episode, scenario, plan)


class RowKey(BaseModel):
    """What an episode is told apart by, and that all else of its row is the number of a domain's metric."""

    model_config = ConfigDict(strict=True, extra="allow")
    __pydantic_extra__: dict[str, FiniteFloat | None]

    scenario: str
    suite: str
    policy: str
    seed: int


@cache
def make_row_type() -> type[RowKey]:
    """Return the type that a row is read back by; rows of earlier versions may lack what is not required."""
    fields: dict[str, Any] = {
        metric.name: (metric.kind, ...) if metric.required else (metric.kind | None, None) for metric in METRICS
    }
    return create_model("Row", __base__=RowKey, **fields)


def summarize(rows: pd.DataFrame, domains: Mapping[str, str] | None = None) -> list[dict[str, Any]]:
    """Aggregate the episodes of every scenario, suite and policy.

    Args:
        rows: one row per episode, columns as make_row writes them.
        domains: scenario to its domain, whose own metrics are then aggregated, too.

    Returns:
        One JSON object per group, in the order in which the groups first appear. A domain's metrics are in ``figures``:
        name to ``median``, ``p90``, ``max`` and the number of ``episodes`` that have it.
    """
    table = []
    for key, group in rows.groupby(GROUP, sort=False, observed=True):
        entry = {**dict(zip(GROUP, key, strict=True)), "episodes": len(group), **_aggregate(METRICS, group)}
        own = _find_own(domains, entry["scenario"], group)
        if own:
            figures = {metric.name: _compute_quantiles(group[metric.name]) for metric in own}
            entry |= {"figures": figures, **_aggregate(own, group)}
        table.append(entry)
    return table


def compare_metrics(rows: pd.DataFrame, pair: Mapping[str, Any], domain: str) -> dict[str, Any]:
    """Compare two policies by a domain's metrics, on the seeds they share.

    Args:
        rows: one row per episode, columns as make_row writes them.
        pair: scenario, suite and policies a and b.
        domain: of the scenario.

    Returns:
        What the metrics' ``compare`` say.
    """
    here = rows[(rows["scenario"] == pair["scenario"]) & (rows["suite"] == pair["suite"])].set_index("seed")
    compared = [metric for metric in _keep_known(find_metrics(domain), here) if metric.compare]
    a, b = (here[here["policy"] == pair[side]] for side in ("a", "b"))
    said: dict[str, Any] = {}
    for metric in compared:
        assert metric.compare is not None
        left, right = (side[metric.name].astype(float).dropna() for side in (a, b))
        said |= metric.compare(*left.align(right, join="inner"))
    return said


def _find_own(domains: Mapping[str, str] | None, scenario: str, group: pd.DataFrame) -> list[Metric]:
    return _keep_known(find_metrics(domains[scenario]), group) if domains and scenario in domains else []


def _keep_known(metrics: Iterable[Metric], rows: pd.DataFrame) -> list[Metric]:
    """Return the metrics that rows have; those of an earlier version may lack some."""
    return [metric for metric in metrics if metric.name in rows.columns]


def _aggregate(metrics: Iterable[Metric], group: pd.DataFrame) -> dict[str, Any]:
    return {
        aggregate.key: aggregate.compute(group[metric.name])
        for metric in _keep_known(metrics, group)
        for aggregate in metric.aggregates
    }


def _compute_quantiles(values: pd.Series) -> dict[str, Any]:
    known = values.dropna().to_numpy(dtype=float)
    numbers: dict[str, Any] = dict.fromkeys(("median", "p90", "max")) | {"episodes": len(known)}
    if len(known):
        numbers |= {"median": float(np.median(known)), "p90": float(np.quantile(known, 0.9)), "max": float(known.max())}
    return numbers

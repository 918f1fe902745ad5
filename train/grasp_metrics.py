"""Figures of merit of a grasp by simultaneous impact, from the true signals of an episode."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
import pandas as pd

from impact_envs.rollout import Episode

AFTER = 0.4  # after the first contact, for how long steps of the torque count [s]
LONGEST_INTERIM = 0.1  # that a grasp should take [s]
OF_CONTACT = (
    "impact_time_difference",
    "torque_step",
    "torque_peak",
    "limit_time",
    "slip",
    "interim_duration",
    "force_peak",
)
FIGURES = (*OF_CONTACT, "box_error", "box_error_true")


def compute_figures(episode: Episode, scenario: Any) -> dict[str, Any]:
    """Return the figures of a dual-arm episode; nothing for another domain's.

    The box is nowhere measured, so its error is told twice: as anybody can estimate it, with the box in the middle of
    the pads, and as it is.

    Args:
        episode: what happened.
        scenario: where.

    Returns:
        ``impact_time_difference`` [s] (None unless both arms hit), ``torque_step``, the greatest change of a joint
        torque from tick to tick in the 0.4 s after the first contact, and ``torque_peak`` after it [N m],
        ``limit_time``, for which a torque was at its limit after it [s], ``slip``, the greatest net one of a pad corner
        since the grasp [m] (None without a grasp), ``interim_duration``, from the first contact to the grasp [s] (None
        without), ``force_peak`` [N], ``box_error``, distance of the middle of the pads from the target, and
        ``box_error_true``, the box's [m], at the end. None, too, where there was no contact.

    Source: van Steen et al., Sec. 5.
    """
    if scenario.domain != "dual_arm":
        return {}
    signals, target = episode.signals, scenario.target.position
    ends = {body: (signals[f"{body}.x"][-1], signals[f"{body}.y"][-1]) for body in scenario.bodies}
    middle = np.mean([ends[arm] for arm in scenario.arms], axis=0)
    figures: dict[str, Any] = dict.fromkeys(OF_CONTACT)
    figures |= {"box_error": math.dist(middle, target), "box_error_true": math.dist(ends["box"], target)}
    if not episode.impacts:
        return figures
    first = min(impact.time for impact in episode.impacts)
    after = episode.times > first + 1e-9
    soon = after & (episode.times <= first + AFTER + 1e-9)
    if len(episode.impacts) == len(scenario.arms):
        figures["impact_time_difference"] = float(signals["box.lag"][-1])
    figures["torque_step"] = float(signals["box.torque_step"][soon].max(initial=0.0))
    figures["torque_peak"] = float(signals["box.torque"][after].max(initial=0.0))
    figures["limit_time"] = float(signals["box.limit_time"][-1])
    figures["force_peak"] = float(signals["box.force_max"].max())
    interim = signals["box.interim"]
    if interim[-1] == interim[-2]:  # it grows until the grasp
        figures["interim_duration"] = float(interim[-1])
        figures["slip"] = float(signals["box.slip"][-1])
    return figures


def add_figures(rows: Iterable[dict[str, Any]], episodes: pd.DataFrame) -> list[dict[str, Any]]:
    """Add to the aggregates of an evaluation what the grasps came to.

    Args:
        rows: one per scenario, suite and policy, see train.metrics.summarize.
        episodes: one row per episode, with figures where it was a grasp.

    Returns:
        The same rows; a dual arm's also with ``figures``: name to ``median``, ``p90``, ``max`` and the number of
        ``episodes`` that have it, and ``short_interim_rate``: share of episodes grasped within 0.1 s of the contact.
    """
    return [row | _summarize(_select(episodes, row, row["policy"])) for row in rows]


def add_torque_steps(pairs: Iterable[dict[str, Any]], episodes: pd.DataFrame) -> list[dict[str, Any]]:
    """Add to paired differences which policy steps its torques less.

    Args:
        pairs: one per scenario, suite and pair a, b, see train.metrics.compare.
        episodes: one row per episode, with figures where it was a grasp.

    Returns:
        The same pairs; a dual arm's also with ``torque_step_less``, share of seeds on which the greatest step of a is
        below that of b, and ``torque_step_ratio``, median of a over b; None both if no seed has both.
    """
    return [pair | _compare_steps(episodes, pair) for pair in pairs]


def _select(episodes: pd.DataFrame, of: dict[str, Any], policy: str) -> pd.DataFrame:
    """Return the episodes of a policy that are grasps, by seed."""
    chosen = episodes["policy"] == policy
    for key in ("scenario", "suite"):
        chosen &= episodes[key] == of[key]
    found = episodes[chosen].set_index("seed")
    if not {*FIGURES} <= {*found.columns}:
        return found.iloc[:0]
    return found[found["box_error"].notna()]


def _summarize(grasps: pd.DataFrame) -> dict[str, Any]:
    if grasps.empty:
        return {}
    table: dict[str, dict[str, Any]] = {}
    for name in FIGURES:
        values = grasps[name].dropna().to_numpy(dtype=float)
        numbers = dict.fromkeys(("median", "p90", "max")) | {"episodes": len(values)}
        if len(values):
            numbers |= {"median": float(np.median(values)), "p90": float(np.quantile(values, 0.9))}
            numbers["max"] = float(values.max())
        table[name] = numbers
    short = grasps["interim_duration"].astype(float) <= LONGEST_INTERIM + 1e-9
    return {"figures": table, "short_interim_rate": float(short.mean())}


def _compare_steps(episodes: pd.DataFrame, pair: dict[str, Any]) -> dict[str, Any]:
    grasps = [_select(episodes, pair, pair[side]) for side in ("a", "b")]
    if any(found.empty for found in grasps):
        return {}
    a, b = (found["torque_step"].astype(float) for found in grasps)
    both = pd.DataFrame({"a": a, "b": b}).dropna()
    if both.empty:
        return {"torque_step_less": None, "torque_step_ratio": None}
    less, ratio = (both["a"] < both["b"]).mean(), (both["a"] / both["b"].clip(lower=1e-9)).median()
    return {"torque_step_less": float(less), "torque_step_ratio": float(ratio)}

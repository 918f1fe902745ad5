"""Metrics of a grasp by simultaneous impact, from the true signals of an episode.

None where an episode does not have one: all but the errors of the box need a contact, some a grasp.

Source: van Steen et al., Sec. 5.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from impact_envs.dual_arm.schema import DualArmScenario
from impact_envs.rollout import Episode
from train.evaluation.metric import Aggregate, Metric

if TYPE_CHECKING:
    import pandas as pd

AFTER = 0.4  # after the first contact, for how long steps of the torque count [s]
LONGEST_INTERIM = 0.1  # that a grasp should take [s]


def _find_after(episode: Episode, duration: float = math.inf) -> np.ndarray:
    """Return which samples follow the first contact, within a duration [s]."""
    first = min(impact.time for impact in episode.impacts)
    return (episode.times > first + 1e-9) & (episode.times <= first + duration + 1e-9)


def _is_grasped(episode: Episode) -> bool:
    interim = episode.signals["box.interim"]
    return bool(episode.impacts) and bool(interim[-1] == interim[-2])  # it grows until the grasp


def measure_time_difference(episode: Episode, scenario: DualArmScenario) -> float | None:
    """Return the time between the contacts of the arms; None unless both hit."""
    return float(episode.signals["box.lag"][-1]) if len(episode.impacts) == len(scenario.arms) else None


def measure_torque_step(episode: Episode, scenario: DualArmScenario) -> float | None:
    """Return the greatest change of a joint torque from tick to tick in the 0.4 s after the first contact.

    None without a grasp: it would be least where the arms do not press on the box at all.
    """
    if not _is_grasped(episode):
        return None
    return float(episode.signals["box.torque_step"][_find_after(episode, AFTER)].max(initial=0.0))


def measure_torque_peak(episode: Episode, scenario: DualArmScenario) -> float | None:
    """Return the greatest joint torque after the first contact."""
    if not episode.impacts:
        return None
    return float(episode.signals["box.torque"][_find_after(episode)].max(initial=0.0))


def measure_limit_time(episode: Episode, scenario: DualArmScenario) -> float | None:
    """Return for how long a torque was at its limit after the first contact."""
    return float(episode.signals["box.limit_time"][-1]) if episode.impacts else None


def measure_slip(episode: Episode, scenario: DualArmScenario) -> float | None:
    """Return the greatest net slip of a pad corner since the grasp; None without a grasp."""
    return float(episode.signals["box.slip"][-1]) if _is_grasped(episode) else None


def measure_interim(episode: Episode, scenario: DualArmScenario) -> float | None:
    """Return the time from the first contact to the grasp; None without a grasp."""
    return float(episode.signals["box.interim"][-1]) if _is_grasped(episode) else None


def measure_force_peak(episode: Episode, scenario: DualArmScenario) -> float | None:
    """Return the greatest contact force."""
    return float(episode.signals["box.force_max"].max()) if episode.impacts else None


def measure_box_error(episode: Episode, scenario: DualArmScenario) -> float:
    """Return the distance of the middle of the pads from the target at the end: the box is nowhere measured."""
    ends = [[episode.signals[f"{arm}.{axis}"][-1] for axis in "xy"] for arm in scenario.arms]
    return math.dist(np.mean(ends, axis=0), scenario.target.position)


def measure_true_box_error(episode: Episode, scenario: DualArmScenario) -> float:
    """Return the distance of the box from the target at the end."""
    return math.dist([episode.signals[f"box.{axis}"][-1] for axis in "xy"], scenario.target.position)


def compare_torque_steps(a: pd.Series, b: pd.Series) -> dict[str, Any]:
    """Say how often policy a steps its torques less, and the median of its greatest step over b's.

    Args:
        a: greatest step of each episode that has one, by seed [N m].
        b: of the other policy, on the same seeds.

    Returns:
        ``torque_step_less`` and ``torque_step_ratio``, None both without a shared seed.
    """
    if a.empty:
        return {"torque_step_less": None, "torque_step_ratio": None}
    less, ratio = (a < b).mean(), (a / b.clip(lower=1e-9)).median()
    return {"torque_step_less": float(less), "torque_step_ratio": float(ratio)}


def _count_short(values: pd.Series) -> float:
    """Return the share of episodes that grasped within LONGEST_INTERIM of the first contact."""
    return float((values.astype(float) <= LONGEST_INTERIM + 1e-9).mean())


METRICS = (
    Metric("impact_time_difference", "s", measure_time_difference),
    Metric("torque_step", "N m", measure_torque_step, compare=compare_torque_steps),
    Metric("torque_peak", "N m", measure_torque_peak),
    Metric("limit_time", "s", measure_limit_time),
    Metric("slip", "m", measure_slip),
    Metric("interim_duration", "s", measure_interim, (Aggregate("short_interim_rate", _count_short),)),
    Metric("force_peak", "N", measure_force_peak),
    Metric("box_error", "m", measure_box_error),
    Metric("box_error_true", "m", measure_true_box_error),
)

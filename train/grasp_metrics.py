"""Figures of merit of a grasp by simultaneous impact, from the true signals of an episode."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from impact_envs.rollout import Episode

AFTER = 0.4  # after the first contact, for how long steps of the torque count [s]


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
    figures: dict[str, Any] = dict.fromkeys(
        ("impact_time_difference", "torque_step", "torque_peak", "limit_time", "slip", "interim_duration", "force_peak")
    )
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

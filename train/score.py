"""What an episode is worth to the learner, and a policy to whoever keeps it: gains are not bought with failures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from agents.play import Played
from agents.sb3 import compute_advantages
from train.arguments import Args

SHARES = (1.0, 0.5, 0.25)  # of its corrections with which a policy is tried, until it loses no success
LEAST_LOSS = 0.0075  # of success: a policy that loses more than this on the tuning seeds is not kept
RISE, FALL = 4.0, 0.5  # of the cost of a failure, after an evaluation that lost success, or did not
HIGHEST = 8.0  # cost of a failure: beyond, robustness counts for nothing


def compute_scores(robustness: np.ndarray, scale: float, worst: float) -> np.ndarray:
    """Return what an episode is worth to the learner: max(rho / scale, -worst), shape (E,).

    Args:
        robustness: rho, shape (E,) [m].
        scale: unit [m].
        worst: a failure counts no more than this.
    """
    return np.maximum(robustness / scale, -worst)


def rate_evaluation(evaluation: dict[str, Any]) -> float:
    """Return what evaluations are ordered by: the gain that is sure, of those that lose hardly any success [m]."""
    return -math.inf if loses_success(evaluation) else evaluation["low"]


def loses_success(evaluation: dict[str, Any]) -> bool:
    """Return whether a policy succeeds noticeably less often than the expert."""
    return bool(evaluation["success_rate"] < evaluation["expert_success_rate"] - LEAST_LOSS)


def compare_episodes(args: Args, played: Played, scale: float, failure: float) -> np.ndarray:
    """Return how much better each episode was than the others with its seed, in robustness and success, shape (E,).

    Args:
        args: of the run: how episodes are weighed.
        played: E episodes, those of one seed in a row.
        scale: unit of robustness [m].
        failure: cost of a failure beside its robustness, times the scale.
    """
    better = compute_advantages(compute_scores(played.robustness, scale, args.worst), args.group, args.cut)
    return better + failure * compute_advantages(played.success.astype(float), args.group)


def find_failure_cost(start: float, evaluations: Sequence[dict[str, Any]]) -> float:
    """Return what a failure costs beside its robustness, after some evaluations.

    Greater after each evaluation that lost success, smaller after one that did not: gains are not bought with failures.

    Args:
        start: the least cost, times the expert's median robustness.
        evaluations: on tuning seeds, so far.
    """
    cost = start
    for evaluation in evaluations:
        if evaluation["share"] == 1.0:
            lost = evaluation["success_rate"] < evaluation["expert_success_rate"]
            cost = min(RISE * cost, max(start, HIGHEST)) if lost else max(start, FALL * cost)
    return cost

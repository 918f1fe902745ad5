"""What an episode is worth to the learner, and a policy to whoever keeps it: gains are not bought with failures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from agents.play import Played
from agents.sb3 import compute_advantages
from train.arguments import Args

ROUNDING = 1e-9  # of a share of episodes: who loses just as much as is allowed may be kept


def compute_scores(robustness: np.ndarray, scale: float, worst: float) -> np.ndarray:
    """Return what an episode is worth to the learner: max(rho / scale, -worst), shape (E,).

    Args:
        robustness: rho, shape (E,) [m].
        scale: unit [m].
        worst: a failure counts no more than this.
    """
    return np.maximum(robustness / scale, -worst)


def rate_evaluation(evaluation: dict[str, Any], loss: float) -> float:
    """Return what evaluations are ordered by: the gain that is sure, of those that lose hardly any success [m]."""
    return -math.inf if loses_success(evaluation, loss) else evaluation["low"]


def loses_success(evaluation: dict[str, Any], loss: float) -> bool:
    """Return whether a policy succeeds less often than the expert, by more than a share of the episodes.

    What it wins in one suite does not pay for what it loses in another. The share of one of n is known sqrt(n) times
    less well than that of all, so it may lose so many times as much.
    """
    alone = loss * math.sqrt(max(len(evaluation["sources"]), 1))
    parts = [(evaluation, loss), *((source, alone) for source in evaluation["sources"])]
    return any(part["success_rate"] < part["expert_success_rate"] - limit - ROUNDING for part, limit in parts)


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


def find_failure_cost(args: Args, evaluations: Sequence[dict[str, Any]]) -> float:
    """Return what a failure costs beside its robustness, after some evaluations, times the expert's median robustness.

    Greater after each evaluation that lost success, smaller after one that did not: gains are not bought with failures.

    Args:
        args: of the run: the least and the greatest cost, and how it moves.
        evaluations: on tuning seeds, so far.
    """
    cost, highest = args.failure, max(args.failure, args.highest_failure)
    for evaluation in evaluations:
        if evaluation["share"] == 1.0:  # a share of a policy says nothing of it
            fewer = evaluation["success_rate"] < evaluation["expert_success_rate"]
            lost = fewer or loses_success(evaluation, args.loss)
            cost = min(args.failure_rise * cost, highest) if lost else max(args.failure, args.failure_fall * cost)
    return cost

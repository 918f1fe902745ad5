"""A task of one decision that is learned in moments, and small models to learn it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.utils import set_random_seed

from agents.actor import Actor
from agents.sb3 import (
    LearningOptions,
    Statistics,
    compute_advantages,
    compute_statistics,
    explore,
    export_actor,
    make_model,
    update,
)

SIZES = (5, 2)
GROUP, PLACES = 8, 8  # decisions in each place, and places, of a round
OPTIONS = LearningOptions(
    hidden=(8, 4), learning_rate=1e-2, batch=32, epochs=4, clip=0.2, entropy=0.0, target_kl=None, log_std=-1.2, seed=0
)


def draw_features(seed: int, count: int) -> np.ndarray:
    """Return features of very different size, one of them constant, shape (count, 5)."""
    return np.random.default_rng(seed).normal(size=(count, SIZES[0])) * [1.0, 1e-2, 50.0, 1.0, 0.0] + 3.0


STATISTICS: Statistics = compute_statistics(draw_features(0, 1000))


def make_small(**changes: Any) -> PPO:
    """Return a new model of the task."""
    model = make_model(*SIZES, replace(OPTIONS, **changes))
    return model


def compute_rewards(normalized: np.ndarray, corrections: np.ndarray) -> np.ndarray:
    """Return the rewards of corrections, best where the first two features say, shape (n,)."""
    return -np.sum((corrections - 0.2 * normalized[:, :2]) ** 2, axis=1)


def practise(model: PPO, rounds: int = 1, seed: int = 0) -> None:
    """Let a model make decisions and learn from them."""
    for number in range(rounds):
        set_random_seed(seed + number)
        normalized = STATISTICS.normalize(np.repeat(draw_features(seed + number, PLACES), GROUP, axis=0))
        corrections = explore(model, normalized)
        update(model, normalized, corrections, compute_advantages(compute_rewards(normalized, corrections), GROUP))


def export(model: PPO) -> Actor:
    """Return the model's policy."""
    return export_actor(model, STATISTICS)

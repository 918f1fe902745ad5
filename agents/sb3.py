"""PPO of Stable-Baselines3 over whole episodes: an episode is compared with others of the same seed."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, cast

import gymnasium
import numpy as np
import torch
from gymnasium.spaces import Box
from stable_baselines3 import PPO
from stable_baselines3.common.buffers import RolloutBuffer
from stable_baselines3.common.logger import Logger
from torch import nn

from agents.actor import Actor, set_to_zero

LEAST_SPREAD = 1e-3  # of a feature: one that hardly varies is not blown up to noise
FEATURE_CLIP = 10.0  # of a normalised feature


@dataclass(frozen=True)
class LearningOptions:
    """Options of PPO.

    Attributes:
        hidden: width of each hidden layer.
        learning_rate: step size of Adam.
        batch: corrections per gradient step.
        epochs: times that every correction is learned from.
        clip: greatest relative change of a correction's probability that is rewarded.
        entropy: weight of the exploration's entropy.
        target_kl: change of the policy at which an update ends early; None: never.
        log_std: logarithm of the exploration's standard deviation at the start.
        seed: of the network.
    """

    hidden: tuple[int, ...]
    learning_rate: float
    batch: int
    epochs: int
    clip: float
    entropy: float
    target_kl: float | None
    log_std: float
    seed: int


@dataclass(frozen=True)
class Statistics:
    """Mean and spread of an expert's features, by which they are normalised.

    Attributes:
        mean, std: shape (F,).
    """

    mean: np.ndarray
    std: np.ndarray

    def normalize(self, features: np.ndarray) -> np.ndarray:
        """Return features over their spread, clipped, shape (n, F), float32."""
        return np.clip((features - self.mean) / self.std, -FEATURE_CLIP, FEATURE_CLIP).astype(np.float32)


def compute_statistics(features: np.ndarray) -> Statistics:
    """Return mean and spread of features, shape (n, F)."""
    return Statistics(features.mean(axis=0), np.sqrt(features.var(axis=0) + LEAST_SPREAD**2))


class _Spaces(gymnasium.Env[np.ndarray, np.ndarray]):
    """All that PPO asks of an environment: episodes are played elsewhere."""

    def __init__(self, feature_size: int, correction_size: int) -> None:
        self.observation_space = Box(-FEATURE_CLIP, FEATURE_CLIP, (feature_size,), np.float32)
        self.action_space = Box(-1.0, 1.0, (correction_size,), np.float32)


def make_model(feature_size: int, correction_size: int, options: LearningOptions) -> PPO:
    """Make a model whose mean correction is exactly zero: the expert.

    gamma = 1: an episode has few corrections, and its end is what counts. There is no value function: what an episode
    is worth beside what its world allows, other episodes in the same world tell better.

    Args:
        feature_size, correction_size: of the expert.
        options: of the algorithm.
    """
    model = PPO(
        "MlpPolicy",
        _Spaces(feature_size, correction_size),
        options.learning_rate,
        n_steps=options.batch,
        batch_size=options.batch,
        n_epochs=options.epochs,
        gamma=1.0,
        gae_lambda=1.0,
        clip_range=options.clip,
        ent_coef=options.entropy,
        vf_coef=0.0,
        target_kl=options.target_kl,
        policy_kwargs={"net_arch": {"pi": list(options.hidden), "vf": []}, "activation_fn": nn.Tanh},
        seed=options.seed,
        device="cpu",
    )
    model.set_logger(Logger(None, []))  # SB3's own makes a folder in the temporary directory
    set_to_zero(model.policy.action_net)
    set_to_zero(model.policy.value_net)
    nn.init.constant_(cast(Any, model.policy).log_std, options.log_std)
    return model


def explore(model: PPO, normalized: np.ndarray) -> np.ndarray:
    """Return corrections drawn from a model's policy, shape (m, C).

    Args:
        model: to draw from, with torch's generator.
        normalized: features, shape (m, F).

    Raises:
        FloatingPointError: weights, or what they predict, are not finite.
    """
    with torch.no_grad(), _refuse_infinity():
        actions, _, _ = model.policy(torch.from_numpy(normalized))
    if not torch.isfinite(actions).all():
        raise FloatingPointError("predictions are not finite")
    return actions.numpy()


def compute_advantages(scores: np.ndarray, group: int, cut: float = math.inf) -> np.ndarray:
    """Return how much better each episode was than the others with its seed, shape (E,).

    A_i = sum_{j != i} clip(R_i - R_j, -cut, cut) / (g - 1). Without a cut it is the difference to the others' mean:
    unbiased, because their corrections do not depend on its own. Cut, a world that is lost or won by chance does not
    outweigh many in which a little is gained.

    Args:
        scores: of episodes, those of one seed in a row, shape (E,).
        group: g, episodes of a seed, at least 2.
        cut: greatest difference that counts.

    Source: Kool, van Hoof & Welling, "Buy 4 REINFORCE samples, get a baseline for free!" (2019).
    """
    each = scores.reshape(-1, group)
    differences = np.clip(each[:, :, np.newaxis] - each[:, np.newaxis], -cut, cut)
    return differences.sum(axis=2).reshape(-1) / (group - 1)


def update(model: PPO, normalized: np.ndarray, corrections: np.ndarray, advantages: np.ndarray) -> None:
    """Improve a model's policy by PPO's clipped objective.

    Args:
        model: that chose the corrections.
        normalized: features, shape (n, F).
        corrections: as drawn, shape (n, C).
        advantages: of each, shape (n,).

    Raises:
        FloatingPointError: weights, or what they predict, are no longer finite.
    """
    count = len(corrections)
    buffer = RolloutBuffer(count, model.observation_space, model.action_space, "cpu", gae_lambda=1.0, gamma=1.0)
    with torch.no_grad(), _refuse_infinity():
        actions = torch.from_numpy(corrections.astype(np.float32))
        _, probability, _ = model.policy.evaluate_actions(torch.from_numpy(normalized), actions)
    buffer.observations[:, 0], buffer.actions[:, 0] = normalized, actions.numpy()
    buffer.log_probs[:, 0] = probability.numpy()
    buffer.advantages[:, 0] = advantages
    buffer.full, model.rollout_buffer = True, buffer
    model.num_timesteps += count
    with _refuse_infinity():
        model.train()
    if not all(torch.isfinite(parameter).all() for parameter in model.policy.parameters()):
        raise FloatingPointError("weights are not finite")


@contextmanager
def _refuse_infinity() -> Iterator[None]:
    """Give torch's refusal of a normal distribution that is not finite a type of its own."""
    try:
        yield
    except ValueError as error:
        if "Normal" not in str(error):
            raise
        raise FloatingPointError("predictions are not finite") from error


def export_actor(model: PPO, statistics: Statistics, share: float = 1.0) -> Actor:
    """Copy the deterministic policy out of a model, without exploration.

    Args:
        model: from `make_model`.
        statistics: by which its features are normalised.
        share: of its mean correction, the expert at 0.

    Returns:
        An actor whose correction equals ``share * model.predict(normalized features, deterministic=True)``.
    """
    modules = (*model.policy.mlp_extractor.policy_net, model.policy.action_net)
    layers = [layer for layer in modules if isinstance(layer, nn.Linear)]
    hidden = tuple(layer.out_features for layer in layers[:-1])
    actor = Actor(layers[0].in_features, layers[-1].out_features, hidden, FEATURE_CLIP)
    for mine, theirs in zip(actor.layers, layers, strict=True):
        mine.load_state_dict(theirs.state_dict())
    with torch.no_grad():
        for parameter in actor.layers[-1].parameters():
            parameter.mul_(share)
    actor.mean.copy_(torch.from_numpy(statistics.mean))
    actor.std.copy_(torch.from_numpy(statistics.std))
    return actor

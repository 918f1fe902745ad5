"""A task that is learned in moments, and small models to learn it."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium.spaces import Box
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

SIZES = (5, 2)


class Target(gymnasium.Env[np.ndarray, np.ndarray]):
    """One decision: hit a place that the features give away, in features of very different size."""

    observation_space = Box(-np.inf, np.inf, (SIZES[0],), np.float64)
    action_space = Box(-1.0, 1.0, (SIZES[1],), np.float32)

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[np.ndarray, dict[str, Any]]:
        super().reset(seed=seed)
        self._features = self.np_random.normal(size=SIZES[0]) * [1.0, 1e-3, 50.0, 1.0, 0.0] + 3.0
        return self._features.copy(), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        return self._features.copy(), -float(np.sum((action - 0.1 * self._features[:2]) ** 2)), True, False, {}


def make_model(algorithm: str) -> tuple[BaseAlgorithm, VecNormalize]:
    envs = VecNormalize(DummyVecEnv([Target, Target]), norm_reward=False, epsilon=1e-6)
    network = {"net_arch": [8, 8], "activation_fn": torch.nn.Tanh}
    if algorithm == "ppo":
        return PPO("MlpPolicy", envs, n_steps=16, batch_size=16, policy_kwargs=network, seed=0, device="cpu"), envs
    options = {"learning_starts": 8, "batch_size": 8, "buffer_size": 64}
    return SAC("MlpPolicy", envs, **options, policy_kwargs=network, seed=0, device="cpu"), envs

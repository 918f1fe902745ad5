"""Learning algorithms of Stable-Baselines3: an entry of `ALGORITHMS` says all that the project knows of one."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Literal, cast

import numpy as np
import torch
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.vec_env import VecNormalize
from torch import nn

from agents.actor import Actor, set_to_zero
from impact_envs.errors import InputError, choices

REPLAY_SIZE = 100_000  # corrections that an off-policy algorithm learns from


@dataclass(frozen=True)
class LearningOptions:
    """Options that all algorithms share; each uses those that it has.

    Attributes:
        hidden: width of each hidden layer, for policy and value.
        learning_rate: step size of Adam.
        rollout: corrections between two on-policy updates, over all environments.
        batch: corrections per gradient step.
        log_std: logarithm of the exploration's standard deviation at the start, before any squashing.
        seed: of networks and exploration.
    """

    hidden: tuple[int, ...]
    learning_rate: float
    rollout: int
    batch: int
    log_std: float
    seed: int


@dataclass(frozen=True)
class Algorithm:
    """A learning algorithm.

    Attributes:
        model: its class.
        squash: how its deterministic policy keeps corrections in [-1, 1].
        make: return a new model from environments, options, and the keyword arguments that all algorithms take.
        list_layers: return the modules of a model's deterministic policy, from features to corrections; only linear
            layers with tanh between them are exported.
        start_at_expert: make the mean correction of a new model zero, and its exploration as log_std says.
    """

    model: type[BaseAlgorithm]
    squash: Literal["clip", "tanh"]
    make: Callable[[VecNormalize, LearningOptions, dict[str, Any]], BaseAlgorithm]
    list_layers: Callable[[Any], Iterable[nn.Module]]
    start_at_expert: Callable[[Any, float], None]


def _make_ppo(envs: VecNormalize, options: LearningOptions, shared: dict[str, Any]) -> PPO:
    steps = max(2, options.rollout // envs.num_envs)
    batch = min(options.batch, steps * envs.num_envs)
    return PPO("MlpPolicy", envs, options.learning_rate, steps, batch, gae_lambda=1.0, **shared)


def _start_ppo(model: PPO, log_std: float) -> None:
    """Zero the value too: nothing is known of it before the first episode."""
    set_to_zero(model.policy.action_net)
    set_to_zero(model.policy.value_net)
    nn.init.constant_(model.policy.log_std, log_std)


def _make_sac(envs: VecNormalize, options: LearningOptions, shared: dict[str, Any]) -> SAC:
    rate, batch = options.learning_rate, options.batch
    return SAC("MlpPolicy", envs, rate, REPLAY_SIZE, batch, batch, gradient_steps=-1, **shared)


def _start_sac(model: SAC, log_std: float) -> None:
    """Make the standard deviation the same for all features."""
    set_to_zero(model.actor.mu)
    layer = cast(nn.Linear, model.actor.log_std)
    set_to_zero(layer)
    nn.init.constant_(layer.bias, log_std)


ALGORITHMS = {
    "ppo": Algorithm(
        PPO, "clip", _make_ppo, lambda m: (*m.policy.mlp_extractor.policy_net, m.policy.action_net), _start_ppo
    ),
    "sac": Algorithm(SAC, "tanh", _make_sac, lambda m: (*m.actor.latent_pi, m.actor.mu), _start_sac),
}


def check_algorithm(name: str) -> None:
    """Raise unless an algorithm is known.

    Raises:
        InputError: one line with the choices.
    """
    if name not in ALGORITHMS:
        raise InputError(f"algo '{name}' is unknown; {choices(name, ALGORITHMS)}")


def find_name(model: BaseAlgorithm) -> str:
    """Return the name of a model's algorithm."""
    return next(name for name, algorithm in ALGORITHMS.items() if isinstance(model, algorithm.model))


def make_model(name: str, envs: VecNormalize, options: LearningOptions) -> BaseAlgorithm:
    """Make a model that starts exactly at the expert.

    gamma = 1: an episode has few decisions, and its return is what counts.

    Args:
        name: of the algorithm.
        envs: training environments.
        options: of the algorithm.

    Raises:
        InputError: unknown algorithm.
    """
    check_algorithm(name)
    network = {"net_arch": list(options.hidden), "activation_fn": nn.Tanh}
    shared = {"gamma": 1.0, "policy_kwargs": network, "seed": options.seed, "device": "cpu"}
    model = ALGORITHMS[name].make(envs, options, shared)
    start_at_expert(model, options.log_std)
    return model


def start_at_expert(model: BaseAlgorithm, log_std: float) -> None:
    """Make a new model's mean correction exactly zero.

    Args:
        model: of an algorithm in `ALGORITHMS`.
        log_std: logarithm of the exploration's standard deviation, before any squashing.
    """
    ALGORITHMS[find_name(model)].start_at_expert(model, log_std)


def export_actor(model: BaseAlgorithm, normalize: VecNormalize) -> Actor:
    """Copy the deterministic policy out of a model, without value function or exploration.

    Args:
        model: of an algorithm in `ALGORITHMS`.
        normalize: the model's environment, which holds the running statistics of the features.

    Returns:
        An actor whose correction equals ``model.predict(normalized features, deterministic=True)``.
    """
    algorithm = ALGORITHMS[find_name(model)]
    layers = [layer for layer in algorithm.list_layers(model) if isinstance(layer, nn.Linear)]
    actor = Actor(
        layers[0].in_features,
        layers[-1].out_features,
        tuple(layer.out_features for layer in layers[:-1]),
        algorithm.squash,
        normalize.clip_obs,
    )
    for mine, theirs in zip(actor.layers, layers, strict=True):
        mine.load_state_dict(theirs.state_dict())
    statistics = get_statistics(normalize)
    actor.mean.copy_(torch.from_numpy(statistics.mean))
    actor.std.copy_(torch.from_numpy(np.sqrt(statistics.var + normalize.epsilon)))
    return actor


def get_statistics(normalize: VecNormalize) -> RunningMeanStd:
    """Return the statistics of the features, which are one vector and not a dictionary of them."""
    return cast(RunningMeanStd, normalize.obs_rms)

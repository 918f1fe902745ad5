"""Bridge to Stable-Baselines3: export the actor of a PPO or SAC model, save and restore a training run."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal, cast

import numpy as np
import torch
from pydantic import Field
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.vec_env import VecNormalize
from torch import nn

from agents.actor import Actor, set_to_zero
from agents.checkpoint import Record, check_tensors, read_record, read_tensors, write_record, write_tensors
from impact_envs.errors import InputError

STATE, DESCRIPTION = "training.safetensors", "training.json"
REPLAY = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")
Model = PPO | SAC


class TrainingRecord(Record):
    """What training.json says: all a run needs to go on that is not a tensor.

    Attributes:
        format_version: of the two files.
        algorithm: "ppo" or "sac".
        steps: corrections answered so far.
        updates: gradient updates so far, as SB3 counts them.
        feature_count: number of feature vectors behind the running mean and variance.
        param_groups: of every optimiser, by SB3's name for it.
        replay_position: where SAC's replay buffer writes next.
        replay_full: whether it has wrapped around.
        run: every argument of the run.
        evaluations: result of every evaluation on tuning seeds so far.
    """

    format_version: Literal[1] = 1
    algorithm: Literal["ppo", "sac"]
    steps: Annotated[int, Field(ge=0)]
    updates: Annotated[int, Field(ge=0)]
    feature_count: Annotated[float, Field(gt=0)]
    param_groups: dict[str, list[dict[str, Any]]]
    replay_position: Annotated[int, Field(ge=0)] = 0
    replay_full: bool = False
    run: dict[str, Any]
    evaluations: list[dict[str, Any]] = Field(default_factory=list)


def start_at_expert(model: Model, log_std: float) -> None:
    """Make a new model's mean correction exactly zero, its exploration small, and PPO's value zero.

    Args:
        model: PPO or SAC model with a state-independent (PPO) or state-dependent (SAC) Gaussian.
        log_std: logarithm of the exploration's standard deviation, before any squashing.
    """
    if isinstance(model, PPO):
        set_to_zero(model.policy.action_net)
        set_to_zero(model.policy.value_net)
        nn.init.constant_(model.policy.log_std, log_std)
    else:
        set_to_zero(model.actor.mu)
        layer = cast(nn.Linear, model.actor.log_std)
        set_to_zero(layer)
        nn.init.constant_(layer.bias, log_std)


def export_actor(model: Model, normalize: VecNormalize) -> Actor:
    """Copy the deterministic policy out of a model, without value function or exploration.

    Args:
        model: PPO or SAC model whose networks have tanh layers.
        normalize: the model's environment, which holds the running statistics of the features.

    Returns:
        An actor whose correction equals ``model.predict(normalized features, deterministic=True)``.
    """
    if isinstance(model, PPO):
        hidden, output = model.policy.mlp_extractor.policy_net, model.policy.action_net
    else:
        hidden, output = model.actor.latent_pi, model.actor.mu
    layers = [layer for layer in (*hidden, output) if isinstance(layer, nn.Linear)]
    actor = Actor(
        layers[0].in_features,
        layers[-1].out_features,
        tuple(layer.out_features for layer in layers[:-1]),
        "clip" if isinstance(model, PPO) else "tanh",
        normalize.clip_obs,
    )
    for mine, theirs in zip(actor.layers, layers, strict=True):
        mine.load_state_dict(theirs.state_dict())
    statistics = _statistics(normalize)
    actor.mean.copy_(torch.from_numpy(statistics.mean))
    actor.std.copy_(torch.from_numpy(np.sqrt(statistics.var + normalize.epsilon)))
    return actor


def save_training(
    directory: str | Path,
    model: Model,
    normalize: VecNormalize,
    run: dict[str, Any],
    evaluations: list[dict[str, Any]],
) -> None:
    """Write all a killed run needs to go on: networks, optimisers, feature statistics, replay buffer.

    Args:
        directory: folder to write training.safetensors and training.json into.
        model: PPO or SAC model.
        normalize: the model's environment.
        run: every argument of the run.
        evaluations: results on tuning seeds so far.

    Raises:
        InputError: the files cannot be written.
    """
    buffer = None if isinstance(model, PPO) else model.replay_buffer
    record = TrainingRecord(
        algorithm="ppo" if isinstance(model, PPO) else "sac",
        steps=model.num_timesteps,
        updates=model._n_updates,
        feature_count=float(_statistics(normalize).count),
        param_groups={name: state["param_groups"] for name, state in _optimizers(model).items()},
        replay_position=buffer.pos if buffer else 0,
        replay_full=bool(buffer.full) if buffer else False,
        run=run,
        evaluations=evaluations,
    )
    write_tensors(Path(directory) / STATE, _tensors(model, normalize))
    write_record(Path(directory) / DESCRIPTION, record)


def read_training(directory: str | Path) -> TrainingRecord:
    """Read what a saved run says of itself, without its tensors.

    Args:
        directory: folder with training.json.

    Raises:
        InputError: one line naming the file and the key.
    """
    return read_record(Path(directory) / DESCRIPTION, TrainingRecord)


def load_training(directory: str | Path, model: Model, normalize: VecNormalize) -> TrainingRecord:
    """Put a saved run into a model of the same architecture.

    Args:
        directory: folder with training.safetensors and training.json.
        model: new PPO or SAC model; its networks, optimisers and counters are overwritten.
        normalize: the model's environment; its statistics are overwritten.

    Returns:
        The rest of the run's state.

    Raises:
        InputError: one line naming the file and what does not fit.
    """
    path = Path(directory) / STATE
    record = read_training(directory)
    tensors = read_tensors(path)
    _restore_features(path, normalize, tensors, record)
    if not isinstance(model, PPO):
        _restore_replay(path, model, tensors, record)
    _restore_parameters(path, model, tensors, record)
    model.num_timesteps, model._n_updates = record.steps, record.updates
    return record


def _statistics(normalize: VecNormalize) -> RunningMeanStd:
    """Return the statistics of the features, which are one vector and not a dictionary of them."""
    return cast(RunningMeanStd, normalize.obs_rms)


def _optimizers(model: Model) -> dict[str, dict[str, Any]]:
    return {name: state for name, state in model.get_parameters().items() if "param_groups" in state}


def _networks(model: Model) -> dict[str, np.ndarray]:
    """Return the weights of every network by name; SAC's temperature is one of them."""
    states = {name: state for name, state in model.get_parameters().items() if "param_groups" not in state}
    tensors = {f"{name}/{key}": tensor for name, state in states.items() for key, tensor in state.items()}
    if isinstance(model, SAC) and model.log_ent_coef is not None:
        tensors["log_ent_coef"] = model.log_ent_coef
    return {name: tensor.detach().cpu().numpy() for name, tensor in tensors.items()}


def _tensors(model: Model, normalize: VecNormalize) -> dict[str, np.ndarray]:
    tensors = _networks(model)
    for name, state in _optimizers(model).items():
        for index, entries in state["state"].items():
            tensors |= {f"{name}/{index}/{key}": value.cpu().numpy() for key, value in entries.items()}
    statistics = _statistics(normalize)
    tensors |= {"features/mean": statistics.mean, "features/var": statistics.var}
    if isinstance(model, SAC) and model.replay_buffer is not None:
        filled = model.replay_buffer.size()
        tensors |= {f"replay/{name}": getattr(model.replay_buffer, name)[:filled] for name in REPLAY}
    return tensors


def _restore_features(
    path: Path, normalize: VecNormalize, tensors: dict[str, np.ndarray], record: TrainingRecord
) -> None:
    statistics = _statistics(normalize)
    expected = {"features/mean": statistics.mean, "features/var": statistics.var}
    found = {name: tensors.pop(name) for name in expected if name in tensors}
    check_tensors(path, found, expected)
    statistics.mean, statistics.var = found["features/mean"], found["features/var"]
    statistics.count = record.feature_count


def _restore_replay(path: Path, model: SAC, tensors: dict[str, np.ndarray], record: TrainingRecord) -> None:
    buffer = model.replay_buffer
    assert buffer is not None
    filled = buffer.buffer_size if record.replay_full else record.replay_position
    if filled > buffer.buffer_size:
        raise InputError(f"{path}: replay buffer of {filled} rows does not fit into {buffer.buffer_size}")
    expected = {f"replay/{name}": getattr(buffer, name)[:filled] for name in REPLAY}
    found = {name: tensors.pop(name) for name in expected if name in tensors}
    check_tensors(path, found, expected)
    for name, array in found.items():
        expected[name][:] = array
    buffer.pos, buffer.full = record.replay_position, record.replay_full


def _restore_parameters(path: Path, model: Model, tensors: dict[str, np.ndarray], record: TrainingRecord) -> None:
    expected = _networks(model)
    check_tensors(path, {name: tensors[name] for name in expected if name in tensors}, expected)
    if record.param_groups.keys() != (optimizers := _optimizers(model)).keys():
        raise InputError(
            f"{path.with_name(DESCRIPTION)}: key 'param_groups': has {', '.join(record.param_groups)}; "
            f"expected {', '.join(optimizers)}"
        )
    states: dict[str, dict[str, Any]] = {name: {"state": {}} for name in optimizers}
    for name in tensors.keys() - expected.keys():
        optimizer, _, rest = name.partition("/")
        index, _, key = rest.partition("/")
        if optimizer not in states or not index.isdigit() or not key:
            raise InputError(f"{path}: tensor '{name}' is unknown")
        states[optimizer]["state"].setdefault(int(index), {})[key] = torch.from_numpy(tensors[name])
    for name, groups in record.param_groups.items():
        states[name]["param_groups"] = groups
    for name in expected:
        if name == "log_ent_coef":
            cast(torch.Tensor, cast(SAC, model).log_ent_coef).data.copy_(torch.from_numpy(tensors[name]))
            continue
        network, _, key = name.partition("/")
        states.setdefault(network, {})[key] = torch.from_numpy(tensors[name])
    try:
        model.set_parameters(cast(Any, states), exact_match=True)
    except (ValueError, RuntimeError, KeyError) as error:
        raise InputError(f"{path}: does not fit the model: {str(error).splitlines()[0]}") from None

"""The state of a training run on disk: networks, optimisers, feature statistics, replay buffer."""

from __future__ import annotations

import json
from itertools import zip_longest
from operator import attrgetter
from pathlib import Path
from typing import Annotated, Any, Literal, cast

import numpy as np
import torch
from pydantic import Field
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.vec_env import VecNormalize

from agents.checkpoint import WeightsRecord, check_tensors, read_record, read_tensors, write_checkpoint
from agents.sb3 import find_name, get_statistics
from impact_envs.errors import InputError

STATE, DESCRIPTION = "training.safetensors", "training.json"
MOMENTS = ("step", "exp_avg", "exp_avg_sq")  # of a parameter, as Adam names them
REPLAY = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")


class TrainingRecord(WeightsRecord):
    """The content of training.json: all that a run needs to continue and that is no tensor.

    Attributes:
        format_version: of the two files.
        algorithm: of `sb3.ALGORITHMS`.
        steps: corrections answered so far.
        updates: gradient updates so far, as SB3 counts them.
        feature_count: number of feature vectors behind the running mean and variance.
        param_groups: of every optimiser, by SB3's name for it.
        replay_position: where the replay buffer writes next; 0 without one.
        replay_full: whether it has wrapped around.
        run: every argument of the run.
        evaluations: result of every evaluation on tuning seeds so far.
    """

    format_version: Literal[1] = 1
    algorithm: str
    steps: Annotated[int, Field(ge=0)]
    updates: Annotated[int, Field(ge=0)]
    feature_count: Annotated[float, Field(gt=0)]
    param_groups: dict[str, list[dict[str, Any]]]
    replay_position: Annotated[int, Field(ge=0)] = 0
    replay_full: bool = False
    run: dict[str, Any]
    evaluations: list[dict[str, Any]] = Field(default_factory=list)


def save_training(
    directory: str | Path,
    model: BaseAlgorithm,
    normalize: VecNormalize,
    run: dict[str, Any],
    evaluations: list[dict[str, Any]],
) -> None:
    """Write all that a killed run needs to continue.

    Args:
        directory: folder to write training.safetensors and training.json into.
        model: of an algorithm in `sb3.ALGORITHMS`.
        normalize: the model's environment.
        run: every argument of the run.
        evaluations: results on tuning seeds so far.

    Raises:
        InputError: the files cannot be written.
    """
    buffer = _get_replay(model)
    record = TrainingRecord(
        algorithm=find_name(model),
        steps=model.num_timesteps,
        updates=cast(Any, model)._n_updates,
        feature_count=float(get_statistics(normalize).count),
        param_groups={name: state["param_groups"] for name, state in _optimizers(model).items()},
        replay_position=buffer.pos if buffer else 0,
        replay_full=bool(buffer.full) if buffer else False,
        run=run,
        evaluations=evaluations,
    )
    write_checkpoint((Path(directory) / STATE, _tensors(model, normalize)), (Path(directory) / DESCRIPTION, record))


def read_training(directory: str | Path) -> TrainingRecord:
    """Read training.json of a saved run, without its tensors.

    Args:
        directory: folder with training.json.

    Raises:
        InputError: one line naming the file and the key.
    """
    return read_record(Path(directory) / DESCRIPTION, TrainingRecord)


def load_training(directory: str | Path, model: BaseAlgorithm, normalize: VecNormalize) -> TrainingRecord:
    """Restore a saved run into a model of the same architecture.

    Args:
        directory: folder with training.safetensors and training.json.
        model: new one of the same algorithm; its networks, optimisers and counters are overwritten.
        normalize: the model's environment; its statistics are overwritten.

    Returns:
        The rest of the run's state.

    Raises:
        InputError: one line naming the file and what does not fit.
    """
    path = Path(directory) / STATE
    record = read_training(directory)
    if record.algorithm != find_name(model):
        raise InputError(
            f"{path.with_name(DESCRIPTION)}: key 'algorithm': is '{record.algorithm}', expected '{find_name(model)}'"
        )
    tensors = read_tensors(path, record)
    _restore_features(path, normalize, tensors, record)
    buffer = _get_replay(model)
    if buffer is not None:
        _restore_replay(path, buffer, tensors, record)
    _restore_parameters(path, model, tensors, record)
    model.num_timesteps, cast(Any, model)._n_updates = record.steps, record.updates
    return record


def _get_replay(model: BaseAlgorithm) -> ReplayBuffer | None:
    """Return the replay buffer of an off-policy model, None if there is none."""
    return getattr(model, "replay_buffer", None)


def _get_variables(model: BaseAlgorithm) -> dict[str, torch.Tensor]:
    """Return the learned tensors of a model that belong to no network, by name; for example SAC's temperature."""
    _, names = model._get_torch_save_params()
    return {name: getattr(model, name) for name in names}


def _optimizers(model: BaseAlgorithm) -> dict[str, dict[str, Any]]:
    return {name: state for name, state in model.get_parameters().items() if "param_groups" in state}


def _networks(model: BaseAlgorithm) -> dict[str, np.ndarray]:
    """Return the weights of all networks and the other learned tensors by name."""
    states = {name: state for name, state in model.get_parameters().items() if "param_groups" not in state}
    tensors = {f"{name}/{key}": tensor for name, state in states.items() for key, tensor in state.items()}
    tensors |= _get_variables(model)
    return {name: tensor.detach().cpu().numpy() for name, tensor in tensors.items()}


def _tensors(model: BaseAlgorithm, normalize: VecNormalize) -> dict[str, np.ndarray]:
    tensors = _networks(model)
    for name, state in _optimizers(model).items():
        for index, entries in state["state"].items():
            tensors |= {f"{name}/{index}/{key}": value.cpu().numpy() for key, value in entries.items()}
    statistics = get_statistics(normalize)
    tensors |= {"features/mean": statistics.mean, "features/var": statistics.var}
    buffer = _get_replay(model)
    if buffer is not None:
        filled = buffer.size()
        tensors |= {f"replay/{name}": getattr(buffer, name)[:filled] for name in REPLAY}
    return tensors


def _restore_features(
    path: Path, normalize: VecNormalize, tensors: dict[str, np.ndarray], record: TrainingRecord
) -> None:
    statistics = get_statistics(normalize)
    expected = {"features/mean": statistics.mean, "features/var": statistics.var}
    found = {name: tensors.pop(name) for name in expected if name in tensors}
    check_tensors(path, found, expected)
    statistics.mean, statistics.var = found["features/mean"], found["features/var"]
    statistics.count = record.feature_count


def _restore_replay(path: Path, buffer: ReplayBuffer, tensors: dict[str, np.ndarray], record: TrainingRecord) -> None:
    filled = buffer.buffer_size if record.replay_full else record.replay_position
    if filled > buffer.buffer_size:
        raise InputError(f"{path}: replay buffer of {filled} rows does not fit into {buffer.buffer_size}")
    expected = {f"replay/{name}": getattr(buffer, name)[:filled] for name in REPLAY}
    found = {name: tensors.pop(name) for name in expected if name in tensors}
    check_tensors(path, found, expected)
    for name, array in found.items():
        expected[name][:] = array
    buffer.pos, buffer.full = record.replay_position, record.replay_full


def _restore_parameters(
    path: Path, model: BaseAlgorithm, tensors: dict[str, np.ndarray], record: TrainingRecord
) -> None:
    expected, variables = _networks(model), _get_variables(model)
    check_tensors(path, {name: tensors[name] for name in expected if name in tensors}, expected)
    if record.param_groups.keys() != (optimizers := _optimizers(model)).keys():
        raise InputError(
            f"{path.with_name(DESCRIPTION)}: key 'param_groups': has {', '.join(record.param_groups)}; "
            f"expected {', '.join(optimizers)}"
        )
    rest = {name: array for name, array in tensors.items() if name not in expected}
    for name in rest:
        if name.partition("/")[0] not in optimizers:
            raise InputError(f"{path}: tensor '{name}' is unknown")
    states = {name: _read_optimizer(path, model, name, rest, record) for name in optimizers}
    for name in expected:
        if name in variables:
            variables[name].data.copy_(torch.from_numpy(tensors[name]))
            continue
        network, _, key = name.partition("/")
        states.setdefault(network, {})[key] = torch.from_numpy(tensors[name])
    model.set_parameters(cast(Any, states), exact_match=True)


def _read_optimizer(
    path: Path, model: BaseAlgorithm, name: str, tensors: dict[str, np.ndarray], record: TrainingRecord
) -> dict[str, Any]:
    """Return the state of one of Adam's instances: the moments are read, all else is the new model's.

    What is not a tensor must be the same in the file, but for the learning rate: a resumed run may have another one.
    """
    own: list[dict[str, Any]] = attrgetter(name)(model).state_dict()["param_groups"]
    for found, group in zip_longest(record.param_groups[name], json.loads(json.dumps(own)), fillvalue={"params": None}):
        for key in (found.keys() & group.keys()) - {"lr"}:
            if found[key] != group[key]:
                where = f"{path.with_name(DESCRIPTION)}: key 'param_groups.{name}': {key}"
                raise InputError(f"{where} is {found[key]!r}, expected {group[key]!r}")
    found = {key: array for key, array in tensors.items() if key.partition("/")[0] == name}
    moments: dict[int, dict[str, np.ndarray]] = {}
    parameters = [parameter for group in attrgetter(name)(model).param_groups for parameter in group["params"]]
    for index, parameter in enumerate(parameters):
        if any(f"{name}/{index}/{key}" in found for key in MOMENTS):  # all of them, or none before the first update
            zeros = np.zeros_like(parameter.detach().cpu().numpy())
            moments[index] = {"step": np.zeros((), np.float32), "exp_avg": zeros, "exp_avg_sq": zeros}
    expected = {f"{name}/{index}/{key}": zero for index, zeros in moments.items() for key, zero in zeros.items()}
    check_tensors(path, found, expected)
    for key, array in found.items():
        least = {"step": 1.0, "exp_avg_sq": 0.0}.get(key.rpartition("/")[2], -np.inf)
        if np.any(array < least):
            raise InputError(f"{path}: tensor '{key}' holds a value below {least:g}")
    state = {index: {key: torch.from_numpy(found[f"{name}/{index}/{key}"]) for key in MOMENTS} for index in moments}
    return {"state": state, "param_groups": own}

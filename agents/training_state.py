"""The state of a training run on disk: networks, Adam's moments, feature statistics."""

from __future__ import annotations

import json
from itertools import zip_longest
from pathlib import Path
from typing import Annotated, Any, Literal, cast

import numpy as np
import torch
from pydantic import Field
from stable_baselines3 import PPO

from agents.checkpoint import WeightsRecord, check_tensors, read_record, read_tensors, write_checkpoint
from agents.sb3 import Statistics
from impact_envs.errors import InputError

STATE, DESCRIPTION = "training.safetensors", "training.json"
MOMENTS = ("step", "exp_avg", "exp_avg_sq")  # of a parameter, as Adam names them
POLICY, OPTIMIZER = "policy", "policy.optimizer"


class TrainingRecord(WeightsRecord):
    """The content of training.json: all that a run needs to continue and that is no tensor.

    Attributes:
        format_version: of the two files.
        steps: corrections answered so far.
        iterations: of the run so far; with the seed it decides every number drawn in the next one.
        updates: passes over the corrections so far, as SB3 counts them.
        scales: unit of the robustness in the score of each source [m].
        param_groups: of Adam.
        run: every argument of the run.
        evaluations: result of every evaluation on tuning seeds so far.
        cpu_seconds: of the run so far, all threads together [s].
    """

    format_version: Literal[2] = 2
    steps: Annotated[int, Field(ge=0)]
    iterations: Annotated[int, Field(ge=0)]
    updates: Annotated[int, Field(ge=0)]
    scales: list[Annotated[float, Field(gt=0)]]
    param_groups: list[dict[str, Any]]
    run: dict[str, Any]
    evaluations: list[dict[str, Any]] = Field(default_factory=list)
    cpu_seconds: Annotated[float, Field(ge=0)] = 0.0


def save_training(
    directory: str | Path,
    model: PPO,
    statistics: Statistics,
    iterations: int,
    scales: list[float],
    run: dict[str, Any],
    evaluations: list[dict[str, Any]],
    cpu_seconds: float = 0.0,
) -> None:
    """Write all that a killed run needs to continue.

    Args:
        directory: folder to write training.safetensors and training.json into.
        model: from `sb3.make_model`.
        statistics: of the features.
        iterations, scales, run, evaluations, cpu_seconds: see TrainingRecord.

    Raises:
        InputError: the files cannot be written.
    """
    record = TrainingRecord(
        steps=model.num_timesteps,
        iterations=iterations,
        updates=model._n_updates,
        scales=scales,
        param_groups=model.policy.optimizer.state_dict()["param_groups"],
        run=run,
        evaluations=evaluations,
        cpu_seconds=cpu_seconds,
    )
    write_checkpoint((Path(directory) / STATE, _tensors(model, statistics)), (Path(directory) / DESCRIPTION, record))


def read_training(directory: str | Path) -> TrainingRecord:
    """Read training.json of a saved run, without its tensors.

    Args:
        directory: folder with training.json.

    Raises:
        InputError: one line naming the file and the key.
    """
    return read_record(Path(directory) / DESCRIPTION, TrainingRecord)


def load_training(directory: str | Path, model: PPO) -> tuple[TrainingRecord, Statistics]:
    """Restore a saved run into a model of the same architecture.

    Args:
        directory: folder with training.safetensors and training.json.
        model: new one; its network, moments and counters are overwritten.

    Returns:
        The rest of the run's state, and the statistics of the features.

    Raises:
        InputError: one line naming the file and what does not fit.
    """
    path = Path(directory) / STATE
    record = read_training(directory)
    tensors = read_tensors(path, record)
    statistics = _take_statistics(path, tensors, model.observation_space.shape)
    network = _network(model)
    check_tensors(path, {name: tensors[name] for name in network if name in tensors}, network)
    rest = {name: array for name, array in tensors.items() if name not in network}
    moments = _read_moments(path, model, rest, record)
    weights = {name.partition("/")[2]: torch.from_numpy(tensors[name]) for name in network}
    model.set_parameters(cast(Any, {POLICY: weights, OPTIMIZER: moments}), exact_match=True)
    model.num_timesteps, model._n_updates = record.steps, record.updates
    return record, statistics


def _network(model: PPO) -> dict[str, np.ndarray]:
    return {f"{POLICY}/{key}": value.detach().cpu().numpy() for key, value in model.policy.state_dict().items()}


def _tensors(model: PPO, statistics: Statistics) -> dict[str, np.ndarray]:
    tensors = _network(model)
    for index, entries in model.policy.optimizer.state_dict()["state"].items():
        tensors |= {f"{OPTIMIZER}/{index}/{key}": value.cpu().numpy() for key, value in entries.items()}
    return tensors | {"features/mean": statistics.mean, "features/std": statistics.std}


def _take_statistics(path: Path, tensors: dict[str, np.ndarray], shape: tuple[int, ...] | None) -> Statistics:
    """Take the statistics out of the tensors."""
    expected = {name: np.zeros(cast(Any, shape)) for name in ("features/mean", "features/std")}
    found = {name: tensors.pop(name) for name in expected if name in tensors}
    check_tensors(path, found, expected)
    if not np.all(found["features/std"] > 0):
        raise InputError(f"{path}: tensor 'features/std' holds a value that is not positive")
    return Statistics(found["features/mean"], found["features/std"])


def _read_moments(path: Path, model: PPO, tensors: dict[str, np.ndarray], record: TrainingRecord) -> dict[str, Any]:
    """Return the state of Adam: the moments are read, all else is the new model's.

    What is not a tensor must be the same in the file, but for the learning rate: a resumed run may have another one.
    """
    own: list[dict[str, Any]] = model.policy.optimizer.state_dict()["param_groups"]
    for found, group in zip_longest(record.param_groups, json.loads(json.dumps(own)), fillvalue={"params": None}):
        for key in (found.keys() & group.keys()) - {"lr"}:
            if found[key] != group[key]:
                where = f"{path.with_name(DESCRIPTION)}: key 'param_groups': {key}"
                raise InputError(f"{where} is {found[key]!r}, expected {group[key]!r}")
    expected: dict[str, np.ndarray] = {}
    parameters = [parameter for group in model.policy.optimizer.param_groups for parameter in group["params"]]
    for index, parameter in enumerate(parameters):
        zeros = np.zeros_like(parameter.detach().cpu().numpy())
        names = [f"{OPTIMIZER}/{index}/{key}" for key in MOMENTS]
        if any(name in tensors for name in names):  # all of them, or none before the first update
            expected |= dict(zip(names, (np.zeros((), np.float32), zeros, zeros), strict=True))
    check_tensors(path, tensors, expected)
    for name, array in tensors.items():
        least = {"step": 1.0, "exp_avg_sq": 0.0}.get(name.rpartition("/")[2], -np.inf)
        if np.any(array < least):
            raise InputError(f"{path}: tensor '{name}' holds a value below {least:g}")
    state: dict[int, dict[str, torch.Tensor]] = {}
    for name, array in tensors.items():
        _, index_text, key = name.rsplit("/", 2)
        state.setdefault(int(index_text), {})[key] = torch.from_numpy(array)
    return {"state": state, "param_groups": own}

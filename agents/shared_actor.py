"""A policy that all robots share, kept in shared.safetensors and shared.json: observation to action.

The network is that of residual policies; what it reads besides the observation are waves of the time: a control that
changes at an instant is a simple function of them.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from gymnasium.vector import AutoresetMode
from pydantic import Field

from agents.actor import Actor, Size
from agents.checkpoint import WeightsRecord, check_tensors, read_record, read_tensors, write_checkpoint
from agents.source import Source
from impact_envs.domain import find_part
from impact_envs.errors import InputError
from impact_envs.function_policy import SharedPolicy
from impact_envs.observation import Layout
from impact_envs.scenario import Scenario
from impact_envs.vector import ImpactVectorEnv, vector_env

Choose = Callable[[np.ndarray], np.ndarray]
LEAST = 1.0  # of the robustness in a mean: a lost world counts no more [m]
WEIGHTS, DESCRIPTION = "shared.safetensors", "shared.json"


class SharedRecord(WeightsRecord):
    """The content of shared.json: the network's architecture and origin.

    Attributes:
        format_version: of the two files.
        domain: of the scenario.
        sources: scenario and suite of the training, and the teacher's expert and plan.
        algorithm: of the training.
        observation: element by element, as the layout of a robot's observation describes it.
        action_size: of a robot.
        time_place: of time / horizon in the observation.
        waves: of the time that the network reads.
        hidden: width of each hidden layer.
        feature_clip: normalised features are clipped to plus and minus this.
        seed, steps: of the training so far; a step is one robot's control period.
        training: every argument of the training run.
        versions: of the packages that trained it.
        cpu_seconds: that its training took, all threads together, None where nobody counted [s].
    """

    format_version: Literal[1] = 1
    domain: str
    sources: Annotated[tuple[Source, ...], Field(min_length=1)]
    algorithm: Annotated[str, Field(min_length=1)]
    observation: Annotated[tuple[str, ...], Field(min_length=1)]
    action_size: Size
    time_place: Annotated[int, Field(ge=0)]
    waves: Annotated[int, Field(ge=0, le=64)]
    hidden: Annotated[tuple[Size, ...], Field(max_length=8)]
    feature_clip: Annotated[float, Field(gt=0)] = 10.0
    seed: int
    steps: Annotated[int, Field(ge=0)]
    training: dict[str, Any] = Field(default_factory=dict)
    versions: dict[str, str] = Field(default_factory=dict)
    cpu_seconds: Annotated[float, Field(ge=0)] | None = None


def find_layout(scenario: Scenario) -> Layout:
    """Return the layout that all robots' observations have, but for the bodies' names.

    Args:
        scenario: of the robots.

    Raises:
        InputError: robots observe, or act, differently, so that they cannot share a policy.
    """
    task = find_part("impact_envs", scenario.domain, "TASK")(scenario)
    sizes = {(task.layouts[name].size, *task.action_spaces[name].shape) for name in scenario.agents}
    if len(sizes) > 1:
        raise InputError(
            f"scenario '{scenario.name}': robots of different observations or actions cannot share a policy"
        )
    layout: Layout = task.layouts[scenario.agents[0]]
    return layout


def add_waves(observations: np.ndarray, place: int, waves: int) -> np.ndarray:
    """Return observations with sin(k pi t) and cos(k pi t) behind, k = 1 ... waves, shape (..., size + 2 waves).

    Args:
        observations: shape (..., size).
        place: of t = time / horizon in them.
        waves: how many.
    """
    angles = np.pi * observations[..., place, np.newaxis] * np.arange(1, waves + 1)
    return np.concatenate([observations, np.sin(angles), np.cos(angles)], axis=-1)


def save_shared(directory: str | Path, actor: Actor, record: SharedRecord) -> None:
    """Write a shared policy's weights and its description.

    Args:
        directory: checkpoint directory, made if missing.
        actor: the network, of observations with waves.
        record: its description.

    Raises:
        InputError: the directory cannot be written.
    """
    write_checkpoint((Path(directory) / WEIGHTS, _arrays(actor)), (Path(directory) / DESCRIPTION, record))


def is_shared(directory: Path) -> bool:
    """Return whether a checkpoint directory holds a shared policy."""
    return (directory / DESCRIPTION).is_file()


def load_shared(directory: str | Path) -> tuple[Actor, SharedRecord]:
    """Read a shared policy; nothing in the files is executed.

    Args:
        directory: checkpoint directory.

    Raises:
        InputError: one line naming the file and what is wrong in it.
    """
    path = Path(directory)
    record = read_record(path / DESCRIPTION, SharedRecord)
    size = len(record.observation)
    if record.time_place >= size:
        raise InputError(f"{path / DESCRIPTION}: key 'time_place': {record.time_place} of {size} elements")
    actor = Actor(size + 2 * record.waves, record.action_size, record.hidden, record.feature_clip)
    tensors = read_tensors(path / WEIGHTS, record)
    check_tensors(path / WEIGHTS, tensors, _arrays(actor))
    if not np.all(tensors["std"] > 0):
        raise InputError(f"{path / WEIGHTS}: tensor 'std' holds a value that is not positive")
    import torch

    actor.load_state_dict({name: torch.from_numpy(array) for name, array in tensors.items()})
    return actor, record


def load_shared_policy(directory: str | Path, scenario: Scenario) -> SharedPolicy:
    """Read a shared policy and let the robots of a scenario act by it; it has no expert.

    Args:
        directory: checkpoint directory.
        scenario: whose robots act.

    Raises:
        InputError: as `load_choice`.
    """
    return SharedPolicy(load_choice(directory, scenario), name=str(directory))


def load_choice(directory: str | Path, scenario: Scenario) -> Choose:
    """Read what a shared policy answers to robots' observations, shape (..., size).

    Args:
        directory: checkpoint directory.
        scenario: whose robots act.

    Raises:
        InputError: the checkpoint is broken, or was trained on other observations.
    """
    actor, record = load_shared(directory)
    size, trained = find_layout(scenario).size, len(record.observation)
    if record.domain != scenario.domain or size != trained:
        names = ", ".join(sorted({source.scenario for source in record.sources}))
        raise InputError(
            f"checkpoint '{directory}' was trained on {names} (domain {record.domain}) with {trained} numbers in a "
            f"robot's observation; scenario '{scenario.name}' (domain {scenario.domain}) has {size}"
        )

    return make_choice(actor, record)


def make_choice(actor: Actor, record: SharedRecord) -> Choose:
    """Return what an actor answers to robots' observations, shape (..., size)."""
    return lambda observations: actor.correction(add_waves(observations, record.time_place, record.waves))


def make_worlds(scenario: Scenario, count: int, threads: int) -> ImpactVectorEnv:
    """Make worlds with every robot's own observation; one that cannot be followed any further starts anew."""
    return vector_env(scenario, count, autoreset_mode=AutoresetMode.NEXT_STEP, per_robot=True, threads=threads)


def judge_shared(scenario: Scenario, choose: Choose, first: int, episodes: int, threads: int) -> dict[str, float]:
    """Play a shared policy in worlds of successive seeds.

    Args:
        scenario: to play.
        choose: robots' observations, shape (worlds, robots, size), to actions, shape (worlds, robots, action_size).
        first: seed.
        episodes: how many.
        threads: that share the worlds.

    Returns:
        ``success_rate`` and ``robustness``, the mean of what is at least minus a metre [m].
    """
    worlds, over, infos = make_worlds(scenario, episodes, threads), np.zeros(episodes, bool), dict[str, Any]()
    robustness, success = np.zeros(episodes), np.zeros(episodes, bool)
    worlds.reset(seed=first)
    while not over.all():
        actions = np.clip(choose(worlds.agent_observations), -1.0, 1.0)
        _, _, failed, cut, infos = worlds.step(actions.reshape(episodes, -1))
        if (ended := (failed | cut) & ~over).any():
            robustness[ended], success[ended] = infos["robustness"][ended], infos["success"][ended]
            over |= ended
    worlds.close()
    return {"success_rate": float(success.mean()), "robustness": float(np.maximum(robustness, -LEAST).mean())}


def _arrays(actor: Actor) -> dict[str, np.ndarray]:
    return {name: tensor.detach().cpu().numpy() for name, tensor in actor.state_dict().items()}

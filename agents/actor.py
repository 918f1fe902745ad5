"""The learned part of a residual policy: a small network, kept in policy.safetensors and policy.json."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import torch
from pydantic import Field
from torch import nn

from agents.checkpoint import WeightsRecord, check_tensors, read_record, read_tensors, write_checkpoint
from agents.source import Source
from impact_envs.errors import InputError

WEIGHTS, DESCRIPTION = "policy.safetensors", "policy.json"
Size = Annotated[int, Field(ge=1, le=4096)]


class PolicyRecord(WeightsRecord):
    """The content of policy.json: the network's architecture and origin.

    Attributes:
        format_version: of the two files.
        domain: of the scenarios.
        sources: scenarios and suites of the training.
        variant: of the expert; None: the expert itself.
        algorithm: of the training.
        feature_size, correction_size: input and output of the network; the expert must offer the same.
        hidden: width of each hidden layer.
        feature_clip: normalised features are clipped to plus and minus this.
        seed, steps: of the training so far; a step is one awaited correction.
        training: every argument of the training run.
        versions: of the packages that trained it.
        cpu_seconds: that its training took, all threads together, None where nobody counted [s].
    """

    format_version: Literal[2] = 2
    domain: str
    sources: Annotated[tuple[Source, ...], Field(min_length=1)]
    variant: str | None = None
    algorithm: Annotated[str, Field(min_length=1)]
    feature_size: Size
    correction_size: Size
    hidden: Annotated[tuple[Size, ...], Field(max_length=8)]
    feature_clip: Annotated[float, Field(gt=0)] = 10.0
    seed: int
    steps: Annotated[int, Field(ge=0)]
    training: dict[str, Any] = Field(default_factory=dict)
    versions: dict[str, str] = Field(default_factory=dict)
    cpu_seconds: Annotated[float, Field(ge=0)] | None = None


class Actor(nn.Module):
    """Map an expert's features to a correction by a tanh network on normalised features.

    correction = clip(W_n tanh(... tanh(W_1 z + b_1)) + b_n, ±1), z = clip((features - mean) / std, ±feature_clip).
    A new actor has W_n = 0 and b_n = 0: its correction is exactly zero.

    Args:
        feature_size: length of the expert's features.
        correction_size: length of the expert's correction.
        hidden: width of each hidden layer.
        feature_clip: bound of the normalised features.
    """

    mean: torch.Tensor
    std: torch.Tensor

    def __init__(
        self,
        feature_size: int,
        correction_size: int,
        hidden: tuple[int, ...] = (64, 64),
        feature_clip: float = 10.0,
    ) -> None:
        super().__init__()
        self.feature_clip = feature_clip
        sizes = (feature_size, *hidden, correction_size)
        self.layers = nn.ModuleList([nn.Linear(a, b) for a, b in pairwise(sizes)])
        self.register_buffer("mean", torch.zeros(feature_size, dtype=torch.float64))
        self.register_buffer("std", torch.ones(feature_size, dtype=torch.float64))
        set_to_zero(self.layers[-1])

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        """Return the mean correction.

        Args:
            features: shape (..., feature_size), float64, as the expert gives them.

        Returns:
            Correction in [-1, 1], shape (..., correction_size), float32.
        """
        normalized = (features - self.mean) / self.std
        x = normalized.clamp(-self.feature_clip, self.feature_clip).float()
        for layer in self.layers[:-1]:
            x = torch.tanh(layer(x))
        return self.layers[-1](x).clamp(-1.0, 1.0)

    def correction(self, features: np.ndarray) -> np.ndarray:
        """Return the mean correction.

        Args:
            features: shape (..., feature_size).

        Returns:
            Correction in [-1, 1], shape (..., correction_size), float64.
        """
        with torch.no_grad():
            return self(torch.as_tensor(features, dtype=torch.float64)).numpy().astype(np.float64)


def set_to_zero(layer: nn.Module) -> None:
    """Make a linear layer return exactly zero.

    Args:
        layer: the layer to change.
    """
    for parameter in layer.parameters():
        nn.init.zeros_(parameter)


def save_policy(directory: str | Path, actor: Actor, record: PolicyRecord) -> None:
    """Write an actor as policy.safetensors (weights and feature statistics only) and policy.json.

    Args:
        directory: checkpoint directory, made if missing.
        actor: the network.
        record: its description.

    Raises:
        InputError: the directory cannot be written.
    """
    write_checkpoint((Path(directory) / WEIGHTS, _arrays(actor)), (Path(directory) / DESCRIPTION, record))


def load_policy(directory: str | Path) -> tuple[Actor, PolicyRecord]:
    """Read an actor; nothing in the files is executed.

    Args:
        directory: checkpoint directory.

    Returns:
        The network and its description.

    Raises:
        InputError: one line naming the file and what is wrong in it.
    """
    path = Path(directory)
    if not path.is_dir():
        raise InputError(f"checkpoint '{path}' is not a directory; it must hold {WEIGHTS} and {DESCRIPTION}")
    for name in (DESCRIPTION, WEIGHTS):
        if not (path / name).is_file():
            raise InputError(f"checkpoint '{path}' has no {name}; it must hold {WEIGHTS} and {DESCRIPTION}")
    record = read_record(path / DESCRIPTION, PolicyRecord)
    actor = Actor(record.feature_size, record.correction_size, record.hidden, record.feature_clip)
    tensors = read_tensors(path / WEIGHTS, record)
    check_tensors(path / WEIGHTS, tensors, _arrays(actor))
    if not np.all(tensors["std"] > 0):
        raise InputError(f"{path / WEIGHTS}: tensor 'std' holds a value that is not positive")
    actor.load_state_dict({name: torch.from_numpy(array) for name, array in tensors.items()})
    return actor, record


def _arrays(actor: Actor) -> dict[str, np.ndarray]:
    return {name: tensor.detach().cpu().numpy() for name, tensor in actor.state_dict().items()}

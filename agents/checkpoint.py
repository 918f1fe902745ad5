"""Checkpoint files: safetensors and JSON, written all or nothing, read strictly, nothing in them is executed."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError
from safetensors import SafetensorError
from safetensors.numpy import load, save

from impact_envs.errors import InputError, choices
from impact_envs.file import replace_file


class JsonRecord(BaseModel):
    """A JSON file of a checkpoint: frozen, strictly typed, unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class WeightsRecord(JsonRecord):
    """The record of a safetensors file beside it.

    Attributes:
        weights_digest: SHA-256 of the safetensors file; None: made by an earlier version, damage goes unnoticed as long
            as the file can be read.
    """

    weights_digest: str | None = None


R = TypeVar("R", bound=JsonRecord)


def read_record(path: Path, schema: type[R]) -> R:
    """Read a record and check all its keys.

    Args:
        path: JSON file.
        schema: class of the record.

    Raises:
        InputError: one line naming the file and the key.
    """
    try:
        return schema.model_validate_json(path.read_bytes())
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        key = ".".join(str(part) for part in first["loc"])
        if first["type"] == "extra_forbidden":
            raise InputError(f"{path}: unknown key '{key}'; {choices(key, schema.model_fields)}") from None
        where = f"key '{key}': " if key else ""
        raise InputError(f"{path}: {where}{first['msg'].removeprefix('Value error, ')}") from None


def write_checkpoint(tensors: tuple[Path, Mapping[str, np.ndarray]], record: tuple[Path, WeightsRecord]) -> None:
    """Write named arrays as safetensors, and their record with the arrays' digest as JSON; both all or nothing.

    Args:
        tensors: file, and arrays by name.
        record: file, and its content.

    Raises:
        InputError: a file cannot be written.
    """
    (weights, arrays), (description, content) = tensors, record
    data = save({name: np.array(array, order="C") for name, array in arrays.items()})
    content = content.model_copy(update={"weights_digest": compute_digest(data)})
    # Both are written before either gets its name, so that they do not part when the disk is full.
    with replace_file(weights) as new_weights, replace_file(description) as new_description:
        new_weights.write_bytes(data)
        new_description.write_text(content.model_dump_json(indent=1) + "\n", encoding="utf-8")


def read_tensors(path: Path, record: WeightsRecord) -> dict[str, np.ndarray]:
    """Read named arrays from a safetensors file.

    Args:
        path: file to read.
        record: with the file's digest.

    Raises:
        InputError: the file is missing, damaged, or holds a value that is not finite.
    """
    try:
        data = path.read_bytes()
        tensors = load(data)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    except SafetensorError as error:
        raise InputError(f"{path}: not a safetensors file: {error}") from None
    if record.weights_digest not in (None, compute_digest(data)):
        raise InputError(f"{path}: is damaged, or of another checkpoint: weights_digest of its JSON file differs")
    for name, array in tensors.items():
        if not np.all(np.isfinite(array)):
            raise InputError(f"{path}: tensor '{name}' holds a value that is not finite")
    return tensors


def check_tensors(path: Path, tensors: Mapping[str, np.ndarray], expected: Mapping[str, np.ndarray]) -> None:
    """Raise unless names, shapes and types of the tensors are the expected ones.

    Args:
        path: file they were read from, for the message.
        tensors: as read.
        expected: arrays of the expected shapes and types.

    Raises:
        InputError: one line naming the file and the tensor.
    """
    for name in sorted(tensors.keys() ^ expected.keys()):
        state = "is missing" if name in expected else f"is unknown; {choices(name, expected)}"
        raise InputError(f"{path}: tensor '{name}' {state}")
    for name, array in expected.items():
        given = tensors[name]
        if given.shape != array.shape or given.dtype != array.dtype:
            found, wanted = (f"{x.dtype} {list(x.shape)}" for x in (given, array))
            raise InputError(f"{path}: tensor '{name}' is {found}, expected {wanted}")


def compute_digest(data: bytes) -> str:
    """Return the digest that a record keeps of its safetensors file."""
    return hashlib.sha256(data).hexdigest()

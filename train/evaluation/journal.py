"""The journal of an evaluation: its finished episodes on disk, from which it goes on."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, FiniteFloat, ValidationError

from impact_envs.errors import InputError, describe_fault
from impact_envs.file import write_atomically
from train.evaluation.metrics import make_row_type
from train.evaluation.replay import find_replay
from train.launch.folder import LocalFolder, open_folder

ROWS = "rows"  # folder of the rows where they are shared, a file for each shard
PACKAGES = (
    "numpy",
    "scipy",
    "pymunk",
    "gymnasium",
    "pettingzoo",
    "casadi",
    "cvxpy",
    "daqp",
    "torch",
    "stable-baselines3",
)


class JudgedCase(BaseModel):
    """One scenario in one suite (manifest.json); ``changes`` is None in older ones."""

    model_config = ConfigDict(extra="allow")

    name: str
    suite: str
    description: str
    formula: str
    horizon: FiniteFloat
    changes: dict[str, Any] | None = None


class Manifest(BaseModel):
    """What was asked of the evaluation (manifest.json).

    ``set``: values changed by the user; ``digests``: name of an input to the digest of its content.
    """

    model_config = ConfigDict(extra="allow")

    format: Literal[1]
    cases: list[JudgedCase]
    policies: list[str]
    episodes: int
    seed: int
    versions: dict[str, str]
    cores: int
    set: dict[str, Any] = {}
    digests: dict[str, str] = {}


def read_versions() -> dict[str, str]:
    """Return the versions of the packages that results depend on, as far as they are installed."""
    found = {}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


class Journal:
    """Finished episodes, one JSON line each, so that an interrupted evaluation goes on where it stopped.

    In a folder of this machine they are lines of rows.jsonl, which this process writes. Behind a URI, where nothing can
    be appended, whoever played a shard writes its rows to a file of their own below ``rows``; see shard.start_playing.

    Args:
        directory: folder of the evaluation, made if missing, or its URI.
        digests: name of an input (scenario in a suite, checkpoint) to the digest of its content.

    Raises:
        InputError: the folder holds an evaluation of other inputs, or is damaged.
    """

    def __init__(self, directory: str | Path, digests: dict[str, str]) -> None:
        self.folder = open_folder(directory)
        self._path = self.folder.path / "rows.jsonl" if isinstance(self.folder, LocalFolder) else None
        self.manifest = self._read_manifest()
        known = self.manifest.get("digests", {})
        for name, digest in digests.items():
            if known.get(name, digest) != digest:
                raise InputError(f"{self.folder}: holds episodes of another '{name}'; choose another output directory")
        self.manifest["digests"] = known | digests
        self.rows = self._read_journal(self._path) if self._path else self._read_shards()

    def write_manifest(self, request: dict[str, Any]) -> None:
        """Write what was asked into manifest.json.

        Args:
            request: the evaluation's arguments.
        """
        self.manifest |= {"format": 1, **request, "versions": read_versions(), "cores": os.cpu_count() or 1}
        self.write("manifest.json", self.manifest)

    def write(self, name: str, value: Any) -> None:
        """Write a JSON file of the evaluation, all or nothing."""
        self.folder.write(name, _to_json(value))

    def append(self, row: dict[str, Any], replay: dict[str, Any] | None) -> None:
        """Write a finished episode to disk; its replay first, so that no row lacks the one it should have.

        Args:
            row: from metrics.make_row.
            replay: from replay.episode_to_dict, if it is to be kept.
        """
        if replay:
            name = find_replay(Path(), *row_key(row)).as_posix()
            self.write(name, replay | {"policy": row["policy"]})
        if self._path:
            try:
                with self._path.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(row, allow_nan=False) + "\n")
            except OSError as error:
                raise InputError(f"{self._path}: cannot be written: {error.strerror}") from None
        self.rows[row_key(row)] = row

    def _read_manifest(self) -> dict[str, Any]:
        data, name = self.folder.read("manifest.json"), f"{self.folder}/manifest.json"
        if data is None:
            if self._path and self._path.exists():
                raise InputError(f"{self.folder}: has rows.jsonl but no manifest.json")
            return {}
        return parse_record(Manifest, data, name).model_dump()

    def _read_journal(self, path: Path) -> dict[tuple[str, str, str, int], dict[str, Any]]:
        """Read the journal; a last line cut by a kill is dropped, also from the file."""
        if not path.exists():
            return {}
        try:
            *lines, tail = path.read_bytes().split(b"\n")
        except OSError as error:
            raise InputError(f"{path}: cannot be read: {error.strerror}") from None
        rows = _parse_rows(lines, path)
        if tail:  # only now: a journal that is refused stays as it is
            write_atomically(path, b"".join(line + b"\n" for line in lines))
        return rows

    def _read_shards(self) -> dict[tuple[str, str, str, int], dict[str, Any]]:
        """Read the rows that were kept shard by shard."""
        rows = dict[tuple[str, str, str, int], dict[str, Any]]()
        for name in self.folder.list(ROWS):
            rows |= _parse_rows((self.folder.read(name) or b"").splitlines(), f"{self.folder}/{name}")
        return rows


def _parse_rows(lines: Iterable[bytes], source: object) -> dict[tuple[str, str, str, int], dict[str, Any]]:
    """Return rows by their keys.

    Raises:
        InputError: a line is no row.
    """
    rows = {}
    for number, line in enumerate(lines, start=1):
        try:
            make_row_type().model_validate_json(line)
        except ValidationError as error:
            raise InputError(f"{source}: line {number} is not an episode: {describe_fault(error)}") from None
        row = json.loads(line)
        rows[row_key(row)] = row
    return rows


Content = TypeVar("Content", bound=BaseModel)


def read_record(model: type[Content], path: Path) -> Content:
    """Read a JSON file of an evaluation.

    Args:
        model: what the file holds.
        path: of the file.

    Raises:
        InputError: one line naming the file and the field.
    """
    try:
        return parse_record(model, path.read_bytes(), path)
    except OSError as error:
        raise InputError(f"evaluation file {path}: cannot be read: {error.strerror}") from None


def parse_record(model: type[Content], data: bytes, source: object) -> Content:
    """Parse a JSON file of an evaluation.

    Args:
        model: what the file holds.
        data: of the file.
        source: its name.

    Raises:
        InputError: one line naming the file and the field.
    """
    try:
        return model.model_validate_json(data)
    except ValidationError as error:
        raise InputError(f"evaluation file {source}: {describe_fault(error)}") from None


def row_key(row: dict[str, Any]) -> tuple[str, str, str, int]:
    """Return what an episode is told apart by: scenario, suite, policy, seed."""
    return row["scenario"], row["suite"], row["policy"], row["seed"]


def write_json(path: Path, value: Any) -> None:
    """Write a JSON file, all or nothing; what JSON cannot say (NaN, infinity) is refused.

    Args:
        path: file to write.
        value: a JSON value.
    """
    write_atomically(path, _to_json(value))


def _to_json(value: Any) -> bytes:
    return (json.dumps(value, allow_nan=False) + "\n").encode()


def digest(*contents: bytes) -> str:
    """Return the SHA-256 of some contents, in hexadecimal."""
    return hashlib.sha256(b"".join(contents)).hexdigest()

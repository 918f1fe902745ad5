"""The journal of an evaluation: its finished episodes on disk, from which it goes on."""

from __future__ import annotations

import hashlib
import json
import os
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from impact_envs.errors import InputError
from impact_envs.file import write_atomically

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

    Args:
        directory: folder of the evaluation, made if missing.
        digests: name of an input (scenario in a suite, checkpoint) to the digest of its content.

    Raises:
        InputError: the folder holds an evaluation of other inputs, or is damaged.
    """

    def __init__(self, directory: str | Path, digests: dict[str, str]) -> None:
        self.directory = Path(directory)
        self._path = self.directory / "rows.jsonl"
        self.manifest = self._read_manifest()
        known = self.manifest.get("digests", {})
        for name, digest in digests.items():
            if known.get(name, digest) != digest:
                raise InputError(
                    f"{self.directory}: holds episodes of another '{name}'; choose another output directory"
                )
        self.manifest["digests"] = known | digests
        self.rows = self._read_rows()

    def write_manifest(self, request: dict[str, Any]) -> None:
        """Write what was asked into manifest.json.

        Args:
            request: the evaluation's arguments.
        """
        self.manifest |= {"format": 1, **request, "versions": read_versions(), "cores": os.cpu_count() or 1}
        write_json(self.directory / "manifest.json", self.manifest)

    def append(self, row: dict[str, Any], replay: dict[str, Any] | None) -> None:
        """Write a finished episode to disk; its replay first, so that no row lacks the one it should have.

        Args:
            row: from metrics.make_row.
            replay: from replay.episode_to_dict, if it is to be kept.
        """
        if replay:
            label = "".join(c if c.isalnum() or c in "-_" else "_" for c in row["policy"])
            name = f"{row['scenario']}__{row['suite']}__{label}__{row['seed']}.json"
            write_json(self.directory / "replays" / name, replay | {"policy": row["policy"]})
        self.rows[row_key(row)] = row
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row, allow_nan=False) + "\n")

    def _read_manifest(self) -> dict[str, Any]:
        path = self.directory / "manifest.json"
        if not path.exists():
            if self._path.exists():
                raise InputError(f"{self.directory}: has rows.jsonl but no manifest.json")
            return {}
        try:
            manifest = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise InputError(f"{path}: cannot be read: {error}") from None
        if not isinstance(manifest, dict) or manifest.get("format") != 1:
            raise InputError(f"{path}: not the manifest of an evaluation of format 1")
        return manifest

    def _read_rows(self) -> dict[tuple[str, str, str, int], dict[str, Any]]:
        """Read the journal; a last line cut by a kill is dropped, also from the file."""
        if not self._path.exists():
            return {}
        *lines, tail = self._path.read_bytes().split(b"\n")
        if tail:
            write_atomically(self._path, b"".join(line + b"\n" for line in lines))
        rows = {}
        for number, line in enumerate(lines, start=1):
            try:
                row = json.loads(line)
                rows[row_key(row)] = row
            except (ValueError, KeyError, TypeError):
                raise InputError(f"{self._path}: line {number} is not an episode") from None
        return rows


def row_key(row: dict[str, Any]) -> tuple[str, str, str, int]:
    """Return what an episode is told apart by: scenario, suite, policy, seed."""
    return row["scenario"], row["suite"], row["policy"], row["seed"]


def write_json(path: Path, value: Any) -> None:
    """Write a JSON file, all or nothing; what JSON cannot say (NaN, infinity) is refused.

    Args:
        path: file to write.
        value: a JSON value.
    """
    write_atomically(path, (json.dumps(value, allow_nan=False) + "\n").encode())


def digest(*contents: bytes) -> str:
    """Return the SHA-256 of some contents, in hexadecimal."""
    return hashlib.sha256(b"".join(contents)).hexdigest()

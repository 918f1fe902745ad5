"""Whether another machine would come to the same results: its code, packages and files against those of who asks."""

from __future__ import annotations

import hashlib
import os
import platform
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import impact_envs
from impact_envs.errors import InputError

PACKAGES = ("impact_envs", "planners", "agents", "train")


@dataclass(frozen=True)
class Origin:
    """What results depend on besides the tasks.

    Attributes:
        facts: name to version or digest.
        folder: that the user's paths start from; None: there are none.
    """

    facts: tuple[tuple[str, str], ...]
    folder: str | None


def describe_origin(facts: Mapping[str, str], with_files: bool) -> Origin:
    """Return what results of this process depend on.

    Args:
        facts: name to version or digest, beside those of Python and of this project's code.
        with_files: whether files of the user are read, whose paths may start from the working folder.
    """
    return Origin(tuple(_add_own(facts).items()), str(Path.cwd()) if with_files else None)


def check_origin(asked: Origin, describe: Callable[[], Mapping[str, str]]) -> None:
    """Raise unless this machine comes to the same results as the one that asks; work in the same folder.

    Args:
        asked: of the machine that asks.
        describe: returns the facts of this one, once it is in the folder.

    Raises:
        InputError: one line naming this machine and what differs.
    """
    node = platform.node()
    if asked.folder is not None:
        try:
            os.chdir(asked.folder)
        except OSError as error:
            reason = f"{error.strerror}; share it between the nodes"
            raise InputError(f"node {node}: folder {asked.folder}, where the user's files are: {reason}") from None
    here = _add_own(describe())
    for name, value in asked.facts:
        if here.get(name) != value:
            raise InputError(
                f"node {node}: {name} is {here.get(name, 'missing'):.16}, but {value:.16} where the command was given; "
                "rows of both must not stand side by side"
            )


def _add_own(facts: Mapping[str, str]) -> dict[str, str]:
    return {"Python": platform.python_version(), "this project's code": _digest_sources(), **facts}


@cache
def _digest_sources() -> str:
    root = Path(impact_envs.__file__).parents[1]
    files = sorted(file for package in PACKAGES for file in (root / package).rglob("*.py"))
    found = hashlib.sha256()
    for file in files:
        found.update(file.relative_to(root).as_posix().encode() + file.read_bytes())
    return found.hexdigest()

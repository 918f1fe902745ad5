"""Which extra of this distribution brings a package that is not installed."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path

DISTRIBUTION = "impact-envs"
# Beside the packages where they run from their source; the metadata of such an install are as old as the install.
SOURCE = Path(__file__).parents[2] / "pyproject.toml"
NO_CHOICE = ("all", "dev")  # extras that are made of others
PACKAGES = {"PIL": "pillow"}  # modules of another name than their package's


def find_extras(module: str) -> list[str]:
    """Return the extras that a module comes with, as the source or the distribution's own metadata say.

    Args:
        module: dotted name, for example ``torch.nn``.

    Returns:
        For example ``["learn"]``; empty of a module that no extra brings.
    """
    root = module.partition(".")[0]
    wanted = _plain(PACKAGES.get(root, root))
    return [extra for extra, package in _list_optional() if extra not in NO_CHOICE and _plain(package) == wanted]


def describe_missing(error: ModuleNotFoundError, needed: Sequence[str] = ()) -> str | None:
    """Return one line that says what to install; None of a module that no extra brings.

    Args:
        error: that a module is missing.
        needed: extras that are needed all together for what was asked.
    """
    extras = find_extras(error.name or "")
    if not extras:
        return None
    wanted = [*needed] if set(needed) & set(extras) else [*needed, extras[0]]
    return f"{error.name} is not installed: pip install '{DISTRIBUTION}[{','.join(wanted)}]'"


def _list_optional() -> list[tuple[str, str]]:
    """Return each extra with each package that it brings."""
    project = tomllib.loads(SOURCE.read_text(encoding="utf-8")).get("project", {}) if SOURCE.is_file() else {}
    if project.get("name") == DISTRIBUTION:
        listed = project.get("optional-dependencies", {})
        return [(extra, re.split(r"[^\w.-]", text)[0]) for extra, texts in listed.items() for text in texts]
    found = (
        re.match(r"""([\w.-]+).*extra\s*==\s*["'](\w+)["']""", text) for text in metadata.requires(DISTRIBUTION) or []
    )
    return [(match[2], match[1]) for match in found if match]


def _plain(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()

"""Which extra of this distribution brings a package that is not installed."""

from __future__ import annotations

import re
from collections.abc import Sequence
from importlib import metadata

DISTRIBUTION = "impact-envs"
NO_CHOICE = ("all", "dev")  # extras that are made of others


def find_extras(module: str) -> list[str]:
    """Return the extras that a module comes with, as the distribution's own metadata say.

    Args:
        module: dotted name, for example ``torch.nn``.

    Returns:
        For example ``["learn"]``; empty of a module that no extra brings.
    """
    try:
        requirements = metadata.requires(DISTRIBUTION) or []
    except metadata.PackageNotFoundError:  # run from its source
        return []
    found = [re.match(r"""([\w.-]+).*extra\s*==\s*["'](\w+)["']""", requirement) for requirement in requirements]
    wanted = _plain(module.partition(".")[0])
    return [match[2] for match in found if match and match[2] not in NO_CHOICE and _plain(match[1]) == wanted]


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


def _plain(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()

"""Values that the user changes: ``--set KEY=VALUE``."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from impact_envs.errors import InputError


def parse_settings(texts: Iterable[str], option: str = "--set") -> dict[str, Any]:
    """Return dotted names to values, written as in TOML; what is no TOML is text.

    Args:
        texts: such as ``true.restitution=0.5``.
        option: that they were given to.

    Raises:
        InputError: a text without a name or a value.
    """
    return dict(_parse_assignment(text, option) for text in texts)


def _parse_assignment(text: str, option: str) -> tuple[str, Any]:
    key, equals, value = text.partition("=")
    if not equals or not key.strip():
        raise InputError(f"{option} {text}: expected KEY=VALUE, for example true.restitution=0.5")
    try:
        table = tomllib.loads(f"value = {value}")
    except tomllib.TOMLDecodeError:
        table = {}
    except (ValueError, RecursionError):  # a number of thousands of digits, lists in thousands of lists
        raise InputError(f"{option} {key.strip()}: too many digits, or nested too deeply: {value:.60}") from None
    return key.strip(), table["value"] if table.keys() == {"value"} else value.strip()


def list_settings(args: dict[str, Any]) -> dict[str, Any]:
    """Return the arguments of a run as JSON values."""
    return {key: _plain(value) for key, value in args.items()}


def _plain(value: Any) -> Any:
    if isinstance(value, Path):
        return str(value)
    return list(value) if isinstance(value, tuple) else value

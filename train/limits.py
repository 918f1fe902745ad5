"""What the training scripts ask of their arguments, and of the run that they go on with."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from impact_envs.errors import InputError


def check_least(args: Any, least: Mapping[str, int]) -> None:
    """Raise unless every number is large enough; None is.

    Args:
        args: with an attribute of each name.
        least: name of each argument to the least value.

    Raises:
        InputError: one line naming the argument, its value and the choices.
    """
    for name, low in least.items():
        if (value := getattr(args, name)) is not None and value < low:
            raise InputError(f"{name} {value} is too small; choices: {low}, {low + 1}, ...")


def check_ranges(args: Any, ranges: Mapping[str, tuple[float, float]]) -> None:
    """Raise unless every number lies between two others, ends included; None does, NaN does not.

    Args:
        args: with an attribute of each name.
        ranges: name of each argument to the least and the greatest value.

    Raises:
        InputError: one line naming the argument, its value and the choices.
    """
    for name, (low, high) in ranges.items():
        if (value := getattr(args, name)) is not None and not low <= value <= high:
            raise InputError(f"{name} {value:g}: choices: from {low:g} to {high:g}")


def check_choice(args: Any) -> None:
    """Raise unless what is kept of a policy's corrections makes sense: all of them first, then ever less.

    Args:
        args: with the attributes ``loss`` and ``shares``.

    Raises:
        InputError: one line naming the argument, its value and the choices.
    """
    check_ranges(args, {"loss": (0.0, 1.0)})
    shares = args.shares
    if not shares or shares[0] != 1.0 or not all(0.0 < low < high for high, low in pairwise(shares)):
        raise InputError(f"shares {list(shares)}: choices: 1 and then ever smaller shares above 0")


def check_hidden(hidden: Sequence[int]) -> None:
    """Raise unless a network has layers, each of some width.

    Raises:
        InputError: it has not.
    """
    if not hidden or min(hidden) < 1:
        raise InputError(f"hidden {list(hidden)}: every layer needs a width of at least 1")


def check_same(held: Path, before: Mapping[str, Any], now: Mapping[str, Any], names: Iterable[str]) -> None:
    """Raise unless a run that is resumed has the arguments that it was begun with.

    Args:
        held: the checkpoint it is resumed from.
        before, now: its arguments and the present ones, as JSON values.
        names: of those that must be the same.

    Raises:
        InputError: one line naming the first that differs.
    """
    for name in names:
        if before.get(name) != now[name]:
            raise InputError(f"{held}: was made with {name} {before.get(name)}; cannot be resumed with {now[name]}")

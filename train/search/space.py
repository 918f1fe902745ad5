"""What a search may choose: values by their names, each from a range or a list."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from impact_envs.errors import InputError
from train.settings import parse_settings

Point = tuple[tuple[str, Any], ...]  # name to value
LOG = "log"  # how the text of a range ends whose logarithm is chosen evenly


@dataclass(frozen=True)
class Range:
    """Numbers between two ends, both included.

    Attributes:
        key: name of the value.
        low, high: ends; only whole numbers are chosen where both are.
        log: whether logarithms are spread evenly, not numbers.
    """

    key: str
    low: float
    high: float
    log: bool = False

    @property
    def whole(self) -> bool:
        """Return whether only whole numbers are chosen."""
        return isinstance(self.low, int) and isinstance(self.high, int)

    @property
    def shown(self) -> tuple[Any, ...]:
        """Return the values that are checked: what is right at both ends is right between them."""
        return self.low, self.high


@dataclass(frozen=True)
class Choice:
    """Values without an order.

    Attributes:
        key: name of the value.
        values: to choose from.
    """

    key: str
    values: tuple[Any, ...]

    @property
    def shown(self) -> tuple[Any, ...]:
        """Return the values that are checked: all."""
        return self.values


Space = tuple[Range | Choice, ...]


def parse_space(texts: Sequence[str]) -> Space:
    """Return what may be chosen.

    Args:
        texts: ``KEY=LOW,HIGH``, ``KEY=LOW,HIGH,log`` or ``KEY=[VALUE, ...]`` each, numbers and values as in TOML.

    Raises:
        InputError: a text that is none of these, or a key given twice.
    """
    space = tuple(map(_parse_dimension, texts))
    keys = [dimension.key for dimension in space]
    for place, key in enumerate(keys):
        if key in keys[:place]:
            raise InputError(f"--sample {key}: is given twice")
    return space


def list_shown(space: Space) -> list[Point]:
    """Return points in which every choice and both ends of every range stand: what is wrong with one shows there.

    As few as the longest list has values: not every combination of them.
    """
    count = max((len(dimension.shown) for dimension in space), default=0)
    return [
        tuple((dimension.key, dimension.shown[min(place, len(dimension.shown) - 1)]) for dimension in space)
        for place in range(count)
    ]


def write_value(item: tuple[str, Any]) -> str:
    """Return a value as --set takes it."""
    key, value = item
    text = str(value).lower() if isinstance(value, bool) else str(value)
    return f"{key}={text}"


def check_distinct(option: str, key: str, values: Sequence[Any]) -> None:
    """Raise if a value is in a list twice, or one that is written like another.

    Args:
        option: that the list was given to.
        key: name of the value.
        values: the list.

    Raises:
        InputError: naming the value.
    """
    for place, value in enumerate(values):
        for before in values[:place]:
            same = value == before and isinstance(value, bool) == isinstance(before, bool)
            if same or write_value((key, value)) == write_value((key, before)):
                raise InputError(f"{option} {key}=[...]: {value} is given twice")


def _parse_dimension(text: str) -> Range | Choice:
    key, _, value = (part.strip() for part in text.partition("="))
    if key and value.startswith("["):
        values = parse_settings([text])[key]
        if isinstance(values, list) and values:
            check_distinct("--sample", key, values)
            return Choice(key, tuple(values))
    ends, scale = value.split(","), ""
    if len(ends) == 3:
        *ends, scale = ends
    if not key or len(ends) != 2 or scale.strip() not in ("", LOG):
        raise InputError(
            f"--sample {text}: expected KEY=LOW,HIGH or KEY=LOW,HIGH,log or KEY=[VALUE, ...], for example "
            "learn.learning_rate=1e-4,1e-2,log"
        )
    low, high = (_parse_number(text, end) for end in ends)
    log = bool(scale)
    if not low < high:
        raise InputError(f"--sample {text}: LOW must be less than HIGH")
    if log and low <= 0:
        raise InputError(f"--sample {text}: a range with log begins above 0")
    return Range(key, low, high, log)


def _parse_number(text: str, end: str) -> float:
    value = parse_settings([f"end={end.strip()}"])["end"]
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InputError(f"--sample {text}: '{end.strip()}' is no number")
    return value

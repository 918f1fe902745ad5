"""Options of an expert by their dotted names, as users set them: listed, and replaced in a copy.

A number is from 0 to a billion unless its field's type says otherwise: `Positive`, `Share`, `Cosine`,
`Spread`, `Count`, `CountOrNone`.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, NamedTuple, TypeVar, get_type_hints

from impact_envs.errors import InputError, choices

LARGEST = 10**18  # of a whole number: larger ones are no float's, and no array's
Options = TypeVar("Options")


class Limits(NamedTuple):
    """The least and the greatest value of an option."""

    least: float = 0.0
    greatest: float = 1e9


Positive = Annotated[float, Limits(1e-9)]
Share = Annotated[float, Limits(0.0, 1.0)]
Cosine = Annotated[float, Limits(-1.0, 1.0)]
Spread = Annotated[float, Limits(0.0, 10.0)]  # of something without a unit
Count = Annotated[int, Limits(1, 1000)]
CountOrNone = Annotated[int, Limits(0, 1000)]


def select_options(variant: str | None, variants: Mapping[str, Options], expert: Options) -> Options:
    """Return the options of a variant.

    Args:
        variant: name of a variant, or None for the expert itself.
        variants: name to options.
        expert: options of the expert itself.

    Raises:
        InputError: unknown variant.
    """
    if variant is None:
        return expert
    if variant not in variants:
        raise InputError(f"variant '{variant}' is unknown; {choices(variant, variants)}")
    return variants[variant]


def list_options(options: Any) -> dict[str, Any]:
    """Return the values of all options by dotted names.

    Args:
        options: a NamedTuple or frozen dataclass, whose fields may be such again.
    """
    return dict(_walk(options, ""))


def replace_options(options: Options, values: Mapping[str, Any], owner: str = "expert") -> Options:
    """Return a copy with some values replaced.

    Args:
        options: a NamedTuple or frozen dataclass, whose fields may be such again.
        values: dotted name to value, for example ``{"retiming.frozen": 3.0}``.
        owner: what the options are called in an error.

    Raises:
        InputError: an unknown name, a value of another kind than the one it replaces, or beyond its limits.
    """
    known = list_options(options)
    for name, value in values.items():
        if name not in known:
            raise InputError(f"{owner}.{name} is unknown; {choices(name, sorted(known))}")
        path = name.split(".")
        value = _convert(f"{owner}.{name}", value, known[name])
        _check_limits(f"{owner}.{name}", value, known[name], _find_limits(options, path))
        options = _replace(options, path, value)
    return options


def _walk(options: Any, prefix: str) -> Iterator[tuple[str, Any]]:
    for name in _names(options):
        value = getattr(options, name)
        if _names(value):
            yield from _walk(value, f"{prefix}{name}.")
        else:
            yield prefix + name, value


def _names(options: Any) -> tuple[str, ...]:
    if dataclasses.is_dataclass(options) and not isinstance(options, type):
        return tuple(field.name for field in dataclasses.fields(options))
    return tuple(getattr(options, "_fields", ()))


def _replace(options: Any, path: list[str], value: Any) -> Any:
    first, *rest = path
    new = _replace(getattr(options, first), rest, value) if rest else value
    replace = dataclasses.replace if dataclasses.is_dataclass(options) else type(options)._replace
    return replace(options, **{first: new})


def _find_limits(options: Any, path: list[str]) -> Limits:
    for name in path[:-1]:
        options = getattr(options, name)
    hint = get_type_hints(type(options), include_extras=True)[path[-1]]
    parts = (hint, *getattr(hint, "__args__", ()))  # a tuple's limits are those of its items
    return next((found for part in parts for found in getattr(part, "__metadata__", ())), Limits())


def _check_limits(name: str, value: Any, present: Any, limits: Limits) -> None:
    for number in value if isinstance(value, tuple) else (value,):
        if isinstance(number, bool) or not isinstance(number, int | float) or number == present:
            continue
        if not limits.least <= number <= limits.greatest:
            raise InputError(f"{name} = {number:g}; choices: from {limits.least:g} to {limits.greatest:g}")


def _convert(name: str, value: Any, present: Any) -> Any:
    """Return a value in the kind of the present one: a whole number may stand for a real one, a list for a tuple."""
    if isinstance(value, int) and abs(value) > LARGEST:
        raise InputError(f"{name} is a number of more than {len(str(LARGEST)) - 1} digits; its value is {present!r}")
    if isinstance(present, bool) or isinstance(value, bool):
        fits = isinstance(present, bool) and isinstance(value, bool)
    elif isinstance(present, float):
        fits = isinstance(value, int | float) and (math.isfinite(value) or value == present)  # inf stands for "never"
        value = float(value) if fits else value
    elif isinstance(present, tuple):
        fits = isinstance(value, list | tuple) and len(value) == len(present)
        value = tuple(_convert(name, *pair) for pair in zip(value, present, strict=True)) if fits else value
    else:
        fits = isinstance(value, type(present))
    if not fits:
        raise InputError(f"{name} = {value!r}: does not fit; its value is {present!r}")
    return value

"""Options of an expert by their dotted names, as users set them: listed, and replaced in a copy."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping
from typing import Any, TypeVar

from impact_envs.errors import InputError, choices

Options = TypeVar("Options")


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
        InputError: an unknown name, or a value of another kind than the one it replaces.
    """
    known = list_options(options)
    for name, value in values.items():
        if name not in known:
            raise InputError(f"{owner}.{name} is unknown; {choices(name, sorted(known))}")
        options = _replace(options, name.split("."), _convert(f"{owner}.{name}", value, known[name]))
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


def _convert(name: str, value: Any, present: Any) -> Any:
    """Return a value in the kind of the present one: a whole number may stand for a real one, a list for a tuple."""
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

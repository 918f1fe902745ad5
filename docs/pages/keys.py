"""What a scenario file may hold: every key with type, unit, default and meaning, read from the schemas.

Types and defaults come from the pydantic models; meanings and units from the comments beside the fields, which are the
only place where they are said.
"""

from __future__ import annotations

import inspect
import types
from collections.abc import Iterator
from typing import Any, Literal, NamedTuple, Union, get_args, get_origin

from annotated_types import Ge, Gt, Le, Lt
from pydantic.fields import FieldInfo

from docs.pages.comments import read_comments, split_comment
from impact_envs.scenario import Scenario, Table, Uniform
from impact_envs.stl import LARGEST


class Key(NamedTuple):
    """A key of a table.

    Attributes:
        name: as it is written.
        type: what it takes, in words.
        unit: empty where it has none.
        default: as TOML writes it; ``required`` where there is none, ``unset`` for no value.
        meaning: one line.
    """

    name: str
    type: str
    unit: str
    default: str
    meaning: str


class Section(NamedTuple):
    """A table of a scenario file: its header, for example ``robots.NAME``, what it is, and its keys."""

    header: str
    meaning: str
    keys: list[Key]


def list_sections(schema: type[Scenario]) -> list[Section]:
    """Return all tables of a domain's scenario file, from the outermost inwards.

    Raises:
        ValueError: a key has no comment that says what it means.
    """
    return list(_walk(schema, ""))


def _walk(table: type[Table], header: str) -> Iterator[Section]:
    yield Section(header, read_first_line(table), [describe_key(table, name) for name in table.model_fields])
    for name, field in table.model_fields.items():
        inner, repeated = find_table(field.annotation)
        if inner is not None:
            yield from _walk(inner, ".".join(filter(None, (header, name, "NAME" if repeated else ""))))


def describe_key(table: type[Table], name: str) -> Key:
    """Return what is said of a field of a table.

    Raises:
        ValueError: nothing says what it means.
    """
    field = table.model_fields[name]
    inner, _ = find_table(field.annotation)
    meaning, unit = split_comment(read_comments(table).get(name, ""))
    if not meaning and inner is not None:
        meaning = read_first_line(inner)
    if not meaning and not unit:
        raise ValueError(f"{table.__module__}.{table.__name__}.{name}: no comment says what it means")
    return Key(
        field.alias or name,
        describe_type(field.annotation, field.metadata),
        unit,
        _describe_default(field),
        meaning or name.replace("_", " ").capitalize(),
    )


def find_table(annotation: Any) -> tuple[type[Table] | None, bool]:
    """Return the table that a key holds, if it holds one, and whether it holds several by name."""
    if get_origin(annotation) is dict:
        inner, _ = find_table(get_args(annotation)[1])
        return inner, True
    for part in _list_choices(annotation):
        if isinstance(part, type) and issubclass(part, Table) and part is not Uniform:
            return part, False
    return None, False


def describe_type(annotation: Any, metadata: list[Any] | tuple[Any, ...] = ()) -> str:
    """Return in words what values a type takes.

    Args:
        annotation: of a field, for example ``tuple[float, float] | None``.
        metadata: limits that belong to it.
    """
    if hasattr(annotation, "__metadata__"):
        return describe_type(annotation.__origin__, (*annotation.__metadata__, *metadata))
    choices = [part for part in _list_choices(annotation) if part is not type(None)]
    if len(choices) > 1:
        plain = [part for part in choices if part is not Uniform]
        text = " or ".join(describe_type(part, metadata) for part in plain)
        return f"{text}, or `{{ uniform = [low, high] }}`" if Uniform in choices else text
    (only,) = choices
    if only is not annotation:
        return describe_type(only, metadata)
    origin, parts = get_origin(annotation), get_args(annotation)
    if origin is Literal:
        return " or ".join(f"`{_write(value)}`" for value in parts)
    if origin is dict:
        inner, _ = find_table(annotation)
        tables = inner is not None or get_origin(parts[1]) is dict
        return "tables by name" if tables else f"{describe_type(parts[1])} by name"
    if origin is tuple:
        if len(parts) == 2 and parts[1] is Ellipsis:
            return f"list, each {describe_type(parts[0])}"
        return f"{len(parts)} × {describe_type(parts[0])}"
    if isinstance(annotation, type) and issubclass(annotation, Table):
        return "table"
    words = {float: "number", int: "whole number", str: "text", bool: "`true` or `false`", Any: "table"}
    return " ".join(filter(None, (words[annotation], _describe_limits(metadata))))


def _describe_limits(metadata: list[Any] | tuple[Any, ...]) -> str:
    """Return limits as signs; those that all numbers have are left out."""
    flat = [limit for entry in metadata for limit in getattr(entry, "metadata", None) or [entry]]
    signs = []
    for kind, sign in ((Gt, ">"), (Ge, "≥"), (Lt, "<"), (Le, "≤")):
        for limit in flat:
            value = getattr(limit, {Gt: "gt", Ge: "ge", Lt: "lt", Le: "le"}[kind], None)
            if isinstance(limit, kind) and value is not None and abs(value) != LARGEST:
                signs.append(f"{sign} {value:g}")
    checks = [getattr(getattr(limit, "func", None), "__name__", "") for limit in flat]
    words = [name.strip("_").replace("_", " ") for name in checks if name.startswith(("_at_", "_above_"))]
    return ", ".join(dict.fromkeys((*signs, *words)))


def _list_choices(annotation: Any) -> list[Any]:
    """Return the parts of a union, or the type itself."""
    if get_origin(annotation) in (Union, types.UnionType):
        return list(get_args(annotation))
    return [annotation]


def _describe_default(field: FieldInfo) -> str:
    if field.is_required():
        return "required"
    if field.default is None:
        return "unset"
    if isinstance(field.default, Table):
        return "all its defaults"
    return "none" if field.default in ({}, "") else f"`{_write(field.default)}`"


def _write(value: Any) -> str:
    """Return a value as TOML writes it."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return f'"{value}"'
    return f"[{', '.join(map(_write, value))}]" if isinstance(value, tuple) else f"{value:g}"


def read_first_line(table: type[Table]) -> str:
    """Return the first paragraph of a table's docstring, on one line."""
    return " ".join(inspect.cleandoc(table.__doc__ or "").split("\n\n")[0].split())

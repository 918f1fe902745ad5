"""The tables of the ``impact`` command: every subcommand with its arguments, read from their dataclasses."""

from __future__ import annotations

import ast
import inspect
import itertools
import textwrap
from dataclasses import MISSING, fields, is_dataclass
from importlib import import_module
from typing import Any

from docs.pages.table import make_table
from train.cli.main import COMMANDS


def write_commands() -> str:
    """Return a section for each subcommand."""
    parts = []
    for name in COMMANDS:
        command = import_module(f"train.cli.{name}").Command
        rows = list_arguments(command)
        text = " ".join(inspect.cleandoc(command.__doc__ or "").split("\n\n")[0].split())
        table = make_table(("argument", "default", "meaning"), rows) if rows else ""
        parts.append(f"## `impact {name}`\n\n{text}\n\n{table}")
    return "\n".join(parts)


def list_arguments(command: type) -> list[list[str]]:
    """Return name, default and meaning of each argument of a command, those of a dataclass in it too."""
    said, rows = _read_arguments(command), list[list[str]]()
    for field in fields(command):
        if is_dataclass(inner := field.default_factory):
            rows += list_arguments(inner)
        elif field.name != "json":
            rows.append([_write_name(field), _describe_default(field), said.get(field.name, "")])
    return rows


def _write_name(field: Any) -> str:
    positional = "Positional" in str(field.type)
    return f"`{field.name.upper()}`" if positional else f"`--{field.name.replace('_', '-')}`"


def _describe_default(field: Any) -> str:
    if field.default is MISSING:
        return "required"
    if isinstance(field.default, tuple):
        return f"`{' '.join(map(str, field.default))}`" if field.default else "none"
    return "none" if field.default is None else f"`{field.default}`"


def _read_arguments(command: type) -> dict[str, str]:
    """Return the text under each field, as the command's help prints it."""
    said: dict[str, str] = {}
    for parent in reversed(command.__mro__[:-1]):
        body = ast.parse(textwrap.dedent(inspect.getsource(parent))).body[0].body  # type: ignore[attr-defined]
        for field, text in itertools.pairwise(body):
            if isinstance(field, ast.AnnAssign) and isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant):
                said[ast.unparse(field.target)] = " ".join(str(text.value.value).split())
    return said

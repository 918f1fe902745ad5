"""Errors a user can mend: one line that names the thing, the value and the choices."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pydantic import ValidationError

LONGEST_MESSAGE = 2000  # characters; what the user wrote may be of any length


class InputError(ValueError):
    """Bad input from the user (file, formula, argument, checkpoint); the command line exits with 2.

    Args:
        message: what is wrong; becomes one line, whatever names and values of the user stand in it.
    """

    def __init__(self, message: str = "") -> None:
        line = "".join(letter if letter.isprintable() else repr(letter)[1:-1] for letter in message[:LONGEST_MESSAGE])
        super().__init__(line + "..." * (len(message) > LONGEST_MESSAGE))


class ScenarioError(InputError):
    """A scenario file that cannot be read or does not make sense."""


class FormulaError(InputError):
    """An STL formula that cannot be parsed, or does not fit the scenario or the trace."""


def choices(wrong: str, known: Iterable[str]) -> str:
    """Say which names are known, the nearest one first.

    Args:
        wrong: the name that is not known.
        known: the names that are.

    Returns:
        Text such as ``did you mean 'radius'? choices: mass, radius``.
    """
    names = list(known)
    near = difflib.get_close_matches(wrong, names, n=1)
    hint = f"did you mean '{near[0]}'? " if near else ""
    return f"{hint}choices: {', '.join(names) or 'none'}"


def describe_fault(error: ValidationError) -> str:
    """Return where the first fault of some data is, and what it is, such as ``cases.0.name: Field required``."""
    first = error.errors(include_url=False)[0]
    where = ".".join(str(part) for part in first["loc"]) or "content"
    return f"{where}: {first['msg'].removeprefix('Value error, ')}"

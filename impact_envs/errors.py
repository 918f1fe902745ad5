"""Errors a user can mend: one line that names the thing, the value and the choices."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import gymnasium.error
import numpy as np

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


class ResetNeeded(InputError, gymnasium.error.ResetNeeded):
    """A call out of order, before the first reset or after an episode's end; Gymnasium's error of that name too."""


class ScenarioError(InputError):
    """A scenario file that cannot be read or does not make sense."""


class FormulaError(InputError):
    """An STL formula that cannot be parsed, or does not fit the scenario or the trace."""


def check_count(name: str, number: Any) -> None:
    """Raise unless a number counts something that there must be.

    Raises:
        InputError: no whole number, or less than 1.
    """
    if isinstance(number, bool) or not isinstance(number, int | np.integer) or number < 1:
        raise InputError(f"{name} = {number!r}: a whole number from 1 is needed")


def choices(wrong: object, known: Iterable[str]) -> str:
    """Say which names are known, the nearest one first.

    Args:
        wrong: what is not known; a name mostly.
        known: the names that are.

    Returns:
        Text such as ``did you mean 'radius'? choices: mass, radius``.
    """
    names = list(known)
    near = difflib.get_close_matches(str(wrong), names, n=1)
    hint = f"did you mean '{near[0]}'? " if near else ""
    return f"{hint}choices: {', '.join(names) or 'none'}"


def describe_fault(error: ValidationError) -> str:
    """Return where the first fault of some data is, and what it is, such as ``cases.0.name: Field required``."""
    first = error.errors(include_url=False)[0]
    where = ".".join(str(part) for part in first["loc"]) or "content"
    return f"{where}: {first['msg'].removeprefix('Value error, ')}"

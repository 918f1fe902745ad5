"""How a simulation fails: it ends the episode, is named and counted, and stops no program."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np


class SimulationFailed(Exception):
    """The model cannot follow its world any further; the environment ends the episode, unsuccessful."""


class TooManyEvents(SimulationFailed):
    """Impacts did not end within a control period.

    Args:
        events: how many were followed.
        body: that had the last impact, if there was one.
    """

    def __init__(self, events: int, body: str = "") -> None:
        super().__init__(events, body)  # what a copy is made with

    def __str__(self) -> str:
        events, body = self.args
        return f"more than {events} events in a control period" + (f", the last of them of {body}" if body else "")


class NotFinite(SimulationFailed):
    """A state is no finite number any more.

    Args:
        body: whose.
    """

    def __init__(self, body: str) -> None:
        super().__init__(body)  # what a copy is made with

    def __str__(self) -> str:
        return f"state of {self.args[0]} is not finite"


def check_finite(states: np.ndarray, bodies: Sequence[str]) -> None:
    """Raise unless all states are finite numbers.

    Args:
        states: one row per body, shape (bodies, n).
        bodies: their names.

    Raises:
        NotFinite: naming the first body of which one is not.
    """
    if not are_finite(states):
        raise NotFinite(bodies[int(np.argmin(np.isfinite(states).all(axis=1)))])


def are_finite(numbers: np.ndarray) -> bool:
    """Return whether all of a few numbers are finite; their sum tells, seldom a whole look, in a third of the time."""
    return math.isfinite(sum(numbers.ravel().tolist())) or bool(np.isfinite(numbers).all())


def explain_failure(error: Exception, read: Callable[[], np.ndarray], bodies: Sequence[str]) -> SimulationFailed:
    """Return why a model failed: arithmetic may stop at a state that is not finite before anybody looks at it.

    Args:
        error: that ended the control period; raised again if it says nothing of the simulation.
        read: returns the model's states, one row per body.
        bodies: their names.
    """
    try:
        check_finite(read(), bodies)
    except NotFinite as failure:
        return failure
    except (ArithmeticError, ValueError):
        return NotFinite("a body")
    if isinstance(error, SimulationFailed):
        return error
    raise error

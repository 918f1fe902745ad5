"""What a caller hands over for every agent, actions or observations: checked here before anything happens."""

from __future__ import annotations

import reprlib
from collections.abc import Mapping
from typing import Any

import numpy as np

from impact_envs.errors import InputError, choices
from impact_envs.interface.failure import are_finite

REAL = "fiub"  # kinds of NumPy types that stand for a real number
FLOAT = np.dtype(float)


def read_vectors(
    vectors: Mapping[str, Any], sizes: Mapping[str, int], what: str, finite: bool = True
) -> dict[str, np.ndarray]:
    """Return every agent's vector in float64.

    Args:
        vectors: agent to its vector.
        sizes: agent to the length it must have.
        what: what to call a vector in an error.
        finite: refuse NaN and infinity.

    Raises:
        InputError: no mapping, an agent that is missing or unknown, or a vector that is none.
    """
    check_agents(vectors, sizes, what)
    return {
        name: value
        if _is_vector(value := vectors[name], size) and (not finite or are_finite(value))
        else read_vector(value, size, f"{what} of {name}", finite)
        for name, size in sizes.items()
    }


def check_agents(vectors: Mapping[str, Any], agents: Mapping[str, Any], what: str) -> None:
    """Raise unless every agent is named once.

    Args:
        vectors: agent to its vector.
        agents: that must be named.
        what: what to call a vector in an error.

    Raises:
        InputError: no mapping, or an agent that is missing or unknown.
    """
    if not isinstance(vectors, (dict, Mapping)):
        raise InputError(f"{what}s = {_show(vectors)}: a dict from agent to {what} is needed; {choices('', agents)}")
    if vectors.keys() != agents.keys():
        wrong = ", ".join(sorted(map(str, vectors.keys() ^ agents.keys())))
        raise InputError(f"{what}s must name every robot once, not so: {wrong}; {choices(wrong, agents)}")


def read_vector(value: Any, size: int, what: str, finite: bool = True, needed: str = "") -> np.ndarray:
    """Return a vector in float64.

    Args:
        value: anything that NumPy makes an array of.
        size: length it must have.
        what: what to call it in an error.
        finite: refuse NaN and infinity.
        needed: what to call what is needed, instead of "3 finite numbers".

    Raises:
        InputError: text, complex numbers, another shape, or a number that is not finite.
    """
    try:
        array = np.asarray(value)
    except (ValueError, TypeError, RuntimeError):  # of different lengths, for example, or a tensor that wants gradients
        array = np.empty(0, object)
    if array.shape == (size,) and array.dtype.kind in REAL and not (finite and not are_finite(array)):
        return array.astype(float, copy=False)
    needed = needed or f"{size} {'finite' if finite else 'real'} numbers"
    raise InputError(f"{what} = {_show(value)}: {needed} are needed")


def _is_vector(value: Any, size: int) -> bool:
    """Return whether a value needs no reading: what robots hand over in every control period."""
    return type(value) is np.ndarray and value.dtype is FLOAT and value.shape == (size,)


def _show(value: Any) -> str:
    """Return a value on one line, not too long."""
    return " ".join(reprlib.repr(value.tolist() if isinstance(value, np.ndarray) else value).split())

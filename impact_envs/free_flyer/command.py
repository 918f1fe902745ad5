"""Commands of all robots as one array: actions in [-1, 1], or body-frame forces and torques."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from impact_envs.compiled import compiled
from impact_envs.errors import InputError, choices


def read_commands(commands: Mapping[str, Any], robots: Mapping[str, Any], limits: np.ndarray, what: str) -> np.ndarray:
    """Return the robots' commands, clipped to their limits, one row per robot, shape (robots, 3).

    Args:
        commands: robot to its command for Fx, Fy, tau, shape (3,).
        robots: by name, in the order of rows.
        limits: of the absolute values, shape (robots, 3).
        what: what to call a command in an error.

    Raises:
        InputError: a robot without command, an unknown robot, or a command that is not three finite numbers.
    """
    if commands.keys() != robots.keys():
        wrong = ", ".join(sorted(commands.keys() ^ robots.keys()))
        raise InputError(f"{what}s must name every robot once, not so: {wrong}; {choices(wrong, robots)}")
    try:
        rows = np.array([commands[name] for name in robots], dtype=float)
    except ValueError:  # of different lengths
        rows = np.empty(0)
    if rows.shape != limits.shape or not clip(rows, limits):
        for name in robots:
            command = np.asarray(commands[name], dtype=float)
            if command.shape != (3,) or not all(map(math.isfinite, command.tolist())):
                raise InputError(f"{what} of {name} = {command.tolist()}: three finite numbers Fx, Fy, tau are needed")
    return rows


@compiled
def clip(rows: np.ndarray, limits: np.ndarray) -> bool:
    """Clip numbers to between -limits and limits, in place; return whether all were finite."""
    finite = True
    for i in range(rows.shape[0]):
        for j in range(rows.shape[1]):
            finite = finite and np.isfinite(rows[i, j])
            rows[i, j] = min(max(rows[i, j], -limits[i, j]), limits[i, j])
    return finite

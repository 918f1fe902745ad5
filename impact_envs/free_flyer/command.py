"""Commands of all robots as one array: actions in [-1, 1], or body-frame forces and torques."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from impact_envs.compiled import compiled
from impact_envs.interface.agent_vectors import REAL, check_agents, read_vector


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
    if not isinstance(commands, dict) or commands.keys() != robots.keys():
        check_agents(commands, robots, what)
    try:
        rows = np.array([commands[name] for name in robots])
    except (ValueError, TypeError):  # of different lengths
        rows = np.empty(0)
    if rows.shape == limits.shape and rows.dtype.kind in REAL:
        if rows.dtype.char != "d":
            rows = rows.astype(float)
        if clip(rows, limits):
            return rows
    needed = "three finite numbers Fx, Fy, tau"
    return np.array([read_vector(commands[name], 3, f"{what} of {name}", needed=needed) for name in robots])


@compiled
def clip(rows: np.ndarray, limits: np.ndarray) -> bool:
    """Clip numbers to between -limits and limits, in place; return whether all were finite."""
    finite = True
    for i in range(rows.shape[0]):
        for j in range(rows.shape[1]):
            finite = finite and np.isfinite(rows[i, j])
            rows[i, j] = min(max(rows[i, j], -limits[i, j]), limits[i, j])
    return finite

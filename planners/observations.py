"""What experts of many worlds ask of observations."""

from __future__ import annotations

from typing import Any

import numpy as np

from impact_envs.errors import InputError
from impact_envs.interface.agent_vectors import REAL


def read_observations(observations: Any, count: int, size: int) -> np.ndarray:
    """Return the joint observations of N worlds as float64.

    Args:
        observations: as `vector_env` returns them.
        count: N.
        size: of one.

    Returns:
        Shape (N, size), contiguous.

    Raises:
        InputError: another shape, or no real numbers.
    """
    needed = f"real numbers of shape ({count}, {size}) are needed"
    try:
        joint = np.asarray(observations)
    except (ValueError, TypeError):  # of different lengths
        raise InputError(f"observations: {needed}") from None
    if joint.shape != (count, size) or joint.dtype.kind not in REAL:
        raise InputError(f"observations have shape {joint.shape}, {joint.dtype}; {needed}")
    return np.ascontiguousarray(joint, dtype=np.float64)

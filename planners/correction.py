"""What every expert asks of a correction that a learner sends."""

from __future__ import annotations

import numpy as np

from impact_envs.errors import InputError


def check_correction(correction: np.ndarray, size: int, awaited: bool) -> np.ndarray:
    """Return a correction clipped to [-1, 1].

    Args:
        correction: as the learner sent it.
        size: length that the expert takes.
        awaited: whether the expert waits for a correction now.

    Returns:
        Shape (size,).

    Raises:
        InputError: wrong shape, a value that is not finite, or no correction is awaited.
    """
    values = np.asarray(correction, dtype=float)
    if values.shape != (size,) or not np.isfinite(values).all():
        raise InputError(f"correction must be {size} finite numbers, got {np.array2string(values, threshold=8)}")
    if not awaited:
        raise InputError("no correction is awaited now; see awaiting_correction")
    return np.clip(values, -1.0, 1.0)

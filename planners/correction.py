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


def check_corrections(worlds: np.ndarray, corrections: np.ndarray, awaiting: np.ndarray, size: int) -> None:
    """Raise unless corrections of some of N worlds are in order.

    Args:
        worlds: which worlds' are given, shape (N,) bool.
        corrections: shape (N, size); the other worlds' rows are not looked at.
        awaiting: which worlds await one, shape (N,) bool.
        size: length that the expert takes.

    Raises:
        InputError: another shape, a value that is not finite, or a world that awaits none; the first world is named.
    """
    needed = len(awaiting), size
    if np.shape(worlds) != awaiting.shape or np.asarray(worlds).dtype != bool or np.shape(corrections) != needed:
        raise InputError(
            f"worlds of shape {np.shape(worlds)} and corrections of shape {np.shape(corrections)}: "
            f"{awaiting.shape} truth values and {needed} numbers are needed"
        )
    for k in np.flatnonzero(worlds & ~awaiting).tolist():
        raise InputError(f"world {k} awaits no correction now; see awaiting_correction")
    for k in np.flatnonzero(worlds & ~np.isfinite(corrections).all(axis=1)).tolist():
        raise InputError(f"correction of world {k} must be {size} finite numbers, got {np.asarray(corrections)[k]}")

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


def spread_corrections(worlds: np.ndarray, corrections: np.ndarray, awaiting: np.ndarray, size: int) -> np.ndarray:
    """Return the corrections of some of N worlds, clipped to [-1, 1], in the rows of these worlds; NaN in the others.

    Args:
        worlds: whose are given: a mask, shape (N,) bool, or their numbers, shape (m,).
        corrections: shape (m, size).
        awaiting: which worlds await one, shape (N,) bool.
        size: length that the expert takes.

    Returns:
        Shape (N, size).

    Raises:
        InputError: another shape, a value that is not finite, no such world, or one that awaits none; the first world
            is named.
    """
    chosen = choose_worlds(worlds, len(awaiting))
    needed = f"finite numbers of shape {(len(chosen), size)} are needed"
    try:
        values = np.asarray(corrections, dtype=float)
    except (ValueError, TypeError):  # of different lengths, or text
        raise InputError(f"corrections: {needed}") from None
    if values.shape != (len(chosen), size):
        raise InputError(f"corrections of shape {values.shape}: {needed}")
    for k in chosen[~awaiting[chosen]].tolist():
        raise InputError(f"world {k} awaits no correction now; see awaiting_correction")
    for k, row in zip(chosen.tolist(), values, strict=True):
        if not np.isfinite(row).all():
            raise InputError(f"correction of world {k} must be {size} finite numbers, got {row}")
    spread = np.full((len(awaiting), size), np.nan)
    spread[chosen] = np.clip(values, -1.0, 1.0)
    return spread


def choose_worlds(worlds: np.ndarray, count: int) -> np.ndarray:
    """Return the numbers of some of N worlds, shape (m,).

    Args:
        worlds: a mask, shape (N,) bool, or their numbers, each once, shape (m,).
        count: N.

    Raises:
        InputError: neither of them.
    """
    needed = f"a mask of shape ({count},), or numbers from 0 to {count - 1}, each once, are needed"
    try:
        chosen = np.asarray(worlds)
    except ValueError:  # of different lengths
        raise InputError(f"worlds: {needed}") from None
    if chosen.dtype == bool and chosen.shape == (count,):
        return np.flatnonzero(chosen)
    if chosen.size == 0 and chosen.ndim == 1:  # an empty list is one of floats
        return np.zeros(0, np.int64)
    if chosen.dtype.kind not in "iu" or chosen.ndim != 1:
        raise InputError(f"worlds of shape {chosen.shape}, {chosen.dtype}: {needed}")
    for k in chosen[(chosen < 0) | (chosen >= count)].tolist():
        raise InputError(f"world {k} does not exist: {needed}")
    if len(np.unique(chosen)) < len(chosen):
        raise InputError(f"worlds {np.array2string(chosen, threshold=8)}: {needed}")
    return chosen

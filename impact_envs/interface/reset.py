"""What a caller hands over to reset many worlds, seeds and masks: checked here before anything happens."""

from __future__ import annotations

from typing import Any

import numpy as np

from impact_envs.errors import InputError
from impact_envs.stream import LARGEST_SEED, check_seed


def make_seeds(seed: Any, count: int, worlds: np.ndarray) -> np.ndarray:
    """Return the seeds of some of N worlds.

    Args:
        seed: of world 0, world k gets seed + k; or one for each world.
        count: N.
        worlds: their numbers, shape (m,).

    Returns:
        Shape (m,).

    Raises:
        InputError: another shape, or a seed that is none.
    """
    if np.ndim(seed) == 0:
        first = check_seed(seed)
        seed = range(first, first + count)
    if np.shape(seed) != (count,):
        raise InputError(f"seed has shape {np.shape(seed)}; one number, or one for each of {count} worlds")
    if isinstance(seed, range) and seed[0] >= 0 and seed[-1] <= LARGEST_SEED:
        return seed[0] + worlds
    for world in worlds.tolist():
        check_seed(seed[world], f"seed of world {world}")
    return np.array([int(seed[world]) for world in worlds.tolist()], np.int64)


def read_mask(options: Any, count: int, started: bool) -> np.ndarray:
    """Return which worlds a reset is for.

    Args:
        options: of the reset; ``reset_mask``, shape (N,) bool, names the worlds; all without.
        count: N.
        started: whether all worlds were reset before.

    Returns:
        Shape (N,) bool.

    Raises:
        InputError: no dict, a mask of another shape or of no world, or one that leaves out a world never reset.
    """
    if options is not None and not isinstance(options, dict):
        raise InputError(f"options = {options!r:.60}: a dict is needed")
    given = (options or {}).get("reset_mask")
    mask = np.ones(count, bool) if given is None else np.asarray(given)
    if mask.shape != (count,) or mask.dtype != bool or not mask.any():
        raise InputError(
            f"reset_mask of shape {mask.shape}, {mask.dtype}: {count} truth values are needed, one of them "
            "true at least"
        )
    if not (started or mask.all()):
        world = int(np.argmin(mask))
        raise InputError(f"reset_mask leaves out world {world}, which was never reset: reset all worlds first")
    return mask

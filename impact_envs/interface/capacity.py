"""How many worlds fit into this machine's memory."""

from __future__ import annotations

import os

from impact_envs.errors import InputError


def check_size(count: int, size: int) -> None:
    """Raise unless so many worlds of a size in bytes exist and fit into half of the machine's memory.

    Raises:
        InputError: naming the count and how many fit.
    """
    if count < 1:
        raise InputError(f"num_envs = {count}: at least 1 world is needed")
    fits = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // (2 * size)
    if count > fits:
        raise InputError(
            f"num_envs = {count}: {size} bytes per world; half of this machine's memory holds {fits} worlds"
        )

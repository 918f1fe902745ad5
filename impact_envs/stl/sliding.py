"""Extremes of sliding windows, a few operations per sample whatever the window: compiled scalar functions.

A window of fixed width keeps its values in blocks of that width. It is the end of the last block, gathered backward
when that block was full, and the start of the present one, gathered forward. Source: van Herk 1992, Gil & Werman 1993.

A queue is a window whose two ends move independently, in a ring. Its oldest values are gathered: each is replaced by
the extreme of itself and of the later ones of them. New values wait behind. When no gathered one is left, the waiting
ones are gathered. The head of a queue holds the place of the oldest value, both counts and the extreme of the waiting.
"""

from __future__ import annotations

import math
from typing import Any

from impact_envs.compiled import inlined
from impact_envs.stl.compiled_formula import MAX
from impact_envs.stl.state import PLACE, combine

WINDOW = 2  # numbers at the head of a window of fixed width: place in the block, and the extreme of the block so far
QUEUE = 4  # numbers at the head of a queue
OLDEST, GATHERED, WAITING, EXTREME_WAITING = range(QUEUE)


@inlined
def worst(pick: int) -> float:
    """Return the number that loses against every other: -inf for MAX, inf for MIN."""
    return -math.inf if pick == MAX else math.inf


@inlined
def slide(memory: Any, k: int, head: int, ring: int, width: int, pick: int, value: float) -> float:
    """Take the next value; return the extreme of the last ``width`` ones, once there are so many.

    Args:
        memory: of all worlds, shape (worlds, ...); written.
        k: the world.
        head: place of the window's ``WINDOW`` numbers, of which the first is 0 at the start.
        ring: place of its ``width`` values.
        width: of the window, at least 1.
        pick: MIN or MAX.
        value: finite.
    """
    place = int(memory[k, head]) & PLACE
    gathered = value if place == 0 else combine(pick, memory[k, head + 1], value)
    memory[k, ring + place] = value
    if place == width - 1:
        memory[k, head] = 0.0
        extreme = value
        for j in range(1, width):
            at = (ring + place - j) & PLACE
            extreme = combine(pick, memory[k, at], extreme)
            memory[k, at] = extreme
        return gathered
    memory[k, head] = place + 1.0
    memory[k, head + 1] = gathered
    return combine(pick, memory[k, ring + place + 1], gathered)


@inlined
def clear_queue(memory: Any, k: int, head: int, pick: int) -> None:
    """Forget what is in a queue."""
    memory[k, head + OLDEST] = 0.0
    memory[k, head + GATHERED] = 0.0
    memory[k, head + WAITING] = 0.0
    memory[k, head + EXTREME_WAITING] = worst(pick)


@inlined
def turn(place: int, length: int) -> int:
    """Return a place of a ring, given as such or up to once around too far."""
    return (place - length if place >= length else place) & PLACE


@inlined
def push(memory: Any, k: int, head: int, ring: int, length: int, pick: int, value: float) -> None:
    """Append a value to a queue.

    Args:
        memory: of all worlds, shape (worlds, ...); written.
        k: the world.
        head: place of the queue's ``QUEUE`` numbers.
        ring: place of its ``length`` values.
        length: of the queue at most.
        pick: MIN or MAX.
        value: finite.
    """
    oldest, gathered = int(memory[k, head + OLDEST]), int(memory[k, head + GATHERED])
    waiting = int(memory[k, head + WAITING])
    memory[k, ring + turn(oldest + gathered + waiting, length)] = value
    memory[k, head + WAITING] = waiting + 1.0
    memory[k, head + EXTREME_WAITING] = combine(pick, memory[k, head + EXTREME_WAITING], value)


@inlined
def drop(memory: Any, k: int, head: int, ring: int, length: int, pick: int) -> None:
    """Take the oldest value from a queue that is not empty."""
    oldest, gathered = int(memory[k, head + OLDEST]), int(memory[k, head + GATHERED])
    if gathered == 0:
        gathered, extreme = int(memory[k, head + WAITING]), worst(pick)
        for j in range(1, gathered + 1):
            at = ring + turn(oldest + gathered - j, length)
            extreme = combine(pick, extreme, memory[k, at])
            memory[k, at] = extreme
        memory[k, head + WAITING] = 0.0
        memory[k, head + EXTREME_WAITING] = worst(pick)
    memory[k, head + OLDEST] = turn(oldest + 1, length)
    memory[k, head + GATHERED] = gathered - 1.0


@inlined
def read_queue(memory: Any, k: int, head: int, ring: int, pick: int) -> float:
    """Return the extreme of a queue, the worst number if it is empty."""
    oldest, waiting = int(memory[k, head + OLDEST]) & PLACE, memory[k, head + EXTREME_WAITING]
    return combine(pick, waiting, memory[k, ring + oldest]) if memory[k, head + GATHERED] > 0 else waiting

"""Extremes of sliding windows, a few operations per sample whatever the window: compiled scalar functions.

A window of fixed width keeps its values in blocks of that width. It is the end of the last block, gathered backward
when that block was full, and the start of the present one, gathered forward. Source: van Herk 1992, Gil & Werman 1993.

A queue is a window whose two ends move independently. It is two stacks: the first holds the oldest values, each
replaced by the extreme of itself and of all below it; new values go on the second. When the first is empty, the second
is moved to it. The head of a queue holds both lengths and the extreme of the second stack.
"""

from __future__ import annotations

import math
from typing import Any

from impact_envs.compiled import inlined
from impact_envs.stl.compiled_formula import MAX
from impact_envs.stl.state import PLACE, combine

WINDOW = 2  # numbers at the head of a window of fixed width: place in the block, and the extreme of the block so far
QUEUE = 3  # numbers at the head of a queue
STACKED, WAITING, GATHERED = range(QUEUE)


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
    memory[k, head + STACKED] = 0.0
    memory[k, head + WAITING] = 0.0
    memory[k, head + GATHERED] = worst(pick)


@inlined
def push(memory: Any, k: int, head: int, stacks: int, length: int, pick: int, value: float) -> None:
    """Append a value to a queue.

    Args:
        memory: of all worlds, shape (worlds, ...); written.
        k: the world.
        head: place of the queue's ``QUEUE`` numbers.
        stacks: place of its ``2 length`` values.
        length: of the queue at most.
        pick: MIN or MAX.
        value: finite.
    """
    waiting = int(memory[k, head + WAITING]) & PLACE
    memory[k, stacks + length + waiting] = value
    memory[k, head + WAITING] = waiting + 1.0
    memory[k, head + GATHERED] = combine(pick, memory[k, head + GATHERED], value)


@inlined
def drop(memory: Any, k: int, head: int, stacks: int, length: int, pick: int) -> None:
    """Take the oldest value from a queue that is not empty."""
    stacked = int(memory[k, head + STACKED]) & PLACE
    if stacked == 0:
        stacked, gathered = int(memory[k, head + WAITING]) & PLACE, worst(pick)
        for j in range(stacked):
            gathered = combine(pick, gathered, memory[k, (stacks + length + stacked - 1 - j) & PLACE])
            memory[k, stacks + j] = gathered
        memory[k, head + WAITING] = 0.0
        memory[k, head + GATHERED] = worst(pick)
    memory[k, head + STACKED] = stacked - 1.0


@inlined
def read_queue(memory: Any, k: int, head: int, stacks: int, pick: int) -> float:
    """Return the extreme of a queue, the worst number if it is empty."""
    stacked, gathered = int(memory[k, head + STACKED]) & PLACE, memory[k, head + GATHERED]
    return combine(pick, gathered, memory[k, (stacks + stacked - 1) & PLACE]) if stacked > 0 else gathered

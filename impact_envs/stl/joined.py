"""Always or eventually of one operator joined with formulas about one instant, in constant time per sample.

Such as F[0,20] (p & G[0,5] q), G[0,20] (p -> F[0,5] q) and G[0,20] (p U[0,5] q). The formula inside is monotone in
the operator's value x, hence max(lower, min(upper, x)), a clamp: its ends are what it is for x = -inf and x = +inf, and
clamps compose to clamps. An eventually, always or until is the clamps of its samples one after another, applied to what
comes after the window: max(q, x), min(q, x), max(min(p, q), min(p, x)).

An instant whose window begins after the present sample is early (of an until the left side counts already), one whose
window holds it is open. All open instants see the same samples to come, hence all of them together are a clamp of what
these samples give. A stretch of instants is followed by two clamps: of its samples, and of its instants. A stretch and
a later one: the samples of the later one act on the instants of both. That is associative, so that the early and the
open instants are two sliding windows (see sliding.py) of such pairs.
"""

from __future__ import annotations

import math
from typing import Any

from impact_envs.compiled import compiled, inlined
from impact_envs.stl.compiled_formula import (
    ENDS,
    FIRST,
    FIRST_2,
    LAST,
    LAST_2,
    LEFT,
    LOWER,
    MAX,
    MIN,
    PICK,
    PICK_2,
    RIGHT,
    SLOT,
    UNSEEN,
    UPPER,
    CompiledFormula,
)
from impact_envs.stl.sliding import worst
from impact_envs.stl.state import PLACE, combine, compute_state

# Memory of a row: the extreme of the final instants, and two windows: of open instants, and of early ones. A window is
# its place in the block, the two clamps of the block so far, and two clamps per instant. In the present block these are
# of the instant's sample and of the instant alone. In the last one they are of the instant alone after the rest of the
# block, and of this instant and the later ones together.
BEST, OPEN = range(2)
SAMPLES, INSTANTS = 1, 3
HEAD = 5
# Which ends of all clamps vary; the others are infinite. The number is also how many numbers are kept of an instant.
BOTH, LOW, HIGH = 4, 2, -2


def compute_size(first: int, last: int, ends: int) -> int:
    """Return how many numbers of a world's memory such an operator takes.

    Args:
        first: start of the inner operator's interval [samples].
        last: its end [samples].
        ends: which ends of the clamps vary.
    """
    return OPEN + 2 * HEAD + abs(ends) * last


@inlined
def clamp(lower: float, upper: float, value: float) -> float:
    """Return the value, or the end of the interval beside which it lies."""
    return combine(MAX, lower, combine(MIN, upper, value))


@inlined
def write_clamp(memory: Any, k: int, at: int, ends: int, lower: float, upper: float) -> None:
    """Set what varies of a clamp."""
    if ends != HIGH:
        memory[k, at] = lower
    if ends == BOTH:
        memory[k, at + 1] = upper
    elif ends == HIGH:
        memory[k, at] = upper


@inlined
def read_clamp(memory: Any, k: int, at: int, ends: int) -> tuple[float, float]:
    """Return both ends of a clamp."""
    if ends == BOTH:
        return memory[k, at], memory[k, at + 1]
    if ends == LOW:
        return memory[k, at], math.inf
    return -math.inf, memory[k, at]


@inlined
def clear_window(memory: Any, k: int, head: int, width: int, pick: int, ends: int) -> None:
    """Forget the instants of a window."""
    none = worst(pick)
    memory[k, head] = 0.0
    write_clamp(memory, k, head + SAMPLES, BOTH, -math.inf, math.inf)
    write_clamp(memory, k, head + INSTANTS, BOTH, none, none)
    for j in range(abs(ends) * width):
        memory[k, head + HEAD + j] = none


@inlined
def pass_window(
    memory: Any,
    k: int,
    head: int,
    width: int,
    how: tuple[int, int],
    sample: tuple[float, float],
    alone: tuple[float, float],
) -> tuple[float, float, float, float]:
    """Take the next sample and the instant at which it is the first; let go of the oldest instant.

    Args:
        memory: of all worlds, shape (worlds, ...); written.
        k: the world.
        head: place of the window.
        width: of the window, at least 1.
        how: instants are joined, MIN or MAX; which ends of the clamps vary.
        sample: its clamp.
        alone: clamp of the instant without samples.

    Returns:
        The clamp of the oldest instant after all its samples, and that of the instants left.
    """
    pick, ends = how
    size = abs(ends)
    half = size >> 1
    place = int(memory[k, head]) & PLACE
    at = (head + HEAD + size * place) & PLACE
    a, b = read_clamp(memory, k, head + SAMPLES, BOTH)
    low, high = clamp(a, b, sample[0]), clamp(a, b, sample[1])
    a, b = read_clamp(memory, k, at, ends)
    oldest_low, oldest_high = clamp(a, b, low), clamp(a, b, high)
    write_clamp(memory, k, at, ends, sample[0], sample[1])
    write_clamp(memory, k, at + half, ends, alone[0], alone[1])
    if place == width - 1:
        memory[k, head] = 0.0
        write_clamp(memory, k, head + SAMPLES, BOTH, -math.inf, math.inf)
        write_clamp(memory, k, head + INSTANTS, BOTH, worst(pick), worst(pick))
        lower, upper = gather_backward(memory, k, at, width, how)
        return oldest_low, oldest_high, lower, upper
    a, b = read_clamp(memory, k, head + INSTANTS, BOTH)
    lower = combine(pick, clamp(a, b, sample[0]), clamp(alone[0], alone[1], sample[0]))
    upper = combine(pick, clamp(a, b, sample[1]), clamp(alone[0], alone[1], sample[1]))
    memory[k, head] = place + 1.0
    write_clamp(memory, k, head + SAMPLES, BOTH, low, high)
    write_clamp(memory, k, head + INSTANTS, BOTH, lower, upper)
    a, b = read_clamp(memory, k, at + size + half, ends)
    lower, upper = combine(pick, clamp(a, b, low), lower), combine(pick, clamp(a, b, high), upper)
    return oldest_low, oldest_high, lower, upper


@inlined
def gather_backward(memory: Any, k: int, at: int, width: int, how: tuple[int, int]) -> tuple[float, float]:
    """Make the present block, whose last instant is at a place, the last block; return the clamp of its instants."""
    pick, ends = how
    size = abs(ends)
    half = size >> 1
    low, high, lower, upper = -math.inf, math.inf, worst(pick), worst(pick)
    for j in range(width):
        entry = (at - size * j) & PLACE
        a, b = read_clamp(memory, k, entry, ends)
        low, high = clamp(a, b, low), clamp(a, b, high)
        a, b = read_clamp(memory, k, entry + half, ends)
        a, b = clamp(a, b, low), clamp(a, b, high)
        lower, upper = combine(pick, lower, a), combine(pick, upper, b)
        write_clamp(memory, k, entry, ends, a, b)
        write_clamp(memory, k, entry + half, ends, lower, upper)
    return lower, upper


@compiled
def start_joined(formula: CompiledFormula, memory: Any, k: int, i: int) -> None:
    """Forget all samples of row i of the root."""
    root = formula.root
    slot, pick, first, ends = root[i, SLOT], root[i, PICK], root[i, FIRST_2], root[i, ENDS]
    width = root[i, LAST_2] - first
    memory[k, slot + BEST] = worst(pick)
    clear_window(memory, k, slot + OPEN, width, pick, ends)
    clear_window(memory, k, slot + OPEN + HEAD + abs(ends) * width, first, pick, ends)


@compiled
def update_joined(
    formula: CompiledFormula, memory: Any, k: int, count: int, signals: Any, i: int
) -> tuple[float, float]:
    """Return the interval of an always or eventually of an operator joined with formulas about one instant."""
    root, numbers = formula.root, formula.numbers
    pick, inner, slot, unseen = root[i, PICK], root[i, PICK_2], root[i, SLOT] & PLACE, root[i, UNSEEN] & PLACE
    first, last, first_2, last_2 = root[i, FIRST], root[i, LAST], root[i, FIRST_2], root[i, LAST_2]
    best, lower, upper = memory[k, slot + BEST], worst(pick), worst(pick)
    low = high = worst(pick)
    if first <= count <= last + last_2:
        if count <= last:
            lower, upper = -math.inf, math.inf
            if root[i, LOWER] >= 0:
                lower = compute_state(formula, memory, k, signals, root[i, LOWER])
            if root[i, UPPER] >= 0:
                upper = compute_state(formula, memory, k, signals, root[i, UPPER])
        left = worst(1 - inner)
        if root[i, LEFT] >= 0:
            left = compute_state(formula, memory, k, signals, root[i, LEFT])
        width, how = last_2 - first_2, (pick, root[i, ENDS])
        worst_case, best_case = numbers[unseen + 2], numbers[unseen + 3]
        held = (-math.inf, left) if inner == MAX else (left, math.inf)
        if first_2 > 0:
            early = slot + OPEN + HEAD + abs(how[1]) * width
            lower, upper, a, b = pass_window(memory, k, early, first_2, how, held, (lower, upper))
            low, high = clamp(a, b, worst_case), clamp(a, b, best_case)
        if count >= first + first_2:
            value = combine(1 - inner, left, compute_state(formula, memory, k, signals, root[i, RIGHT]))
            sample = (value, left) if inner == MAX else (left, value)
            a, b, lower, upper = pass_window(memory, k, slot + OPEN, width, how, sample, (lower, upper))
            low = combine(pick, low, clamp(lower, upper, worst_case))
            high = combine(pick, high, clamp(lower, upper, best_case))
            best = combine(pick, best, a if inner == MAX else b)  # of a final instant, no more samples come
            memory[k, slot + BEST] = best
    if count >= last + last_2:
        return best, best
    if count < last:
        low, high = combine(pick, low, numbers[unseen]), combine(pick, high, numbers[unseen + 1])
    return combine(pick, best, low), combine(pick, best, high)

"""Operators about one operator joined with formulas about one instant, in constant time per sample.

Such as F[0,20] (p & G[0,5] q), G[0,20] (p -> F[0,5] q), G[0,20] (p U[0,5] q) and p U[0,20] G[0,5] q. What stands inside
is monotone in the inner operator's value x, hence a clamp max(lower, min(upper, x)), whose ends are what it is for
x = -inf and x = inf. Clamps one after another are a clamp again, and so is the least or greatest of clamps of the same
x. An inner operator is a clamp per sample, one after another, of what comes after the window: of eventually
max(q, x), of always min(q, x), of until max(min(p, q), min(p, x)).

An instant is early while its inner interval has not begun (of an until the left side counts already), open until that
has ended, then final. All open instants see the same samples to come, so that all together they are a clamp of what
these give. Follow a stretch of instants by two clamps, of its samples and of its instants. Of a stretch and a later one
together, the later one's samples act on the instants of both. This is associative: early and open instants are sliding
windows of such pairs (van Herk 1992, Gil & Werman 1993, see sliding.py).

Of an outer until the left side is known wherever the right one is, and joins it as a formula about one instant.
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
    LEFT_2,
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
from impact_envs.stl.term import Join, Pick

# Memory of a row: the extreme of the final instants, that of an outer until's left side, and two windows, of open and
# of early instants. A window is its place in the block, the two clamps of the block so far, and two clamps per instant.
# In the present block these are of the instant's sample and of the instant without samples. In the last one they are
# of the instant after the rest of the block, and of it and the later ones together.
BEST, HELD, OPEN = range(3)
SAMPLES, INSTANTS = 1, 3
HEAD = 5
# Which ends of all clamps vary; the others are infinite. The magnitude is how many numbers are kept of an instant.
BOTH, LOW, HIGH = 4, 2, -2


def find_ends(pick: Pick, join: Join) -> int:
    """Return which ends of the clamps vary.

    Args:
        pick: of the outer operator.
        join: what it is about.
    """
    operator = join.operator
    if len(operator.children) == 2 or operator.pick is pick:
        return BOTH
    if operator.pick is max:
        return BOTH if join.upper else LOW
    return BOTH if join.lower else HIGH


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
    memory[k, slot + HELD] = worst(1 - pick)
    clear_window(memory, k, slot + OPEN, width, pick, ends)
    clear_window(memory, k, slot + OPEN + HEAD + abs(ends) * width, first, pick, ends)


@compiled
def update_joined(
    formula: CompiledFormula, memory: Any, k: int, count: int, signals: Any, i: int
) -> tuple[float, float]:
    """Return the interval of an operator about one operator joined with formulas about one instant."""
    root, numbers = formula.root, formula.numbers
    pick, inner, slot, unseen = root[i, PICK], root[i, PICK_2], root[i, SLOT] & PLACE, root[i, UNSEEN] & PLACE
    first, last, first_2, last_2 = root[i, FIRST], root[i, LAST], root[i, FIRST_2], root[i, LAST_2]
    best, held, lower, upper = memory[k, slot + BEST], memory[k, slot + HELD], worst(pick), worst(pick)
    low = high = worst(pick)
    if count <= last and root[i, LEFT] >= 0:
        held = combine(1 - pick, held, compute_state(formula, memory, k, signals, root[i, LEFT]))
        memory[k, slot + HELD] = held
    if first <= count <= last + last_2:
        width, how = last_2 - first_2, (pick, root[i, ENDS])
        if count <= last:
            lower, upper = -math.inf, math.inf
            if root[i, LOWER] >= 0:
                lower = compute_state(formula, memory, k, signals, root[i, LOWER])
            if root[i, UPPER] >= 0:
                upper = compute_state(formula, memory, k, signals, root[i, UPPER])
            lower, upper = combine(1 - pick, lower, held), combine(1 - pick, upper, held)
        left = worst(1 - inner)
        if root[i, LEFT_2] >= 0:
            left = compute_state(formula, memory, k, signals, root[i, LEFT_2])
        if first_2 > 0:
            sample = (-math.inf, left) if inner == MAX else (left, math.inf)
            head = slot + OPEN + HEAD + abs(how[1]) * width
            lower, upper, a, b = pass_window(memory, k, head, first_2, how, sample, (lower, upper))
            low, high = clamp(a, b, numbers[unseen + 2]), clamp(a, b, numbers[unseen + 3])
        if count >= first + first_2:
            value = combine(1 - inner, left, compute_state(formula, memory, k, signals, root[i, RIGHT]))
            sample = (value, left) if inner == MAX else (left, value)
            if width > 0:
                a, b, lower, upper = pass_window(memory, k, slot + OPEN, width, how, sample, (lower, upper))
            else:
                a, b = clamp(lower, upper, sample[0]), clamp(lower, upper, sample[1])
                lower = upper = worst(pick)
            low = combine(pick, low, clamp(lower, upper, numbers[unseen + 2]))
            high = combine(pick, high, clamp(lower, upper, numbers[unseen + 3]))
            best = combine(pick, best, a if inner == MAX else b)  # of a final instant: no samples come after its last
            memory[k, slot + BEST] = best
    if count >= last + last_2:
        return best, best
    if count < last:
        low = combine(pick, low, combine(1 - pick, held, numbers[unseen]))
        high = combine(pick, high, combine(1 - pick, held, numbers[unseen + 1]))
    return combine(pick, best, low), combine(pick, best, high)

"""Alternations: always eventually, always eventually always, and their duals, in constant time per sample.

A value is final when all samples it depends on have come, and open before. The robustness is a least and greatest of
samples. If every sample to come is the same number u, it is max(A, min(u, B)): so it is enough to follow two numbers,
A for u = -inf and B for u = +inf, whatever the number of open instants.

All code is for an outer "always", the least over instants t; for an outer "eventually" all signs are turned.

Always eventually: an instant is worth the greatest sample it has seen, the last instant has seen the fewest, hence A
is what the last instant has seen (TAIL), and B is the least of the final values (BEST).

Always eventually always: A is the same with final values of the innermost operator in the place of samples. For B an
open instant t is worth max(M(t), h(t)): M(t) is the greatest final inner value that t has seen, h(t) the least sample
so far of the last inner window of t. As t grows M falls and h rises, so the least is next to where they cross. For a
given t M only rises and h only falls with time, so the crossing only moves forward.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from impact_envs.compiled import compiled, inlined
from impact_envs.stl.compiled_formula import (
    FIRST,
    FIRST_2,
    FIRST_3,
    LAST,
    LAST_2,
    LAST_3,
    MAX,
    MIN,
    PICK,
    RIGHT,
    SLOT,
    UNSEEN,
    CompiledFormula,
)
from impact_envs.stl.sliding import (
    QUEUE,
    WINDOW,
    clear_queue,
    drop,
    push,
    read_queue,
    slide,
    worst,
)
from impact_envs.stl.state import PLACE, combine, compute_state

# Memory of a row: the least over final instants, the greatest that the last instant has seen, M of the instant before
# the crossing, and the crossing itself, counted from the outer operator's first instant.
BEST, TAIL, PASSED, CROSSING = range(4)
# Then the heads of two windows, which make the middle and the innermost operator final, and of two queues, of which M
# and h at the crossing are read. The values of all four follow.
OUTER = 4
INNER = OUTER + WINDOW
FINALS = INNER + WINDOW
SAMPLES = FINALS + QUEUE
HEAD = SAMPLES + QUEUE


def compute_size(widths: Sequence[int]) -> int:
    """Return how many numbers of a world's memory an alternation takes.

    Args:
        widths: of the operators inside, outer one first [samples].
    """
    return HEAD + (widths[0] if len(widths) == 1 else 2 * sum(widths))


@compiled
def start_alternation(formula: CompiledFormula, memory: Any, k: int, i: int) -> None:
    """Forget all samples of row i of the root."""
    slot = formula.root[i, SLOT]
    memory[k, slot + BEST] = worst(MIN)
    memory[k, slot + TAIL] = worst(MAX)
    memory[k, slot + PASSED] = worst(MIN)
    memory[k, slot + CROSSING] = 0.0
    memory[k, slot + OUTER] = 0.0
    memory[k, slot + INNER] = 0.0
    clear_queue(memory, k, slot + FINALS, MAX)
    clear_queue(memory, k, slot + SAMPLES, MIN)


@inlined
def update_twofold(
    formula: CompiledFormula, memory: Any, k: int, count: int, signals: Any, i: int
) -> tuple[float, float]:
    """Return the interval of an always eventually or an eventually always."""
    root, numbers = formula.root, formula.numbers
    slot, unseen, sign = root[i, SLOT] & PLACE, root[i, UNSEEN] & PLACE, 1.0 if root[i, PICK] == MIN else -1.0
    first, last, first_2, last_2 = root[i, FIRST], root[i, LAST], root[i, FIRST_2], root[i, LAST_2]
    best, tail = memory[k, slot + BEST], memory[k, slot + TAIL]
    if first + first_2 <= count <= last + last_2:
        value = sign * compute_state(formula, memory, k, signals, root[i, RIGHT])
        window = slide(memory, k, slot + OUTER, slot + HEAD, last_2 - first_2 + 1, MAX, value)
        if count >= first + last_2:
            best = combine(MIN, best, window)
            memory[k, slot + BEST] = best
        if count >= last + first_2:
            tail = combine(MAX, tail, value)
            memory[k, slot + TAIL] = tail
    if count >= last + last_2:
        return sign * best, sign * best
    low, high = sign * numbers[unseen], sign * numbers[unseen + 1]
    low, high = combine(MIN, best, combine(MAX, tail, low)), combine(MIN, best, combine(MAX, tail, high))
    return sign * low, sign * high


@compiled
def update_threefold(
    formula: CompiledFormula, memory: Any, k: int, count: int, signals: Any, i: int
) -> tuple[float, float]:
    """Return the interval of an always eventually always or an eventually always eventually."""
    root, numbers = formula.root, formula.numbers
    slot, unseen, sign = root[i, SLOT] & PLACE, root[i, UNSEEN] & PLACE, 1.0 if root[i, PICK] == MIN else -1.0
    first, last = root[i, FIRST], root[i, LAST]
    first_2, last_2, first_3, last_3 = root[i, FIRST_2], root[i, LAST_2], root[i, FIRST_3], root[i, LAST_3]
    best, tail, bound = memory[k, slot + BEST], memory[k, slot + TAIL], worst(MIN)
    if first + first_2 + first_3 <= count <= last + last_2 + last_3:
        width_2, width_3 = (last_2 - first_2 + 1) & PLACE, (last_3 - first_3 + 1) & PLACE
        value = sign * compute_state(formula, memory, k, signals, root[i, RIGHT])
        ring = slot + HEAD
        extreme = slide(memory, k, slot + INNER, ring + width_2, width_3, MIN, value)
        seen = count - last_3  # the instant at which the innermost operator becomes final
        if seen >= first + first_2:
            window = slide(memory, k, slot + OUTER, ring, width_2, MAX, extreme)
            if seen >= first + last_2:
                best = combine(MIN, best, window)
                memory[k, slot + BEST] = best
            if seen >= last + first_2:
                tail = combine(MAX, tail, extreme)
                memory[k, slot + TAIL] = tail
        bound = move_crossing(formula, memory, k, count, i, value, extreme)
    if count >= last + last_2 + last_3:
        return sign * best, sign * best
    low, high = combine(MIN, sign * numbers[unseen], bound), combine(MIN, sign * numbers[unseen + 1], bound)
    low, high = combine(MIN, best, combine(MAX, tail, low)), combine(MIN, best, combine(MAX, tail, high))
    return sign * low, sign * high


@inlined
def move_crossing(
    formula: CompiledFormula, memory: Any, k: int, count: int, i: int, value: float, extreme: float
) -> float:
    """Return what the open instants are worth if all samples to come are as good as can be.

    Args:
        formula: of a row i that is threefold.
        memory: of all worlds.
        k: the world.
        count: of the present sample.
        i: the row.
        value: of the innermost formula at the present sample.
        extreme: of the innermost operator where it became final.
    """
    root = formula.root
    slot, length = root[i, SLOT] & PLACE, root[i, LAST] - root[i, FIRST]
    width_2 = (root[i, LAST_2] - root[i, FIRST_2] + 1) & PLACE
    width_3 = (root[i, LAST_3] - root[i, FIRST_3] + 1) & PLACE
    since_final = count - root[i, FIRST] - root[i, FIRST_2] - root[i, LAST_3]
    since_sample = count - root[i, FIRST] - root[i, LAST_2] - root[i, FIRST_3]
    ring_2 = slot + HEAD + width_2 + width_3
    ring_3 = ring_2 + width_2
    passed, crossing = memory[k, slot + PASSED], int(memory[k, slot + CROSSING])
    if since_final >= 0:
        passed = combine(MAX, passed, extreme)
        if crossing <= length:
            push(memory, k, slot + FINALS, ring_2, width_2, MAX, extreme)
    if since_sample >= 0 and crossing <= length:
        push(memory, k, slot + SAMPLES, ring_3, width_3, MIN, value)
    held = worst(MIN)
    while crossing <= min(length, since_sample):  # there is a sample in the queue
        held = read_queue(memory, k, slot + SAMPLES, ring_3, MIN)
        reached = read_queue(memory, k, slot + FINALS, ring_2, MAX)
        if reached < held:
            break
        passed, held = reached, worst(MIN)
        drop(memory, k, slot + FINALS, ring_2, width_2, MAX)
        drop(memory, k, slot + SAMPLES, ring_3, width_3, MIN)
        crossing += 1
    memory[k, slot + PASSED] = passed
    memory[k, slot + CROSSING] = crossing
    return combine(MIN, passed, held)

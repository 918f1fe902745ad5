"""Parts of a formula followed instant by instant: operators inside operators that are no alternation (alternation.py).

A node is a part of a formula inside a temporal operator inside which there is another one. After sample
``count`` its value at instant t is what the bounds alone allow for t > count - EARLIEST, final for t <= count -
REACH, and open in between. Only the open ones are computed anew; a ring of the node holds them, instant t at t
& MASK, STRIDE numbers each: lower and upper end, or a single number where they are the same. A sample takes time
in proportion to the number of open instants. Compiled scalar functions.
"""

from __future__ import annotations

from typing import Any

from impact_envs.compiled import compiled, inlined
from impact_envs.stl.compiled_formula import (
    EARLIEST,
    END,
    EXTREME_NODE,
    FIRST,
    JOIN_NODE,
    KIND,
    LAST,
    LEFT,
    MASK,
    PICK,
    REACH,
    RIGHT,
    SLOT,
    START,
    STATE_NODE,
    STRIDE,
    UNSEEN,
    CompiledFormula,
)
from impact_envs.stl.state import PLACE, combine, compute_state


@inlined
def read_node(formula: CompiledFormula, memory: Any, k: int, count: int, node: int, t: int) -> tuple[float, float]:
    """Return both ends of a node's value at instant t."""
    nodes = formula.nodes
    if t > count - nodes[node, EARLIEST]:
        unseen = nodes[node, UNSEEN]
        return formula.numbers[unseen], formula.numbers[unseen + 1]
    stride = nodes[node, STRIDE]
    at = (nodes[node, SLOT] & PLACE) + stride * (t & nodes[node, MASK])
    return memory[k, at], memory[k, at + stride - 1]


@inlined
def write_node(formula: CompiledFormula, memory: Any, k: int, node: int, t: int, low: float, high: float) -> None:
    """Set both ends of a node's value at instant t."""
    at = formula.nodes[node, SLOT] + 2 * (t & formula.nodes[node, MASK])
    memory[k, at] = low
    memory[k, at + 1] = high


@compiled
def update_join(formula: CompiledFormula, memory: Any, k: int, count: int, node: int, begin: int, end: int) -> None:
    """Compute a conjunction or disjunction of two nodes at the instants from begin to end."""
    left, right = formula.nodes[node, LEFT], formula.nodes[node, RIGHT]
    pick = formula.nodes[node, PICK]
    for t in range(begin, end + 1):
        low, high = read_node(formula, memory, k, count, left, t)
        a, b = read_node(formula, memory, k, count, right, t)
        write_node(formula, memory, k, node, t, combine(pick, low, a), combine(pick, high, b))


@compiled
def update_extreme_node(
    formula: CompiledFormula, memory: Any, k: int, count: int, node: int, begin: int, end: int
) -> None:
    """Compute the extremes of a node (RIGHT) over the windows of the instants from begin to end.

    In each block of as many windows as a window is wide, a window is the end of the first one, gathered
    backward, and the start of the next block, gathered forward. Source: van Herk 1992, Gil & Werman 1993.
    """
    child, pick = formula.nodes[node, RIGHT], formula.nodes[node, PICK]
    first, last = formula.nodes[node, FIRST], formula.nodes[node, LAST]
    width = last - first + 1
    block = begin
    while block <= end:
        stop = min(block + width - 1, end)
        low, high = read_node(formula, memory, k, count, child, block + last)
        for j in range(width):
            t = block + width - 1 - j
            a, b = read_node(formula, memory, k, count, child, t + first)
            low, high = combine(pick, low, a), combine(pick, high, b)
            if t <= stop:
                write_node(formula, memory, k, node, t, low, high)
        low, high = read_node(formula, memory, k, count, child, min(block + 1, end) + last)
        for t in range(block + 1, stop + 1):
            a, b = read_node(formula, memory, k, count, child, t + last)
            low, high = combine(pick, low, a), combine(pick, high, b)
            a, b = read_node(formula, memory, k, count, node, t)
            write_node(formula, memory, k, node, t, combine(pick, a, low), combine(pick, b, high))
        block += width


@compiled
def update_until_node(
    formula: CompiledFormula, memory: Any, k: int, count: int, node: int, begin: int, end: int
) -> None:
    """Compute F[first,last] q and F[first,first] (p U q), the until unbounded, at the instants from begin to end.

    Equation: u(t) = min(p(t), max(q(t), u(t + 1))). What comes after a window's end does not matter (see
    ``_until`` of robustness.py), hence u may start from values not seen yet.
    """
    update_extreme_node(formula, memory, k, count, node, begin, end)
    nodes = formula.nodes
    left, right, pick = nodes[node, LEFT], nodes[node, RIGHT], nodes[node, PICK]
    first, unseen = nodes[node, FIRST], nodes[node, UNSEEN]
    low, high = formula.numbers[unseen], formula.numbers[unseen + 1]
    seen = count - min(nodes[left, EARLIEST], nodes[right, EARLIEST])
    top = min(end + nodes[node, LAST], seen)
    for j in range(top - begin - first + 1):
        t = top - j
        a, b = read_node(formula, memory, k, count, right, t)
        low, high = combine(pick, a, low), combine(pick, b, high)
        a, b = read_node(formula, memory, k, count, left, t)
        low, high = combine(1 - pick, a, low), combine(1 - pick, b, high)
        if t - first <= end:
            a, b = read_node(formula, memory, k, count, node, t - first)
            write_node(formula, memory, k, node, t - first, combine(1 - pick, a, low), combine(1 - pick, b, high))


@compiled
def update_nodes(formula: CompiledFormula, memory: Any, k: int, count: int, signals: Any) -> None:
    """Compute what is open of every node, children first."""
    nodes = formula.nodes
    for node in range(nodes.shape[0]):
        begin = max(nodes[node, START], count - nodes[node, REACH])
        end = min(nodes[node, END], count - nodes[node, EARLIEST])
        if begin <= end:
            kind = nodes[node, KIND]
            if kind == STATE_NODE:
                value = compute_state(formula, memory, k, signals, nodes[node, LEFT])
                memory[k, nodes[node, SLOT] + (count & nodes[node, MASK])] = value
            elif kind == JOIN_NODE:
                update_join(formula, memory, k, count, node, begin, end)
            elif kind == EXTREME_NODE:
                update_extreme_node(formula, memory, k, count, node, begin, end)
            else:
                update_until_node(formula, memory, k, count, node, begin, end)


@compiled
def update_open_extreme(formula: CompiledFormula, memory: Any, k: int, count: int, i: int) -> tuple[float, float]:
    """Return the interval of an eventually or always of a node: final instants are kept, open ones gathered anew."""
    root = formula.root
    pick, first, last, child = root[i, PICK], root[i, FIRST], root[i, LAST], root[i, RIGHT]
    best = memory[k, root[i, SLOT]]
    final = count - formula.nodes[child, REACH]
    seen = count - formula.nodes[child, EARLIEST]
    if first <= final <= last:
        value, _ = read_node(formula, memory, k, count, child, final)
        best = combine(pick, best, value)
        memory[k, root[i, SLOT]] = best
    low, high = best, best
    # One unseen instant stands for all.
    for t in range(max(first, final + 1), min(last, max(first, seen + 1)) + 1):
        a, b = read_node(formula, memory, k, count, child, t)
        low, high = combine(pick, low, a), combine(pick, high, b)
    return low, high


@compiled
def update_open_until(formula: CompiledFormula, memory: Any, k: int, count: int, i: int) -> tuple[float, float]:
    """Return the interval of an until between nodes: final instants are kept, open ones gathered anew."""
    root, nodes = formula.root, formula.nodes
    pick, first, last, slot = root[i, PICK], root[i, FIRST], root[i, LAST], root[i, SLOT]
    left, right = root[i, LEFT], root[i, RIGHT]
    final = count - max(nodes[left, REACH], nodes[right, REACH])
    seen = count - min(nodes[left, EARLIEST], nodes[right, EARLIEST])
    low, high, held_low, held_high = memory[k, slot], memory[k, slot], memory[k, slot + 1], memory[k, slot + 1]
    t = max(0, final)
    while t <= min(last, max(first, seen + 1)):
        a, b = read_node(formula, memory, k, count, left, t)
        held_low, held_high = combine(1 - pick, held_low, a), combine(1 - pick, held_high, b)
        if t >= first:
            a, b = read_node(formula, memory, k, count, right, t)
            low = combine(pick, low, combine(1 - pick, held_low, a))
            high = combine(pick, high, combine(1 - pick, held_high, b))
        if t == final:
            memory[k, slot] = low
            memory[k, slot + 1] = held_low
        # One unseen instant, in the interval, stands for all.
        t = first if seen <= t < first else t + 1
    return low, high

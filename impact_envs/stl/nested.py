"""Parts of a formula followed instant by instant: operators inside operators for which there is no faster way.

Those are in alternation.py and joined.py.

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
def view_node(formula: CompiledFormula, count: int, node: int) -> tuple[int, int, int, int, float, float]:
    """Return what reading and writing a node takes: last instant seen, slot, mask, stride, ends of what is unseen.

    It is read from the tables once, not at every instant: the compiler cannot know that a store leaves them alone.
    """
    nodes, numbers = formula.nodes, formula.numbers
    seen, unseen = count - nodes[node, EARLIEST], nodes[node, UNSEEN] & PLACE
    slot, mask, stride = nodes[node, SLOT] & PLACE, nodes[node, MASK] & PLACE, nodes[node, STRIDE] & PLACE
    return seen, slot, mask, stride, numbers[unseen], numbers[unseen + 1]


@inlined
def read_node(memory: Any, k: int, view: tuple[int, int, int, int, float, float], t: int) -> tuple[float, float]:
    """Return both ends of a node's value at instant t."""
    seen, slot, mask, stride, low, high = view
    if t > seen:
        return low, high
    at = slot + stride * (t & mask)
    return memory[k, at], memory[k, at + stride - 1]


@inlined
def write_node(
    memory: Any, k: int, view: tuple[int, int, int, int, float, float], t: int, low: float, high: float
) -> None:
    """Set both ends of a node's value at instant t."""
    _, slot, mask, _, _, _ = view
    at = slot + 2 * (t & mask)
    memory[k, at] = low
    memory[k, at + 1] = high


@compiled
def update_join(formula: CompiledFormula, memory: Any, k: int, count: int, node: int, begin: int, end: int) -> None:
    """Compute a conjunction or disjunction of two nodes at the instants from begin to end."""
    nodes = formula.nodes
    left, right = view_node(formula, count, nodes[node, LEFT]), view_node(formula, count, nodes[node, RIGHT])
    pick, view = nodes[node, PICK], view_node(formula, count, node)
    for t in range(begin, end + 1):
        low, high = read_node(memory, k, left, t)
        a, b = read_node(memory, k, right, t)
        write_node(memory, k, view, t, combine(pick, low, a), combine(pick, high, b))


@compiled
def update_extreme_node(
    formula: CompiledFormula, memory: Any, k: int, count: int, node: int, begin: int, end: int
) -> None:
    """Compute the extremes of a node (RIGHT) over the windows of the instants from begin to end.

    In each block of as many windows as a window is wide, a window is the end of the first one, gathered
    backward, and the start of the next block, gathered forward. Source: van Herk 1992, Gil & Werman 1993.
    """
    nodes = formula.nodes
    child, view = view_node(formula, count, nodes[node, RIGHT]), view_node(formula, count, node)
    pick, first, last = nodes[node, PICK], nodes[node, FIRST], nodes[node, LAST]
    width = last - first + 1
    block = begin
    while block <= end:
        stop = min(block + width - 1, end)
        low, high = read_node(memory, k, child, block + last)
        for j in range(width):
            t = block + width - 1 - j
            a, b = read_node(memory, k, child, t + first)
            low, high = combine(pick, low, a), combine(pick, high, b)
            if t <= stop:
                write_node(memory, k, view, t, low, high)
        low, high = read_node(memory, k, child, min(block + 1, end) + last)
        for t in range(block + 1, stop + 1):
            a, b = read_node(memory, k, child, t + last)
            low, high = combine(pick, low, a), combine(pick, high, b)
            a, b = read_node(memory, k, view, t)
            write_node(memory, k, view, t, combine(pick, a, low), combine(pick, b, high))
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
    left, right = view_node(formula, count, nodes[node, LEFT]), view_node(formula, count, nodes[node, RIGHT])
    view, pick, first = view_node(formula, count, node), nodes[node, PICK], nodes[node, FIRST]
    _, _, _, _, low, high = view
    seen = max(left[0], right[0])
    top = min(end + nodes[node, LAST], seen)
    for j in range(top - begin - first + 1):
        t = top - j
        a, b = read_node(memory, k, right, t)
        low, high = combine(pick, a, low), combine(pick, b, high)
        a, b = read_node(memory, k, left, t)
        low, high = combine(1 - pick, a, low), combine(1 - pick, b, high)
        if t - first <= end:
            a, b = read_node(memory, k, view, t - first)
            write_node(memory, k, view, t - first, combine(1 - pick, a, low), combine(1 - pick, b, high))


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
    view, final = view_node(formula, count, child), count - formula.nodes[child, REACH]
    seen = view[0]
    if first <= final <= last:
        value, _ = read_node(memory, k, view, final)
        best = combine(pick, best, value)
        memory[k, root[i, SLOT]] = best
    low, high = best, best
    # One unseen instant stands for all.
    for t in range(max(first, final + 1), min(last, max(first, seen + 1)) + 1):
        a, b = read_node(memory, k, view, t)
        low, high = combine(pick, low, a), combine(pick, high, b)
    return low, high


@compiled
def update_open_until(formula: CompiledFormula, memory: Any, k: int, count: int, i: int) -> tuple[float, float]:
    """Return the interval of an until between nodes: final instants are kept, open ones gathered anew."""
    root, nodes = formula.root, formula.nodes
    pick, first, last, slot = root[i, PICK], root[i, FIRST], root[i, LAST], root[i, SLOT]
    final = count - max(nodes[root[i, LEFT], REACH], nodes[root[i, RIGHT], REACH])
    left, right = view_node(formula, count, root[i, LEFT]), view_node(formula, count, root[i, RIGHT])
    seen = max(left[0], right[0])
    low, high, held_low, held_high = memory[k, slot], memory[k, slot], memory[k, slot + 1], memory[k, slot + 1]
    t = max(0, final)
    while t <= min(last, max(first, seen + 1)):
        a, b = read_node(memory, k, left, t)
        held_low, held_high = combine(1 - pick, held_low, a), combine(1 - pick, held_high, b)
        if t >= first:
            a, b = read_node(memory, k, right, t)
            low = combine(pick, low, combine(1 - pick, held_low, a))
            high = combine(pick, high, combine(1 - pick, held_high, b))
        if t == final:
            memory[k, slot] = low
            memory[k, slot + 1] = held_low
        # One unseen instant, in the interval, stands for all.
        t = first if seen <= t < first else t + 1
    return low, high

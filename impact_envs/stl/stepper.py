"""The online monitor for one world of many: scalar functions over the flat arrays of a ``Program``.

The same floating-point operations in the same order as margin.py and rosi.py, so that the intervals equal those
of ``Monitor`` to the last bit (of operators inside operators but for the sign of a zero, which numpy leaves open).
No allocation, no recursion: the same source compiles for CPU and GPU (there without fused multiply-add) and runs
uncompiled.

A node is a part of a formula inside a temporal operator inside which there is another one. After sample
``count`` its value at instant t is what the bounds alone allow for t > count - EARLIEST, final for t <= count -
REACH, and open in between. Only the open ones are computed anew; a ring of the node holds them, instant t at t
& MASK, STRIDE numbers each: lower and upper end, or a single number where they are the same.

Source: Deshmukh et al. 2017 (see monitor.py).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from numba import njit

if TYPE_CHECKING:
    from impact_envs.stl.program import Program

# Nothing is allocated and only numbers are returned: counting references to the arrays would take most of the time.
OPTIONS: dict[str, Any] = {"cache": True, "_nrt": False}
scalar = njit(**OPTIONS)
inlined = njit(**OPTIONS, forceinline=True)

# Masks a place in an array, which changes nothing, but tells the compiler that it is not counted from the end.
PLACE = 0x7FFFFFFF
# How a value joins the one so far: the least, the greatest, or in its place.
MIN, MAX, SET = range(3)
# Steps of a Boolean combination that are no leaves, of ``Program.code`` and ``Program.root``.
PUSH, POP = range(2)
# Kinds of a predicate.
AREA, LINEAR, DISTANCE, SPEED = range(2, 6)
# Kinds of a temporal operator at the root; an open one has temporal operators inside.
EXTREME, UNTIL, OPEN_EXTREME, OPEN_UNTIL = range(2, 6)
# Kinds of a node.
STATE_NODE, JOIN_NODE, EXTREME_NODE, UNTIL_NODE = range(4)
# Columns of all tables, those of ``Program.code``, and those of ``Program.root`` (to UNSEEN) and ``Program.nodes``.
KIND, HOW = range(2)
COLUMN, NUMBER, COUNT = range(2, 5)
PICK, FIRST, LAST, LEFT, RIGHT, SLOT, UNSEEN, EARLIEST, REACH, START, END, MASK, STRIDE = range(2, 15)


@inlined
def combine(how: int, a: float, b: float) -> float:
    """Return the least or the greatest of two numbers, the first of equals as Python does, or the second."""
    if how == MIN:
        return b if b < a else a
    if how == MAX:
        return b if b > a else a
    return b


@inlined
def compute_margin(program: Program, signals: Any, k: int, i: int) -> float:
    """Return mu of the predicate at step i of the code (see margin.py)."""
    columns, numbers = program.columns, program.numbers
    kind, c, n = program.code[i, KIND], program.code[i, COLUMN] & PLACE, program.code[i, NUMBER] & PLACE
    sign = numbers[n]
    if kind == AREA:
        x, y = signals[k, columns[c] & PLACE], signals[k, columns[c + 1] & PLACE]
        least = math.inf
        for face in range(program.code[i, COUNT]):
            f = n + 1 + 3 * face
            slack = numbers[f] - numbers[f + 1] * x - numbers[f + 2] * y
            if slack < least:
                least = slack
        return sign * least
    bound = numbers[n + 1]
    if kind == LINEAR:
        rest = bound
        for term in range(program.code[i, COUNT]):
            rest = rest - numbers[n + 2 + term] * signals[k, columns[c + term] & PLACE]
        return sign * rest
    x, y = signals[k, columns[c] & PLACE], signals[k, columns[c + 1] & PLACE]
    if kind == DISTANCE:
        x, y = x - signals[k, columns[c + 2] & PLACE], y - signals[k, columns[c + 3] & PLACE]
    return sign * (bound - math.sqrt(x * x + y * y))


@inlined
def compute_state(program: Program, memory: Any, k: int, signals: Any, state: int) -> float:
    """Return the robustness of a formula without temporal operators at the present sample."""
    value = 0.0
    for i in range(program.starts[state] & PLACE, program.starts[state + 1] & PLACE):
        kind = program.code[i, KIND]
        if kind == PUSH:
            memory[k, program.code[i, NUMBER]] = value
        else:
            if kind == POP:
                second = value
                value = memory[k, program.code[i, NUMBER]]
            else:
                second = compute_margin(program, signals, k, i)
            value = combine(program.code[i, HOW], value, second)
    return value


@inlined
def read_node(program: Program, memory: Any, k: int, count: int, node: int, t: int) -> tuple[float, float]:
    """Return both ends of a node's value at instant t."""
    nodes = program.nodes
    if t > count - nodes[node, EARLIEST]:
        unseen = nodes[node, UNSEEN]
        return program.numbers[unseen], program.numbers[unseen + 1]
    stride = nodes[node, STRIDE]
    at = (nodes[node, SLOT] & PLACE) + stride * (t & nodes[node, MASK])
    return memory[k, at], memory[k, at + stride - 1]


@inlined
def write_node(program: Program, memory: Any, k: int, node: int, t: int, low: float, high: float) -> None:
    """Set both ends of a node's value at instant t."""
    at = program.nodes[node, SLOT] + 2 * (t & program.nodes[node, MASK])
    memory[k, at] = low
    memory[k, at + 1] = high


@scalar
def update_join(program: Program, memory: Any, k: int, count: int, node: int, begin: int, end: int) -> None:
    """Compute a conjunction or disjunction of two nodes at the instants from begin to end."""
    left, right = program.nodes[node, LEFT], program.nodes[node, RIGHT]
    pick = program.nodes[node, PICK]
    for t in range(begin, end + 1):
        low, high = read_node(program, memory, k, count, left, t)
        a, b = read_node(program, memory, k, count, right, t)
        write_node(program, memory, k, node, t, combine(pick, low, a), combine(pick, high, b))


@scalar
def update_extreme_node(program: Program, memory: Any, k: int, count: int, node: int, begin: int, end: int) -> None:
    """Compute the extremes of a node (RIGHT) over the windows of the instants from begin to end.

    In each block of as many windows as a window is wide, a window is the end of the first one, gathered
    backward, and the start of the next block, gathered forward. Source: van Herk 1992, Gil & Werman 1993.
    """
    child, pick = program.nodes[node, RIGHT], program.nodes[node, PICK]
    first, last = program.nodes[node, FIRST], program.nodes[node, LAST]
    width = last - first + 1
    block = begin
    while block <= end:
        stop = min(block + width - 1, end)
        low, high = read_node(program, memory, k, count, child, block + last)
        for j in range(width):
            t = block + width - 1 - j
            a, b = read_node(program, memory, k, count, child, t + first)
            low, high = combine(pick, low, a), combine(pick, high, b)
            if t <= stop:
                write_node(program, memory, k, node, t, low, high)
        low, high = read_node(program, memory, k, count, child, min(block + 1, end) + last)
        for t in range(block + 1, stop + 1):
            a, b = read_node(program, memory, k, count, child, t + last)
            low, high = combine(pick, low, a), combine(pick, high, b)
            a, b = read_node(program, memory, k, count, node, t)
            write_node(program, memory, k, node, t, combine(pick, a, low), combine(pick, b, high))
        block += width


@scalar
def update_until_node(program: Program, memory: Any, k: int, count: int, node: int, begin: int, end: int) -> None:
    """Compute F[first,last] q and F[first,first] (p U q), the until unbounded, at the instants from begin to end.

    Equation: u(t) = min(p(t), max(q(t), u(t + 1))). What comes after a window's end does not matter (see
    ``_until`` of robustness.py), hence u may start from values not seen yet.
    """
    update_extreme_node(program, memory, k, count, node, begin, end)
    nodes = program.nodes
    left, right, pick = nodes[node, LEFT], nodes[node, RIGHT], nodes[node, PICK]
    first, unseen = nodes[node, FIRST], nodes[node, UNSEEN]
    low, high = program.numbers[unseen], program.numbers[unseen + 1]
    seen = count - min(nodes[left, EARLIEST], nodes[right, EARLIEST])
    top = min(end + nodes[node, LAST], seen)
    for j in range(top - begin - first + 1):
        t = top - j
        a, b = read_node(program, memory, k, count, right, t)
        low, high = combine(pick, a, low), combine(pick, b, high)
        a, b = read_node(program, memory, k, count, left, t)
        low, high = combine(1 - pick, a, low), combine(1 - pick, b, high)
        if t - first <= end:
            a, b = read_node(program, memory, k, count, node, t - first)
            write_node(program, memory, k, node, t - first, combine(1 - pick, a, low), combine(1 - pick, b, high))


@scalar
def update_nodes(program: Program, memory: Any, k: int, count: int, signals: Any) -> None:
    """Compute what is open of every node, children first."""
    nodes = program.nodes
    for node in range(nodes.shape[0]):
        begin = max(nodes[node, START], count - nodes[node, REACH])
        end = min(nodes[node, END], count - nodes[node, EARLIEST])
        if begin <= end:
            kind = nodes[node, KIND]
            if kind == STATE_NODE:
                value = compute_state(program, memory, k, signals, nodes[node, LEFT])
                memory[k, nodes[node, SLOT] + (count & nodes[node, MASK])] = value
            elif kind == JOIN_NODE:
                update_join(program, memory, k, count, node, begin, end)
            elif kind == EXTREME_NODE:
                update_extreme_node(program, memory, k, count, node, begin, end)
            else:
                update_until_node(program, memory, k, count, node, begin, end)


@inlined
def update_extreme(program: Program, memory: Any, k: int, count: int, signals: Any, i: int) -> tuple[float, float]:
    """Return the interval of an eventually or always: the extreme so far, and what samples to come can make of it."""
    root = program.root
    pick, last, slot, unseen = root[i, PICK], root[i, LAST], root[i, SLOT] & PLACE, root[i, UNSEEN] & PLACE
    best = memory[k, slot]
    if root[i, FIRST] <= count <= last:
        best = combine(pick, best, compute_state(program, memory, k, signals, root[i, RIGHT]))
        memory[k, slot] = best
    if count >= last:
        return best, best
    return combine(pick, best, program.numbers[unseen]), combine(pick, best, program.numbers[unseen + 1])


@inlined
def update_until(program: Program, memory: Any, k: int, count: int, signals: Any, i: int) -> tuple[float, float]:
    """Return the interval of an until: ``held`` is the least of the left side, ``best`` the best completion so far."""
    root = program.root
    pick, last, slot, unseen = root[i, PICK], root[i, LAST], root[i, SLOT] & PLACE, root[i, UNSEEN] & PLACE
    best, held = memory[k, slot], memory[k, slot + 1]
    if count <= last:
        held = combine(1 - pick, held, compute_state(program, memory, k, signals, root[i, LEFT]))
        memory[k, slot + 1] = held
        if count >= root[i, FIRST]:
            right = compute_state(program, memory, k, signals, root[i, RIGHT])
            best = combine(pick, best, combine(1 - pick, held, right))
            memory[k, slot] = best
    if count >= last:
        return best, best
    low, high = program.numbers[unseen], program.numbers[unseen + 1]
    return combine(pick, best, combine(1 - pick, held, low)), combine(pick, best, combine(1 - pick, held, high))


@scalar
def update_open_extreme(program: Program, memory: Any, k: int, count: int, i: int) -> tuple[float, float]:
    """Return the interval of an eventually or always of a node: final instants are kept, open ones gathered anew."""
    root = program.root
    pick, first, last, child = root[i, PICK], root[i, FIRST], root[i, LAST], root[i, RIGHT]
    best = memory[k, root[i, SLOT]]
    final = count - program.nodes[child, REACH]
    seen = count - program.nodes[child, EARLIEST]
    if first <= final <= last:
        value, _ = read_node(program, memory, k, count, child, final)
        best = combine(pick, best, value)
        memory[k, root[i, SLOT]] = best
    low, high = best, best
    # One unseen instant stands for all.
    for t in range(max(first, final + 1), min(last, max(first, seen + 1)) + 1):
        a, b = read_node(program, memory, k, count, child, t)
        low, high = combine(pick, low, a), combine(pick, high, b)
    return low, high


@scalar
def update_open_until(program: Program, memory: Any, k: int, count: int, i: int) -> tuple[float, float]:
    """Return the interval of an until between nodes: final instants are kept, open ones gathered anew."""
    root, nodes = program.root, program.nodes
    pick, first, last, slot = root[i, PICK], root[i, FIRST], root[i, LAST], root[i, SLOT]
    left, right = root[i, LEFT], root[i, RIGHT]
    final = count - max(nodes[left, REACH], nodes[right, REACH])
    seen = count - min(nodes[left, EARLIEST], nodes[right, EARLIEST])
    low, high, held_low, held_high = memory[k, slot], memory[k, slot], memory[k, slot + 1], memory[k, slot + 1]
    t = max(0, final)
    while t <= min(last, max(first, seen + 1)):
        a, b = read_node(program, memory, k, count, left, t)
        held_low, held_high = combine(1 - pick, held_low, a), combine(1 - pick, held_high, b)
        if t >= first:
            a, b = read_node(program, memory, k, count, right, t)
            low = combine(pick, low, combine(1 - pick, held_low, a))
            high = combine(pick, high, combine(1 - pick, held_high, b))
        if t == final:
            memory[k, slot] = low
            memory[k, slot + 1] = held_low
        # One unseen instant, in the interval, stands for all.
        t = first if seen <= t < first else t + 1
    return low, high


@scalar
def start_monitor(program: Program, memory: Any, k: int) -> None:
    """Forget all samples of world k.

    Args:
        program: from ``make_program``.
        memory: of all worlds, shape (worlds, ``memory_size(program)``).
        k: the world.
    """
    root = program.root
    for i in range(root.shape[0]):
        if root[i, KIND] != PUSH and root[i, KIND] != POP:
            worst = -math.inf if root[i, PICK] == MAX else math.inf
            memory[k, root[i, SLOT]] = worst
            if root[i, KIND] == UNTIL or root[i, KIND] == OPEN_UNTIL:
                memory[k, root[i, SLOT] + 1] = -worst


@inlined
def update_monitor(program: Program, memory: Any, k: int, count: int, signals: Any) -> tuple[float, float]:
    """Take the next sample of world k; samples after the last one the formula looks at change nothing.

    Args:
        program: from ``make_program``.
        memory: of all worlds, shape (worlds, ``memory_size(program)``); written.
        k: the world.
        count: samples taken since ``start_monitor``: 0 at time 0, then one more at every call.
        signals: the sample of all worlds, in the order given to ``make_program``, finite, shape (worlds,
            signals).

    Returns:
        Lower and upper end of the robustness still possible.
    """
    if program.nodes.shape[0] > 0:
        update_nodes(program, memory, k, count, signals)
    root = program.root
    low = high = 0.0
    for i in range(root.shape[0]):
        kind, slot = root[i, KIND], root[i, SLOT]
        if kind == PUSH:
            memory[k, slot] = low
            memory[k, slot + 1] = high
        else:
            if kind == EXTREME:
                a, b = update_extreme(program, memory, k, count, signals, i)
            elif kind == UNTIL:
                a, b = update_until(program, memory, k, count, signals, i)
            elif kind == OPEN_EXTREME:
                a, b = update_open_extreme(program, memory, k, count, i)
            elif kind == OPEN_UNTIL:
                a, b = update_open_until(program, memory, k, count, i)
            else:
                a, b = low, high
                low, high = memory[k, slot], memory[k, slot + 1]
            low, high = combine(root[i, HOW], low, a), combine(root[i, HOW], high, b)
    return low, high

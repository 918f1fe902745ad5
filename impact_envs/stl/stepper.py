"""The online monitor for one world of many: compiled scalar functions over the flat arrays of a formula.

The intervals are those of the recursion in tests/impact_envs/stl/oracle.py to the last bit (of operators inside
operators but for the sign of a zero, which numpy leaves open). Here are the operators over formulas without temporal
operators; alternation.py, joined.py and nested.py have those over others.

Source: Deshmukh et al. 2017 (see monitor.py).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from impact_envs.compiled import compiled, inlined
from impact_envs.stl.alternation import start_alternation, update_threefold, update_twofold
from impact_envs.stl.compiled_formula import (
    CONJUNCT,
    EXTREME,
    FIRST,
    HOW,
    JOINED,
    KIND,
    LAST,
    LEFT,
    OPEN_EXTREME,
    OPEN_UNTIL,
    PICK,
    POP,
    PUSH,
    RIGHT,
    SLOT,
    THREEFOLD,
    TWOFOLD,
    UNSEEN,
    UNTIL,
    CompiledFormula,
)
from impact_envs.stl.joined import start_joined, update_joined
from impact_envs.stl.nested import update_nodes, update_open_extreme, update_open_until
from impact_envs.stl.sliding import worst
from impact_envs.stl.state import PLACE, combine, compute_state
from impact_envs.stl.verdict import settle_tie


@inlined
def update_extreme(
    formula: CompiledFormula, memory: Any, k: int, count: int, signals: Any, i: int
) -> tuple[float, float]:
    """Return the interval of an eventually or always: the extreme so far, and what samples to come can make of it."""
    root = formula.root
    pick, last, slot, unseen = root[i, PICK], root[i, LAST], root[i, SLOT] & PLACE, root[i, UNSEEN] & PLACE
    best = memory[k, slot]
    if root[i, FIRST] <= count <= last:
        best = combine(pick, best, compute_state(formula, memory, k, signals, root[i, RIGHT]))
        memory[k, slot] = best
    if count >= last:
        return best, best
    return combine(pick, best, formula.numbers[unseen]), combine(pick, best, formula.numbers[unseen + 1])


@inlined
def update_until(
    formula: CompiledFormula, memory: Any, k: int, count: int, signals: Any, i: int
) -> tuple[float, float]:
    """Return the interval of an until: ``held`` is the least of the left side, ``best`` the best completion so far."""
    root = formula.root
    pick, last, slot, unseen = root[i, PICK], root[i, LAST], root[i, SLOT] & PLACE, root[i, UNSEEN] & PLACE
    best, held = memory[k, slot], memory[k, slot + 1]
    if count <= last:
        held = combine(1 - pick, held, compute_state(formula, memory, k, signals, root[i, LEFT]))
        memory[k, slot + 1] = held
        if count >= root[i, FIRST]:
            right = compute_state(formula, memory, k, signals, root[i, RIGHT])
            best = combine(pick, best, combine(1 - pick, held, right))
            memory[k, slot] = best
    if count >= last:
        return best, best
    low, high = formula.numbers[unseen], formula.numbers[unseen + 1]
    return combine(pick, best, combine(1 - pick, held, low)), combine(pick, best, combine(1 - pick, held, high))


@compiled
def start_monitor(formula: CompiledFormula, memory: Any, k: int) -> None:
    """Forget all samples of world k.

    Args:
        formula: from ``compile_formula``.
        memory: of all worlds, shape (worlds, ``formula.size``).
        k: the world.
    """
    root = formula.root
    for i in range(root.shape[0]):
        kind = root[i, KIND]
        if kind in (TWOFOLD, THREEFOLD):
            start_alternation(formula, memory, k, i)
        elif kind == JOINED:
            start_joined(formula, memory, k, i)
        elif kind not in (PUSH, POP):
            memory[k, root[i, SLOT]] = worst(root[i, PICK])
            if kind in (UNTIL, OPEN_UNTIL):
                memory[k, root[i, SLOT] + 1] = worst(1 - root[i, PICK])


@inlined
def update_monitor(formula: CompiledFormula, memory: Any, k: int, count: int, signals: Any) -> tuple[float, float]:
    """Take the next sample of world k; samples after the last one the formula looks at change nothing.

    Args:
        formula: from ``compile_formula``.
        memory: of all worlds, shape (worlds, ``formula.size``); written.
        k: the world.
        count: samples taken since ``start_monitor``: 0 at time 0, then one more at every call.
        signals: the sample of all worlds, in the order given to ``compile_formula``, finite, shape (worlds,
            signals).

    Returns:
        Lower and upper end of the robustness still possible, ties marked (see ``verdict.py``).
    """
    if formula.nodes.shape[0] > 0:
        update_nodes(formula, memory, k, count, signals)
    root = formula.root
    low = high = 0.0
    part = 0  # its interval stands there
    for i in range(root.shape[0]):
        kind, slot = root[i, KIND], root[i, SLOT]
        if kind == PUSH:
            memory[k, slot] = low
            memory[k, slot + 1] = high
        else:
            if kind == EXTREME:
                a, b = update_extreme(formula, memory, k, count, signals, i)
            elif kind == UNTIL:
                a, b = update_until(formula, memory, k, count, signals, i)
            elif kind == TWOFOLD:
                a, b = update_twofold(formula, memory, k, count, signals, i)
            elif kind == THREEFOLD:
                a, b = update_threefold(formula, memory, k, count, signals, i)
            elif kind == JOINED:
                a, b = update_joined(formula, memory, k, count, signals, i)
            elif kind == OPEN_EXTREME:
                a, b = update_open_extreme(formula, memory, k, count, i)
            elif kind == OPEN_UNTIL:
                a, b = update_open_until(formula, memory, k, count, i)
            else:
                a, b = low, high
                low, high = memory[k, slot], memory[k, slot + 1]
            if kind != POP:
                memory[k, part], memory[k, part + 1] = a, b
                part += 2
            low, high = combine(root[i, HOW], low, a), combine(root[i, HOW], high, b)
    return low, high


@compiled
def read_conjuncts(formula: CompiledFormula, memory: Any, k: int, conjuncts: Any) -> None:
    """Write the intervals of robustness still possible of the formula's conjuncts, as the last sample left them.

    Args:
        formula: from ``compile_formula``.
        memory: of all worlds, shape (worlds, ``formula.size``).
        k: the world.
        conjuncts: takes lower and upper end of each, shape (worlds, 2 conjuncts).
    """
    root = formula.root
    low = high = math.inf
    part = 0
    for i in range(root.shape[0]):
        kind, slot, place = root[i, KIND], root[i, SLOT] & PLACE, 2 * root[i, CONJUNCT]
        if i > 0 and root[i - 1, CONJUNCT] != root[i, CONJUNCT]:
            low = high = math.inf  # what the least starts from
        if kind == PUSH:
            memory[k, slot], memory[k, slot + 1] = low, high
        else:
            if kind == POP:
                a, b = low, high
                low, high = memory[k, slot], memory[k, slot + 1]
            else:
                a, b = memory[k, part], memory[k, part + 1]
                part += 2
            low, high = combine(root[i, HOW], low, a), combine(root[i, HOW], high, b)
        conjuncts[k, place], conjuncts[k, place + 1] = settle_tie(low), settle_tie(high)


@compiled
def update_world(
    root: np.ndarray,
    nodes: np.ndarray,
    starts: np.ndarray,
    code: np.ndarray,
    columns: np.ndarray,
    numbers: np.ndarray,
    size: int,
    memory: np.ndarray,
    count: int,
    sample: np.ndarray,
    conjuncts: np.ndarray,
) -> tuple[tuple[float, float], tuple[float, float]]:
    """``update_monitor`` of a single world, for Python, which hands over arrays faster than a NamedTuple of them.

    Args:
        conjuncts: takes what ``read_conjuncts`` writes, shape (1, 2 conjuncts).

    Returns:
        Lower and upper end, and both again with ties marked.
    """
    formula = CompiledFormula(root, nodes, starts, code, columns, numbers, size)
    low, high = update_monitor(formula, memory, 0, count, sample)
    read_conjuncts(formula, memory, 0, conjuncts)
    return (settle_tie(low), settle_tie(high)), (low, high)

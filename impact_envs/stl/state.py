"""Robustness of formulas without temporal operators, in one world of many: compiled scalar functions.

The same floating-point operations in the same order as margin.py. No allocation, no recursion: the same source
compiles for CPU and GPU (there without fused multiply-add) and runs uncompiled.
"""

from __future__ import annotations

import math
from typing import Any

from impact_envs.compiled import inlined
from impact_envs.stl.compiled_formula import COLUMN, COUNT, HOW, KIND, MAX, MIN, NUMBER, POP, PUSH, CompiledFormula
from impact_envs.stl.margin import AREA, LINEAR

# Masks a place in an array, which changes nothing, but tells the compiler that it is not counted from the end.
PLACE = 0x7FFFFFFF


@inlined
def combine(how: int, a: float, b: float) -> float:
    """Return the least or the greatest of two numbers, the first of equals as Python does, or the second."""
    if how == MIN:
        return b if b < a else a
    if how == MAX:
        return b if b > a else a
    return b


@inlined
def compute_margin(formula: CompiledFormula, signals: Any, k: int, i: int) -> float:
    """Return mu of the predicate at step i of the code (see margin.py)."""
    columns, numbers = formula.columns, formula.numbers
    kind, c, n = formula.code[i, KIND], formula.code[i, COLUMN] & PLACE, (formula.code[i, NUMBER] & PLACE) + 1
    count = formula.code[i, COUNT]
    sign = numbers[n]
    if kind == AREA:
        x, y = signals[k, columns[c] & PLACE], signals[k, columns[c + 1] & PLACE]
        least = math.inf
        for face in range(count):
            f = n + 1 + 3 * face
            slack = numbers[f] - numbers[f + 1] * x - numbers[f + 2] * y
            if slack < least:
                least = slack
        return sign * least
    bound = numbers[n + 1]
    if kind == LINEAR:
        rest = bound
        for term in range(count):
            rest = rest - numbers[n + 2 + term] * signals[k, columns[c + term] & PLACE]
        return sign * rest
    x, y = signals[k, columns[c] & PLACE], signals[k, columns[c + 1] & PLACE]  # a norm
    if count == 4:
        x, y = x - signals[k, columns[c + 2] & PLACE], y - signals[k, columns[c + 3] & PLACE]
    return sign * (bound - math.sqrt(x * x + y * y))


@inlined
def compute_state(formula: CompiledFormula, memory: Any, k: int, signals: Any, state: int) -> float:
    """Return the robustness of a formula without temporal operators at the present sample, ties marked."""
    value = 0.0
    for i in range(formula.starts[state] & PLACE, formula.starts[state + 1] & PLACE):
        kind = formula.code[i, KIND]
        if kind == PUSH:
            memory[k, formula.code[i, NUMBER]] = value
        else:
            if kind == POP:
                second = value
                value = memory[k, formula.code[i, NUMBER]]
            else:
                second = compute_margin(formula, signals, k, i)
                if second == 0.0:
                    second = formula.numbers[formula.code[i, NUMBER] & PLACE]
            value = combine(formula.code[i, HOW], value, second)
    return value

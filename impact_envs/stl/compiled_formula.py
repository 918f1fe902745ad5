"""A formula as flat arrays: what compiler.py makes, and what the compiled functions read."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class CompiledFormula(NamedTuple):
    """A formula as arrays of which every row is a step; the columns are named below.

    Attributes:
        root: Boolean combination of temporal operators, int32.
        nodes: parts of the formula inside temporal operators that are followed instant by instant, children first,
            int32.
        starts: first row in ``code`` of each formula without temporal operators, and the end, int32.
        code: Boolean combinations of predicates, int32.
        columns: of the sample, as the predicates read them, int32.
        numbers: of the predicates, what stands for a margin of zero and the coefficients; ends of ranges; float64.
        size: how many numbers a world's memory holds.
    """

    root: np.ndarray
    nodes: np.ndarray
    starts: np.ndarray
    code: np.ndarray
    columns: np.ndarray
    numbers: np.ndarray
    size: int


# How a value joins the one so far: the least, the greatest, or in its place.
MIN, MAX, SET = range(3)
# Steps of ``code`` and ``root`` that open and close a bracket; all others are predicates (margin.py) or operators.
PUSH, POP = -1, -2

# Operators of ``root``. Over formulas without temporal operators:
EXTREME = 1  # eventually or always
UNTIL = 2
# an alternation of eventually and always over such a formula:
TWOFOLD = 3  # such as always eventually
THREEFOLD = 4  # such as always eventually always
# an operator of such a formula and one about one operator joined with such formulas:
JOINED = 5
# and over any formulas, which are nodes:
OPEN_EXTREME = 6
OPEN_UNTIL = 7

# Kinds of a node: without temporal operators, a conjunction or disjunction of two nodes, and operators over nodes.
STATE_NODE, JOIN_NODE, EXTREME_NODE, UNTIL_NODE = range(4)

# Columns of all tables; those of ``code``; those of ``root`` and ``nodes``; then those of one of them only.
KIND, HOW = range(2)
COLUMN, NUMBER, COUNT = range(2, 5)
PICK, FIRST, LAST, LEFT, RIGHT, SLOT, UNSEEN = range(2, 9)
FIRST_2, LAST_2, FIRST_3, LAST_3 = range(9, 13)  # of ``root``: the operators inside an alternation or join
PICK_2, LEFT_2, LOWER, UPPER, ENDS = range(13, 18)  # of ``root``: the operator inside a join, and what clamps it
CONJUNCT = 18  # of ``root``: which of the formula's conjuncts the row belongs to
EARLIEST, REACH, START, END, MASK, STRIDE = range(9, 15)  # of ``nodes``

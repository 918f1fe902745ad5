"""The quadratic program that optimises the rest of a plan: its variables, and how its rows are written; compiled.

Of m impacts the variables are t_1..t_m, P_2..P_{m+1}, rho, in this order: the first place lies on the object's flight,
and the time of the last knot is given.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from impact_envs.compiled import compiled

MOST_KNOTS = 8  # impacts of an object that are optimised at once; further ones keep their times
SIZE = 3 * MOST_KNOTS + 1  # of the variables
ROWS = 320

# The object's flight to its next impact.
LINE = np.dtype(
    [
        ("position", float, 2),  # at time 0 [m]
        ("velocity", float, 2),  # [m/s]
        ("end", float),  # time of the last knot of the chain [s]
    ]
)


class RestQP(NamedTuple):
    """Where T threads optimise the rest of a plan.

    Attributes:
        chain: knots of an object that are left, shape (T, 9).
        line: LINE, shape (T,).
        centre, scale, point: of the cost's squares, and the point from the centre in units of the scale,
            shape (T, 25).
        rows, bounds: of that point, shapes (T, 320, 25), (T, 320).
        used: number of rows, shape (T,).
        scratch: of the projection, shape (T, 29, 26).
    """

    chain: np.ndarray
    line: np.ndarray
    centre: np.ndarray
    scale: np.ndarray
    point: np.ndarray
    rows: np.ndarray
    bounds: np.ndarray
    used: np.ndarray
    scratch: np.ndarray


class Rest(NamedTuple):
    """One thread's part of a RestQP, with m impacts to come.

    Attributes:
        stages: m.
        chain, centre, scale, rows, bounds: see `RestQP`, without the axis of threads.
        line: a LINE.
        used: number of rows, shape (1,).
    """

    stages: int
    chain: np.ndarray
    line: np.record
    centre: np.ndarray
    scale: np.ndarray
    rows: np.ndarray
    bounds: np.ndarray
    used: np.ndarray


def make_rest_qp(threads: int = 1) -> RestQP:
    """Make room for threads to optimise in."""
    T, n = threads, SIZE
    return RestQP(
        chain=np.zeros((T, MOST_KNOTS + 1), np.int64),
        line=np.zeros(T, LINE),
        centre=np.zeros((T, n)),
        scale=np.zeros((T, n)),
        point=np.zeros((T, n)),
        rows=np.zeros((T, ROWS, n)),
        bounds=np.zeros((T, ROWS)),
        used=np.zeros(T, np.int64),
        scratch=np.zeros((T, n + 4, n + 1)),
    )


@compiled
def open_row(rest: Rest, bound: float) -> int:
    """Start a row 0 <= bound; return its number, the last one if there is no room."""
    row = min(rest.used[0], len(rest.rows) - 1)
    for i in range(3 * rest.stages + 1):
        rest.rows[row, i] = 0.0
    rest.bounds[row], rest.used[0] = bound, row + 1
    return row


@compiled
def put_variable(rest: Rest, row: int, v: int, factor: float) -> None:
    """Add factor times a variable to the left side of a row."""
    rest.rows[row, v] += factor * rest.scale[v]
    rest.bounds[row] -= factor * rest.centre[v]


@compiled
def put_time(rest: Rest, row: int, i: int, factor: float) -> None:
    """Add factor times the time of a stage."""
    if i < rest.stages:
        put_variable(rest, row, i, factor)
    else:
        rest.bounds[row] -= factor * rest.line.end


@compiled
def put_place(rest: Rest, row: int, i: int, x: float, y: float) -> None:
    """Add the scalar product of (x, y) with the place of a stage."""
    if i == 0:
        line = rest.line
        put_variable(rest, row, 0, x * line.velocity[0] + y * line.velocity[1])
        rest.bounds[row] -= x * line.position[0] + y * line.position[1]
    else:
        put_variable(rest, row, rest.stages + 2 * (i - 1), x)
        put_variable(rest, row, rest.stages + 2 * (i - 1) + 1, y)

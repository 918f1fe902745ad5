"""Project a point onto a polyhedron by a dual active-set method, or report that it is empty; small, dense, compiled."""

from __future__ import annotations

import math

import numpy as np

from impact_envs.compiled import compiled

TOLERANCE = 1e-9  # of rows
PARALLEL = 1e-10  # part of a row outside the space of the active ones, relative, below which it is in it
STEPS = 200
FOUND, EMPTY, OUT_OF_STEPS = range(3)


@compiled
def project_point(rows: np.ndarray, bounds: np.ndarray, count: int, x: np.ndarray, scratch: np.ndarray) -> int:
    """Move x to the nearest point with rows x <= bounds, min |x - x_0|^2 / 2, in place.

    From x_0 on make the most violated row active, step by step, while multipliers u >= 0 of the active rows keep
    x = x_0 - sum_j u_j a_j; drop an active row when its multiplier reaches zero.

    Args:
        rows: a_j, shape (>= m, n).
        bounds: shape (>= m,).
        count: m.
        x: shape (n,).
        scratch: shape (>= n + 4, >= n + 1).

    Returns:
        FOUND; EMPTY: no point satisfies the rows; OUT_OF_STEPS.

    Source: Goldfarb & Idnani, A numerically stable dual method for solving strictly convex quadratic programs, 1983,
        for the identity as Hessian.
    """
    n = len(x)
    L, r, z, u, active = scratch, scratch[n], scratch[n + 1], scratch[n + 2], scratch[n + 3]
    held = 0
    for _ in range(STEPS):
        p, worst = -1, TOLERANCE
        for j in range(count):
            over = -bounds[j]
            for i in range(n):
                over += rows[j, i] * x[i]
            if over > worst:
                p, worst = j, over
        if p < 0:
            return FOUND
        multiplier = 0.0
        for _ in range(STEPS):
            length = _decompose(rows, active, held, p, L, r, z)
            size = 0.0
            for i in range(n):
                size += rows[p, i] * rows[p, i]
            full = worst / length if length > PARALLEL * size else math.inf
            step, leaving = full, -1
            for j in range(held):
                if r[j] > 0.0 and u[j] < step * r[j]:
                    step, leaving = u[j] / r[j], j
            if step == math.inf:
                return EMPTY
            for j in range(held):
                u[j] -= step * r[j]
            multiplier += step
            if full < math.inf:
                for i in range(n):
                    x[i] -= step * z[i]
                worst -= step * length
            if leaving < 0:
                active[held], u[held] = p, multiplier
                held += 1
                break
            for j in range(leaving, held - 1):
                active[j], u[j] = active[j + 1], u[j + 1]
            held -= 1
    return OUT_OF_STEPS


@compiled
def _decompose(
    rows: np.ndarray, active: np.ndarray, held: int, p: int, L: np.ndarray, r: np.ndarray, z: np.ndarray
) -> float:
    """Split row p into sum_j r_j a_j over the active rows and z, at right angles to them; return |z|^2."""
    n = rows.shape[1]
    for a in range(held):
        for b in range(a + 1):
            total = 0.0
            for i in range(n):
                total += rows[int(active[a]), i] * rows[int(active[b]), i]
            for i in range(b):
                total -= L[a, i] * L[b, i]
            L[a, b] = math.sqrt(max(total, 1e-300)) if a == b else total / L[b, b]
    for a in range(held):
        total = 0.0
        for i in range(n):
            total += rows[int(active[a]), i] * rows[p, i]
        for i in range(a):
            total -= L[a, i] * r[i]
        r[a] = total / L[a, a]
    for a in range(held - 1, -1, -1):
        for i in range(a + 1, held):
            r[a] -= L[i, a] * r[i]
        r[a] /= L[a, a]
    length = 0.0
    for i in range(n):
        z[i] = rows[p, i]
        for j in range(held):
            z[i] -= r[j] * rows[int(active[j]), i]
        length += z[i] * z[i]
    return length

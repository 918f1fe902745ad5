"""Box-constrained strictly convex QP by projected Newton: small, dense in two blocks, always feasible, compiled.

Inner loops run along rows and over sums that do not wait for each other: so they fill vector registers, and every sum
still adds in the order of its index.
"""

from __future__ import annotations

import math

import numpy as np

from impact_envs.compiled import compiled, inlined

NEWTON_STEPS = 30  # 13 were the most in 2000 wild starts of the tracking problem
HALVINGS = 20
TOLERANCE = 1e-9  # of the gradient over the free variables
NOT_SOLVED = -1
VECTORS = 5  # of scratch


@compiled
def solve_box_qp(
    H: np.ndarray,
    g: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    x: np.ndarray,
    split: int,
    U: np.ndarray,
    vectors: np.ndarray,
    free: np.ndarray,
    max_steps: int,
) -> int:
    """Minimise x' H x / 2 + g' x over lower <= x <= upper, in place.

    Each step takes the Newton step of the variables that are not held at their bounds by the gradient, and searches
    along its projection onto the box.

    Args:
        H: symmetric positive definite, zero (and not read) between the variables before split and the others, shape
            (n, n).
        g: shape (n,).
        lower, upper: bounds, shape (n,).
        x: start, then solution, shape (n,).
        split: where the second block starts, n if H has one block.
        U: scratch, shape (n, n).
        vectors: scratch, shape (5, n).
        free: scratch, int, shape (2, n).
        max_steps: Newton steps allowed.

    Returns:
        Newton steps taken, or NOT_SOLVED; x is then the best point found.

    Source: Bertsekas, Projected Newton Methods for Optimization Problems with Simple Constraints, 1982.
    """
    n, slope, d = len(g), vectors[0], vectors[1]
    for i in range(n):
        x[i] = min(max(x[i], lower[i]), upper[i])
    for step in range(max_steps + 1):
        for i in range(n):
            slope[i] = g[i]
        add_product(H, x, slope, split)
        worst = 0.0
        for i in range(n):
            if not math.isfinite(slope[i]):
                return NOT_SOLVED
            d[i] = -slope[i]
            held = (x[i] <= lower[i] and slope[i] > 0.0) or (x[i] >= upper[i] and slope[i] < 0.0)
            free[0, i] = 0 if held else 1
            if not held:
                worst = max(worst, abs(slope[i]))
        if worst <= TOLERANCE:
            return step
        if step == max_steps:
            return NOT_SOLVED
        for first, end in ((0, split), (split, n)):
            if not solve_free(H, d, free, U, vectors[2], first, end):
                return NOT_SOLVED
        if not search_projected(H, lower, upper, x, split, vectors):
            return NOT_SOLVED
    return NOT_SOLVED


@compiled
def add_product(H: np.ndarray, x: np.ndarray, y: np.ndarray, split: int) -> None:
    """Add H x to y, both of shape (n,); H as in `solve_box_qp`."""
    for first, end in ((0, split), (split, len(x))):
        for j in range(first, end):
            if x[j] != 0.0:
                for i in range(first, end):
                    y[i] += H[j, i] * x[j]


@compiled
def solve_free(
    H: np.ndarray, d: np.ndarray, free: np.ndarray, U: np.ndarray, p: np.ndarray, first: int, end: int
) -> bool:
    """Replace d by the solution of H d = d over the free variables of a block and by 0 elsewhere, by Cholesky.

    Args:
        H: symmetric positive definite, shape (n, n).
        d: right side, then solution, shape (n,).
        free: whether each variable is, then scratch, shape (2, n).
        U: scratch for the factor, H = U' U, shape (n, n).
        p: scratch, shape (n,).
        first, end: of the block.

    Returns:
        False if H is not positive definite over the free variables.
    """
    at, m = free[1], 0
    for i in range(first, end):
        if free[0, i] == 1:
            at[m], p[m] = i, d[i]
            m += 1
        else:
            d[i] = 0.0
    if m == end - first:
        for j in range(m):
            row, given = U[j, j:m], H[first + j, first + j : end]
            for i in range(len(row)):
                row[i] = given[i]
    else:
        for j in range(m):
            for i in range(j, m):
                U[j, i] = H[at[j], at[i]]
    for k in range(0, m, 2):
        if not divide_row(U, p, k, m):
            return False
        if k + 1 == m:
            break
        row, tail, factor = U[k + 1, k + 1 : m], U[k, k + 1 : m], U[k, k + 1]
        for i in range(len(row)):
            row[i] -= factor * tail[i]
        if not divide_row(U, p, k + 1, m):
            return False
        # Two rows at once: every element is still lessened by one after the other.
        for j in range(k + 2, m):
            row, tail, factor = U[j, j:m], U[k, j:m], U[k, j]
            next_tail, next_factor = U[k + 1, j:m], U[k + 1, j]
            for i in range(len(row)):
                row[i] = row[i] - factor * tail[i] - next_factor * next_tail[i]
    for i in range(m - 1, -1, -1):
        p[i] /= U[i, i]
        d[at[i]] = p[i]
        for j in range(i):
            p[j] -= U[j, i] * p[i]
    return True


@inlined
def divide_row(U: np.ndarray, p: np.ndarray, k: int, m: int) -> bool:
    """Finish row k of the factor of `solve_free`, and substitute forward; return whether its pivot is positive."""
    if not U[k, k] > 0.0:
        return False
    root = math.sqrt(U[k, k])
    U[k, k], p[k] = root, p[k] / root
    pivot, rest, known = U[k, k + 1 : m], p[k + 1 : m], p[k]  # slices, because numba fills vectors from 0 on only
    for i in range(len(pivot)):
        pivot[i] /= root
        rest[i] -= pivot[i] * known
    return True


@compiled
def search_projected(
    H: np.ndarray, lower: np.ndarray, upper: np.ndarray, x: np.ndarray, split: int, vectors: np.ndarray
) -> bool:
    """Move x along the projection of x + alpha d onto the box until the objective falls enough (Armijo).

    Args:
        H, lower, upper: the problem, see `solve_box_qp`.
        x: start, then the accepted point, shape (n,).
        split: of H.
        vectors: gradient at the start and direction d, then scratch, shape (5, n).

    Returns:
        False if no step along the direction lowers the objective.
    """
    n, gradient, d, moves, change = len(x), vectors[0], vectors[1], vectors[3], vectors[4]
    alpha = 1.0
    for _ in range(HALVINGS):
        slope, curvature, moved = 0.0, 0.0, 0.0
        for i in range(n):
            moves[i] = min(max(x[i] + alpha * d[i], lower[i]), upper[i]) - x[i]
            change[i] = 0.0
        add_product(H, moves, change, split)
        for i in range(n):
            moved = max(moved, abs(moves[i]))
            slope += gradient[i] * moves[i]
            curvature += change[i] * moves[i]
        if moved == 0.0:
            return False
        # change of a quadratic: slope + curvature / 2; the full Newton step without clipping has exactly slope / 2
        if curvature / 2 <= -0.9 * slope:
            for i in range(n):
                x[i] = min(max(x[i] + alpha * d[i], lower[i]), upper[i])
            return True
        alpha /= 2
    return False

"""Box-constrained strictly convex QP by projected Newton: small, dense, always feasible, compiled."""

from __future__ import annotations

import numpy as np

from impact_envs.compiled import compiled

NEWTON_STEPS = 30  # 13 were the most in 2000 wild starts of the tracking problem
HALVINGS = 20
TOLERANCE = 1e-9  # of the gradient over the free variables
NOT_SOLVED = -1


@compiled
def solve_box_qp(
    H: np.ndarray,
    g: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    x: np.ndarray,
    L: np.ndarray,
    d: np.ndarray,
    trial: np.ndarray,
    free: np.ndarray,
    max_steps: int,
) -> int:
    """Minimise x' H x / 2 + g' x over lower <= x <= upper, in place.

    Each step takes the Newton step of the variables that are not held at their bounds by the gradient, and searches
    along its projection onto the box.

    Args:
        H: symmetric positive definite, shape (n, n).
        g: shape (n,).
        lower, upper: bounds, shape (n,).
        x: start, then solution, shape (n,).
        L: scratch, shape (n, n).
        d, trial: scratch, shape (n,).
        free: scratch, bool, shape (n,).
        max_steps: Newton steps allowed.

    Returns:
        Newton steps taken, or NOT_SOLVED; x is then the best point found.

    Source: Bertsekas, Projected Newton Methods for Optimization Problems with Simple Constraints, 1982.
    """
    n = len(g)
    for i in range(n):
        x[i] = min(max(x[i], lower[i]), upper[i])
    for step in range(max_steps + 1):
        worst = 0.0
        for i in range(n):
            slope = g[i]
            for j in range(n):
                slope += H[i, j] * x[j]
            d[i] = -slope
            free[i] = not ((x[i] <= lower[i] and slope > 0.0) or (x[i] >= upper[i] and slope < 0.0))
            if free[i]:
                worst = max(worst, abs(slope))
            if not np.isfinite(slope):
                return NOT_SOLVED
        if worst <= TOLERANCE:
            return step
        if step == max_steps or not solve_free(H, d, free, L):
            return NOT_SOLVED
        if not search_projected(H, g, lower, upper, x, d, trial):
            return NOT_SOLVED
    return NOT_SOLVED


@compiled
def solve_free(H: np.ndarray, d: np.ndarray, free: np.ndarray, L: np.ndarray) -> bool:
    """Replace d by the solution of H d = d over the free variables and by 0 elsewhere, by Cholesky.

    Args:
        H: symmetric positive definite, shape (n, n).
        d: right side, then solution, shape (n,).
        free: bool, shape (n,).
        L: scratch for the factor, shape (n, n).

    Returns:
        False if H is not positive definite over the free variables.
    """
    n = len(d)
    for i in range(n):
        if not free[i]:
            d[i] = 0.0
            continue
        for j in range(i + 1):
            if not free[j]:
                continue
            total = H[i, j]
            for k in range(j):
                if free[k]:
                    total -= L[i, k] * L[j, k]
            if i == j:
                if not total > 0.0:
                    return False
                L[i, i] = np.sqrt(total)
            else:
                L[i, j] = total / L[j, j]
                d[i] -= L[i, j] * d[j]
        d[i] /= L[i, i]
    for i in range(n - 1, -1, -1):
        if free[i]:
            d[i] /= L[i, i]
            for j in range(i):
                if free[j]:
                    d[j] -= L[i, j] * d[i]
    return True


@compiled
def search_projected(
    H: np.ndarray,
    g: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    x: np.ndarray,
    d: np.ndarray,
    trial: np.ndarray,
) -> bool:
    """Move x along the projection of x + alpha d onto the box until the objective falls enough (Armijo).

    Args:
        H, g, lower, upper: the problem, see `solve_box_qp`.
        x: start, then the accepted point, shape (n,).
        d: direction, shape (n,).
        trial: scratch, shape (n,).

    Returns:
        False if no step along the direction lowers the objective.
    """
    n = len(g)
    alpha = 1.0
    for _ in range(HALVINGS):
        slope, curvature, moved = 0.0, 0.0, 0.0
        for i in range(n):
            trial[i] = min(max(x[i] + alpha * d[i], lower[i]), upper[i])
            moved = max(moved, abs(trial[i] - x[i]))
        for i in range(n):
            Hx, Hm = 0.0, 0.0
            for j in range(n):
                Hx += H[i, j] * x[j]
                Hm += H[i, j] * (trial[j] - x[j])
            slope += (g[i] + Hx) * (trial[i] - x[i])
            curvature += Hm * (trial[i] - x[i])
        if moved == 0.0:
            return False
        # change of a quadratic: slope + curvature / 2; the full Newton step without clipping has exactly slope / 2
        if curvature / 2 <= -0.9 * slope:
            for i in range(n):
                x[i] = trial[i]
            return True
        alpha /= 2
    return False

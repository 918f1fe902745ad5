"""Convex problems with linear rows and second-order cones, solved by Clarabel."""

from __future__ import annotations

from collections.abc import Sequence

import clarabel
import numpy as np
from scipy import sparse

from planners.errors import Infeasible, SolverFailed
from planners.mixed_integer import Model, stack
from planners.path_cost import PieceCost


def solve_cones(model: Model, integers: np.ndarray, costs: Sequence[PieceCost]) -> np.ndarray:
    """Minimise the model with its integers fixed, under cost >= move^2 / duration for each piece.

    With e the cost, d the move and t the duration this is the second-order cone |((e - t) / 2, d)| <= (e + t) / 2.

    Args:
        model: the model; its objective is kept.
        integers: a point whose integer entries are kept, shape (n,).
        costs: of pieces of paths.

    Returns:
        The optimal point, shape (n,).

    Raises:
        SolverFailed: Clarabel stopped without a usable answer.
    """
    fixed = np.array(model.integer)
    base = np.where(fixed, np.round(integers), 0.0)
    free = np.flatnonzero(~fixed)
    matrix, _, high = model.rows()
    equal = len(model.equalities)
    split = matrix.shape[0] - equal
    box = sparse.identity(len(free))
    parts = ((0.5 * (one.cost + one.duration), 0.5 * (one.cost - one.duration), one.move) for one in costs)
    stacked = [row for cone in parts for row in cone]
    cone_rows, cone_high = stack(stacked, len(base))
    rest = high - matrix @ base
    rows = matrix[:, free]
    # Clarabel wants A x + s = b with s in {0}, R+ and the second-order cones, in this order.
    A = sparse.vstack([rows[split:], rows[:split], box, -box, -cone_rows[:, free]], format="csc")
    upper, lower = np.array(model.upper)[free], np.array(model.lower)[free]
    b = np.concatenate([rest[split:], rest[:split], upper, -lower, cone_high + cone_rows @ base])
    cones = [clarabel.ZeroConeT(equal), clarabel.NonnegativeConeT(split + 2 * len(free))]
    cones += [clarabel.SecondOrderConeT(3)] * len(costs)
    linear = np.zeros(len(base))
    for i, c in model.objective.coefficients.items():
        linear[i] += c
    x = solve_clarabel(model.name, sparse.csc_matrix((len(free), len(free))), linear[free], A, b, cones)
    base[free] = x
    return base


def solve_clarabel(
    name: str, P: sparse.csc_matrix, q: np.ndarray, A: sparse.csc_matrix, b: np.ndarray, cones: list[object]
) -> np.ndarray:
    """Minimise x'Px/2 + q'x subject to A x + s = b with s in the cones.

    Args:
        name: what failures call the problem.
        P: upper triangle of the cost matrix, shape (n, n).
        q: linear cost, shape (n,).
        A: rows, shape (m, n).
        b: right-hand side, shape (m,).
        cones: Clarabel cones, in the order of the rows.

    Returns:
        The optimal point, shape (n,).

    Raises:
        Infeasible: proven to have no solution.
        SolverFailed: stopped without a usable answer.
    """
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    solution = clarabel.DefaultSolver(P, q, A, b, cones, settings).solve()
    status = str(solution.status)
    if "PrimalInfeasible" in status:
        raise Infeasible(name, "proven infeasible", "allow more time, thrust or impacts")
    if status not in ("Solved", "AlmostSolved"):
        raise SolverFailed(name, f"Clarabel: {status}", "change the time reserves or the number of impacts")
    return np.array(solution.x)

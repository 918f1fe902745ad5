"""Solvers of the torques' quadratic programs: ours, compiled; DAQP; and Clarabel to check both."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from impact_envs.errors import InputError, choices
from planners.dual_arm.torque_qp import BOUNDED, CONTACT_ROWS, EQUAL, TorqueQP
from planners.errors import Infeasible, SolverFailed
from planners.goldfarb_idnani import INFEASIBLE, SOLVED, make_workspace, solve_qp

REMEDY = "relax torque limits or friction, or use the slack form"
COMPILED = "goldfarb_idnani"  # the solver that a compiled control loop has
CLARABEL_TOLERANCE = 1e-11  # absolute, relative and of the constraints


def get_solver(name: str = COMPILED) -> Callable[[TorqueQP], np.ndarray]:
    """Return the function that solves a program.

    Args:
        name: of `SOLVERS`.

    Returns:
        A function from a program to its minimiser, shape (n,).

    Raises:
        InputError: unknown solver.
    """
    if name not in SOLVERS:
        raise InputError(f"solver '{name}' is unknown; {choices(name, SOLVERS)}")
    return SOLVERS[name]


def solve_goldfarb_idnani(qp: TorqueQP) -> np.ndarray:
    """Solve a program with Goldfarb and Idnani's dual active-set method, as the compiled control loop does.

    Returns:
        The minimiser, shape (n,).

    Raises:
        Infeasible: the program has no solution.
        SolverFailed: the method stopped early.
    """
    H, f, A, lower, upper, sense = qp
    x, work = np.zeros(len(f)), make_workspace(len(f), len(sense))
    status = solve_qp(H, f, A, lower, upper, BOUNDED, int((sense == EQUAL).sum()), work, x)
    if status == SOLVED:
        return x
    if status == INFEASIBLE:
        raise Infeasible("reference spreading", "Goldfarb-Idnani: infeasible", REMEDY)
    raise SolverFailed("reference spreading", "Goldfarb-Idnani: stopped early", REMEDY)


def solve_daqp(qp: TorqueQP) -> np.ndarray:
    """Solve a program with DAQP's dual active-set method.

    Returns:
        The minimiser, shape (n,).

    Raises:
        Infeasible: the program has no solution.
        SolverFailed: the method stopped early.
    """
    import daqp

    H, f, A, lower, upper, sense = qp
    x, _, flag, _ = daqp.solve(H, f, A, upper, lower, sense)
    if flag == 1 and math.isfinite(x.sum()):
        return x
    if flag == -1:
        raise Infeasible("reference spreading", "DAQP: infeasible", REMEDY)
    raise SolverFailed("reference spreading", f"DAQP: exit flag {flag}", REMEDY)


def solve_clarabel(qp: TorqueQP) -> np.ndarray:
    """Solve a program with Clarabel's interior-point method.

    Returns:
        The minimiser, shape (n,).

    Raises:
        Infeasible: the program has no solution.
        SolverFailed: the method stopped early.
    """
    import clarabel
    from scipy import sparse

    H, f, A, lower, upper, sense = qp
    rows = np.vstack([np.eye(BOUNDED, len(f)), A])
    equal = sense == EQUAL
    above, below = ~equal & np.isfinite(upper), ~equal & np.isfinite(lower)
    G = np.vstack([rows[equal], rows[above], -rows[below]])
    h = np.concatenate([upper[equal], upper[above], -lower[below]])
    cones = [clarabel.ZeroConeT(int(equal.sum())), clarabel.NonnegativeConeT(int(above.sum() + below.sum()))]
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = CLARABEL_TOLERANCE
    solution = clarabel.DefaultSolver(
        sparse.csc_matrix(np.triu(H)), f, sparse.csc_matrix(G), h, cones, settings
    ).solve()
    status = str(solution.status)
    if status in ("Solved", "AlmostSolved", "InsufficientProgress"):
        return np.array(solution.x)
    if "PrimalInfeasible" in status:
        raise Infeasible("reference spreading", f"Clarabel: {status}", REMEDY)
    raise SolverFailed("reference spreading", f"Clarabel: {status}", REMEDY)


SOLVERS = {COMPILED: solve_goldfarb_idnani, "daqp": solve_daqp, "clarabel": solve_clarabel}


def relax_contacts(qp: TorqueQP, weight: float) -> TorqueQP:
    """Return the slack form of a post-impact program, which always has a solution.

    The rows that forbid acceleration between pads and box move into the cost: weight |C x - d|^2.

    Args:
        qp: of size GRASP.
        weight: of the squared accelerations between pads and box.

    Returns:
        A new program.
    """
    rows = np.array(CONTACT_ROWS)
    C, d = qp.A[rows], qp.upper[6 + rows]
    lower, upper, sense = qp.lower.copy(), qp.upper.copy(), qp.sense.copy()
    lower[6 + rows], upper[6 + rows], sense[6 + rows] = -np.inf, np.inf, 0
    H = qp.H + 2.0 * weight * C.T @ C
    f = qp.f - 2.0 * weight * C.T @ d
    return TorqueQP(H, f, qp.A, lower, upper, sense)

"""Solvers of the torques' quadratic programs: ours, compiled; DAQP; and Clarabel to check both."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from impact_envs.errors import InputError, choices
from planners.dual_arm.torque_qp import BOUNDED, TorqueQP
from planners.errors import Infeasible, SolverFailed
from planners.goldfarb_idnani import INFEASIBLE, SOLVED, make_workspace, solve_qp

REMEDY = "relax torque limits or friction, or use the slack form"
COMPILED = "goldfarb_idnani"  # the solver that a compiled control loop has
EQUAL = 5  # sense of an equality for DAQP
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
    x, work = np.zeros(len(qp.f)), make_workspace(len(qp.f), len(qp.lower))
    status = solve_qp(*qp, BOUNDED, int((qp.lower == qp.upper).sum()), work, x)
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

    H, f, A, lower, upper = qp
    sense = np.where(lower == upper, EQUAL, 0).astype(np.int32)
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

    H, f, A, lower, upper = qp
    rows = np.vstack([np.eye(BOUNDED, len(f)), A])
    equal = lower == upper
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

"""One door to small dense quadratic programs: DAQP where it is installed, Clarabel otherwise."""

from __future__ import annotations

import math
from collections.abc import Callable
from importlib.util import find_spec

import numpy as np

from impact_envs.errors import InputError, choices
from planners.dual_arm.programs import CONTACT_ROWS, Program
from planners.errors import Infeasible, SolverFailed

SOLVERS = ("daqp", "clarabel")
REMEDY = "relax torque limits or friction, or use the slack form"
SLACK_WEIGHT = 1.0  # on squared accelerations between pads and box in the slack form
CLARABEL_TOLERANCE = 1e-11


def get_solver(name: str | None = None) -> Callable[[Program], np.ndarray]:
    """Return the function that solves a program.

    Args:
        name: "daqp" or "clarabel"; the first that is installed without one.

    Returns:
        A function from a program to its minimiser, shape (n,).

    Raises:
        InputError: unknown solver, or DAQP asked for and not installed.
    """
    if name is None:
        name = "daqp" if find_spec("daqp") else "clarabel"
    if name not in SOLVERS:
        raise InputError(f"solver '{name}' is unknown; {choices(name, SOLVERS)}")
    if name == "daqp" and not find_spec("daqp"):
        raise InputError("solver 'daqp' needs the package daqp: pip install daqp; installed: clarabel")
    return solve_daqp if name == "daqp" else solve_clarabel


def solve_daqp(program: Program) -> np.ndarray:
    """Solve a program with DAQP's dual active-set method.

    Args:
        program: to solve.

    Returns:
        The minimiser, shape (n,).

    Raises:
        Infeasible: it has no solution.
        SolverFailed: the method stopped early.
    """
    import daqp

    H, f, A, lower, upper, sense = program
    x, _, flag, _ = daqp.solve(H, f, A, upper, lower, sense)
    if flag == 1 and math.isfinite(x.sum()):
        return x
    if flag == -1:
        raise Infeasible("reference spreading", "DAQP: infeasible", REMEDY)
    raise SolverFailed("reference spreading", f"DAQP: exit flag {flag}", REMEDY)


def solve_clarabel(program: Program) -> np.ndarray:
    """Solve a program with Clarabel's interior-point method.

    Args:
        program: to solve.

    Returns:
        The minimiser, shape (n,).

    Raises:
        Infeasible: it has no solution.
        SolverFailed: the method stopped early.
    """
    import clarabel
    from scipy import sparse

    H, f, A, lower, upper, sense = program
    rows = np.vstack([np.eye(6, len(f)), A])
    equal = sense == 5
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


def relax_contacts(program: Program) -> Program:
    """Return the slack form of a post-impact program, which always has a solution.

    The rows that forbid acceleration between pads and box move into the cost, with `SLACK_WEIGHT` on their squares.

    Args:
        program: of shape GRASP.

    Returns:
        A new program.
    """
    rows = np.array(CONTACT_ROWS)
    C, d = program.A[rows], program.upper[6 + rows]
    lower, upper, sense = program.lower.copy(), program.upper.copy(), program.sense.copy()
    lower[6 + rows], upper[6 + rows], sense[6 + rows] = -np.inf, np.inf, 0
    H = program.H + 2.0 * SLACK_WEIGHT * C.T @ C
    f = program.f - 2.0 * SLACK_WEIGHT * C.T @ d
    return Program(H, f, program.A, lower, upper, sense)

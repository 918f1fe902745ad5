"""One door to mixed-integer solvers: HiGHS, which is always there, and SCIP and Gurobi where they are installed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np
from scipy import sparse

from impact_envs.errors import InputError, choices
from planners.errors import Infeasible, SolverFailed
from planners.mixed_integer import Affine, Model, Solution, solve_mixed_integer

SOLVERS = ("highs", "scip", "gurobi")
PACKAGES = {"highs": "highspy", "scip": "pyscipopt", "gurobi": "gurobipy"}
TOLERANCE = 1e-8  # of rows and integers
REMEDY = "relax the formula, the limits or the horizon"
Squares = Sequence[tuple[float, Affine]]


def installed_solvers() -> tuple[str, ...]:
    """Return the solvers whose packages are installed; a licence may still be missing."""
    return tuple(name for name in SOLVERS if find_spec(PACKAGES[name]))


def solve(
    model: Model,
    time_limit: float,
    relative_gap: float = 1e-6,
    solver: str = "highs",
    squares: Squares = (),
) -> Solution:
    r"""Minimise a mixed-integer model with linear rows: objective + sum_i w_i e_i(x)^2.

    One thread. An infinite gap stops at the first point found.

    Args:
        model: the model.
        time_limit: wall time after which the best point so far is returned [s].
        relative_gap: proof is complete once (objective - bound) / |objective| is below this.
        solver: one of `SOLVERS`; SCIP and Gurobi need their packages.
        squares: pairs (w_i, e_i) of a weight >= 0 and an expression; SCIP and Gurobi only.

    Returns:
        The best point and the proven bound.

    Raises:
        InputError: unknown solver, or its package is not installed.
        Infeasible: proven to have no solution.
        SolverFailed: no point within the time limit, no licence, or squares given to HiGHS.
    """
    check_solver(solver)
    if solver == "scip":
        return _solve_scip(model, time_limit, relative_gap, squares)
    if solver == "gurobi":
        return _solve_gurobi(model, time_limit, relative_gap, squares)
    if squares:
        status = "HiGHS takes no quadratic objective together with integer variables"
        raise SolverFailed(model.name, status, "use solver scip or gurobi, or leave the quadratic terms out")
    return solve_mixed_integer(model, time_limit, relative_gap)


def check_solver(solver: str) -> None:
    """Check that a solver is known and its package installed.

    Args:
        solver: its name.

    Raises:
        InputError: it is not; says which are, and how to install it.
    """
    if solver not in SOLVERS:
        raise InputError(f"solver '{solver}' is unknown; {choices(solver, SOLVERS)}")
    if solver not in installed_solvers():
        package = PACKAGES[solver]
        here = ", ".join(installed_solvers())
        raise InputError(f"solver '{solver}' needs the package {package}: pip install {package}; installed: {here}")


def _stack(expressions: Sequence[Affine], size: int) -> tuple[sparse.csr_matrix, np.ndarray]:
    """Return A, c with expressions = A x + c."""
    indptr = np.cumsum([0, *(len(e.coefficients) for e in expressions)])
    columns = [i for e in expressions for i in e.coefficients]
    data = [c for e in expressions for c in e.coefficients.values()]
    constants = np.array([e.constant for e in expressions])
    return sparse.csr_matrix((data, columns, indptr), shape=(len(expressions), size)), constants


def _solution(model: Model, x: np.ndarray, bound: float, squares: Squares) -> Solution:
    value = model.objective.value(x) + sum(weight * expression.value(x) ** 2 for weight, expression in squares)
    return Solution(x, value, min(bound, value))


def _solve_scip(model: Model, time_limit: float, relative_gap: float, squares: Squares) -> Solution:
    """Solve with SCIP; each square has a variable t_i >= w_i e_i^2 in the objective."""
    scip_package: Any = import_module(PACKAGES["scip"])
    scip = scip_package.Model(model.name)
    scip.hideOutput()
    parameters = {"limits/time": max(time_limit, 0.1), "parallel/maxnthreads": 1, "lp/threads": 1}
    if math.isinf(relative_gap):
        parameters["limits/solutions"] = 1
    else:
        parameters["limits/gap"] = relative_gap
    if not squares:
        parameters["numerics/feastol"] = TOLERANCE
    for name, value in parameters.items():
        scip.setParam(name, value)
    kinds = ("C", "I")
    x = [
        scip.addVar(lb=low, ub=high, vtype=kinds[integer])
        for low, high, integer in zip(model.lower, model.upper, model.integer, strict=True)
    ]

    def express(affine: Affine) -> Any:
        return scip_package.quicksum(c * x[i] for i, c in affine.coefficients.items())

    for row in model.inequalities:
        scip.addCons(express(row) <= -row.constant)
    for row in model.equalities:
        scip.addCons(express(row) == -row.constant)
    objective = express(model.objective)
    for weight, expression in squares:
        share = scip.addVar(lb=0.0)
        root = express(expression) + expression.constant
        scip.addCons(weight * root * root <= share)
        objective += share
    scip.setObjective(objective, "minimize")
    scip.optimize()
    return _read_scip(model, scip, x, squares)


def _read_scip(model: Model, scip: Any, x: list[Any], squares: Squares) -> Solution:
    status = scip.getStatus()
    if status == "userinterrupt":
        raise KeyboardInterrupt
    if status in ("infeasible", "inforunbd"):
        raise Infeasible(model.name, "proven infeasible", REMEDY)
    if scip.getNSols() == 0:
        raise SolverFailed(model.name, f"SCIP: {status}, no solution found", "raise the time limit")
    best = scip.getBestSol()
    values = np.array([scip.getSolVal(best, variable) for variable in x])
    bound = scip.getDualbound() + model.objective.constant
    return _solution(model, values, -math.inf if bound <= -scip.infinity() else bound, squares)


def _solve_gurobi(model: Model, time_limit: float, relative_gap: float, squares: Squares) -> Solution:
    """Solve with Gurobi, squares in its quadratic objective."""
    gurobi: Any = import_module(PACKAGES["gurobi"])
    parameters = {
        "OutputFlag": 0,
        "Threads": 1,
        "TimeLimit": max(time_limit, 0.1),
        "FeasibilityTol": TOLERANCE,
        "IntFeasTol": TOLERANCE,
    }
    if math.isinf(relative_gap):
        parameters["SolutionLimit"] = 1
    else:
        parameters["MIPGap"] = relative_gap
    try:
        with gurobi.Env(params=parameters) as environment, gurobi.Model(model.name, env=environment) as problem:
            matrix, _, high = model.rows()
            split = len(model.inequalities)
            kinds = ["I" if integer else "C" for integer in model.integer]
            x = problem.addMVar(len(kinds), lb=model.lower, ub=model.upper, vtype=kinds)
            problem.addConstr(matrix[:split] @ x <= high[:split])
            problem.addConstr(matrix[split:] @ x == high[split:])
            linear, constant = _stack([model.objective], len(kinds))
            cost = linear.toarray()[0] @ x + constant[0]
            if squares:
                roots = [expression * math.sqrt(weight) for weight, expression in squares]
                S, s = _stack(roots, len(kinds))
                cost = cost + x @ (S.T @ S) @ x + 2.0 * (s @ S) @ x + s @ s
            problem.setObjective(cost)
            problem.optimize()
            return _read_gurobi(gurobi, model, problem, x, squares)
    except gurobi.GurobiError as error:
        raise SolverFailed(model.name, f"Gurobi: {error}", "use another solver, or a licence that allows it") from None


def _read_gurobi(gurobi: Any, model: Model, problem: Any, x: Any, squares: Squares) -> Solution:
    status = problem.Status
    if status == gurobi.GRB.INTERRUPTED:
        raise KeyboardInterrupt
    # Every variable has finite bounds, so a model that is infeasible or unbounded is infeasible.
    if status in (gurobi.GRB.INFEASIBLE, gurobi.GRB.INF_OR_UNBD):
        raise Infeasible(model.name, "proven infeasible", REMEDY)
    if problem.SolCount == 0:
        raise SolverFailed(model.name, f"Gurobi: status {status}, no solution found", "raise the time limit")
    bound = problem.ObjBound if any(model.integer) or squares else problem.ObjVal
    return _solution(model, np.array(x.X), bound, squares)

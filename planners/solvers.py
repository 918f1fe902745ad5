"""The one door to mixed-integer solvers: HiGHS is always there, SCIP and Gurobi where their packages are installed.

A further solver is one entry of `SOLVERS`: its title, its package and a function that solves a model.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import highspy
import numpy as np

from impact_envs.errors import InputError, choices
from planners.budget import Work, get_clock, read_clock
from planners.errors import Infeasible, SolverFailed
from planners.mixed_integer import Affine, Model, Solution, stack

TOLERANCE = 1e-8  # of rows [their unit] and integers
RELATIVE_GAP = 1e-6  # of the objective, at which a solution counts as optimal
BOUND_GAP = 1e-4  # the same for a bound alone
SHORTEST = 0.1  # solvers get no less time than this [s]
Squares = Sequence[tuple[float, Affine]]


@dataclass(frozen=True)
class Limits:
    """Say when a solver stops.

    Args:
        seconds: wall time [s].
        relative_gap: (objective - bound) / |objective| at which the proof is complete; infinite: at the first point.
        nodes: of branch and bound; 0 solves the linear relaxation alone; None: any number.
        pauses: at which the solver may be interrupted, heuristics included, the same on every machine; only HiGHS
            counts them. None: any number.
    """

    seconds: float
    relative_gap: float
    nodes: int | None = None
    pauses: int | None = None


@dataclass(frozen=True)
class Outcome:
    """Hold what a solver stopped with.

    Args:
        status: in the solver's own words.
        x: best point found, shape (n,); None: no point was found.
        objective: of this point, constants included.
        bound: proven lower bound of the objective.
        infeasible: proven to have no solution.
        iterations: of the simplex method; only HiGHS says.
    """

    status: str
    x: np.ndarray | None = None
    objective: float = math.inf
    bound: float = -math.inf
    infeasible: bool = False
    iterations: int = 0


@dataclass(frozen=True)
class Solver:
    """Describe a mixed-integer solver.

    Args:
        title: its name in messages.
        package: that pip installs and Python imports.
        run: minimises the model's objective plus sum_i w_i e_i(x)^2 over pairs (w_i, e_i), on one thread.
        quadratic: whether `run` takes any such pairs.
    """

    title: str
    package: str
    run: Callable[[Model, Limits, Squares], Outcome]
    quadratic: bool = True


def installed_solvers() -> tuple[str, ...]:
    """Return the names of the solvers whose packages are installed; a licence may still be missing."""
    return tuple(name for name, solver in SOLVERS.items() if find_spec(solver.package))


def check_solver(name: str) -> None:
    """Check that a solver is known and its package installed.

    Raises:
        InputError: it is not; says which are, and how to install it.
    """
    if name not in SOLVERS:
        raise InputError(f"solver '{name}' is unknown; {choices(name, SOLVERS)}")
    if name not in installed_solvers():
        package, here = SOLVERS[name].package, ", ".join(installed_solvers())
        raise InputError(f"solver '{name}' needs the package {package}: pip install {package}; installed: {here}")


def solve(
    model: Model,
    time_limit: float,
    relative_gap: float = RELATIVE_GAP,
    solver: str = "highs",
    squares: Squares = (),
    work: Work | None = None,
    nodes: int | None = None,
    pauses: int | None = None,
) -> Solution:
    r"""Minimise a mixed-integer model with linear rows: objective + sum_i w_i e_i(x)^2.

    Args:
        model: the model.
        time_limit: wall time after which the best point so far is returned [s].
        relative_gap: (objective - bound) / |objective| at which the proof is complete; infinite: at the first point.
        solver: a key of `SOLVERS`.
        squares: pairs (w_i, e_i) of a weight >= 0 and an expression; not for HiGHS.
        work: counts this solution and limits its nodes; of HiGHS alone it is the same on every machine.
        nodes: of branch and bound, above which the best point so far is returned; None: as many as the work allows.
        pauses: of the solver, with the same effect, see `Limits`.

    Returns:
        The best point and the proven bound.

    Raises:
        InputError: unknown solver, or its package is not installed.
        Infeasible: proven to have no solution.
        SolverFailed: no point within the limits, no licence, or squares given to HiGHS.
        OutOfWork: no more work is allowed.
    """
    limits = [count for count in (nodes, work.nodes if work else None) if count is not None]
    bounds = Limits(time_limit, relative_gap, min(limits, default=None), pauses)
    outcome = _run(model, bounds, solver, squares, work)
    if outcome.x is None:
        status = f"{SOLVERS[solver].title}: {outcome.status}, no solution found"
        raise SolverFailed(model.name, status, "raise the time limit")
    return Solution(outcome.x, outcome.objective, outcome.bound)


def compute_lower_bound(
    model: Model, time_limit: float, nodes: int, solver: str = "highs", work: Work | None = None
) -> tuple[float, np.ndarray | None]:
    """Return a proven lower bound of a model's objective from a search of limited size.

    Args:
        model: the model.
        time_limit: wall time [s].
        nodes: greatest number of nodes of branch and bound; 0 solves the linear relaxation alone.
        solver: a key of `SOLVERS`.
        work: counts this search.

    Returns:
        The bound, and the best point found, shape (n,), if any; with 0 nodes its integers are fractional.

    Raises:
        InputError: unknown solver, or its package is not installed.
        Infeasible: proven to have no solution.
        OutOfWork: no more work is allowed.
    """
    outcome = _run(model, Limits(time_limit, BOUND_GAP, nodes), solver, (), work)
    return outcome.bound, outcome.x


def _run(model: Model, limits: Limits, name: str, squares: Squares, work: Work | None) -> Outcome:
    check_solver(name)
    solver = SOLVERS[name]
    if squares and not solver.quadratic:
        able = " or ".join(other for other, one in SOLVERS.items() if one.quadratic)
        status = f"{solver.title} takes no quadratic objective together with integer variables"
        raise SolverFailed(model.name, status, f"use solver {able}, or leave the quadratic terms out")
    outcome = solver.run(model, limits, squares)
    if work is not None:
        work.spend(len(model.inequalities) + len(model.equalities), outcome.iterations)
    if outcome.infeasible:
        raise Infeasible(model.name, "proven infeasible", "relax the formula, the limits or the horizon")
    return outcome


def _run_highs(model: Model, limits: Limits, squares: Squares) -> Outcome:
    solver = highspy.Highs()
    options: dict[str, Any] = {
        "output_flag": False,
        "threads": 1,
        "mip_feasibility_tolerance": TOLERANCE,
        "primal_feasibility_tolerance": TOLERANCE,
        "mip_rel_gap": limits.relative_gap,
        "mip_allow_restart": False,  # these models are small: a restart costs more than it brings
    }
    if limits.nodes is not None:
        options |= {"solve_relaxation": limits.nodes == 0, "mip_max_nodes": max(limits.nodes, 1)}
    for option, value in options.items():
        solver.setOptionValue(option, value)
    solver.passModel(_make_highs_problem(model))
    _run_by_clock(solver, max(limits.seconds, SHORTEST), limits.pauses)
    status, text = solver.getModelStatus(), solver.modelStatusToString(solver.getModelStatus()).lower()
    info = solver.getInfo()
    iterations = max(info.simplex_iteration_count, 0)
    if status in (highspy.HighsModelStatus.kInfeasible, highspy.HighsModelStatus.kUnboundedOrInfeasible):
        return Outcome(text, infeasible=True, iterations=iterations)
    found = info.primal_solution_status == highspy.SolutionStatus.kSolutionStatusFeasible
    x = np.array(solver.getSolution().col_value) if found else None
    continuous = limits.nodes == 0 or not any(model.integer)
    bound = info.mip_dual_bound
    if continuous:  # the simplex method has a bound only where it came to its end
        bound = info.objective_function_value if status == highspy.HighsModelStatus.kOptimal else -math.inf
    return Outcome(text, x, info.objective_function_value, bound, iterations=iterations)


def _run_by_clock(solver: highspy.Highs, seconds: float, most: int | None) -> None:
    """Solve until the clock of limits says that it is over; asking it also lets Python see a Ctrl-C.

    Args:
        solver: with its problem.
        seconds: limit [s].
        most: pauses, see `Limits`.
    """
    pauses = 0
    clock, end = get_clock(), read_clock() + seconds
    if clock.read is time.perf_counter:
        solver.setOptionValue("time_limit", seconds)  # searches within its search know of this limit alone

    def look_at_clock(kind: Any, message: str, out: Any, answer: Any, data: Any) -> None:
        nonlocal pauses
        pauses += 1
        if (most is not None and pauses > most) or clock.stopped or clock.read() > end:
            answer.user_interrupt = True

    solver.setCallback(look_at_clock, None)
    for kind in ("kCallbackMipInterrupt", "kCallbackSimplexInterrupt"):
        solver.startCallback(getattr(highspy.cb.HighsCallbackType, kind))
    solver.run()


def _make_highs_problem(model: Model) -> highspy.HighsLp:
    matrix, low, high = model.rows()
    problem = highspy.HighsLp()
    problem.num_col_, problem.num_row_ = len(model.lower), matrix.shape[0]
    cost = np.zeros(len(model.lower))
    for i, c in model.objective.coefficients.items():
        cost[i] += c
    problem.col_cost_, problem.offset_ = cost, model.objective.constant
    problem.col_lower_, problem.col_upper_ = np.array(model.lower), np.array(model.upper)
    problem.row_lower_, problem.row_upper_ = low, high
    problem.a_matrix_.format_ = highspy.MatrixFormat.kRowwise
    problem.a_matrix_.start_ = matrix.indptr
    problem.a_matrix_.index_ = matrix.indices
    problem.a_matrix_.value_ = matrix.data
    kinds = (highspy.HighsVarType.kContinuous, highspy.HighsVarType.kInteger)
    problem.integrality_ = [kinds[integer] for integer in model.integer]
    return problem


def _run_scip(model: Model, limits: Limits, squares: Squares) -> Outcome:
    """Solve with SCIP; each square has a variable t_i >= w_i e_i^2 in the objective."""
    scip_package: Any = import_module(SOLVERS["scip"].package)
    scip = scip_package.Model(model.name)
    scip.hideOutput()
    for name, value in _make_scip_parameters(limits, bool(squares)).items():
        scip.setParam(name, value)
    kinds = ("C", "C" if limits.nodes == 0 else "I")
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
    status = scip.getStatus()
    if status == "userinterrupt":
        raise KeyboardInterrupt
    bound = scip.getDualbound()
    best = scip.getBestSol() if scip.getNSols() else None
    return _make_outcome(
        model,
        squares,
        status,
        None if best is None else np.array([scip.getSolVal(best, variable) for variable in x]),
        -math.inf if bound <= -scip.infinity() else bound + model.objective.constant,
        status in ("infeasible", "inforunbd"),
    )


def _make_scip_parameters(limits: Limits, quadratic: bool) -> dict[str, float]:
    parameters = {"limits/time": max(limits.seconds, SHORTEST), "parallel/maxnthreads": 1, "lp/threads": 1}
    if math.isinf(limits.relative_gap):
        parameters["limits/solutions"] = 1
    else:
        parameters["limits/gap"] = limits.relative_gap
    if limits.nodes:
        parameters["limits/nodes"] = limits.nodes
    if not quadratic:
        parameters["numerics/feastol"] = TOLERANCE
    return parameters


def _run_gurobi(model: Model, limits: Limits, squares: Squares) -> Outcome:
    """Solve with Gurobi, squares in its quadratic objective."""
    gurobi: Any = import_module(SOLVERS["gurobi"].package)
    parameters = {
        "OutputFlag": 0,
        "Threads": 1,
        "TimeLimit": max(limits.seconds, SHORTEST),
        "FeasibilityTol": TOLERANCE,
        "IntFeasTol": TOLERANCE,
    }
    if math.isinf(limits.relative_gap):
        parameters["SolutionLimit"] = 1
    else:
        parameters["MIPGap"] = limits.relative_gap
    if limits.nodes:
        parameters["NodeLimit"] = limits.nodes
    try:
        with gurobi.Env(params=parameters) as environment, gurobi.Model(model.name, env=environment) as problem:
            matrix, _, high = model.rows()
            split = len(model.inequalities)
            kinds = ["I" if integer and limits.nodes != 0 else "C" for integer in model.integer]
            x = problem.addMVar(len(kinds), lb=model.lower, ub=model.upper, vtype=kinds)
            problem.addConstr(matrix[:split] @ x <= high[:split])
            problem.addConstr(matrix[split:] @ x == high[split:])
            linear, constant = stack([model.objective], len(kinds))
            cost = linear.toarray()[0] @ x + constant[0]
            if squares:
                roots = [expression * math.sqrt(weight) for weight, expression in squares]
                S, s = stack(roots, len(kinds))
                cost = cost + x @ (S.T @ S) @ x + 2.0 * (s @ S) @ x + s @ s
            problem.setObjective(cost)
            problem.optimize()
            status = problem.Status
            if status == gurobi.GRB.INTERRUPTED:
                raise KeyboardInterrupt
            # Every variable has finite bounds, so a model that is infeasible or unbounded is infeasible.
            if status in (gurobi.GRB.INFEASIBLE, gurobi.GRB.INF_OR_UNBD):
                return Outcome(f"status {status}", infeasible=True)
            point = np.array(x.X) if problem.SolCount else None
            bound = problem.ObjBound if problem.IsMIP or squares or point is None else problem.ObjVal
            return _make_outcome(model, squares, f"status {status}", point, bound, False)
    except gurobi.GurobiError as error:
        raise SolverFailed(model.name, f"Gurobi: {error}", "use another solver, or a licence that allows it") from None


def _make_outcome(
    model: Model, squares: Squares, status: str, x: np.ndarray | None, bound: float, infeasible: bool
) -> Outcome:
    """Return the outcome of a point, whose objective is computed here, for the solver may round."""
    if x is None:
        return Outcome(status, bound=bound, infeasible=infeasible)
    value = model.objective.value(x) + sum(weight * expression.value(x) ** 2 for weight, expression in squares)
    return Outcome(status, x, value, min(bound, value))


SOLVERS = {
    "highs": Solver("HiGHS", "highspy", _run_highs, quadratic=False),
    "scip": Solver("SCIP", "pyscipopt", _run_scip),
    "gurobi": Solver("Gurobi", "gurobipy", _run_gurobi),
}

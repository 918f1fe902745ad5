"""Tracking MPC by CasADi, nonlinear in the heading: compiled once, solved with new parameters.

The jump of an impact is an affine map of the state before one stage, and the identity elsewhere.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from impact_envs.errors import InputError, choices
from planners.errors import SolverFailed
from planners.free_flyer.tracking.problem import NO_JUMP, STAGES, TrackingProblem, TrackingTask, make_matrices

SOLVERS: dict[str, dict[str, Any]] = {
    "fatrop": {
        "structure_detection": "auto",
        "fatrop": {"print_level": 0, "tol": 1e-8, "max_iter": 100},
    },
    "ipopt": {"ipopt": {"print_level": 0, "sb": "yes", "tol": 1e-8, "max_iter": 100}},
}


@dataclass(eq=False)
class CasadiTracking:
    """Hold one MPC compiled by CasADi; its variables are x_0, u_0, x_1, ..., x_N in one vector.

    Args:
        name: of the problem, for messages.
        problem: that it was built from.
        solver: CasADi's function.
        nx: size of the state.
        lower, upper: bounds of the variables.
        guess: where the next solve starts; the last solution.
        seconds: that the last solve took, of CPU time.
    """

    name: str
    problem: TrackingProblem
    solver: Any
    nx: int
    lower: np.ndarray
    upper: np.ndarray
    guess: np.ndarray
    seconds: float = 0.0


def has_fatrop() -> bool:
    """Return whether the installed CasADi has fatrop, a solver made for optimal control."""
    import casadi

    return bool(casadi.has_nlpsol("fatrop"))


def build_casadi_tracking(problem: TrackingProblem, solver: str | None = None) -> CasadiTracking:
    """Build the tracking MPC with the heading free to turn over the horizon.

    min sum_k |x_k - x_ref,k|_Q^2 + |u_k - u_ref,k|_R^2 + |x_N - x_ref,N|_P^2,  x_{k+1} = RK4(D_k x_k + d_k, u_k, h_k),
    p' = v, v' = Rot(theta) F / m, theta' = omega, omega' = tau / I, |u| <= limit

    Args:
        problem: the same that `mpc.solve_tracking` solves with the heading held.
        solver: "fatrop" or "ipopt"; without one fatrop where CasADi has it.

    Returns:
        The problem, for `solve_casadi_tracking`.

    Raises:
        InputError: unknown solver.

    Source: Verhagen & Tumova, Eqs. 31 and 33; with `problem.PUBLISHED_WEIGHTS` App. B.
    """
    import casadi as ca

    solver = solver or ("fatrop" if has_fatrop() else "ipopt")
    if solver not in SOLVERS:
        raise InputError(f"solver '{solver}' is unknown; {choices(solver, SOLVERS)}")
    gain, turn = float(problem.gains[0]), float(problem.gains[2])

    def flow(x: Any, u: Any) -> Any:
        c, s = ca.cos(x[2]), ca.sin(x[2])
        force = ca.vertcat(c * u[0] - s * u[1], s * u[0] + c * u[1])
        return ca.vertcat(x[3:6], gain * force, turn * u[2])

    state, reference = ca.SX.sym("state", 6), ca.SX.sym("reference", 6, STAGES + 1)
    forward, stage = ca.SX.sym("forward", 3, STAGES), ca.SX.sym("stage", 5, STAGES)
    effort, tables = ca.DM(np.diag(problem.effort)), [ca.SX.sym(name, 6, 6) for name in ("stages", "end")]
    x, u = make_variables(6, 3)
    cost, rules = 0, []
    for k in range(STAGES):
        start = ca.vertcat(x[k][:3], bounce(x[k][3:5], stage[:, k]), x[k][5])
        rules += [x[k + 1] - integrate(flow, start, u[k], stage[4, k]), *([x[0] - state] if k == 0 else [])]
        off, push = x[k + 1] - reference[:, k + 1], u[k] - forward[:, k]
        cost += ca.bilin(tables[k == STAGES - 1], off) + ca.bilin(effort, push)
    parameters = ca.vertcat(state, *map(ca.vec, (reference, forward, stage, *tables)))
    program = {"x": interleave(x, u), "f": cost, "g": ca.vertcat(*rules), "p": parameters}
    return compile_mpc(f"tracking MPC by {solver}", solver, program, SOLVERS[solver], problem, 6, problem.limits)


def solve_casadi_tracking(mpc: CasadiTracking, task: TrackingTask) -> np.ndarray:
    """Solve the problem of `build_casadi_tracking`, from its last solution on.

    Args:
        mpc: the problem.
        task: of this step.

    Returns:
        Inputs of all stages in the body frame, shape (10, 3) [N, N, N m].

    Raises:
        SolverFailed: the solver did not converge.
    """
    weights = make_matrices(mpc.problem.select_weights(task.node))
    parts = (task.state, task.states, task.inputs, list_stages(task), weights)
    return solve_mpc(mpc, np.concatenate([part.ravel() for part in parts]))


class CasadiTracker:
    """Track by the MPC of `build_casadi_tracking`.

    Args:
        solver: "fatrop" or "ipopt"; by default fatrop where CasADi has it.
    """

    def __init__(self, solver: str | None = None) -> None:
        self._solver = solver
        self._problems: Mapping[str, TrackingProblem] = {}

    def reset(self, problems: Mapping[str, TrackingProblem]) -> None:
        """See `Tracker.reset`."""
        if problems is not self._problems:
            self._problems = problems
            self._mpcs = {robot: build_casadi_tracking(problem, self._solver) for robot, problem in problems.items()}
        for mpc in self._mpcs.values():
            mpc.guess[:] = 0.0

    def track(self, robot: str, task: TrackingTask) -> np.ndarray:
        """See `Tracker.track`."""
        return solve_casadi_tracking(self._mpcs[robot], task)


def make_variables(nx: int, nu: int) -> tuple[list[Any], list[Any]]:
    """Return symbols of the states at the nodes and of the inputs of the stages."""
    import casadi as ca

    return [ca.SX.sym(f"x{k}", nx) for k in range(STAGES + 1)], [ca.SX.sym(f"u{k}", nu) for k in range(STAGES)]


def interleave(x: list[Any], u: list[Any]) -> Any:
    """Return x_0, u_0, x_1, ..., x_N, the order in which fatrop finds the stages."""
    import casadi as ca

    return ca.vertcat(*(part for pair in zip(x, u, strict=False) for part in pair), x[-1])


def bounce(v: Any, stage: Any) -> Any:
    """Return the velocity after the impact before a stage: v - c (n . v - n . v_O) n, where c = 0 without one."""
    kick = stage[2] * (stage[0] * v[0] + stage[1] * v[1] - stage[3])
    return v - kick * stage[:2]


def integrate(flow: Any, x: Any, u: Any, h: Any) -> Any:
    """Return the state after h seconds with the input held, by the classical Runge-Kutta method."""
    k1 = flow(x, u)
    k2 = flow(x + h / 2 * k1, u)
    k3 = flow(x + h / 2 * k2, u)
    k4 = flow(x + h * k3, u)
    return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def list_stages(task: TrackingTask) -> np.ndarray:
    """Return (n_x, n_y, c, n . v_O, h) of every stage, shape (10, 5); c = 0 where no impact precedes it."""
    stages = np.zeros((STAGES, 5))
    stages[:, 4] = task.durations
    if task.node != NO_JUMP:
        stages[task.node, :4] = task.jump
    return stages


def compile_mpc(
    name: str,
    solver: str,
    program: dict[str, Any],
    options: dict[str, Any],
    problem: TrackingProblem,
    nx: int,
    limits: np.ndarray,
) -> CasadiTracking:
    """Compile a program whose inputs are within limits and whose rules are equalities."""
    import casadi as ca

    free, size = np.full(nx, math.inf), STAGES * (nx + len(limits)) + nx
    upper = np.concatenate([np.tile(np.concatenate([free, limits]), STAGES), free])
    options = {"print_time": False, "error_on_fail": False} | options
    if solver == "fatrop":
        options["equality"] = [True] * program["g"].numel()
    function = ca.nlpsol("mpc", solver, program, options)
    return CasadiTracking(name, problem, function, nx, -upper, upper, np.zeros(size))


def solve_mpc(mpc: CasadiTracking, parameters: np.ndarray) -> np.ndarray:
    """Return the inputs of all stages, shape (10, nu)."""
    begin = time.thread_time()
    found = mpc.solver(x0=mpc.guess, p=parameters, lbx=mpc.lower, ubx=mpc.upper, lbg=0.0, ubg=0.0)
    mpc.seconds = time.thread_time() - begin
    stats = mpc.solver.stats()
    if not stats["success"]:
        raise SolverFailed(mpc.name, str(stats["return_status"]), "check the state and the reference")
    mpc.guess = np.array(found["x"]).ravel()
    return mpc.guess[: -mpc.nx].reshape(STAGES, -1)[:, mpc.nx :].copy()

"""Tracking MPC by CasADi: a reference for `tracking`, nonlinear in the heading, and the published formulation.

Both take what `tracking.solve_tracking` takes, a filled `tracking.Workspace`; they are compiled once and solved with
new parameters. The jump of an impact is an affine map of the state before one stage, and the identity elsewhere.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from impact_envs.errors import InputError, choices
from planners.errors import SolverFailed
from planners.free_flyer.tracking.mpc import NO_JUMP, STAGES, TrackingProblem, Workspace

# Published weights: of position, velocity and attitude, without and with an impact in the horizon; of force and rate.
PUBLISHED = ((5.0, 0.8, 8e3), (1e-3, 8e3, 8e3))
PUBLISHED_EFFORT = (1e-3, 2.0)
TERMINAL = 10.0  # times the weights of the stages
RATE_LIMIT = 0.5  # of the published rate command [rad/s]
SOLVERS: dict[str, dict[str, Any]] = {
    "fatrop": {
        "structure_detection": "auto",
        "fatrop": {"print_level": 0, "tol": 1e-8, "max_iter": 100},
    },
    "ipopt": {"ipopt": {"print_level": 0, "sb": "yes", "tol": 1e-8, "max_iter": 100}},
}
PUBLISHED_OPTIONS = {"ipopt": {"print_level": 0, "sb": "yes", "tol": 1e-2, "max_iter": 100}}


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
        problem: the same that `tracking.solve_tracking` solves with the heading held.
        solver: "fatrop" or "ipopt"; without one fatrop where CasADi has it.

    Returns:
        The problem, for `solve_casadi_tracking`.

    Raises:
        InputError: unknown solver.

    Source: Verhagen & Tumova, Eqs. 31 and 33 with the weights of `tracking.Weights`.
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
    effort, tables = ca.DM(np.diag(problem.effort)), [ca.DM(_make_table(rows)) for rows in problem.weights]
    x, u = _make_variables(6, 3)
    cost, rules = 0, []
    for k in range(STAGES):
        start = ca.vertcat(x[k][:3], _bounce(x[k][3:5], stage[:, k]), x[k][5])
        rules += [x[k + 1] - _integrate(flow, start, u[k], stage[4, k]), *([x[0] - state] if k == 0 else [])]
        off, push = x[k + 1] - reference[:, k + 1], u[k] - forward[:, k]
        cost += ca.bilin(tables[k == STAGES - 1], off) + ca.bilin(effort, push)
    parameters = ca.vertcat(state, *map(ca.vec, (reference, forward, stage)))
    program = {"x": _interleave(x, u), "f": cost, "g": ca.vertcat(*rules), "p": parameters}
    return _compile(f"tracking MPC by {solver}", solver, program, SOLVERS[solver], problem, 6, problem.limits)


def build_published_tracking(problem: TrackingProblem) -> CasadiTracking:
    """Build the published MPC, for ipopt: in space, with an attitude quaternion and rates as inputs.

    min sum_{n < N} |e_n|_Q^2 + |u_n|_R^2 + |e_N|_{Q_N}^2,  e = (p_ref - p, v_ref - v, 1 - (q_ref' q)^2),
    p' = v, v' = Rot(q) F / m, q' = Xi(q) omega / 2, by RK4 and Eq. 6 at an impact

    Args:
        problem: mass and limits of force.

    Returns:
        The problem, for `solve_published_tracking`. Unlike the published code, which has one problem per position of
        an impact in the horizon, this is one problem.

    Source: Verhagen & Tumova, Eqs. 30, 31, 33 and App. B with its weights; options of ipopt and limits of the rates
    from the published code.
    """
    import casadi as ca

    def flow(x: Any, u: Any) -> Any:
        w, v = x[6], x[7:10]
        force = u[:3] + 2 * ca.cross(v, ca.cross(v, u[:3]) + w * u[:3])
        turn = ca.vertcat(-ca.dot(v, u[3:]), w * u[3:] + ca.cross(v, u[3:]))
        return ca.vertcat(x[3:6], float(problem.gains[0]) * force, turn / 2)

    state, reference = ca.SX.sym("state", 10), ca.SX.sym("reference", 10, STAGES + 1)
    weights, stage = ca.SX.sym("weights", 3), ca.SX.sym("stage", 5, STAGES)
    x, u = _make_variables(10, 6)

    def weigh(k: int) -> Any:
        p, v, q = (
            x[k][:3] - reference[:3, k],
            x[k][3:6] - reference[3:6, k],
            1 - ca.dot(x[k][6:], reference[6:, k]) ** 2,
        )
        return weights[0] * ca.sumsqr(p) + weights[1] * ca.sumsqr(v) + weights[2] * q**2

    cost, rules = TERMINAL * weigh(STAGES), []
    for k in range(STAGES):
        start = ca.vertcat(x[k][:3], _bounce(x[k][3:5], stage[:, k]), x[k][5:])
        rules += [x[k + 1] - _integrate(flow, start, u[k], stage[4, k]), *([x[0] - state] if k == 0 else [])]
        cost += weigh(k) + PUBLISHED_EFFORT[0] * ca.sumsqr(u[k][:3]) + PUBLISHED_EFFORT[1] * ca.sumsqr(u[k][3:])
    parameters = ca.vertcat(state, ca.vec(reference), weights, ca.vec(stage))
    program = {"x": _interleave(x, u), "f": cost, "g": ca.vertcat(*rules), "p": parameters}
    limits = np.array([problem.limits[0]] * 3 + [RATE_LIMIT] * 3)
    mpc = _compile("published MPC by ipopt", "ipopt", program, PUBLISHED_OPTIONS, problem, 10, limits)
    mpc.guess[6::16] = 1.0
    return mpc


def solve_casadi_tracking(mpc: CasadiTracking, workspace: Workspace, c: int = 0) -> np.ndarray:
    """Solve the problem of `build_casadi_tracking`, from its last solution on.

    Args:
        mpc: the problem.
        workspace: with state and reference filled in.
        c: thread.

    Returns:
        Inputs of all stages in the body frame, shape (10, 3) [N, N, N m].

    Raises:
        SolverFailed: the solver did not converge.
    """
    parts = (workspace.state[c], workspace.states[c], workspace.inputs[c], _list_stages(workspace, c))
    return _solve(mpc, np.concatenate([part.ravel() for part in parts]))


def solve_published_tracking(mpc: CasadiTracking, workspace: Workspace, c: int = 0) -> np.ndarray:
    """Solve the problem of `build_published_tracking`, from its last solution on.

    Args:
        mpc: the problem.
        workspace: with state and reference filled in.
        c: thread.

    Returns:
        First input [Fx, Fy, torque]; the torque reaches the commanded rate within one period, shape (3,) [N, N, N m].

    Raises:
        SolverFailed: the solver did not converge.
    """
    state, reference = _lift(workspace.state[c : c + 1]), _lift(workspace.states[c])
    weights = np.array(PUBLISHED[int(workspace.node[c] != NO_JUMP)])
    problem, parts = mpc.problem, (state, reference, weights, _list_stages(workspace, c))
    first = _solve(mpc, np.concatenate([part.ravel() for part in parts]))[0]
    torque = (first[5] - workspace.state[c, 5]) / (problem.gains[2] * problem.period)
    return np.array([first[0], first[1], np.clip(torque, -problem.limits[2], problem.limits[2])])


def _make_table(rows: np.ndarray) -> np.ndarray:
    """Return the weight matrix of a state from (pp, pv, vv) of each axis."""
    pp, pv, vv = (np.diag(column) for column in rows.T)
    return np.block([[pp, pv], [pv, vv]])


def _make_variables(nx: int, nu: int) -> tuple[list[Any], list[Any]]:
    import casadi as ca

    return [ca.SX.sym(f"x{k}", nx) for k in range(STAGES + 1)], [ca.SX.sym(f"u{k}", nu) for k in range(STAGES)]


def _interleave(x: list[Any], u: list[Any]) -> Any:
    """Return x_0, u_0, x_1, ..., x_N, the order in which fatrop finds the stages."""
    import casadi as ca

    return ca.vertcat(*(part for pair in zip(x, u, strict=False) for part in pair), x[-1])


def _bounce(v: Any, stage: Any) -> Any:
    """Return the velocity after the impact before a stage: v - c (n . v - n . v_O) n, where c = 0 without one."""
    kick = stage[2] * (stage[0] * v[0] + stage[1] * v[1] - stage[3])
    return v - kick * stage[:2]


def _integrate(flow: Any, x: Any, u: Any, h: Any) -> Any:
    """Return the state after h seconds with the input held, by the classical Runge-Kutta method."""
    k1 = flow(x, u)
    k2 = flow(x + h / 2 * k1, u)
    k3 = flow(x + h / 2 * k2, u)
    k4 = flow(x + h * k3, u)
    return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def _list_stages(workspace: Workspace, c: int) -> np.ndarray:
    """Return (n_x, n_y, c, n . v_O, h) of every stage, shape (10, 5); c = 0 where no impact precedes it."""
    stages = np.zeros((STAGES, 5))
    stages[:, 4] = workspace.durations[c]
    node = int(workspace.node[c])
    if node != NO_JUMP:
        stages[node, :4] = workspace.jump[c]
    return stages


def _lift(states: np.ndarray) -> np.ndarray:
    """Return planar states as [p, v, q] in space, shape (n, 10)."""
    lifted = np.zeros((len(states), 10))
    lifted[:, :2], lifted[:, 3:5] = states[:, :2], states[:, 3:5]
    lifted[:, 6], lifted[:, 9] = np.cos(states[:, 2] / 2), np.sin(states[:, 2] / 2)
    return lifted


def _compile(
    name: str,
    solver: str,
    program: dict[str, Any],
    options: dict[str, Any],
    problem: TrackingProblem,
    nx: int,
    limits: np.ndarray,
) -> CasadiTracking:
    import casadi as ca

    free, size = np.full(nx, math.inf), STAGES * (nx + len(limits)) + nx
    upper = np.concatenate([np.tile(np.concatenate([free, limits]), STAGES), free])
    options = {"print_time": False, "error_on_fail": False} | options
    if solver == "fatrop":
        options["equality"] = [True] * program["g"].numel()
    function = ca.nlpsol("mpc", solver, program, options)
    return CasadiTracking(name, problem, function, nx, -upper, upper, np.zeros(size))


def _solve(mpc: CasadiTracking, parameters: np.ndarray) -> np.ndarray:
    """Return the inputs of all stages, shape (10, nu)."""
    begin = time.thread_time()
    found = mpc.solver(x0=mpc.guess, p=parameters, lbx=mpc.lower, ubx=mpc.upper, lbg=0.0, ubg=0.0)
    mpc.seconds = time.thread_time() - begin
    stats = mpc.solver.stats()
    if not stats["success"]:
        raise SolverFailed(mpc.name, str(stats["return_status"]), "check the state and the reference")
    mpc.guess = np.array(found["x"]).ravel()
    return mpc.guess[: -mpc.nx].reshape(STAGES, -1)[:, mpc.nx :].copy()

"""The published tracking MPC, for ipopt: in space, with an attitude quaternion and rates as inputs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from planners.errors import SolverFailed
from planners.free_flyer.tracking.casadi_mpc import (
    CasadiTracking,
    bounce,
    compile_mpc,
    integrate,
    interleave,
    list_stages,
    make_variables,
    solve_mpc,
)
from planners.free_flyer.tracking.problem import NO_JUMP, PUBLISHED_WEIGHTS, STAGES, TrackingProblem, TrackingTask

# Published weights: of position, velocity and attitude, without and with an impact in the horizon; of force and rate.
ATTITUDE, RATE = 8e3, 2.0
PUBLISHED = (
    (PUBLISHED_WEIGHTS.position, PUBLISHED_WEIGHTS.velocity, ATTITUDE),
    (PUBLISHED_WEIGHTS.near_position, PUBLISHED_WEIGHTS.near_velocity, ATTITUDE),
)
PUBLISHED_EFFORT = (PUBLISHED_WEIGHTS.force, RATE)
TERMINAL = PUBLISHED_WEIGHTS.terminal
RATE_LIMIT = 0.5  # of the published rate command [rad/s]
PUBLISHED_OPTIONS = {"ipopt": {"print_level": 0, "sb": "yes", "tol": 1e-2, "max_iter": 100}}


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
    x, u = make_variables(10, 6)

    def weigh(k: int) -> Any:
        p, v, q = (
            x[k][:3] - reference[:3, k],
            x[k][3:6] - reference[3:6, k],
            1 - ca.dot(x[k][6:], reference[6:, k]) ** 2,
        )
        return weights[0] * ca.sumsqr(p) + weights[1] * ca.sumsqr(v) + weights[2] * q**2

    cost, rules = TERMINAL * weigh(STAGES), []
    for k in range(STAGES):
        start = ca.vertcat(x[k][:3], bounce(x[k][3:5], stage[:, k]), x[k][5:])
        rules += [x[k + 1] - integrate(flow, start, u[k], stage[4, k]), *([x[0] - state] if k == 0 else [])]
        cost += weigh(k) + PUBLISHED_EFFORT[0] * ca.sumsqr(u[k][:3]) + PUBLISHED_EFFORT[1] * ca.sumsqr(u[k][3:])
    parameters = ca.vertcat(state, ca.vec(reference), weights, ca.vec(stage))
    program = {"x": interleave(x, u), "f": cost, "g": ca.vertcat(*rules), "p": parameters}
    limits = np.array([problem.limits[0]] * 3 + [RATE_LIMIT] * 3)
    mpc = compile_mpc("published MPC by ipopt", "ipopt", program, PUBLISHED_OPTIONS, problem, 10, limits)
    start_at_rest(mpc)
    return mpc


def solve_published_tracking(mpc: CasadiTracking, task: TrackingTask) -> np.ndarray:
    """Solve the problem of `build_published_tracking`, from its last solution on.

    Args:
        mpc: the problem.
        task: of this step.

    Returns:
        First input [Fx, Fy, torque]; the torque reaches the commanded rate within one period, shape (3,) [N, N, N m].

    Raises:
        SolverFailed: the solver did not converge.
    """
    state, reference = _lift(task.state[None]), _lift(task.states)
    weights = np.array(PUBLISHED[int(task.node != NO_JUMP)])
    problem, parts = mpc.problem, (state, reference, weights, list_stages(task))
    first = solve_mpc(mpc, np.concatenate([part.ravel() for part in parts]))[0]
    torque = (first[5] - task.state[5]) / (problem.gains[2] * problem.period)
    return np.array([first[0], first[1], np.clip(torque, -problem.limits[2], problem.limits[2])])


class PublishedTracker:
    """Track by the published MPC; where its solver fails nothing is thrust, as in the published code."""

    def __init__(self) -> None:
        self._problems: Mapping[str, TrackingProblem] = {}

    def reset(self, problems: Mapping[str, TrackingProblem]) -> None:
        """See `Tracker.reset`."""
        if problems is not self._problems:
            self._problems = problems
            self._mpcs = {robot: build_published_tracking(problem) for robot, problem in problems.items()}
        for mpc in self._mpcs.values():
            start_at_rest(mpc)

    def track(self, robot: str, task: TrackingTask) -> np.ndarray:
        """See `Tracker.track`."""
        try:
            return solve_published_tracking(self._mpcs[robot], task)[None]
        except SolverFailed:
            return np.zeros((1, 3))


def start_at_rest(mpc: CasadiTracking) -> None:
    """Let the next solve start from unturned bodies at the origin."""
    mpc.guess[:] = 0.0
    mpc.guess[6::16] = 1.0


def _lift(states: np.ndarray) -> np.ndarray:
    """Return planar states as [p, v, q] in space, shape (n, 10)."""
    lifted = np.zeros((len(states), 10))
    lifted[:, :2], lifted[:, 3:5] = states[:, :2], states[:, 3:5]
    lifted[:, 6], lifted[:, 9] = np.cos(states[:, 2] / 2), np.sin(states[:, 2] / 2)
    return lifted

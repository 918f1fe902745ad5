"""Tracking control of one free-flyer: impact-aware MPC as one box-constrained QP, and LQR as its fallback.

State (q, v) = [x, y, heading, vx, vy, omega] in the world frame, input [Fx, Fy, torque] in the body frame. With the
heading held over the horizon the dynamics are linear and the whole problem condenses into the inputs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numba import njit
from scipy.linalg import solve_discrete_are

from planners.errors import SolverFailed
from planners.free_flyer.box_qp import NEWTON_STEPS, NOT_SOLVED, solve_box_qp

STAGES = 10  # 1 s at 10 Hz: Verhagen & Tumova, App. B
NO_JUMP = 0

Source = Literal["mpc", "shifted_plan", "lqr"]


@dataclass(frozen=True)
class Weights:
    """Weights of the tracking cost; chosen in closed loop, they replace those of Verhagen & Tumova, App. B.

    Args:
        position, velocity: on errors of position [1/m^2] and velocity [s^2/m^2].
        heading, rate: on errors of heading [1/rad^2] and angular velocity [s^2/rad^2].
        force, torque: on deviations from the feed-forward force [1/N^2] and torque [1/(N m)^2].
    """

    position: float = 40.0
    velocity: float = 40.0
    heading: float = 5.0
    rate: float = 0.5
    force: float = 0.05
    torque: float = 0.1


class Actuated(Protocol):
    """A body with force and torque limits, such as a scenario's robot."""

    @property
    def mass(self) -> float:
        """Return the mass [kg]."""

    @property
    def inertia(self) -> float:
        """Return the moment of inertia [kg m^2]."""

    @property
    def force_limit(self) -> float:
        """Return the greatest force per body axis [N]."""

    @property
    def torque_limit(self) -> float:
        """Return the greatest torque [N m]."""


@dataclass(frozen=True, eq=False)
class TrackingProblem:
    """Hold the MPC compiled for one robot: what stays the same from step to step.

    Args:
        period: control period [s].
        gains: acceleration per input, shape (3,) [1/kg, 1/kg, 1/(kg m^2)].
        limits: greatest input of either sign, shape (3,) [N, N, N m].
        weights: (pp, pv, vv) of each axis x, y, heading: at the stages, then at the end, shape (2, 3, 3).
        effort: diagonal of R, shape (3,).
        feedback: LQR gain (position, velocity) of each axis, shape (3, 2).
    """

    period: float
    gains: np.ndarray
    limits: np.ndarray
    weights: np.ndarray
    effort: np.ndarray
    feedback: np.ndarray


@dataclass(frozen=True, eq=False)
class Reference:
    """Hold what the robot should do over the horizon.

    Args:
        states: at the nodes 0..10, shape (11, 6); at the node of a predicted impact the state just before it.
        inputs: feed-forward inputs of the stages in the body frame, shape (10, 3) [N, N, N m].
        durations: of the stages, shape (10,) [s].
        jump_node: node of a predicted impact, 1..9; NO_JUMP without one.
        normal: unit vector from robot to object, shape (2,).
        jump_gain: c = (1 + e) m_O / (m_R + m_O).
        object_speed: v_O . n, speed of the object along the normal before the impact [m/s].
    """

    states: np.ndarray
    inputs: np.ndarray
    durations: np.ndarray
    jump_node: int = NO_JUMP
    normal: tuple[float, float] = (1.0, 0.0)
    jump_gain: float = 0.0
    object_speed: float = 0.0


def build_tracking_problem(robot: Actuated, period: float, weights: Weights = Weights()) -> TrackingProblem:
    """Build the tracking MPC of one robot.

    Args:
        robot: mass [kg], inertia [kg m^2] and limits [N, N m].
        period: control period [s].
        weights: of the cost.

    Returns:
        The problem, with the infinite-horizon cost as terminal weight.

    Source: Verhagen & Tumova, Eq. 31 and App. B; terminal weight: discrete algebraic Riccati equation.
    """
    gains = np.array([1.0 / robot.mass, 1.0 / robot.mass, 1.0 / robot.inertia])
    position = np.array([weights.position, weights.position, weights.heading])
    velocity = np.array([weights.velocity, weights.velocity, weights.rate])
    effort = np.array([weights.force, weights.force, weights.torque])
    table, feedback = np.zeros((2, 3, 3)), np.zeros((3, 2))
    table[0, :, 0], table[0, :, 2] = position, velocity
    A = np.array([[1.0, period], [0.0, 1.0]])
    for axis in range(3):
        B = gains[axis] * np.array([[period**2 / 2], [period]])
        R = effort[axis].reshape(1, 1)
        P = solve_discrete_are(A, B, np.diag([position[axis], velocity[axis]]), R)
        table[1, axis] = P[0, 0], P[0, 1], P[1, 1]
        feedback[axis] = np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)[0]
    limits = np.array([robot.force_limit, robot.force_limit, robot.torque_limit])
    return TrackingProblem(period, gains, limits, table, effort, feedback)


@njit(cache=True)
def jump(z: np.ndarray, normal: tuple[float, float], gain: float, object_speed: float) -> None:
    """Apply the impact to a state in place: v+ = v- - c (n . v- - n . v_O) n.

    Args:
        z: state, shape (6,).
        normal: unit vector n from robot to object.
        gain: c = (1 + e) m_O / (m_R + m_O).
        object_speed: n . v_O [m/s].

    Source: Verhagen & Tumova, Eq. 6, solved for the robot.
    """
    kick = gain * (normal[0] * z[3] + normal[1] * z[4] - object_speed)
    z[3] -= kick * normal[0]
    z[4] -= kick * normal[1]


@njit(cache=True)
def push(z: np.ndarray, axis: int, acceleration: float, h: float) -> None:
    """Add the effect of an acceleration held over a stage to a state in place.

    Args:
        z: state at the end of the stage, shape (6,).
        axis: 0, 1, 2 for x, y, heading.
        acceleration: along that axis [m/s^2, rad/s^2].
        h: duration of the stage [s].
    """
    z[axis] += h * h / 2 * acceleration
    z[3 + axis] += h * acceleration


@njit(cache=True)
def push_body(z: np.ndarray, channel: int, u: float, heading: float, gains: np.ndarray, h: float) -> None:
    """Add the effect of one input channel, given in the body frame, held over a stage, to a state in place.

    Args:
        z: state at the end of the stage, shape (6,).
        channel: 0, 1, 2 for Fx, Fy, torque.
        u: input [N, N m].
        heading: of the body [rad].
        gains: acceleration per input, shape (3,).
        h: duration of the stage [s].
    """
    a = gains[channel] * u
    c, s = math.cos(heading), math.sin(heading)
    if channel == 0:
        push(z, 0, c * a, h)
        push(z, 1, s * a, h)
    elif channel == 1:
        push(z, 0, -s * a, h)
        push(z, 1, c * a, h)
    else:
        push(z, 2, a, h)


@njit(cache=True)
def condense(
    state: np.ndarray,
    states: np.ndarray,
    inputs: np.ndarray,
    durations: np.ndarray,
    jump_node: int,
    normal: tuple[float, float],
    jump_gain: float,
    object_speed: float,
    gains: np.ndarray,
    weights: np.ndarray,
    effort: np.ndarray,
    Z: np.ndarray,
    H: np.ndarray,
    g: np.ndarray,
) -> None:
    """Condense the tracking problem into the deviations d = u - u_ref.

    sum_k |x_k - x_ref,k|^2_Q + |d_k|^2_R + |x_N - x_ref,N|^2_P  =  d' H d + 2 g' d + const, with
    x_{k+1} = A(h_k) x_k + B(h_k) u_k, and the jump of an impact before the stage that starts at its node.

    Args:
        state: measured state, shape (6,); its heading turns the forces over the whole horizon.
        states, inputs, durations, jump_node, normal, jump_gain, object_speed: see `Reference`.
        gains, weights, effort: see `TrackingProblem`.
        Z: scratch, shape (31, 6): row i is the sensitivity of the state to input i, the last row the state itself.
        H: Hessian, written, shape (30, 30).
        g: gradient at d = 0, written, shape (30,).

    Source: Verhagen & Tumova, Eqs. 6, 31 and 33.
    """
    size, stages, heading = len(g), len(durations), state[2]
    Z[:] = 0.0
    H[:] = 0.0
    g[:] = 0.0
    for i in range(6):
        Z[size, i] = state[i]
    for k in range(stages):
        h = durations[k]
        for i in range(3 * k + 1):
            z, speed = (Z[size], object_speed) if i == 3 * k else (Z[i], 0.0)
            if k == jump_node and k > 0:
                jump(z, normal, jump_gain, speed)
            for axis in range(3):
                z[axis] += h * z[3 + axis]
        for channel in range(3):
            push_body(Z[size], channel, inputs[k, channel], heading, gains, h)
            push_body(Z[3 * k + channel], channel, 1.0, heading, gains, h)
        W = weights[1] if k == stages - 1 else weights[0]
        for i in range(3 * k + 3):
            for axis in range(3):
                position = W[axis, 0] * Z[i, axis] + W[axis, 1] * Z[i, 3 + axis]
                velocity = W[axis, 1] * Z[i, axis] + W[axis, 2] * Z[i, 3 + axis]
                g[i] += position * (Z[size, axis] - states[k + 1, axis])
                g[i] += velocity * (Z[size, 3 + axis] - states[k + 1, 3 + axis])
                for j in range(i + 1):
                    H[i, j] += position * Z[j, axis] + velocity * Z[j, 3 + axis]
    for i in range(size):
        H[i, i] += effort[i % 3]
        for j in range(i):
            H[j, i] = H[i, j]


class Tracker:
    """Track a reference by MPC; if it fails by the plan of the last success, then by LQR.

    Args:
        problem: the MPC compiled for this robot.
        max_steps: Newton steps allowed per solve.
    """

    def __init__(self, problem: TrackingProblem, max_steps: int = NEWTON_STEPS) -> None:
        n = 3 * STAGES
        self.problem = problem
        self.max_steps = max_steps
        self._Z, self._H, self._L = np.zeros((n + 1, 6)), np.zeros((n, n)), np.zeros((n, n))
        self._g, self._d, self._trial, self._x = np.zeros((4, n))
        self._free = np.zeros(n, dtype=np.bool_)
        self._plan = np.zeros((0, 3))

    def reset(self) -> None:
        """Forget the plan of the last success."""
        self._plan = np.zeros((0, 3))

    def solve(self, state: np.ndarray, reference: Reference) -> np.ndarray:
        """Solve the MPC.

        Args:
            state: measured state, shape (6,).
            reference: what to do over the horizon.

        Returns:
            Inputs of all stages, shape (10, 3) [N, N, N m].

        Raises:
            SolverFailed: the QP was not solved within the Newton steps allowed.
        """
        p, r = self.problem, reference
        impact = r.jump_node, r.normal, r.jump_gain, r.object_speed
        matrices = self._Z, self._H, self._g
        condense(state, r.states, r.inputs, r.durations, *impact, p.gains, p.weights, p.effort, *matrices)
        lower, upper = (-p.limits - r.inputs).ravel(), (p.limits - r.inputs).ravel()
        self._x[:] = 0.0
        scratch = self._L, self._d, self._trial, self._free
        steps = solve_box_qp(self._H, self._g, lower, upper, self._x, *scratch, self.max_steps)
        if steps == NOT_SOLVED:
            raise SolverFailed("tracking QP", f"not solved in {self.max_steps} Newton steps", "allow more of them")
        return r.inputs + self._x.reshape(STAGES, 3)

    def control(self, state: np.ndarray, reference: Reference) -> tuple[np.ndarray, Source]:
        """Return the input to apply now, and where it came from.

        Args:
            state: measured state, shape (6,).
            reference: what to do over the horizon.

        Returns:
            Input in the body frame, shape (3,) [N, N, N m], within the limits; "mpc", "shifted_plan" or "lqr".
        """
        source: Source = "mpc"
        try:
            self._plan = self.solve(state, reference)
        except SolverFailed:
            if len(self._plan) == 0:
                return compute_lqr(self.problem, state, reference), "lqr"
            source = "shifted_plan"
        u, self._plan = self._plan[0], self._plan[1:]
        return np.clip(u, -self.problem.limits, self.problem.limits), source


def compute_lqr(problem: TrackingProblem, state: np.ndarray, reference: Reference) -> np.ndarray:
    """Return the input of LQR with feed-forward, clipped to the limits.

    u = u_ref - K_p R(heading)' (q - q_ref) - K_v R(heading)' (v - v_ref)

    Args:
        problem: gains and limits.
        state: measured state, shape (6,).
        reference: its node 0 and first feed-forward input are used.

    Returns:
        Input in the body frame, shape (3,) [N, N, N m].
    """
    error = state - reference.states[0]
    c, s = math.cos(state[2]), math.sin(state[2])
    turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    K = problem.feedback
    u = reference.inputs[0] - K[:, 0] * (turn @ error[:3]) - K[:, 1] * (turn @ error[3:])
    return np.clip(u, -problem.limits, problem.limits)

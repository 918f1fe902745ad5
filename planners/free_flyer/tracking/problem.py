"""The tracking problem of one robot: what stays the same from step to step, and what a step brings.

State (q, v) = [x, y, heading, vx, vy, omega] in the world frame, input [Fx, Fy, torque] in the body frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple, Protocol

import numpy as np

from planners.options import Positive

STAGES = 10  # 1 s at 10 Hz: Verhagen & Tumova, App. B
NO_JUMP = 0

# Columns of TrackingProblem.row: acceleration per input; limits; weights (pp, pv, vv) of each axis at the stages, then
# at the end; effort; feedback (position, velocity) of each axis; weights with an impact in the horizon; 1 if the weight
# of the end is the cost of going on for ever, 0 otherwise.
GAIN, INPUT_LIMIT, WEIGHT, EFFORT, FEEDBACK, NEAR_WEIGHT, ENDLESS = 0, 3, 6, 24, 27, 33, 51


DOUBLINGS = 60  # of the horizon, at most: of a Riccati equation that is followed to the end
Matrix = tuple[tuple[float, float], tuple[float, float]]


@dataclass(frozen=True)
class Weights:
    """Weights of the tracking cost; chosen in closed loop, they replace those of Verhagen & Tumova, App. B.

    Args:
        position, velocity: on errors of position [1/m^2] and velocity [s^2/m^2].
        near_position, near_velocity: the same, while an impact is in the horizon.
        heading, rate: on errors of heading [1/rad^2] and angular velocity [s^2/rad^2].
        force, torque: on deviations from the feed-forward force [1/N^2] and torque [1/(N m)^2].
        terminal: of the end over those of the stages; 0: the cost of going on for ever.
    """

    position: Positive = 40.0
    velocity: Positive = 40.0
    near_position: Positive = 40.0
    near_velocity: Positive = 40.0
    heading: Positive = 5.0
    rate: Positive = 0.5
    force: Positive = 0.05
    torque: Positive = 20.0
    terminal: float = 0.0


# App. B. The square of its error of attitude, 1 - (q_ref' q)^2, has no curvature where it is zero: the heading, which
# nothing turns in the paper, keeps the weights above.
PUBLISHED_WEIGHTS = Weights(
    position=5.0, velocity=0.8, near_position=1e-3, near_velocity=8e3, force=1e-3, terminal=10.0
)


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
        near: the same with an impact in the horizon, shape (2, 3, 3).
        endless: whether the weight of the end is the cost of going on for ever.
        effort: diagonal of R, shape (3,).
        feedback: LQR gain (position, velocity) of each axis, shape (3, 2).
    """

    period: float
    gains: np.ndarray
    limits: np.ndarray
    weights: np.ndarray
    near: np.ndarray
    endless: bool
    effort: np.ndarray
    feedback: np.ndarray

    def select_weights(self, node: int) -> np.ndarray:
        """Return the weights of a step whose predicted impact comes at a node, or is not there, shape (2, 3, 3)."""
        return self.weights if node == NO_JUMP else self.near

    @property
    def row(self) -> np.ndarray:
        """Return everything but the period as one row for compiled code, shape (52,)."""
        parts = (self.gains, self.limits, self.weights.ravel(), self.effort, self.feedback.ravel())
        return np.concatenate([*parts, self.near.ravel(), [float(self.endless)]])


def build_tracking_problem(robot: Actuated, period: float, weights: Weights = Weights()) -> TrackingProblem:
    """Build the tracking MPC of one robot.

    Args:
        robot: mass [kg], inertia [kg m^2] and limits [N, N m].
        period: control period [s].
        weights: of the cost.

    Returns:
        The problem; feedback is the LQR of the weights without an impact.

    Source: Verhagen & Tumova, Eq. 31 and App. B; terminal weight: discrete algebraic Riccati equation.
    """
    gains = np.array([1.0 / robot.mass, 1.0 / robot.mass, 1.0 / robot.inertia])
    effort = np.array([weights.force, weights.force, weights.torque])
    far, feedback = _weigh(weights.position, weights.velocity, weights, gains, period)
    near, _ = _weigh(weights.near_position, weights.near_velocity, weights, gains, period)
    limits = np.array([robot.force_limit, robot.force_limit, robot.torque_limit])
    return TrackingProblem(period, gains, limits, far, near, weights.terminal == 0.0, effort, feedback)


def _weigh(
    position: float, velocity: float, weights: Weights, gains: np.ndarray, period: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return a table of weights as in `TrackingProblem`, and the LQR gain of each axis, shape (3, 2)."""
    table, feedback = np.zeros((2, 3, 3)), np.zeros((3, 2))
    table[0, :, 0], table[0, :, 2] = (position, position, weights.heading), (velocity, velocity, weights.rate)
    table[1] = weights.terminal * table[0]
    for axis, effort in enumerate((weights.force, weights.force, weights.torque)):
        gain = float(gains[axis])
        moved, pushed = gain * period * period / 2.0, gain * period  # what a unit of input does to place and velocity
        now = float(table[0, axis, 0]), float(table[0, axis, 2])
        pp, pv, vv = solve_riccati(period, (moved, pushed), now, effort)
        if weights.terminal == 0.0:
            table[1, axis] = pp, pv, vv
        place, speed = moved * pp + pushed * pv, moved * pv + pushed * vv
        total = effort + moved * place + pushed * speed
        feedback[axis] = place / total, (place * period + speed) / total
    return table, feedback


@lru_cache(256)  # robots are alike, and an evaluation makes their experts again and again
def solve_riccati(
    period: float, B: tuple[float, float], weights: tuple[float, float], effort: float
) -> tuple[float, float, float]:
    """Solve P = Q + A' P (1 + B B' P / r)^-1 A with A = (1, T; 0, 1) by doubling the horizon until P stays as it is.

    Plain sums and products, unlike LAPACK's the same on every processor.

    Args:
        period: T [s].
        B: what a unit of input does to place and velocity.
        weights: diagonal of Q, on place and velocity, positive.
        effort: r, on the input, positive.

    Returns:
        P_11, P_12 and P_22.

    Source: Chu, Fan, Lin & Wang, *Structure-Preserving Algorithms for Periodic Discrete-Time Algebraic Riccati
        Equations*, Int. J. Control 77 (2004).
    """
    A = ((1.0, period), (0.0, 1.0))
    G = ((B[0] * B[0] / effort, B[0] * B[1] / effort), (B[0] * B[1] / effort, B[1] * B[1] / effort))
    P = ((weights[0], 0.0), (0.0, weights[1]))
    for _ in range(DOUBLINGS):
        (w11, w12), (w21, w22) = multiply(G, P)
        w11, w22 = 1.0 + w11, 1.0 + w22
        d = w11 * w22 - w12 * w21
        inverse = ((w22 / d, -w12 / d), (-w21 / d, w11 / d))
        turned, step = ((A[0][0], A[1][0]), (A[0][1], A[1][1])), multiply(inverse, A)
        (p11, p12), (_, p22) = multiply(turned, multiply(P, step))
        (g11, g12), (_, g22) = multiply(A, multiply(multiply(inverse, G), turned))
        last, A = P, multiply(A, step)
        P = ((P[0][0] + p11, P[0][1] + p12), (P[0][1] + p12, P[1][1] + p22))
        G = ((G[0][0] + g11, G[0][1] + g12), (G[0][1] + g12, G[1][1] + g22))
        if last == P:
            break
    return P[0][0], P[0][1], P[1][1]


def multiply(a: Matrix, b: Matrix) -> Matrix:
    """Return the product of two matrices of two rows and columns."""
    (a11, a12), (a21, a22) = a
    (b11, b12), (b21, b22) = b
    return (a11 * b11 + a12 * b21, a11 * b12 + a12 * b22), (a21 * b11 + a22 * b21, a21 * b12 + a22 * b22)


def make_matrices(weights: np.ndarray) -> np.ndarray:
    """Return a table of weights as matrices: at the stages, then at the end, shape (2, 6, 6)."""
    blocks = [[np.diag(column) for column in rows.T] for rows in weights]
    return np.array([np.block([[pp, pv], [pv, vv]]) for pp, pv, vv in blocks])


class TrackingTask(NamedTuple):
    """What one robot has to track in one step, over N = 10 stages.

    Attributes:
        state: measured, shape (6,).
        states: reference at the nodes 0..N; at the node of a predicted impact the state just before it, shape (N+1, 6).
        inputs: feed-forward inputs of the stages in the body frame, shape (N, 3) [N, N, N m].
        durations: of the stages; a border between two is moved onto the impact, shape (N,) [s].
        node: of the predicted impact, 1..N-1, which comes before the stage that starts there; NO_JUMP without one.
        jump: (n_x, n_y, c, n . v_O) of that impact: v+ = v- - c (n . v- - n . v_O) n; meaningless without one, shape
            (4,).
    """

    state: np.ndarray
    states: np.ndarray
    inputs: np.ndarray
    durations: np.ndarray
    node: int
    jump: np.ndarray

    def has_impact_before(self, k: int) -> bool:
        """Return whether the predicted impact comes just before stage k."""
        return self.node == k != NO_JUMP

    @property
    def normal(self) -> np.ndarray:
        """Return the unit vector n from robot to object, shape (2,)."""
        return self.jump[:2]

    @property
    def gain(self) -> float:
        """Return c = (1 + e) m_O / (m_R + m_O)."""
        return float(self.jump[2])

    @property
    def object_speed(self) -> float:
        """Return the object's velocity along the normal before the impact [m/s]."""
        return float(self.jump[3])

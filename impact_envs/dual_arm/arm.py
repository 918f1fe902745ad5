"""Kinematics and dynamics of a planar arm with three joints.

Joint angles q are relative; absolute angles a are their running sums. In a, the mass matrix is
H_ij = C_ij cos(a_i - a_j), and joint torques tau act as (tau_1 - tau_2, tau_2 - tau_3, tau_3).
An arm is a row of numbers: base x, y, lengths 1 to 3, C_11, C_12, C_13, C_22, C_23, C_33, gravity loads G_1 to G_3.
"""

from __future__ import annotations

import math

import numpy as np

from impact_envs.compiled import compiled, interpret
from impact_envs.elementary import atan2, cos_sin
from impact_envs.errors import InputError

Three = tuple[float, float, float]
# Columns of an arm's row.
X, Y, L1, L2, L3, C11, C12, C13, C22, C23, C33, G1, G2, G3 = range(14)
SIZE = 14


def make_arm(
    base: tuple[float, float], lengths: Three, masses: Three, centers: Three, inertias: Three, g: float
) -> np.ndarray:
    """Collect the numbers of one arm.

    C_ii = I_i + m_i c_i^2 + (sum of later masses) l_i^2, C_ij = l_i (m_j c_j + (sum of masses after j) l_j), j > i;
    G_i = g (m_i c_i + (sum of later masses) l_i).

    Args:
        base: of the first joint [m].
        lengths: l_i of the links [m].
        masses: m_i [kg].
        centers: c_i, distance of each centre of mass from the link's joint [m].
        inertias: I_i about the centres of mass [kg m^2].
        g: gravity, along -y [m/s^2].

    Returns:
        Shape (14,).
    """
    later = [sum(masses[i + 1 :]) for i in range(3)]
    load = [masses[i] * centers[i] + later[i] * lengths[i] for i in range(3)]
    squares = [(center * center, length * length) for center, length in zip(centers, lengths, strict=True)]
    diagonal = [inertias[i] + masses[i] * squares[i][0] + later[i] * squares[i][1] for i in range(3)]
    couplings = [
        diagonal[0],
        lengths[0] * load[1],
        lengths[0] * load[2],
        diagonal[1],
        lengths[1] * load[2],
        diagonal[2],
    ]
    return np.array([*base, *lengths, *couplings, *(g * moment for moment in load)])


@compiled
def compute_pose(arm: np.ndarray, q1: float, q2: float, q3: float) -> tuple[float, float, float]:
    """Return position x, y [m] and angle [rad] of the arm's end."""
    a1, a2, a3 = q1, q1 + q2, q1 + q2 + q3
    (c1, s1), (c2, s2), (c3, s3) = cos_sin(a1), cos_sin(a2), cos_sin(a3)
    x = arm[X] + arm[L1] * c1 + arm[L2] * c2 + arm[L3] * c3
    y = arm[Y] + arm[L1] * s1 + arm[L2] * s2 + arm[L3] * s3
    return x, y, a3


@compiled
def solve_arm(
    arm: np.ndarray,
    directions: tuple[tuple[float, float], tuple[float, float], tuple[float, float]],
    w1: float,
    w2: float,
    w3: float,
    f1: float,
    f2: float,
    f3: float,
) -> tuple[float, float, float]:
    """Return the absolute angular accelerations under generalised forces.

    H a'' = f - b with b_i = sum_j C_ij sin(a_i - a_j) a_j'^2 + G_i cos(a_i).

    Args:
        arm: the arm's row.
        directions: cosine and sine of the absolute angles.
        w1, w2, w3: their rates [rad/s].
        f1, f2, f3: forces on the absolute angles [N m].

    Returns:
        a'' [rad/s^2].
    """
    (c1, s1), (c2, s2), (c3, s3) = directions
    # Of differences of angles: cos(a - b) = cos a cos b + sin a sin b, sin(a - b) = sin a cos b - cos a sin b.
    s12, s13, s23 = arm[C12] * (s1 * c2 - c1 * s2), arm[C13] * (s1 * c3 - c1 * s3), arm[C23] * (s2 * c3 - c2 * s3)
    h12, h13, h23 = arm[C12] * (c1 * c2 + s1 * s2), arm[C13] * (c1 * c3 + s1 * s3), arm[C23] * (c2 * c3 + s2 * s3)
    u, v, w = w1 * w1, w2 * w2, w3 * w3
    r1 = f1 - s12 * v - s13 * w - arm[G1] * c1
    r2 = f2 + s12 * u - s23 * w - arm[G2] * c2
    r3 = f3 + s13 * u + s23 * v - arm[G3] * c3
    h11, h22, h33 = arm[C11], arm[C22], arm[C33]
    m11, m12, m13 = h22 * h33 - h23 * h23, h13 * h23 - h12 * h33, h12 * h23 - h13 * h22
    m22, m23, m33 = h11 * h33 - h13 * h13, h12 * h13 - h11 * h23, h11 * h22 - h12 * h12
    d = 1.0 / (h11 * m11 + h12 * m12 + h13 * m13)
    return (
        d * (m11 * r1 + m12 * r2 + m13 * r3),
        d * (m12 * r1 + m22 * r2 + m23 * r3),
        d * (m13 * r1 + m23 * r2 + m33 * r3),
    )


@compiled
def compute_dynamics(arm: np.ndarray, q: np.ndarray, v: np.ndarray, M: np.ndarray, h: np.ndarray) -> None:
    """Write M and h of M q'' + h = tau.

    Args:
        arm: the arm's row.
        q: joint angles, shape (3,) [rad].
        v: joint rates, shape (3,) [rad/s].
        M: mass matrix, written, shape (3, 3) [kg m^2].
        h: gravity and velocity terms, written, shape (3,) [N m].
    """
    a1, a2, a3 = q[0], q[0] + q[1], q[0] + q[1] + q[2]
    w1, w2, w3 = v[0], v[0] + v[1], v[0] + v[1] + v[2]
    (c1, s1), (c2, s2), (c3, s3) = cos_sin(a1), cos_sin(a2), cos_sin(a3)
    s12, s13, s23 = arm[C12] * (s1 * c2 - c1 * s2), arm[C13] * (s1 * c3 - c1 * s3), arm[C23] * (s2 * c3 - c2 * s3)
    h12, h13, h23 = arm[C12] * (c1 * c2 + s1 * s2), arm[C13] * (c1 * c3 + s1 * s3), arm[C23] * (c2 * c3 + s2 * s3)
    h[2] = arm[G3] * c3 - s13 * w1 * w1 - s23 * w2 * w2
    h[1] = h[2] + arm[G2] * c2 - s12 * w1 * w1 + s23 * w3 * w3
    h[0] = h[1] + arm[G1] * c1 + s12 * w2 * w2 + s13 * w3 * w3
    M[2, 2] = arm[C33]
    M[1, 2] = h23 + M[2, 2]
    M[0, 2] = h13 + M[1, 2]
    M[1, 1] = arm[C22] + h23 + M[1, 2]
    M[0, 1] = h12 + h13 + M[1, 1]
    M[0, 0] = arm[C11] + h12 + h13 + M[0, 1]
    M[1, 0], M[2, 0], M[2, 1] = M[0, 1], M[0, 2], M[1, 2]


@compiled
def compute_kinematics(
    arm: np.ndarray, q: np.ndarray, v: np.ndarray, pose: np.ndarray, J: np.ndarray, drift: np.ndarray
) -> None:
    """Write pose, Jacobian and velocity product of the arm's end: (p, theta)'' = J q'' + J' q'.

    Args:
        arm: the arm's row.
        q: joint angles, shape (3,) [rad].
        v: joint rates, shape (3,) [rad/s].
        pose: x, y, angle, written, shape (3,) [m, rad].
        J: Jacobian, written, shape (3, 3).
        drift: J' q', written, shape (3,) [m/s^2, rad/s^2].
    """
    a1, a2, a3 = q[0], q[0] + q[1], q[0] + q[1] + q[2]
    w1, w2, w3 = v[0], v[0] + v[1], v[0] + v[1] + v[2]
    u, w, z = w1 * w1, w2 * w2, w3 * w3
    (c1, s1), (c2, s2), (c3, s3) = cos_sin(a1), cos_sin(a2), cos_sin(a3)
    x1, x2, x3 = arm[L1] * c1, arm[L2] * c2, arm[L3] * c3
    y1, y2, y3 = arm[L1] * s1, arm[L2] * s2, arm[L3] * s3
    pose[0], pose[1], pose[2] = arm[X] + x1 + x2 + x3, arm[Y] + y1 + y2 + y3, a3
    J[0, 2], J[1, 2] = -y3, x3
    J[0, 1], J[1, 1] = -y2 - y3, x2 + x3
    J[0, 0], J[1, 0] = -y1 - y2 - y3, x1 + x2 + x3
    J[2, 0] = J[2, 1] = J[2, 2] = 1.0
    drift[0] = -(x1 * u + x2 * w + x3 * z)
    drift[1] = -(y1 * u + y2 * w + y3 * z)
    drift[2] = 0.0


def solve_inverse_kinematics(arm: np.ndarray, pose: np.ndarray, elbow: int) -> np.ndarray:
    """Return the joint angles at which the arm's end has a pose.

    Args:
        arm: the arm's row.
        pose: x, y, angle, shape (3,) [m, rad].
        elbow: sign of the second joint's angle.

    Returns:
        q, shape (3,) [rad].

    Raises:
        InputError: the pose is out of reach.
    """
    find_direction, find_angle = interpret(cos_sin), interpret(atan2)
    c, s = find_direction(float(pose[2]))
    x, y = float(pose[0] - arm[L3] * c - arm[X]), float(pose[1] - arm[L3] * s - arm[Y])
    reach = math.sqrt(x * x + y * y)
    l1, l2 = float(arm[L1]), float(arm[L2])
    longest, shortest = l1 + l2, abs(l1 - l2)
    if not shortest < reach < longest:
        raise InputError(
            f"pose ({pose[0]:.3g}, {pose[1]:.3g}, {pose[2]:.3g}) is out of reach: the wrist would be {reach:.3g} m "
            f"from the base; {shortest:.3g} to {longest:.3g} m are possible"
        )
    # tan(bend / 2)^2 = (1 - cos(bend)) / (1 + cos(bend)), with the law of cosines.
    far, near = (longest - reach) * (longest + reach), (reach - shortest) * (reach + shortest)
    bend = 2.0 * find_angle(math.sqrt(far), math.sqrt(near)) * elbow
    c, s = find_direction(bend)
    first = find_angle(y, x) - find_angle(l2 * s, l1 + l2 * c)
    return np.array([first, bend, pose[2] - first - bend])

"""Dynamics and kinematics of both arms, for the quadratic programs, and the box's state estimated from them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from impact_envs.compiled import compiled
from impact_envs.dual_arm.arm import compute_dynamics, compute_kinematics
from planners.dual_arm.reference import AnteField, compute_ante_rate, compute_ante_velocity

SINGULAR = 1e-9  # determinant of a Jacobian [m^2]


class Terms(NamedTuple):
    """Dynamics and kinematics of both arms at one state.

    Attributes:
        M, h: of M q'' + h = tau, shapes (2, 3, 3) [kg m^2], (2, 3) [N m].
        pose: x, y, angle of the pads, shape (2, 3) [m, rad].
        J: their Jacobians, shape (2, 3, 3).
        drift, twist: J' q' and J q', shape (2, 3) [m/s^2, rad/s^2], [m/s, rad/s].
        nominal: joint rates of arms that follow the reference, shape (2, 3) [rad/s].
    """

    M: np.ndarray
    h: np.ndarray
    pose: np.ndarray
    J: np.ndarray
    drift: np.ndarray
    twist: np.ndarray
    nominal: np.ndarray


# The same as a record.
TERMS = np.dtype(
    [
        ("M", float, (2, 3, 3)),
        ("h", float, (2, 3)),
        ("pose", float, (2, 3)),
        ("J", float, (2, 3, 3)),
        ("drift", float, (2, 3)),
        ("twist", float, (2, 3)),
        ("nominal", float, (2, 3)),
    ]
)


def make_terms() -> Terms:
    """Allocate the terms of both arms."""
    return Terms(*(np.zeros(TERMS[name].shape) for name in Terms._fields))


@compiled
def compute_terms(arms: np.ndarray, q: np.ndarray, v: np.ndarray, terms: Terms) -> None:
    """Write dynamics and kinematics of both arms.

    Args:
        arms: rows of `arm.make_arm`, shape (2, 14).
        q, v: joint angles and rates, shape (2, 3).
        terms: written.
    """
    for i in range(2):
        compute_dynamics(arms[i], q[i], v[i], terms.M[i], terms.h[i])
        compute_kinematics(arms[i], q[i], v[i], terms.pose[i], terms.J[i], terms.drift[i])
        for r in range(3):
            terms.twist[i, r] = terms.J[i, r, 0] * v[i, 0] + terms.J[i, r, 1] * v[i, 1] + terms.J[i, r, 2] * v[i, 2]


@compiled
def compute_nominal_rates(
    arms: np.ndarray, q: np.ndarray, v: np.ndarray, terms: Terms, field: AnteField, integrated: np.ndarray
) -> None:
    """Write the joint rates of arms that follow the ante-impact reference, q_int' = J^-1 (v_ref, omega_ref).

    Args:
        arms: rows of `arm.make_arm`, shape (2, 14).
        q, v: joint angles and rates as measured, shape (2, 3).
        terms: `nominal` is written, with the measured rates where the Jacobian is singular; the rest is scratch.
        field: the reference.
        integrated: poses along the reference since the impact, shape (2, 3) [m, rad].

    Source: van Steen et al., Eq. 34.
    """
    v_int = terms.nominal
    for i in range(2):
        compute_kinematics(arms[i], q[i], v[i], terms.pose[i], terms.J[i], terms.drift[i])
        vx, vy = compute_ante_velocity(field, i, terms.pose[i, 0], terms.pose[i, 1])
        w, _ = compute_ante_rate(field, i, integrated[i, 2])
        found, v_int[i, 0], v_int[i, 1], v_int[i, 2] = find_rates(terms.J[i], vx, vy, w)
        if not found:
            v_int[i, 0], v_int[i, 1], v_int[i, 2] = v[i, 0], v[i, 1], v[i, 2]


@compiled
def find_rates(J: np.ndarray, vx: float, vy: float, w: float) -> tuple[bool, float, float, float]:
    """Return whether an arm can move its pad at all as wished, and the joint rates that do, J^-1 (v, omega).

    Args:
        J: its Jacobian, whose last row is ones, shape (3, 3).
        vx, vy, w: velocity of the pad [m/s], [rad/s].
    """
    # Eliminate the third joint.
    a, b, c, d = J[0, 0] - J[0, 2], J[0, 1] - J[0, 2], J[1, 0] - J[1, 2], J[1, 1] - J[1, 2]
    ex, ey = vx - J[0, 2] * w, vy - J[1, 2] * w
    det = a * d - b * c
    if abs(det) < SINGULAR:
        return False, 0.0, 0.0, 0.0
    first, second = (d * ex - b * ey) / det, (a * ey - c * ex) / det
    return True, first, second, w - first - second


@compiled
def integrate_reference(field: AnteField, integrated: np.ndarray, dt: float) -> None:
    """Move the integrated poses along the ante-impact reference by an explicit Euler step.

    Source: van Steen et al., Eq. 33.
    """
    for i in range(2):
        vx, vy = compute_ante_velocity(field, i, integrated[i, 0], integrated[i, 1])
        rate, _ = compute_ante_rate(field, i, integrated[i, 2])
        integrated[i, 0] += dt * vx
        integrated[i, 1] += dt * vy
        integrated[i, 2] += dt * rate


@compiled
def estimate_box(terms: Terms, box: np.ndarray) -> None:
    """Write the box's pose and twist as the mean of both pads', which face each other.

    theta_b = theta_1 + wrap(theta_2 - pi - theta_1) / 2.

    Args:
        terms: of both arms.
        box: x, y, heading and their rates, written, shape (6,).

    Source: van Steen et al., Eq. 51, with theta_2 = theta_b + pi of Eq. 16.
    """
    for r in range(3):
        box[r] = 0.5 * (terms.pose[0, r] + terms.pose[1, r])
        box[3 + r] = 0.5 * (terms.twist[0, r] + terms.twist[1, r])
    turn = terms.pose[1, 2] - math.pi - terms.pose[0, 2]
    turn -= 2.0 * math.pi * math.floor(turn / (2.0 * math.pi) + 0.5)
    box[2] = terms.pose[0, 2] + 0.5 * turn

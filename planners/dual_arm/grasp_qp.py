"""The quadratic program after the impact: arms and box as one system, held together by four rigid contacts."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from impact_envs.compiled import compiled
from impact_envs.elementary import cos_sin
from planners.dual_arm.reference import PostField, compute_post_reference
from planners.dual_arm.terms import Terms, compute_terms, estimate_box
from planners.dual_arm.torque_qp import (
    BOUNDED,
    BOX,
    EQUALITIES_GRASP,
    NORMAL,
    QDD,
    TANGENTIAL,
    TorqueQP,
    clear_cost,
    write_arm_motion,
)

RELAXED = 9  # rows of A that are equalities in the slack form too: the motion of arms and box


class PostGains(NamedTuple):
    """Gains and weights after the impact, see `options.ControllerOptions`, and what is believed of box and pads.

    Attributes:
        friction: of the pads.
        mass, inertia: of the box [kg], [kg m^2].
        gravity: along -y [m/s^2].
        half_height: of a pad [m].
    """

    k_p_post: float
    k_theta_post: float
    w_p_post: float
    w_theta_post: float
    w_share: float
    w_normal: float
    grip: float
    friction: float
    mass: float
    inertia: float
    gravity: float
    half_height: float


@compiled
def build_post(qp: TorqueQP, terms: Terms, field: PostField, gains: PostGains, box: np.ndarray) -> None:
    """Build the post-impact program: move the box along its velocity field, held by four rigid contacts.

    min w_p |p_b'' - a_ref - k_p (v_ref - p_b')|^2 + w_theta (...)^2 + w_share ((l_1 - l_2)^2 + (l_3 - l_4)^2)
    + w_n |lambda_N - grip|^2, subject to the motion of arms and box, gamma_k'' = 0, sigma_1'' = sigma_3'' = 0 and
    |lambda_T| <= mu lambda_N.

    Args:
        qp: written, of size GRASP.
        terms: of both arms at the measured state.
        field: the reference.
        box: its estimated state, shape (6,).

    Source: van Steen et al., Eqs. 42 to 50; Eq. 44 with the exact second derivative of the gap.
    """
    clear_cost(qp)
    write_arm_motion(qp, terms)
    vx, vy, w, ax, ay, turn = compute_post_reference(field, box[0], box[1], box[2])
    for r in range(3):
        velocity, acceleration = (vx, ax) if r == 0 else ((vy, ay) if r == 1 else (w, turn))
        weight, gain = (gains.w_p_post, gains.k_p_post) if r < 2 else (gains.w_theta_post, gains.k_theta_post)
        qp.H[BOX + r, BOX + r] += 2.0 * weight
        qp.f[BOX + r] -= 2.0 * weight * (acceleration + gain * (velocity - box[3 + r]))
        qp.A[6 + r, BOX + r] = gains.mass if r < 2 else gains.inertia
        qp.lower[12 + r] = qp.upper[12 + r] = -gains.mass * gains.gravity if r == 1 else 0.0
    for k in range(4):
        qp.H[NORMAL + k, NORMAL + k] += 2.0 * (gains.w_normal + gains.w_share)
        qp.H[NORMAL + k, NORMAL + (k ^ 1)] -= 2.0 * gains.w_share
        qp.f[NORMAL + k] -= 2.0 * gains.w_normal * gains.grip
        write_contact(qp, terms, gains, box, k)


@compiled
def write_contact(qp: TorqueQP, terms: Terms, gains: PostGains, box: np.ndarray, k: int) -> None:
    """Write contact k: its forces in the motion of arm and box, no relative acceleration, its friction cone.

    With r = R' (c - p_b): r'' = R' (c'' - p_b'' - omega' S r - 2 omega S (c' - p_b') - omega^2 r), and the gap
    gamma'' = -side r_x'', the slip sigma'' = r_y''. Forces on the arm are J_N' lambda_N -
    J_T' lambda_T, so that friction dissipates.

    Args:
        qp: written.
        terms: of both arms.
        box: its estimated state, shape (6,).
        k: pad corner, 0 to 3.
    """
    i = k // 2
    side = 1.0 - 2.0 * i
    half = gains.half_height * (1.0 - 2.0 * (k % 2))
    c, d = cos_sin(box[2])
    heading, w, spin = terms.pose[i, 2], box[5], terms.twist[i, 2]
    ch, dh = cos_sin(heading)
    lx, ly = -half * dh, half * ch
    rx, ry = terms.pose[i, 0] + lx - box[0], terms.pose[i, 1] + ly - box[1]
    ux, uy = terms.twist[i, 0] - spin * ly - box[3], terms.twist[i, 1] + spin * lx - box[4]
    # the part of c'' - p_b'' - omega' S r - ... that comes from velocities alone
    gx = terms.drift[i, 0] - spin * spin * lx + 2.0 * w * uy - w * w * rx
    gy = terms.drift[i, 1] - spin * spin * ly - 2.0 * w * ux - w * w * ry
    for row in range(2):
        # along the normal out of the box (gamma), then along its face (sigma)
        nx, ny = (-side * c, -side * d) if row == 0 else (-d, c)
        column, sign = (NORMAL + k, 1.0) if row == 0 else (TANGENTIAL + k, -1.0)
        target = 9 + k if row == 0 else (13 + i if k % 2 == 0 else -1)
        for a in range(3):
            J = nx * (terms.J[i, 0, a] - ly) + ny * (terms.J[i, 1, a] + lx)
            qp.A[3 * i + a, column] = -sign * J
            if target >= 0:
                qp.A[target, QDD + 3 * i + a] = J
        lever = nx * -ry + ny * rx
        qp.A[6, column], qp.A[7, column], qp.A[8, column] = sign * nx, sign * ny, sign * lever
        if target >= 0:
            qp.A[target, BOX], qp.A[target, BOX + 1], qp.A[target, BOX + 2] = -nx, -ny, -lever
            qp.lower[6 + target] = qp.upper[6 + target] = -(nx * gx + ny * gy)
    for row in range(2):
        qp.A[15 + 2 * k + row, NORMAL + k] = gains.friction
        qp.A[15 + 2 * k + row, TANGENTIAL + k] = 1.0 - 2.0 * row


@compiled
def assemble_post(
    qp: TorqueQP,
    terms: Terms,
    field: PostField,
    gains: PostGains,
    arms: np.ndarray,
    q: np.ndarray,
    v: np.ndarray,
    box: np.ndarray,
) -> None:
    """Compute the terms, estimate the box and build the post-impact program.

    Args:
        qp, terms: written.
        field, gains: see `build_post`.
        arms, q, v: see `compute_terms`.
        box: its estimated state, written, shape (6,).
    """
    compute_terms(arms, q, v, terms)
    estimate_box(terms, box)
    build_post(qp, terms, field, gains, box)


@compiled
def relax_contacts(qp: TorqueQP, weight: float) -> None:
    """Turn a post-impact program into its slack form, which always has a solution.

    The rows that forbid acceleration between pads and box move into the cost: weight |C x - d|^2.

    Args:
        qp: of size GRASP, changed in place.
        weight: of the squared accelerations between pads and box.
    """
    n = len(qp.f)
    for row in range(RELAXED, EQUALITIES_GRASP):
        wanted = qp.upper[BOUNDED + row]
        for a in range(n):
            pull = 2.0 * weight * qp.A[row, a]
            if pull != 0.0:
                qp.f[a] -= pull * wanted
                for b in range(n):
                    qp.H[a, b] += pull * qp.A[row, b]
        qp.lower[BOUNDED + row], qp.upper[BOUNDED + row] = -math.inf, math.inf

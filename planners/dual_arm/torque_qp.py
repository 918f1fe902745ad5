"""The quadratic programs of reference spreading before the impact and in the interim phase, built in place every tick.

Minimise x' H x / 2 + f' x subject to lower <= (x_1 .. x_6, A x) <= upper, where x = (tau, q'') up to full contact
and x = (tau, q'', q_b'', lambda_N, lambda_T) after it (`grasp_qp`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from impact_envs.compiled import compiled
from impact_envs.elementary import cos_sin
from planners.dual_arm.reference import (
    AnteField,
    compute_ante_acceleration,
    compute_ante_rate,
    compute_ante_velocity,
)
from planners.dual_arm.terms import Terms, compute_nominal_rates, compute_terms, integrate_reference

TAU, QDD, BOX, NORMAL, TANGENTIAL = 0, 6, 12, 15, 19  # where the parts of x begin
FREE, GRASP = (12, 6), (23, 23)  # sizes: unknowns and rows of A, without and with the box
BOUNDED = 6  # unknowns with bounds: the torques
EQUALITIES_FREE, EQUALITIES_GRASP = 6, 15  # the first rows of A
EQUALITIES = {FREE: EQUALITIES_FREE, GRASP: EQUALITIES_GRASP}
# Added to the diagonal of H to make it definite: torques, and the split of tangential forces on a pad, have no cost.
REGULARISATION = 1e-8


class AnteGains(NamedTuple):
    """Gains and weights before the impact, see `options.ControllerOptions`."""

    k_p: float
    k_theta: float
    sync_p: float
    sync_d: float
    w_p: float
    w_theta: float
    w_sync: float


class InterimGains(NamedTuple):
    """Gains and weights of the interim phase, see `options.ControllerOptions`."""

    k_int: float
    k_theta_int: float
    w_p_int: float
    w_theta_int: float


class TorqueQP(NamedTuple):
    """A quadratic program for the torques of both arms.

    Attributes:
        H: shape (n, n).
        f: shape (n,).
        A: shape (m, n); the first rows are equalities, see `EQUALITIES`.
        lower, upper: of the six torques, then of the rows of A, shape (6 + m,).
    """

    H: np.ndarray
    f: np.ndarray
    A: np.ndarray
    lower: np.ndarray
    upper: np.ndarray


def make_program_type(size: tuple[int, int]) -> np.dtype:
    """Return a program as a record.

    Args:
        size: FREE or GRASP.
    """
    n, m = size
    parts = [("H", float, (n, n)), ("f", float, n), ("A", float, (m, n)), ("lower", float, 6 + m)]
    return np.dtype([*parts, ("upper", float, 6 + m)])


def make_torque_qp(size: tuple[int, int], limits: np.ndarray) -> TorqueQP:
    """Allocate a program and fill in what never changes: torque limits, and which rows are equalities.

    Args:
        size: FREE or GRASP.
        limits: greatest torques, shape (2, 3) [N m].

    Returns:
        The program.
    """
    n, m = size
    bound = np.full(6 + m, np.inf)
    qp = TorqueQP(np.zeros((n, n)), np.zeros(n), np.zeros((m, n)), -bound, bound)
    qp.upper[:6] = limits.ravel()
    qp.lower[:6] = -limits.ravel()
    qp.lower[6 + EQUALITIES[size] :] = 0.0
    return qp


@compiled
def write_arm_motion(qp: TorqueQP, terms: Terms) -> None:
    """Write M q'' - tau = -h of both arms into the first six rows.

    Source: van Steen et al., Eq. 31.
    """
    for i in range(2):
        for r in range(3):
            row = 3 * i + r
            for c in range(3):
                qp.A[row, QDD + 3 * i + c] = terms.M[i, r, c]
            qp.A[row, TAU + row] = -1.0
            qp.lower[6 + row] = qp.upper[6 + row] = -terms.h[i, r]


@compiled
def clear_cost(qp: TorqueQP) -> None:
    """Reset the cost to the regularisation alone."""
    n = len(qp.f)
    for r in range(n):
        qp.f[r] = 0.0
        for c in range(n):
            qp.H[r, c] = 0.0
        qp.H[r, r] = REGULARISATION


@compiled
def add_arm_task(qp: TorqueQP, terms: Terms, i: int, r: int, weight: float, target: float) -> None:
    """Add weight (J_r q_i'' + (J' q')_r - target)^2 to the cost.

    Args:
        qp: added to.
        terms: of both arms.
        i: arm, 0 or 1.
        r: row of its Jacobian: 0 x, 1 y, 2 angle.
        weight: of the task.
        target: desired acceleration of the pad [m/s^2, rad/s^2].
    """
    start = QDD + 3 * i
    rest = target - terms.drift[i, r]
    for a in range(3):
        qp.f[start + a] -= 2.0 * weight * terms.J[i, r, a] * rest
        for b in range(3):
            qp.H[start + a, start + b] += 2.0 * weight * terms.J[i, r, a] * terms.J[i, r, b]


@compiled
def build_ante(qp: TorqueQP, terms: Terms, field: AnteField, gains: AnteGains, ramp: float) -> None:
    """Build the ante-impact program: follow the velocity field, and keep the pads mirror images of each other.

    min sum_i w_p |p_i'' - a_ref - k_p (v_ref - p_i')|^2 + w_theta (...)^2
    + w_s |p_1'' - T_s p_2'' - k_sp (p_2m - p_1) - k_sd (p_2m' - p_1')|^2, p_2m = T_s (p_2 - p_b) + p_b.

    Args:
        qp: written, of size FREE.
        terms: of both arms at the measured state.
        field: the reference.
        ramp: factor on the feedback gains, 1 after the soft start.

    Source: van Steen et al., Eqs. 22 to 32.
    """
    clear_cost(qp)
    write_arm_motion(qp, terms)
    for i in range(2):
        x, y = terms.pose[i, 0], terms.pose[i, 1]
        vx, vy = compute_ante_velocity(field, i, x, y)
        ax, ay = compute_ante_acceleration(field, i, x, y)
        rate, turn = compute_ante_rate(field, i, terms.pose[i, 2])
        add_arm_task(qp, terms, i, 0, gains.w_p, ax + ramp * gains.k_p * (vx - terms.twist[i, 0]))
        add_arm_task(qp, terms, i, 1, gains.w_p, ay + ramp * gains.k_p * (vy - terms.twist[i, 1]))
        add_arm_task(qp, terms, i, 2, gains.w_theta, turn + ramp * gains.k_theta * (rate - terms.twist[i, 2]))
    if gains.w_sync > 0.0:
        add_synchronisation(qp, terms, field, gains, ramp)


@compiled
def add_synchronisation(qp: TorqueQP, terms: Terms, field: AnteField, gains: AnteGains, ramp: float) -> None:
    """Add the task that keeps pad 2 the mirror image of pad 1 about the box's y axis.

    Source: van Steen et al., Eqs. 22 to 25.
    """
    c, d = cos_sin(2.0 * field.box[2])
    for r in range(2):
        # T_s = R diag(-1, 1) R' = [[-c, -d], [-d, c]] of twice the angle
        t0, t1 = (-c, -d) if r == 0 else (-d, c)
        mirrored = field.box[r] + t0 * (terms.pose[1, 0] - field.box[0]) + t1 * (terms.pose[1, 1] - field.box[1])
        mirrored_rate = t0 * terms.twist[1, 0] + t1 * terms.twist[1, 1]
        target = gains.sync_p * (mirrored - terms.pose[0, r]) + gains.sync_d * (mirrored_rate - terms.twist[0, r])
        rest = ramp * target - terms.drift[0, r] + t0 * terms.drift[1, 0] + t1 * terms.drift[1, 1]
        for a in range(6):
            ja = terms.J[0, r, a] if a < 3 else -t0 * terms.J[1, 0, a - 3] - t1 * terms.J[1, 1, a - 3]
            qp.f[QDD + a] -= 2.0 * gains.w_sync * ja * rest
            for b in range(6):
                jb = terms.J[0, r, b] if b < 3 else -t0 * terms.J[1, 0, b - 3] - t1 * terms.J[1, 1, b - 3]
                qp.H[QDD + a, QDD + b] += 2.0 * gains.w_sync * ja * jb


@compiled
def build_interim(
    qp: TorqueQP, terms: Terms, field: AnteField, gains: InterimGains, integrated: np.ndarray, press: float
) -> None:
    """Build the interim program: feedforward of the ante-impact reference, feedback of position only.

    min sum_i w_p |J q_i'' + J_int' q_int' - a_ref - k_int (p_int - p_i)|^2 + w_theta (...)^2. The angle's reference is
    taken at the integrated angle: at the measured angle its feedforward would act as a negative stiffness.

    Args:
        qp: written, of size FREE.
        terms: of both arms at the measured angles and the nominal rates.
        field: the reference.
        integrated: p_int and theta_int, shape (2, 3) [m, rad].
        press: extra acceleration of both pads towards the box, 0 in the paper [m/s^2].

    Source: van Steen et al., Eqs. 35 to 41.
    """
    clear_cost(qp)
    write_arm_motion(qp, terms)
    for i in range(2):
        ax, ay = compute_ante_acceleration(field, i, terms.pose[i, 0], terms.pose[i, 1])
        _, turn = compute_ante_rate(field, i, integrated[i, 2])
        side = press * (1.0 - 2.0 * i)
        c, d = cos_sin(field.box[2])
        ax, ay = ax + side * c, ay + side * d
        for r in range(3):
            feedforward = ax if r == 0 else (ay if r == 1 else turn)
            weight, gain = (gains.w_p_int, gains.k_int) if r < 2 else (gains.w_theta_int, gains.k_theta_int)
            add_arm_task(qp, terms, i, r, weight, feedforward + gain * (integrated[i, r] - terms.pose[i, r]))


@compiled
def assemble_ante(
    qp: TorqueQP,
    terms: Terms,
    field: AnteField,
    gains: AnteGains,
    arms: np.ndarray,
    q: np.ndarray,
    v: np.ndarray,
    ramp: float,
) -> None:
    """Compute the terms and build the ante-impact program: a whole tick up to the solver.

    Args:
        qp, terms: written.
        field, gains, ramp: see `build_ante`.
        arms, q, v: see `compute_terms`.
    """
    compute_terms(arms, q, v, terms)
    build_ante(qp, terms, field, gains, ramp)


@compiled
def assemble_interim(
    qp: TorqueQP,
    terms: Terms,
    field: AnteField,
    gains: InterimGains,
    arms: np.ndarray,
    q: np.ndarray,
    v: np.ndarray,
    integrated: np.ndarray,
    press: float,
    dt: float,
) -> None:
    """Compute the terms at the nominal rates, build the interim program, and integrate the reference poses.

    Args:
        qp, terms: written.
        field, gains, press: see `build_interim`.
        arms, q, v: see `compute_terms`.
        integrated: p_int and theta_int, updated to the next tick, shape (2, 3) [m, rad].
        dt: tick [s].
    """
    compute_nominal_rates(arms, q, v, terms, field, integrated)
    compute_terms(arms, q, terms.nominal, terms)
    build_interim(qp, terms, field, gains, integrated, press)
    integrate_reference(field, integrated, dt)

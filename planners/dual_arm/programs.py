"""The three quadratic programs of reference spreading, as data: built compiled, in place, once per control tick.

Minimise x' H x / 2 + f' x subject to lower <= (x_1 .. x_6, A x) <= upper. Every program starts with the torques;
x = (tau, q'') before and during the impact, and x = (tau, q'', q_b'', lambda_N, lambda_T) after it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from planners.dual_arm.reference import (
    AnteField,
    compute_ante_acceleration,
    compute_ante_rate,
    compute_ante_velocity,
)
from planners.dual_arm.terms import Terms, compute_nominal_rates, compute_terms, integrate_reference

TAU, QDD, BOX, NORMAL, TANGENTIAL = 0, 6, 12, 15, 19  # where the parts of x begin
FREE, GRASP = (12, 6), (23, 23)  # unknowns and rows of A without and with the box
CONTACT_ROWS = range(9, 15)  # of A: no acceleration between pads and box
EQUALITIES = {FREE: 6, GRASP: 15}
# Added to the diagonal of H: torques cost nothing, and the split of tangential forces on one pad is free.
REGULARISATION = 1e-8
# Places in the gains: before, during and after the impact, then what is believed of friction, box and pads.
KP, KTH, SYNC_P, SYNC_D, WP, WTH, WS = range(7)
K_INT, KTH_INT, WP_INT, WTH_INT = range(7, 11)
KP_POST, KTH_POST, WP_POST, WTH_POST, W_SHARE, W_NORMAL = range(11, 17)
FRICTION, MASS, INERTIA, GRAVITY, HALF_HEIGHT = range(17, 22)
GRIP = 22


class Program(NamedTuple):
    """Hold one quadratic program.

    Attributes:
        H: shape (n, n).
        f: shape (n,).
        A: shape (m, n); the first rows are equalities, see `EQUALITIES`.
        lower, upper: of the six torques, then of the rows of A, shape (6 + m,).
        sense: 5 for an equality, 0 for two bounds, shape (6 + m,).
    """

    H: np.ndarray
    f: np.ndarray
    A: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    sense: np.ndarray


def make_program(shape: tuple[int, int], limits: np.ndarray) -> Program:
    """Allocate a program and fill in what never changes: torque limits and the pattern of equalities.

    Args:
        shape: FREE or GRASP.
        limits: greatest torques, shape (2, 3) [N m].

    Returns:
        The program.
    """
    n, m = shape
    bound = np.full(6 + m, np.inf)
    sense = np.zeros(6 + m, dtype=np.int32)
    sense[6 : 6 + EQUALITIES[shape]] = 5
    program = Program(np.zeros((n, n)), np.zeros(n), np.zeros((m, n)), -bound, bound, sense)
    program.upper[:6] = limits.ravel()
    program.lower[:6] = -limits.ravel()
    program.lower[6 + EQUALITIES[shape] :] = 0.0
    return program


@njit(cache=True)
def write_arm_motion(program: Program, terms: Terms) -> None:
    """Write M q'' - tau = -h of both arms into the first six rows.

    Source: van Steen et al., Eq. 31.
    """
    for i in range(2):
        for r in range(3):
            row = 3 * i + r
            for c in range(3):
                program.A[row, QDD + 3 * i + c] = terms.M[i, r, c]
            program.A[row, TAU + row] = -1.0
            program.lower[6 + row] = program.upper[6 + row] = -terms.h[i, r]


@njit(cache=True)
def clear_cost(program: Program) -> None:
    """Set the cost to the regularisation alone."""
    n = len(program.f)
    for r in range(n):
        program.f[r] = 0.0
        for c in range(n):
            program.H[r, c] = 0.0
        program.H[r, r] = REGULARISATION


@njit(cache=True)
def add_arm_task(program: Program, terms: Terms, i: int, r: int, weight: float, target: float) -> None:
    """Add weight (J_r q_i'' + (J' q')_r - target)^2 to the cost.

    Args:
        program: added to.
        terms: of both arms.
        i: arm, 0 or 1.
        r: row of its Jacobian: 0 x, 1 y, 2 angle.
        weight: of the task.
        target: acceleration the pad should have [m/s^2, rad/s^2].
    """
    start = QDD + 3 * i
    rest = target - terms.drift[i, r]
    for a in range(3):
        program.f[start + a] -= 2.0 * weight * terms.J[i, r, a] * rest
        for b in range(3):
            program.H[start + a, start + b] += 2.0 * weight * terms.J[i, r, a] * terms.J[i, r, b]


@njit(cache=True)
def build_ante(program: Program, terms: Terms, field: AnteField, gains: np.ndarray, ramp: float) -> None:
    """Build the ante-impact program: follow the velocity field, both pads mirror images of each other.

    min sum_i w_p |p_i'' - a_ref - k_p (v_ref - p_i')|^2 + w_theta (...)^2
    + w_s |p_1'' - T_s p_2'' - k_sp (p_2m - p_1) - k_sd (p_2m' - p_1')|^2, p_2m = T_s (p_2 - p_b) + p_b.

    Args:
        program: written, shape FREE.
        terms: of both arms at the measured state.
        field: the reference.
        gains: shape (23,).
        ramp: factor on the feedback gains, 1 after the soft start.

    Source: van Steen et al., Eqs. 22 to 32.
    """
    clear_cost(program)
    write_arm_motion(program, terms)
    for i in range(2):
        x, y = terms.pose[i, 0], terms.pose[i, 1]
        vx, vy = compute_ante_velocity(field, i, x, y)
        ax, ay = compute_ante_acceleration(field, i, x, y)
        rate, turn = compute_ante_rate(field, i, terms.pose[i, 2])
        add_arm_task(program, terms, i, 0, gains[WP], ax + ramp * gains[KP] * (vx - terms.twist[i, 0]))
        add_arm_task(program, terms, i, 1, gains[WP], ay + ramp * gains[KP] * (vy - terms.twist[i, 1]))
        add_arm_task(program, terms, i, 2, gains[WTH], turn + ramp * gains[KTH] * (rate - terms.twist[i, 2]))
    if gains[WS] > 0.0:
        add_synchronisation(program, terms, field, gains, ramp)


@njit(cache=True)
def add_synchronisation(program: Program, terms: Terms, field: AnteField, gains: np.ndarray, ramp: float) -> None:
    """Add the task that makes pad 2 the mirror image of pad 1 about the box's y axis.

    Source: van Steen et al., Eqs. 22 to 25.
    """
    c, d = math.cos(2.0 * field.box[2]), math.sin(2.0 * field.box[2])
    for r in range(2):
        # T_s = R diag(-1, 1) R' = [[-c, -d], [-d, c]] of twice the angle
        t0, t1 = (-c, -d) if r == 0 else (-d, c)
        mirrored = field.box[r] + t0 * (terms.pose[1, 0] - field.box[0]) + t1 * (terms.pose[1, 1] - field.box[1])
        mirrored_rate = t0 * terms.twist[1, 0] + t1 * terms.twist[1, 1]
        target = gains[SYNC_P] * (mirrored - terms.pose[0, r]) + gains[SYNC_D] * (mirrored_rate - terms.twist[0, r])
        rest = ramp * target - terms.drift[0, r] + t0 * terms.drift[1, 0] + t1 * terms.drift[1, 1]
        for a in range(6):
            ja = terms.J[0, r, a] if a < 3 else -t0 * terms.J[1, 0, a - 3] - t1 * terms.J[1, 1, a - 3]
            program.f[QDD + a] -= 2.0 * gains[WS] * ja * rest
            for b in range(6):
                jb = terms.J[0, r, b] if b < 3 else -t0 * terms.J[1, 0, b - 3] - t1 * terms.J[1, 1, b - 3]
                program.H[QDD + a, QDD + b] += 2.0 * gains[WS] * ja * jb


@njit(cache=True)
def build_interim(
    program: Program, terms: Terms, field: AnteField, gains: np.ndarray, integrated: np.ndarray, press: float
) -> None:
    """Build the interim program: feed-forward of the ante-impact reference, feedback of position only.

    min sum_i w_p |J q_i'' + J_int' q_int' - a_ref - k_int (p_int - p_i)|^2 + w_theta (...)^2. The angle's reference is
    taken at the integrated angle: at the measured one its feed-forward is a negative stiffness.

    Args:
        program: written, shape FREE.
        terms: of both arms at the measured angles and the nominal rates.
        field: the reference.
        gains: shape (23,).
        integrated: p_int and theta_int, shape (2, 3) [m, rad].
        press: further acceleration of both pads towards the box [m/s^2], 0 in the paper.

    Source: van Steen et al., Eqs. 35 to 41.
    """
    clear_cost(program)
    write_arm_motion(program, terms)
    for i in range(2):
        ax, ay = compute_ante_acceleration(field, i, terms.pose[i, 0], terms.pose[i, 1])
        _, turn = compute_ante_rate(field, i, integrated[i, 2])
        side = press * (1.0 - 2.0 * i)
        ax, ay = ax + side * math.cos(field.box[2]), ay + side * math.sin(field.box[2])
        for r in range(3):
            feedforward = ax if r == 0 else (ay if r == 1 else turn)
            weight, gain = (gains[WP_INT], gains[K_INT]) if r < 2 else (gains[WTH_INT], gains[KTH_INT])
            add_arm_task(program, terms, i, r, weight, feedforward + gain * (integrated[i, r] - terms.pose[i, r]))


@njit(cache=True)
def assemble_ante(
    program: Program,
    terms: Terms,
    field: AnteField,
    gains: np.ndarray,
    arms: np.ndarray,
    q: np.ndarray,
    v: np.ndarray,
    ramp: float,
) -> None:
    """Compute the terms and build the ante-impact program: all of a tick that is not its solution.

    Args:
        program, terms: written.
        field, gains, ramp: see `build_ante`.
        arms, q, v: see `compute_terms`.
    """
    compute_terms(arms, q, v, terms)
    build_ante(program, terms, field, gains, ramp)


@njit(cache=True)
def assemble_interim(
    program: Program,
    terms: Terms,
    field: AnteField,
    gains: np.ndarray,
    arms: np.ndarray,
    q: np.ndarray,
    v: np.ndarray,
    integrated: np.ndarray,
    press: float,
    dt: float,
) -> None:
    """Compute the terms at the nominal rates, build the interim program, and move the integrated poses on.

    Args:
        program, terms: written.
        field, gains, press: see `build_interim`.
        arms, q, v: see `compute_terms`.
        integrated: p_int and theta_int, then those of the next tick, shape (2, 3) [m, rad].
        dt: tick [s].
    """
    compute_nominal_rates(arms, q, v, terms, field, integrated)
    compute_terms(arms, q, terms.nominal, terms)
    build_interim(program, terms, field, gains, integrated, press)
    integrate_reference(field, integrated, dt)

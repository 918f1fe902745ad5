"""Output- and state-dependent Riccati control (OSDRE) of the tip of a floating manipulator.

With z = (y, dy/dt), y the tip's position in the world, the output dynamics are dz/dt = A(z) z + B u. The gain solves
the Riccati equation of (A, B) and multiplies the error z - (y_goal, 0).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from impact_envs.compiled import compiled
from impact_envs.elementary import hypot
from impact_envs.physics.multibody import (
    Chain,
    compute_bias,
    compute_directions,
    compute_jacobian,
    compute_mass_matrix,
    compute_point,
    factorise,
    solve_factorised,
)
from planners.floating_manipulator.riccati import RiccatiScratch, make_riccati_scratch, solve_riccati

# Below this output (or speed) the state-dependent coefficients are 0, as the generalised inverse of 0 is [m], [m/s].
LEAST_OUTPUT = 1e-6
# Below this singular value of B (a stretched arm in line with its mount) torques cannot accelerate the tip in all
# directions, and the Riccati equation has no useful solution [1/kg/m].
LEAST_AUTHORITY = 1e-3


class OutputScratch(NamedTuple):
    """Working arrays of `compute_gain`, for n joints.

    Attributes:
        w, rates: directions and absolute rates, shapes (n + 1, 2) and (n + 1,).
        M, J: mass matrix, later its factor, and tip Jacobian, shapes (n + 3, n + 3) and (2, n + 3).
        a: accelerations without torque, shape (n + 3,).
        z, drift: output, and tip acceleration without torque, shapes (4,) and (2,).
        B: tip acceleration per torque, shape (2, n).
        A, S, Q, K: Riccati equation and its solution, shape (4, 4).
        riccati: scratch of its solver.
    """

    w: np.ndarray
    rates: np.ndarray
    M: np.ndarray
    J: np.ndarray
    a: np.ndarray
    z: np.ndarray
    drift: np.ndarray
    B: np.ndarray
    A: np.ndarray
    S: np.ndarray
    Q: np.ndarray
    K: np.ndarray
    riccati: RiccatiScratch


def make_output_scratch(joints: int) -> OutputScratch:
    """Allocate the working arrays of a manipulator.

    Args:
        joints: n.
    """
    m = joints + 3
    w, rates, M, J, a = (np.zeros(shape) for shape in ((m - 2, 2), (m - 2,), (m, m), (2, m), (m,)))
    z, drift, B = np.zeros(4), np.zeros(2), np.zeros((2, joints))
    A, S, Q, K = np.zeros((4, 4, 4))
    return OutputScratch(w, rates, M, J, a, z, drift, B, A, S, Q, K, make_riccati_scratch(4))


@compiled
def compute_output_dynamics(chain: Chain, q: np.ndarray, v: np.ndarray, s: OutputScratch) -> None:
    """Compute output z, drift and B of  d^2y/dt^2 = drift + B u.

    drift = J M^-1 (-c) + dJ/dt v and B = J M^-1 (0; 1), which is the generalised Jacobian times the inverse of the
    arm's reduced mass matrix.

    Args:
        chain: mass distribution.
        q, v: coordinates and rates, shape (n + 3,).
        s: z, drift and B are written.

    Source: Nekoo, Sharf & Ollero, Eqs. 22, 23 and 29.
    """
    compute_directions(chain, q, v, s.w, s.rates)
    tip = chain.levers[len(chain.levers) - 1]
    s.z[0], s.z[1], s.z[2], s.z[3], s.drift[0], s.drift[1] = compute_point(q, v, s.w, s.rates, tip)
    compute_mass_matrix(chain, s.w, s.M)
    compute_bias(chain, s.w, s.rates, s.a)
    compute_jacobian(s.w, tip, s.J)
    factorise(s.M)
    for axis in range(2):
        solve_factorised(s.M, s.J[axis])
        for i in range(len(q)):
            s.drift[axis] -= s.J[axis, i] * s.a[i]
        for j in range(len(q) - 3):
            s.B[axis, j] = s.J[axis, 3 + j]


@compiled
def fill_coefficients(printed: bool, s: OutputScratch) -> None:
    """Write A such that  A z = (dy/dt, drift).

    The lower rows are drift z' / (z' z), or drift (dy/dt)' / |dy/dt|^2 in their right half if ``printed``.

    Args:
        printed: use the printed form.
        s: z and drift are read, A is written.

    Source: Nekoo, Sharf & Ollero, Eq. 30 is the printed form; the other one reproduces their numbers.
    """
    first = 2 if printed else 0
    square = 0.0
    for j in range(first, 4):
        square += s.z[j] * s.z[j]
    for i in range(2):
        for j in range(4):
            s.A[i, j] = 1.0 if j == i + 2 else 0.0
            s.A[2 + i, j] = 0.0
            if j >= first and square > LEAST_OUTPUT * LEAST_OUTPUT:
                s.A[2 + i, j] = s.drift[i] * s.z[j] / square


@compiled
def compute_authority(B: np.ndarray) -> float:
    """Return the smaller singular value of B, shape (2, n)."""
    xx = yy = xy = 0.0
    for j in range(B.shape[1]):
        xx += B[0, j] * B[0, j]
        yy += B[1, j] * B[1, j]
        xy += B[0, j] * B[1, j]
    square = (xx + yy) / 2.0 - hypot((xx - yy) / 2.0, xy)
    return math.sqrt(max(square, 0.0))


@compiled
def compute_gain(chain: Chain, q: np.ndarray, v: np.ndarray, effort: float, printed: bool, s: OutputScratch) -> bool:
    """Compute the output dynamics and the solution K of their Riccati equation.

    Args:
        chain: mass distribution.
        q, v: coordinates and rates, shape (n + 3,).
        effort: r in R = r 1.
        printed: form of the state-dependent coefficients.
        s: z, B and K are written; K is unchanged if there is no solution.

    Returns:
        Whether there is a solution.
    """
    compute_output_dynamics(chain, q, v, s)
    if not compute_authority(s.B) >= LEAST_AUTHORITY:
        return False
    fill_coefficients(printed, s)
    for i in range(2):
        for j in range(2):
            s.S[2 + i, 2 + j] = 0.0
            for k in range(s.B.shape[1]):
                s.S[2 + i, 2 + j] += s.B[i, k] * s.B[j, k] / effort
    return solve_riccati(s.A, s.S, s.Q, s.K, s.riccati)


@compiled
def compute_feedback(goal: np.ndarray, effort: float, s: OutputScratch, u: np.ndarray) -> None:
    """Compute u = -R^-1 B' K (z - (goal, 0)).

    Args:
        goal: of the tip, shape (2,) [m].
        effort: r in R = r 1.
        s: z, B and K are read.
        u: result, shape (n,) [N m].

    Source: Nekoo, Sharf & Ollero, Eq. 32.
    """
    for j in range(len(u)):
        u[j] = 0.0
        for i in range(2):
            for k in range(4):
                error = s.z[k] - goal[k] if k < 2 else s.z[k]
                u[j] -= s.B[i, j] * s.K[2 + i, k] * error / effort


@compiled
def compute_base_rates(chain: Chain, q: np.ndarray, momenta: np.ndarray, v: np.ndarray, s: OutputScratch) -> None:
    """Compute the rates of the base from momenta and joint rates.

    dq_b/dt = M_b^-1 ((P; L - p_b x P) - M_ba dq_a/dt).

    Args:
        chain: mass distribution.
        q: coordinates, shape (n + 3,).
        momenta: P_x, P_y and L about the world's origin, shape (3,) [N s], [N m s].
        v: v[3:] are the joint rates, v[:3] is written, shape (n + 3,).
        s: working arrays.

    Source: Nekoo, Sharf & Ollero, Eqs. 19 and 24.
    """
    compute_directions(chain, q, v, s.w, s.rates)
    compute_mass_matrix(chain, s.w, s.M)
    v[0], v[1] = momenta[0], momenta[1]
    v[2] = momenta[2] - q[0] * momenta[1] + q[1] * momenta[0]
    for i in range(3):
        for j in range(3, len(q)):
            v[i] -= s.M[i, j] * v[j]
    factorise(s.M[:3, :3])
    solve_factorised(s.M[:3, :3], v[:3])


@compiled
def compute_torques(
    chain: Chain,
    q: np.ndarray,
    v: np.ndarray,
    momenta: np.ndarray,
    measured: bool,
    goal: np.ndarray,
    effort: float,
    printed: bool,
    s: OutputScratch,
    u: np.ndarray,
) -> bool:
    """Compute the torques of one OSDRE step.

    Args:
        chain: mass distribution.
        q, v: coordinates and rates, shape (n + 3,); v[:3] is overwritten unless ``measured``.
        momenta: P_x, P_y and L about the world's origin, shape (3,) [N s], [N m s].
        measured: the base's rates are v[:3]; otherwise compute them from the momenta.
        goal: of the tip, shape (2,) [m].
        effort: r in R = r 1.
        printed: form of the state-dependent coefficients.
        s: working arrays; K is the last gain found.
        u: result, shape (n,) [N m].

    Returns:
        Whether the Riccati equation had a solution.
    """
    if not measured:
        compute_base_rates(chain, q, momenta, v, s)
    solved = compute_gain(chain, q, v, effort, printed, s)
    compute_feedback(goal, effort, s, u)
    return solved

"""Planar multibody dynamics of a free-floating base that carries a chain of links and a load at its tip.

Coordinates q = (x, y, psi, q_1, ..., q_n): position of the base's centre of mass, heading of the base, relative joint
angles; v is their rate. Link j has the absolute heading theta_j = psi + q_1 + ... + q_j, theta_0 = psi. With the
directions w_0 = R(psi) d (d: where joint 1 sits on the base) and w_j = (cos theta_j, sin theta_j), every point of the
chain lies at (x, y) + sum_j l_j w_j; l is called its lever.

With n = 0 and d = 0 this is one free body, such as a box. The functions are scalar code in the subset of Python that
numba compiles; results go into arrays of the caller.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from impact_envs.compiled import compiled
from impact_envs.elementary import cos_sin


class Chain(NamedTuple):
    """Hold the mass distribution of base, links and load.

    Args:
        mass: of everything [kg].
        mount: d, joint 1 in the base's frame, shape (2,) [m].
        first: h_j = sum over bodies of m l_j, shape (n + 1,) [kg m].
        second: H_jk = sum over bodies of m l_j l_k, shape (n + 1, n + 1) [kg m^2].
        inertia: of base and links about their centres of mass, the load's added to its link's, shape (n + 1,) [kg m^2].
        levers: of the centres of mass of base and links, and of the tip in the last row, shape (n + 2, n + 1) [m].
    """

    mass: float
    mount: np.ndarray
    first: np.ndarray
    second: np.ndarray
    inertia: np.ndarray
    levers: np.ndarray


def make_chain(
    base: tuple[float, float],
    mount: Sequence[float] = (0.0, 0.0),
    links: Sequence[tuple[float, float, float, float]] = (),
    load: tuple[float, float] = (0.0, 0.0),
) -> Chain:
    """Collect the mass distribution of a chain.

    Args:
        base: mass [kg], inertia about its centre of mass [kg m^2].
        mount: joint 1 in the base's frame, from its centre of mass, shape (2,) [m].
        links: mass [kg], inertia about the centre of mass [kg m^2], length [m], centre of mass from the joint [m].
        load: mass [kg] and inertia [kg m^2] at the tip.

    Returns:
        The chain; a free body without links.
    """
    n = len(links)
    levers = np.zeros((n + 2, n + 1))
    levers[1:, 0] = 1.0
    for k, (_, _, length, centre) in enumerate(links, start=1):
        levers[k, k] = centre
        levers[k + 1 :, k] = length
    masses = np.array([base[0], *(link[0] for link in links), load[0]])
    inertia = np.array([base[1], *(link[1] for link in links)])
    inertia[n] += load[1]
    moments, rows = (masses[:, None] * levers).tolist(), levers.tolist()
    # Plain sums: products of matrices are rounded otherwise on other processors.
    first = [sum(row[j] for row in moments) for j in range(n + 1)]
    pairs = list(zip(rows, moments, strict=True))
    second = [[sum(row[k] * moment[j] for row, moment in pairs) for j in range(n + 1)] for k in range(n + 1)]
    return Chain(
        mass=float(sum(masses.tolist())),
        mount=np.array(mount, dtype=float),
        first=np.array(first),
        second=np.array(second),
        inertia=inertia,
        levers=levers,
    )


@compiled
def compute_directions(chain: Chain, q: np.ndarray, v: np.ndarray, w: np.ndarray, rates: np.ndarray) -> None:
    """Compute the directions w_j and the absolute angular rates of base and links.

    Args:
        chain: mass distribution.
        q, v: coordinates and their rates, shape (n + 3,).
        w: result, shape (n + 1, 2).
        rates: result, shape (n + 1,) [rad/s].
    """
    theta, rate = q[2], v[2]
    c, s = cos_sin(theta)
    w[0, 0] = c * chain.mount[0] - s * chain.mount[1]
    w[0, 1] = s * chain.mount[0] + c * chain.mount[1]
    rates[0] = rate
    for j in range(1, len(rates)):
        theta += q[2 + j]
        rate += v[2 + j]
        w[j, 0], w[j, 1] = cos_sin(theta)
        rates[j] = rate


@compiled
def compute_mass_matrix(chain: Chain, w: np.ndarray, M: np.ndarray) -> None:
    """Compute the mass matrix.

    M = [[m 1, h_j S w_j], [., H_jk w_j . w_k + I_j]] in absolute headings, then summed over the links a joint carries.

    Args:
        chain: mass distribution.
        w: directions, shape (n + 1, 2).
        M: result, shape (n + 3, n + 3).
    """
    count = len(w)
    M[0, 0] = M[1, 1] = chain.mass
    M[0, 1] = M[1, 0] = 0.0
    for j in range(count):
        M[0, 2 + j] = M[2 + j, 0] = -chain.first[j] * w[j, 1]
        M[1, 2 + j] = M[2 + j, 1] = chain.first[j] * w[j, 0]
        for k in range(count):
            M[2 + j, 2 + k] = chain.second[j, k] * (w[j, 0] * w[k, 0] + w[j, 1] * w[k, 1])
        M[2 + j, 2 + j] += chain.inertia[j]
    for j in range(count, 1, -1):
        for i in range(count + 2):
            M[i, j] += M[i, j + 1]
    for j in range(count, 1, -1):
        for i in range(count + 2):
            M[j, i] += M[j + 1, i]


@compiled
def compute_bias(chain: Chain, w: np.ndarray, rates: np.ndarray, c: np.ndarray) -> None:
    """Compute the centrifugal and Coriolis forces c in M dv/dt + c = generalised forces.

    Args:
        chain: mass distribution.
        w, rates: directions and absolute rates, shapes (n + 1, 2) and (n + 1,).
        c: result, shape (n + 3,).
    """
    count = len(rates)
    c[0] = c[1] = 0.0
    for j in range(count):
        square = rates[j] * rates[j]
        c[0] -= chain.first[j] * square * w[j, 0]
        c[1] -= chain.first[j] * square * w[j, 1]
        c[2 + j] = 0.0
        for k in range(count):
            cross = w[j, 0] * w[k, 1] - w[j, 1] * w[k, 0]
            c[2 + j] -= chain.second[j, k] * cross * rates[k] * rates[k]
    for j in range(count, 1, -1):
        c[j] += c[j + 1]


@compiled
def compute_jacobian(w: np.ndarray, lever: np.ndarray, J: np.ndarray) -> None:
    """Compute the Jacobian of a point of the chain: its velocity is J v.

    Args:
        w: directions, shape (n + 1, 2).
        lever: of the point, shape (n + 1,) [m]; the tip's is the last row of ``chain.levers``.
        J: result, shape (2, n + 3).
    """
    J[0, 0] = J[1, 1] = 1.0
    J[0, 1] = J[1, 0] = 0.0
    x = y = 0.0
    for j in range(len(lever) - 1, -1, -1):
        x += lever[j] * w[j, 0]
        y += lever[j] * w[j, 1]
        J[0, 2 + j], J[1, 2 + j] = -y, x


@compiled
def compute_point(
    q: np.ndarray, v: np.ndarray, w: np.ndarray, rates: np.ndarray, lever: np.ndarray
) -> tuple[float, float, float, float, float, float]:
    """Return position, velocity and velocity-dependent acceleration (dJ/dt v) of a point of the chain.

    Args:
        q, v: coordinates and rates, shape (n + 3,).
        w, rates: directions and absolute rates, shapes (n + 1, 2) and (n + 1,).
        lever: of the point, shape (n + 1,) [m].

    Returns:
        x, y, vx, vy, ax, ay [m], [m/s], [m/s^2].
    """
    x, y, vx, vy, ax, ay = q[0], q[1], v[0], v[1], 0.0, 0.0
    for j in range(len(lever)):
        lx, ly = lever[j] * w[j, 0], lever[j] * w[j, 1]
        x += lx
        y += ly
        vx -= rates[j] * ly
        vy += rates[j] * lx
        ax -= rates[j] * rates[j] * lx
        ay -= rates[j] * rates[j] * ly
    return x, y, vx, vy, ax, ay


@compiled
def compute_momenta(
    chain: Chain, q: np.ndarray, v: np.ndarray, w: np.ndarray, rates: np.ndarray
) -> tuple[float, float, float]:
    """Return linear momentum and angular momentum about the world's origin.

    Args:
        chain: mass distribution.
        q, v: coordinates and rates, shape (n + 3,).
        w, rates: directions and absolute rates, shapes (n + 1, 2) and (n + 1,).

    Returns:
        P_x, P_y [N s], L [N m s].

    Source: Nekoo, Sharf & Ollero, Eqs. 8 and 9.
    """
    px, py, spin = chain.mass * v[0], chain.mass * v[1], 0.0
    for j in range(len(rates)):
        hx, hy = chain.first[j] * w[j, 0], chain.first[j] * w[j, 1]
        px -= rates[j] * hy
        py += rates[j] * hx
        spin += hx * v[1] - hy * v[0] + chain.inertia[j] * rates[j]
        for k in range(len(rates)):
            spin += chain.second[j, k] * (w[j, 0] * w[k, 0] + w[j, 1] * w[k, 1]) * rates[k]
    return px, py, spin + q[0] * py - q[1] * px


@compiled
def compute_kinetic_energy(chain: Chain, v: np.ndarray, w: np.ndarray, rates: np.ndarray) -> float:
    """Return the kinetic energy [J].

    Args:
        chain: mass distribution.
        v: rates of the coordinates, shape (n + 3,).
        w, rates: directions and absolute rates, shapes (n + 1, 2) and (n + 1,).
    """
    twice = chain.mass * (v[0] * v[0] + v[1] * v[1])
    for j in range(len(rates)):
        across = w[j, 0] * v[1] - w[j, 1] * v[0]
        twice += rates[j] * (2.0 * chain.first[j] * across + chain.inertia[j] * rates[j])
        for k in range(len(rates)):
            twice += chain.second[j, k] * (w[j, 0] * w[k, 0] + w[j, 1] * w[k, 1]) * rates[j] * rates[k]
    return twice / 2.0


@compiled
def factorise(M: np.ndarray) -> None:
    """Replace a symmetric positive definite matrix by its Cholesky factor, in the lower triangle.

    Args:
        M: matrix, then factor, shape (m, m).
    """
    for i in range(len(M)):
        for j in range(i + 1):
            total = M[i, j]
            for k in range(j):
                total -= M[i, k] * M[j, k]
            M[i, j] = math.sqrt(total) if i == j else total / M[j, j]


@compiled
def solve_factorised(L: np.ndarray, b: np.ndarray) -> None:
    """Solve L L' x = b in place.

    Args:
        L: Cholesky factor in the lower triangle, shape (m, m).
        b: right side, then solution, shape (m,).
    """
    m = len(b)
    for i in range(m):
        for k in range(i):
            b[i] -= L[i, k] * b[k]
        b[i] /= L[i, i]
    for i in range(m - 1, -1, -1):
        for k in range(i + 1, m):
            b[i] -= L[k, i] * b[k]
        b[i] /= L[i, i]

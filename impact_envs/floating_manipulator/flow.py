"""Dynamics of manipulator and box together: accelerations, and one step of Runge-Kutta 4.

Coordinates q = (base x, y, psi, joints, box x, y, heading), v their rates. In flight the two systems are independent;
while the tip pushes the box, a normal force keeps the gap closed.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from impact_envs.compiled import compiled
from impact_envs.floating_manipulator.contact import Contact, compute_contact
from impact_envs.floating_manipulator.schema import FloatingManipulatorScenario, Physics
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


class System(NamedTuple):
    """The true physics of one world.

    Attributes:
        chain: base, links and load.
        box_mass, box_inertia: [kg], [kg m^2].
        half_length, half_width: of the box along its own axes [m].
        radius: of the tip [m].
    """

    chain: Chain
    box_mass: float
    box_inertia: float
    half_length: float
    half_width: float
    radius: float


class Scratch(NamedTuple):
    """Working arrays, for m = n + 6 coordinates.

    Attributes:
        w, rates: directions and absolute rates, shapes (n + 1, 2) and (n + 1,).
        M, J: mass matrix (later its factor) and tip Jacobian of the chain, shapes (n + 3, n + 3) and (2, n + 3).
        row, response: the gap's rate is row . v; the change of v per impulse along it, shape (m,).
        a: accelerations of the four stages, shape (4, m).
        q_stage, v_stage, q_next, v_next: shape (m,).
        v_minus: rates just before an impact, shape (m,).
    """

    w: np.ndarray
    rates: np.ndarray
    M: np.ndarray
    J: np.ndarray
    row: np.ndarray
    response: np.ndarray
    a: np.ndarray
    q_stage: np.ndarray
    v_stage: np.ndarray
    q_next: np.ndarray
    v_next: np.ndarray
    v_minus: np.ndarray


def make_system(scenario: FloatingManipulatorScenario, physics: Physics) -> System:
    """Collect the numbers of a true world that moves: the one place where the drawn masses are unpacked.

    Args:
        scenario: sizes of box and tip.
        physics: the drawn numbers.

    Returns:
        The system.
    """
    length, width = scenario.box.size
    return System(
        chain=physics.chain,
        box_mass=physics.box_mass,
        box_inertia=physics.box_inertia,
        half_length=length / 2,
        half_width=width / 2,
        radius=scenario.load.radius,
    )


def make_scratch(joints: int) -> Scratch:
    """Allocate the working arrays of a manipulator.

    Args:
        joints: n.
    """
    m = joints + 6
    shapes = [(joints + 1, 2), (joints + 1,), (m - 3, m - 3), (2, m - 3), (m,), (m,), (4, m)] + 5 * [(m,)]
    return Scratch(*(np.zeros(shape) for shape in shapes))


@compiled
def find_contact(system: System, q: np.ndarray, v: np.ndarray, scratch: Scratch) -> Contact:
    """Return the contact geometry of tip and box; scratch holds the directions."""
    m = len(q)
    chain = system.chain
    compute_directions(chain, q, v, scratch.w, scratch.rates)
    tip = compute_point(q, v, scratch.w, scratch.rates, chain.levers[len(chain.levers) - 1])
    box = (q[m - 3], q[m - 2], q[m - 1], v[m - 3], v[m - 2], v[m - 1])
    return compute_contact(tip, system.radius, box, system.half_length, system.half_width)


@compiled
def compute_response(system: System, contact: Contact, scratch: Scratch) -> float:
    """Compute the response to an impulse p along the normal, dv = response p; scratch must hold the factor of M.

    Args:
        system: masses.
        contact: normal and point.
        scratch: row and response are written.

    Returns:
        Change of the gap's rate per impulse, 1 / m_eff [1/kg].
    """
    m = len(scratch.row)
    chain = system.chain
    row, response = scratch.row, scratch.response
    compute_jacobian(scratch.w, chain.levers[len(chain.levers) - 1], scratch.J)
    for i in range(m - 3):
        row[i] = response[i] = contact.nx * scratch.J[0, i] + contact.ny * scratch.J[1, i]
    solve_factorised(scratch.M, response[: m - 3])
    row[m - 3], row[m - 2] = -contact.nx, -contact.ny
    row[m - 1] = -(contact.rx * contact.ny - contact.ry * contact.nx)
    response[m - 3], response[m - 2] = row[m - 3] / system.box_mass, row[m - 2] / system.box_mass
    response[m - 1] = row[m - 1] / system.box_inertia
    inverse_mass = 0.0
    for i in range(m):
        inverse_mass += row[i] * response[i]
    return inverse_mass


@compiled
def compute_acceleration(
    system: System, force: np.ndarray, q: np.ndarray, v: np.ndarray, touching: bool, a: np.ndarray, scratch: Scratch
) -> float:
    """Compute accelerations.

    M a + c = force + row' p, and if touching  row . a + bias = 0.

    Args:
        system: true physics.
        force: generalised forces, shape (m,) [N], [N m].
        q, v: coordinates and rates, shape (m,).
        touching: the tip pushes the box.
        a: result, shape (m,).
        scratch: working arrays.

    Returns:
        Normal force p, negative where the tip would have to pull; 0 if not touching [N].
    """
    m = len(q)
    compute_directions(system.chain, q, v, scratch.w, scratch.rates)
    compute_mass_matrix(system.chain, scratch.w, scratch.M)
    compute_bias(system.chain, scratch.w, scratch.rates, a[: m - 3])
    for i in range(m - 3):
        a[i] = force[i] - a[i]
    factorise(scratch.M)
    solve_factorised(scratch.M, a[: m - 3])
    a[m - 3], a[m - 2] = force[m - 3] / system.box_mass, force[m - 2] / system.box_mass
    a[m - 1] = force[m - 1] / system.box_inertia
    if not touching:
        return 0.0
    contact = find_contact(system, q, v, scratch)
    inverse_mass = compute_response(system, contact, scratch)
    opening = contact.bias
    for i in range(m):
        opening += scratch.row[i] * a[i]
    press = -opening / inverse_mass
    for i in range(m):
        a[i] += scratch.response[i] * press
    return press


@compiled
def take_step(
    system: System, force: np.ndarray, q: np.ndarray, v: np.ndarray, h: float, touching: bool, scratch: Scratch
) -> None:
    """Take one Runge-Kutta 4 step from (q, v) to (q_next, v_next) in scratch."""
    m = len(q)
    a, qs, vs = scratch.a, scratch.q_stage, scratch.v_stage
    compute_acceleration(system, force, q, v, touching, a[0], scratch)
    for stage in range(1, 4):
        part = h if stage == 3 else h / 2.0
        for i in range(m):
            if stage == 1:
                qs[i] = q[i] + part * v[i]
            else:
                qs[i] = q[i] + part * (v[i] + part * a[stage - 2, i] * (0.5 if stage == 3 else 1.0))
            vs[i] = v[i] + part * a[stage - 1, i]
        compute_acceleration(system, force, qs, vs, touching, a[stage], scratch)
    for i in range(m):
        scratch.q_next[i] = q[i] + h * v[i] + h * h / 6.0 * (a[0, i] + a[1, i] + a[2, i])
        scratch.v_next[i] = v[i] + h / 6.0 * (a[0, i] + 2.0 * a[1, i] + 2.0 * a[2, i] + a[3, i])


@compiled
def compute_opening(system: System, force: np.ndarray, q: np.ndarray, v: np.ndarray, scratch: Scratch) -> float:
    """Return the acceleration of the gap in free flight [m/s^2]; scratch holds row and response of the contact."""
    compute_acceleration(system, force, q, v, False, scratch.a[0], scratch)
    contact = find_contact(system, q, v, scratch)
    compute_response(system, contact, scratch)
    opening = contact.bias
    for i in range(len(q)):
        opening += scratch.row[i] * scratch.a[0, i]
    return opening


@compiled
def compute_rows(system: System, q: np.ndarray, v: np.ndarray, scratch: Scratch, rows: np.ndarray) -> None:
    """Compute x, y, vx, vy, heading, omega of base, links, tip and box.

    Args:
        system: true physics.
        q, v: coordinates and rates, shape (m,).
        scratch: working arrays.
        rows: result, shape (n + 3, 6).
    """
    m, n = len(q), len(scratch.rates) - 1
    compute_directions(system.chain, q, v, scratch.w, scratch.rates)
    heading = 0.0
    for k in range(n + 2):
        x, y, vx, vy, _, _ = compute_point(q, v, scratch.w, scratch.rates, system.chain.levers[k])
        if k <= n:
            heading += q[2 + k]
        rows[k, 0], rows[k, 1], rows[k, 2], rows[k, 3] = x, y, vx, vy
        rows[k, 4], rows[k, 5] = heading, scratch.rates[min(k, n)]
    for i in range(2):
        rows[n + 2, i], rows[n + 2, 2 + i] = q[m - 3 + i], v[m - 3 + i]
    rows[n + 2, 4], rows[n + 2, 5] = q[m - 1], v[m - 1]

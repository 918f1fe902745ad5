"""The chain's dynamics equal a Lagrangian written independently, and keep what physics keeps."""

import casadi as ca
import numpy as np
import pytest

from impact_envs.physics.multibody import (
    compute_bias,
    compute_directions,
    compute_jacobian,
    compute_kinetic_energy,
    compute_mass_matrix,
    compute_momenta,
    compute_point,
    factorise,
    make_chain,
    solve_factorised,
)


def random_tables(rng, n):
    links = [tuple(rng.uniform([0.5, 0.1, 0.5, 0.2], [3.0, 1.0, 2.0, 1.0])) for _ in range(n)]
    return (5.0, 2.1), rng.uniform(-1, 1, 2), links, tuple(rng.uniform(0.1, 1.0, 2))


def lagrangian(base, mount, links, load):
    """Kinetic energy, momenta and tip from the velocities of every body, by symbolic differentiation."""
    n = len(links)
    q, v = ca.SX.sym("q", n + 3), ca.SX.sym("v", n + 3)
    psi = q[2]
    joint = q[:2] + ca.vertcat(
        ca.cos(psi) * mount[0] - ca.sin(psi) * mount[1], ca.sin(psi) * mount[0] + ca.cos(psi) * mount[1]
    )
    bodies, heading = [(*base, q[:2], psi)], psi
    for k, (mass, inertia, length, centre) in enumerate(links):
        heading = heading + q[3 + k]
        along = ca.vertcat(ca.cos(heading), ca.sin(heading))
        bodies.append((mass, inertia, joint + centre * along, heading))
        joint = joint + length * along
    bodies.append((*load, joint, heading))
    energy, momentum, spin = 0, ca.SX.zeros(2), 0
    for mass, inertia, position, angle in bodies:
        velocity, rate = ca.jtimes(position, q, v), ca.jtimes(angle, q, v)
        energy += (mass * ca.dot(velocity, velocity) + inertia * rate**2) / 2
        momentum += mass * velocity
        spin += inertia * rate + mass * (position[0] * velocity[1] - position[1] * velocity[0])
    M = ca.hessian(energy, v)[0]
    bias = ca.jtimes(ca.gradient(energy, v), q, v) - ca.gradient(energy, q)
    J = ca.jacobian(joint, q)
    dJ = ca.reshape(ca.jtimes(ca.vec(J), q, v), 2, n + 3)
    out = [M, bias, J, dJ, joint, momentum, spin, energy]
    return ca.Function("reference", [q, v], out)


@pytest.mark.parametrize("n", [0, 1, 3, 5])
def test_dynamics_equal_a_symbolic_lagrangian(n):
    rng = np.random.default_rng(n)
    tables = random_tables(rng, n)
    chain, reference = make_chain(*tables), lagrangian(*tables)
    w, rates = np.empty((n + 1, 2)), np.empty(n + 1)
    M, c, J = np.empty((n + 3, n + 3)), np.empty(n + 3), np.empty((2, n + 3))
    for _ in range(50):
        q, v = rng.uniform(-3, 3, n + 3), rng.normal(size=n + 3)
        compute_directions(chain, q, v, w, rates)
        compute_mass_matrix(chain, w, M)
        compute_bias(chain, w, rates, c)
        tip = chain.levers[-1]
        compute_jacobian(w, tip, J)
        x, y, vx, vy, ax, ay = compute_point(q, v, w, rates, tip)
        px, py, spin = compute_momenta(chain, q, v, w, rates)
        wanted = [np.array(out) for out in reference(q, v)]
        dJ = wanted.pop(3)
        got = [M, c[:, None], J, np.array([[x], [y]]), np.array([[px], [py]]), np.array([[spin]])]
        got.append(np.array([[compute_kinetic_energy(chain, v, w, rates)]]))
        for ours, theirs in zip(got, wanted, strict=True):
            np.testing.assert_allclose(ours, theirs, atol=2e-12, rtol=1e-12)
        np.testing.assert_allclose([vx, vy], J @ v, atol=1e-12)
        np.testing.assert_allclose([ax, ay], dJ @ v, atol=1e-12)


def test_a_box_is_a_chain_without_links():
    chain = make_chain((5.0, 0.8333))
    q, v = np.array([3.5, -0.5, 0.4]), np.array([-0.2, 0.1, 0.3])
    w, rates, M = np.empty((1, 2)), np.empty(1), np.empty((3, 3))
    compute_directions(chain, q, v, w, rates)
    compute_mass_matrix(chain, w, M)
    np.testing.assert_array_equal(M, np.diag([5.0, 5.0, 0.8333]))
    # Nekoo, Sharf & Ollero, Eq. 6.
    np.testing.assert_allclose(
        compute_momenta(chain, q, v, w, rates), [-1.0, 0.5, 0.8333 * 0.3 + 3.5 * 0.5 - 0.5 * 1.0], atol=1e-15
    )


def test_factor_solves():
    rng = np.random.default_rng(1)
    root = rng.normal(size=(6, 6))
    M, b = root @ root.T + np.eye(6), rng.normal(size=6)
    L, x = M.copy(), b.copy()
    factorise(L)
    solve_factorised(L, x)
    np.testing.assert_allclose(M @ x, b, atol=1e-12)

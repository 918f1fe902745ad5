import numpy as np
import pytest

from impact_envs.physics.impact import (
    Side,
    apply_impulse,
    compute_effective_mass,
    compute_impulse,
    compute_mass_fractions,
    compute_planar_jacobian,
    compute_restitution,
    compute_velocity_gain,
    is_rebound,
    solve_contacts,
)


def random_side(rng, n=4, d=2):
    """An articulated body: any Jacobian, any symmetric positive definite mass matrix."""
    root = rng.normal(size=(n, n))
    return Side(rng.normal(size=(d, n)), root @ root.T + np.eye(n), rng.normal(size=n))


def unit(rng, d=2):
    vector = rng.normal(size=d)
    return vector / np.linalg.norm(vector)


def kinetic(mass_matrix, v):
    return v @ mass_matrix @ v / 2


def stacked(normal, a, b):
    """Row (positive when parting), mass matrix and velocity of two bodies written as one system."""
    row = np.concatenate([-normal @ a.jacobian, normal @ b.jacobian])
    n = len(a.velocity)
    mass_matrix = np.zeros((n + len(b.velocity),) * 2)
    mass_matrix[:n, :n], mass_matrix[n:, n:] = a.mass_matrix, b.mass_matrix
    return row, mass_matrix, np.concatenate([a.velocity, b.velocity])


@pytest.mark.parametrize("e", [0.0, 0.3, 0.8, 1.0])
def test_impulse_reverses_normal_speed_times_restitution(e):
    rng = np.random.default_rng(1)
    for _ in range(50):
        a, b, normal = random_side(rng), random_side(rng, n=3), unit(rng)
        before = normal @ (a.jacobian @ a.velocity - b.jacobian @ b.velocity)
        impulse = compute_impulse(normal, a, b, e)
        va, vb = apply_impulse(a, -impulse * normal), apply_impulse(b, impulse * normal)
        after = normal @ (a.jacobian @ va - b.jacobian @ vb)
        assert after == pytest.approx(-e * before if before > 0 else before, abs=1e-9)
        loss = kinetic(a.mass_matrix, a.velocity) + kinetic(b.mass_matrix, b.velocity)
        loss -= kinetic(a.mass_matrix, va) + kinetic(b.mass_matrix, vb)
        m_eff = compute_effective_mass(normal, [a, b])
        assert loss == pytest.approx((1 - e**2) * m_eff * max(before, 0) ** 2 / 2, abs=1e-9)


def test_disc_is_the_case_of_mass_times_identity():
    rng = np.random.default_rng(2)
    for _ in range(50):
        m_r, m_o, e = rng.uniform(0.1, 20), rng.uniform(0.1, 20), rng.uniform()
        v_r, v_o, normal = rng.normal(size=2), rng.normal(size=2), unit(rng)
        robot, thing = Side(np.eye(2), m_r * np.eye(2), v_r), Side(np.eye(2), m_o * np.eye(2), v_o)
        impulse = compute_impulse(normal, robot, thing, e) * normal
        closing = max(normal @ (v_r - v_o), 0.0) * normal
        np.testing.assert_allclose(
            apply_impulse(robot, -impulse), v_r - compute_velocity_gain(e, m_o, m_r) * closing, atol=1e-12
        )
        np.testing.assert_allclose(
            apply_impulse(thing, impulse), v_o + compute_velocity_gain(e, m_r, m_o) * closing, atol=1e-12
        )


def test_mass_fractions_solve_equation_5():
    rng = np.random.default_rng(3)
    m_r, m_o, e = 16.8, 4.0, 0.8
    v_r, v_o = rng.normal(size=2), rng.normal(size=2)
    m1, m2, m3, m4 = compute_mass_fractions(m_r, m_o, e)
    plus = m1 * v_r + m2 * v_o, m3 * v_r + m4 * v_o
    left = np.array([[m_r, m_o], [1.0, -1.0]]) @ np.stack(plus)
    np.testing.assert_allclose(left, [m_r * v_r + m_o * v_o, -e * (v_r - v_o)], atol=1e-12)


def test_discs_that_part_keep_their_velocities():
    a, b = Side(np.eye(2), np.eye(2), np.array([-0.1, 0.3])), Side(np.eye(2), 2 * np.eye(2), np.array([0.1, 0.0]))
    assert compute_impulse(np.array([1.0, 0.0]), a, b, 0.8) == 0.0


def test_wall_is_the_limit_of_a_heavy_body():
    rng = np.random.default_rng(4)
    a, normal = random_side(rng), unit(rng)
    heavy = Side(np.eye(2), 1e12 * np.eye(2), np.zeros(2))
    assert compute_impulse(normal, a, None, 0.6) == pytest.approx(compute_impulse(normal, a, heavy, 0.6), rel=1e-9)


def test_one_frictionless_contact_is_the_closed_form():
    rng = np.random.default_rng(5)
    for _ in range(30):
        a, b, normal, e = random_side(rng), random_side(rng, n=3), unit(rng), rng.uniform()
        row, mass_matrix, v = stacked(normal, a, b)
        p, q = solve_contacts(row[None], mass_matrix, v, np.array([e]))
        assert p[0] == pytest.approx(compute_impulse(normal, a, b, e), rel=1e-12)
        assert q[0] == 0.0


@pytest.mark.parametrize("mixed", [False, True])
def test_simultaneous_contacts_are_complementary_and_gain_no_energy(mixed):
    rng = np.random.default_rng(6)
    for _ in range(50):
        k, n = int(rng.integers(2, 4)), 6
        root, rows, v = rng.normal(size=(n, n)), rng.normal(size=(k, n)), rng.normal(size=n)
        mass_matrix, e = root @ root.T + np.eye(n), np.full(k, rng.uniform())
        if mixed:  # different restitution, and all contacts close in
            e, rows = rng.uniform(size=k), -np.sign(rows @ v)[:, None] * rows
        p, _ = solve_contacts(rows, mass_matrix, v, e)
        plus = v + np.linalg.solve(mass_matrix, rows.T @ p)
        slack = rows @ plus + e * (rows @ v)
        assert np.all(p >= 0)
        assert np.all(slack >= -1e-8)
        np.testing.assert_allclose(p * slack, 0, atol=1e-8)
        assert kinetic(mass_matrix, plus) <= kinetic(mass_matrix, v) + 1e-9


def test_friction_stays_in_its_cone_and_gains_no_energy():
    rng = np.random.default_rng(7)
    stuck = 0
    for _ in range(300):
        mass_matrix = np.diag(rng.uniform(0.1, 5, 6))
        arms, mu, e = rng.uniform(-1, 1, (2, 2)), rng.uniform(0, 1), rng.uniform()
        J = np.hstack([-compute_planar_jacobian(arms[0]), compute_planar_jacobian(arms[1])])
        v = rng.normal(size=6)
        p, q = solve_contacts(J[:1], mass_matrix, v, np.array([e]), J[1:], mu)
        plus = v + np.linalg.solve(mass_matrix, J.T @ np.concatenate([p, q]))
        assert abs(q[0]) <= mu * p[0] + 1e-12
        assert kinetic(mass_matrix, plus) <= kinetic(mass_matrix, v) + 1e-9
        if p[0] > 0:
            assert (J @ plus)[0] == pytest.approx(-e * (J @ v)[0], abs=1e-9)
            stuck += abs(q[0]) < mu * p[0] - 1e-9
    assert stuck > 20


def test_central_contact_sticks_when_friction_suffices():
    # Disc on a wall: normal and tangential motion are apart, so the slip stops; 1/m_t = 1/m + r^2/I.
    m, inertia, r, slip = 2.0, 0.05, 0.2, 0.3
    J = compute_planar_jacobian(np.array([0.0, -r]))
    v = np.array([slip, -1.0, 0.0])
    mass_matrix = np.diag([m, m, inertia])
    p, q = solve_contacts(J[1:], mass_matrix, v, np.array([0.5]), J[:1], 10.0)
    assert p[0] == pytest.approx(1.5 * m)
    assert q[0] == pytest.approx(-slip / (1 / m + r**2 / inertia))
    _, q = solve_contacts(J[1:], mass_matrix, v, np.array([0.5]), J[:1], 0.01)
    assert q[0] == pytest.approx(-0.01 * 1.5 * m)


def test_restitution_falls_with_speed():
    assert compute_restitution(0.3, 0.8) == 0.8
    assert compute_restitution(0.0, 0.9, 0.5) == 0.9
    assert compute_restitution(0.5, 0.9, 0.5) == pytest.approx(0.9 / np.e)


def test_what_rebounds_is_fast_and_not_pressed_on():
    assert is_rebound(0.1, 0.0, 0.01, 0.02)
    assert not is_rebound(0.01, 0.0, 0.01, 0.02)
    assert not is_rebound(0.1, 11.0, 0.01, 0.02)  # thrown back to 0.1 m/s, it would return within 2 * 0.1 / 11 s

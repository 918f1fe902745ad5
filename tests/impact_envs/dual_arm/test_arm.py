import numpy as np
import pytest

from impact_envs.dual_arm.arm import (
    compute_dynamics,
    compute_kinematics,
    compute_pose,
    make_arm,
    solve_arm,
    solve_inverse_kinematics,
)
from impact_envs.errors import InputError

ARM = make_arm((-0.75, 0.1), (0.5, 0.4, 0.15), (4.0, 3.0, 1.5), (0.25, 0.2, 0.07), (0.085, 0.065, 0.012), 9.81)
RNG = np.random.default_rng(1)
STATES = [(RNG.uniform(-np.pi, np.pi, 3), RNG.normal(0.0, 2.0, 3)) for _ in range(20)]


def dynamics(q, v):
    M, h = np.zeros((3, 3)), np.zeros(3)
    compute_dynamics(ARM, q, v, M, h)
    return M, h


def kinematics(q, v):
    pose, J, drift = np.zeros(3), np.zeros((3, 3)), np.zeros(3)
    compute_kinematics(ARM, q, v, pose, J, drift)
    return pose, J, drift


def energy(q, v):
    """Kinetic and potential energy, link by link from the centres of mass."""
    lengths, masses, centers = ARM[2:5], (4.0, 3.0, 1.5), (0.25, 0.2, 0.07)
    joint, joint_velocity, total = np.array(ARM[:2]), np.zeros(2), 0.0
    for a, w, length, m, c, inertia in zip(
        np.cumsum(q), np.cumsum(v), lengths, masses, centers, (0.085, 0.065, 0.012), strict=True
    ):
        along, across = np.array([np.cos(a), np.sin(a)]), np.array([-np.sin(a), np.cos(a)])
        velocity = joint_velocity + c * w * across
        total += 0.5 * m * velocity @ velocity + 0.5 * inertia * w**2 + m * 9.81 * (joint + c * along)[1]
        joint, joint_velocity = joint + length * along, joint_velocity + length * w * across
    return total


def test_the_mass_matrix_is_the_kinetic_energy():
    for q, v in STATES:
        M, _ = dynamics(q, v)
        assert np.linalg.eigvalsh(M).min() > 0.0
        assert 0.5 * v @ M @ v == pytest.approx(energy(q, v) - energy(q, 0 * v))


def test_the_bias_balances_the_power():
    """Without torque energy is kept: v'(M v' + h) = 0 along v' = -M^-1 h, so dE/dt = 0."""
    for q, v in STATES:
        M, h = dynamics(q, v)
        a, dt = -np.linalg.solve(M, h), 1e-6
        later = energy(q + dt * v, v + dt * a)
        before = energy(q - dt * v, v - dt * a)
        assert (later - before) / (2 * dt) == pytest.approx(0.0, abs=1e-6)


def test_gravity_load_is_the_slope_of_the_potential():
    for q, _ in STATES:
        _, h = dynamics(q, np.zeros(3))
        for j in range(3):
            e = 1e-6 * np.eye(3)[j]
            assert h[j] == pytest.approx((energy(q + e, 0 * q) - energy(q - e, 0 * q)) / 2e-6, abs=1e-6)


def test_both_forms_of_the_dynamics_agree():
    for q, v in STATES:
        M, h = dynamics(q, v)
        tau = RNG.normal(0.0, 20.0, 3)
        directions = tuple((np.cos(a), np.sin(a)) for a in np.cumsum(q))
        absolute = solve_arm(ARM, directions, *np.cumsum(v), tau[0] - tau[1], tau[1] - tau[2], tau[2])
        assert np.cumsum(np.linalg.solve(M, tau - h)) == pytest.approx(np.array(absolute))


def test_jacobian_and_its_rate_equal_finite_differences():
    h = 1e-6
    for q, v in STATES:
        pose, J, drift = kinematics(q, v)
        assert pose == pytest.approx(np.array(compute_pose(ARM, *q)))
        ahead, behind = kinematics(q + h * v, v), kinematics(q - h * v, v)
        assert J @ v == pytest.approx((ahead[0] - behind[0]) / (2 * h), abs=1e-6)
        assert drift == pytest.approx((ahead[1] - behind[1]) @ v / (2 * h), abs=1e-6)


@pytest.mark.parametrize("elbow", [-1, 1])
def test_inverse_kinematics_inverts(elbow):
    for q, _ in STATES:
        q = np.array([q[0], elbow * abs(q[1]), q[2]])
        pose = np.array(compute_pose(ARM, *q))
        assert compute_pose(ARM, *solve_inverse_kinematics(ARM, pose, elbow)) == pytest.approx(tuple(pose))


def test_a_pose_out_of_reach_is_refused():
    with pytest.raises(InputError, match=r"out of reach: the wrist would be 2\.\d* m"):
        solve_inverse_kinematics(ARM, np.array([1.5, 0.0, 0.0]), 1)

"""The output dynamics that OSDRE works with are those of the manipulator; its guards hold."""

import numpy as np
import pytest

from impact_envs.errors import InputError
from impact_envs.physics.multibody import (
    compute_bias,
    compute_directions,
    compute_jacobian,
    compute_mass_matrix,
    compute_momenta,
    compute_point,
    make_chain,
)
from planners.floating_manipulator.options import RegulatorOptions
from planners.floating_manipulator.osdre import (
    OutputScratch,
    compute_authority,
    compute_base_rates,
    compute_output_dynamics,
    fill_coefficients,
)
from tests.planners.floating_manipulator.oracle.output_regulator import OutputRegulator

LINK = (2.0, 0.6667, 2.0, 1.0)


def chain_of(n):
    return make_chain((5.0, 2.0833), (0.905, -0.391), n * [LINK], (1.0, 0.0))


def scratch_of(regulator) -> OutputScratch:
    return regulator._scratch


def matrices(chain, q, v):
    n = len(q) - 3
    w, rates, M, c = np.empty((n + 1, 2)), np.empty(n + 1), np.empty((n + 3, n + 3)), np.empty(n + 3)
    J = np.empty((2, n + 3))
    compute_directions(chain, q, v, w, rates)
    compute_mass_matrix(chain, w, M)
    compute_bias(chain, w, rates, c)
    compute_jacobian(w, chain.levers[-1], J)
    ax, ay = compute_point(q, v, w, rates, chain.levers[-1])[4:]
    return M, c, J, np.array([ax, ay]), compute_momenta(chain, q, v, w, rates)


@pytest.mark.parametrize("n", [2, 3, 5])
def test_output_dynamics_are_the_reduced_ones_of_the_paper(n):
    # Nekoo, Sharf & Ollero, Eqs. 22 and 23: B = (J_a - J_b M_b^-1 M_ba) M_c^-1.
    rng, chain = np.random.default_rng(n), chain_of(n)
    s = scratch_of(OutputRegulator(chain, (0.0, 0.0)))
    for _ in range(50):
        q, v = rng.uniform(-2, 2, n + 3), rng.normal(size=n + 3)
        compute_output_dynamics(chain, q, v, s)
        M, c, J, bias, _ = matrices(chain, q, v)
        coupling = np.linalg.solve(M[:3, :3], M[:3, 3:])
        M_c = M[3:, 3:] - M[3:, :3] @ coupling
        generalised = J[:, 3:] - J[:, :3] @ coupling
        np.testing.assert_allclose(s.B, generalised @ np.linalg.inv(M_c), atol=1e-10)
        np.testing.assert_allclose(s.drift, J @ np.linalg.solve(M, -c) + bias, atol=1e-9)
        np.testing.assert_allclose(s.z[2:], J @ v, atol=1e-12)
        assert compute_authority(s.B) == pytest.approx(np.linalg.svd(s.B)[1][-1], abs=1e-7)


@pytest.mark.parametrize("printed", [False, True])
def test_coefficients_times_output_are_the_drift(printed):
    rng, chain = np.random.default_rng(1), chain_of(3)
    s = scratch_of(OutputRegulator(chain, (0.0, 0.0)))
    for _ in range(20):
        compute_output_dynamics(chain, rng.uniform(-2, 2, 6), rng.normal(size=6), s)
        fill_coefficients(printed, s)
        np.testing.assert_allclose(s.A @ s.z, [*s.z[2:], *s.drift], atol=1e-12)
    assert printed == (not s.A[2:, :2].any())
    compute_output_dynamics(chain, np.array([5.0, -1.75, 0.1, 1.0, 1.1, -2.2]), np.zeros(6), s)
    fill_coefficients(printed, s)
    np.testing.assert_array_equal(s.A[2:], 0.0)


def test_momenta_and_joint_rates_determine_the_base():
    rng, chain = np.random.default_rng(2), chain_of(3)
    s = scratch_of(OutputRegulator(chain, (0.0, 0.0)))
    for _ in range(20):
        q, v = rng.uniform(-3, 3, 6), rng.normal(size=6)
        momenta = np.array(matrices(chain, q, v)[-1])
        found = np.concatenate([rng.normal(size=3), v[3:]])
        compute_base_rates(chain, q, momenta, found, s)
        np.testing.assert_allclose(found, v, atol=1e-10)


@pytest.mark.parametrize("form", ["absolute_output", "printed"])
def test_measured_rates_and_momenta_give_the_same_torque(form):
    rng, chain = np.random.default_rng(3), chain_of(3)
    for _ in range(10):
        q, v = rng.uniform(-1, 1, 6) + np.array([5.0, -1.75, 0.0, 1.0, 1.1, -2.0]), 0.1 * rng.normal(size=6)
        momenta = np.array(matrices(chain, q, v)[-1])
        regulator = OutputRegulator(chain, (3.0, 0.0), RegulatorOptions(form))
        measured, source = regulator.control(q, v, 1.0)
        derived, _ = regulator.control(q, np.concatenate([np.zeros(3), v[3:]]), 1.0, momenta)
        assert source == "riccati"
        np.testing.assert_allclose(derived, measured, atol=1e-7)


@pytest.mark.parametrize("form", ["absolute_output", "printed"])
def test_law_pulls_the_tip_to_its_goal_and_rests_there(form):
    chain, q = chain_of(3), np.array([5.0, -1.75, 0.1, 1.03247, 1.131766, -2.164236])
    s = scratch_of(OutputRegulator(chain, (0.0, 0.0)))
    compute_output_dynamics(chain, q, np.zeros(6), s)
    here, B = s.z[:2].copy(), s.B.copy()
    for direction in np.eye(2):
        u, _ = OutputRegulator(chain, tuple(here + direction), RegulatorOptions(form)).control(q, np.zeros(6), 1.0)
        assert direction @ B @ u > 0
    u, _ = OutputRegulator(chain, tuple(here), RegulatorOptions(form)).control(q, np.zeros(6), 1.0)
    np.testing.assert_allclose(u, 0.0, atol=1e-12)


def test_stretched_arm_is_driven_by_the_last_gain_and_counted():
    chain = make_chain((5.0, 2.0833), (1.0, 0.0), 3 * [LINK], (1.0, 0.0))
    regulator = OutputRegulator(chain, (3.0, 0.0))
    stretched, bent = np.zeros(6), np.array([0.0, 0.0, 0.0, 0.5, 0.8, -0.7])
    u, source = regulator.control(stretched, np.zeros(6), 1.0)
    assert source == "none"
    np.testing.assert_array_equal(u, 0.0)
    assert regulator.control(bent, np.zeros(6), 1.0)[1] == "riccati"
    u, source = regulator.control(stretched, np.zeros(6), 1.0)
    assert source == "last_gain"
    assert np.isfinite(u).all()
    regulator.reset()
    assert regulator.control(stretched, np.zeros(6), 1.0)[1] == "none"


@pytest.mark.parametrize("form", ["absolute_output", "printed"])
def test_tip_at_the_origin_and_slow_self_motion_stay_finite(form):
    chain = chain_of(3)
    regulator = OutputRegulator(chain, (3.0, 0.0), RegulatorOptions(form))
    s = scratch_of(regulator)
    q = np.array([0.0, 0.0, 0.1, 1.03247, 1.131766, -2.164236])
    compute_output_dynamics(chain, q, np.zeros(6), s)
    q[:2] -= s.z[:2]
    M, _, J, _, _ = matrices(chain, q, np.zeros(6))
    coupling = np.linalg.solve(M[:3, :3], M[:3, 3:])
    # Joint rates that leave the tip at rest at zero momentum.
    null = np.linalg.svd(J[:, 3:] - J[:, :3] @ coupling)[2][-1]
    for speed in (0.0, 1e-8, 1e-4):
        v = np.concatenate([-coupling @ null, null]) * 0.3 + speed
        u, source = regulator.control(q, v, 1.0)
        assert source == "riccati"
        assert np.isfinite(u).all()
        assert np.abs(u).max() < 100


def test_unknown_form_is_refused():
    with pytest.raises(InputError, match="did you mean 'printed'"):
        OutputRegulator(chain_of(3), (0.0, 0.0), RegulatorOptions("print"))

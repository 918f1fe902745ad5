"""The sign-function solver of the Riccati equation agrees with SciPy's, and says when there is no solution."""

import numpy as np
import pytest
from scipy.linalg import solve_continuous_are

from planners.floating_manipulator.riccati import make_riccati_scratch, solve_riccati


def solve(A, B, Q, R):
    K = np.zeros_like(A)
    S = B @ np.linalg.solve(R, B.T)
    return solve_riccati(A, S, Q, K, make_riccati_scratch(len(A))), K


@pytest.mark.parametrize("m", [2, 4, 6])
def test_solution_is_the_stabilising_one(m):
    rng = np.random.default_rng(m)
    for _ in range(100):
        A, B = rng.normal(size=(m, m)) * 10 ** rng.uniform(-2, 1), rng.normal(size=(m, 3))
        R = np.eye(3) * 10 ** rng.uniform(-1, 1)
        Q = np.diag(rng.uniform(0.1, 2.0, m))
        solved, K = solve(A, B, Q, R)
        assert solved
        np.testing.assert_array_equal(K, K.T)
        wanted = solve_continuous_are(A, B, Q, R)
        np.testing.assert_allclose(K, wanted, atol=1e-7 * np.abs(wanted).max())
        assert np.linalg.eigvals(A - B @ np.linalg.solve(R, B.T) @ K).real.max() < 0


def test_double_integrator_has_the_solution_known_by_hand():
    # q = r = 1: K = (sqrt 3, 1; 1, sqrt 3).
    solved, K = solve(np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]]), np.eye(2), np.eye(1))
    assert solved
    np.testing.assert_allclose(K, [[np.sqrt(3), 1.0], [1.0, np.sqrt(3)]], atol=1e-13)


def test_without_a_solution_the_last_one_stays():
    K = np.full((2, 2), 7.0)
    unstable, nothing = np.eye(2), np.zeros((2, 2))
    for A in (unstable, np.full((2, 2), np.nan)):
        assert not solve_riccati(A, nothing, np.eye(2), K, make_riccati_scratch(2))
        np.testing.assert_array_equal(K, 7.0)

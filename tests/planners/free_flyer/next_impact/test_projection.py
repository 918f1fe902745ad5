"""The nearest point of a polyhedron: as an interior-point solver finds it, and said so where there is none."""

import clarabel
import numpy as np
import pytest
from scipy import sparse

from planners.cones import solve_clarabel
from planners.free_flyer.next_impact.projection import EMPTY, FOUND, project_point


def solve(rows: np.ndarray, bounds: np.ndarray, count: int, x: np.ndarray) -> int:
    return project_point(rows, bounds, count, x, np.full((len(x) + 4, len(x) + 1), np.nan))


@pytest.mark.parametrize("seed", range(30))
def test_the_point_is_the_interior_point_solvers(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, m = int(rng.integers(2, 14)), int(rng.integers(1, 60))
    rows = rng.normal(size=(m, n))
    inside = rng.normal(size=n)
    bounds = rows @ inside + rng.uniform(0.0, 0.5, m)
    start = 3.0 * rng.normal(size=n)
    x = start.copy()
    assert solve(rows, bounds, m, x) == FOUND
    expected = solve_clarabel(
        "projection",
        sparse.csc_matrix(np.eye(n)),
        -start,
        sparse.csc_matrix(rows),
        bounds,
        [clarabel.NonnegativeConeT(m)],
    )
    assert (rows @ x <= bounds + 1e-8).all()
    np.testing.assert_allclose(x, expected, atol=2e-5)


def test_a_point_inside_stays() -> None:
    x = np.array([0.1, -0.2])
    assert solve(np.eye(2), np.ones(2), 2, x) == FOUND
    assert x.tolist() == [0.1, -0.2]


def test_only_the_counted_rows_bind() -> None:
    x = np.array([3.0])
    assert solve(np.array([[1.0], [1.0]]), np.array([2.0, 1.0]), 1, x) == FOUND
    assert x[0] == pytest.approx(2.0)


def test_equal_and_parallel_rows_do_no_harm() -> None:
    rows, bounds = np.array([[1.0, 0.0], [1.0, 0.0], [2.0, 0.0], [0.0, 1.0]]), np.array([1.0, 1.0, 2.0, 1.0])
    x = np.array([5.0, 5.0])
    assert solve(rows, bounds, 4, x) == FOUND
    np.testing.assert_allclose(x, 1.0)


@pytest.mark.parametrize("seed", range(10))
def test_an_empty_polyhedron_is_said_to_be_empty(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 10))
    rows, inside = rng.normal(size=(20, n)), rng.normal(size=n)
    bounds = rows @ inside + 1.0
    across = rng.normal(size=n)
    rows, bounds = np.vstack([rows, across, -across]), np.append(bounds, [-1.0, 0.5])
    assert solve(rows, bounds, len(bounds), rng.normal(size=n)) == EMPTY

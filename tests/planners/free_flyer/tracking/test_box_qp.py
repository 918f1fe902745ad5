"""Projected Newton finds the point where the conditions of optimality hold."""

from __future__ import annotations

import numpy as np
import pytest

from planners.free_flyer.tracking.box_qp import NEWTON_STEPS, NOT_SOLVED, VECTORS, solve_box_qp


def run(
    H: np.ndarray,
    g: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    steps: int = NEWTON_STEPS,
    split: int | None = None,
) -> tuple[int, np.ndarray]:
    n = len(g)
    x, U, vectors, free = np.zeros(n), np.zeros((n, n)), np.zeros((VECTORS, n)), np.zeros((2, n), dtype=np.int64)
    return solve_box_qp(H, g, lower, upper, x, n if split is None else split, U, vectors, free, steps), x


@pytest.mark.parametrize("seed", range(20))
def test_conditions_of_optimality(seed: int) -> None:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(30, 30))
    H, g = root @ root.T + 0.1 * np.eye(30), 10 * rng.normal(size=30)
    lower = -rng.uniform(0.0, 0.5, 30)
    upper = rng.uniform(0.0, 0.5, 30)
    steps, x = run(H, g, lower, upper)
    slope = H @ x + g
    assert 0 < steps <= NEWTON_STEPS
    assert np.all((x >= lower) & (x <= upper))
    assert np.abs(slope[(x > lower) & (x < upper)]).max(initial=0.0) < 1e-8
    assert np.all(slope[x == lower] >= -1e-8)
    assert np.all(slope[x == upper] <= 1e-8)
    assert np.any((x == lower) | (x == upper))


@pytest.mark.parametrize("seed", range(5))
def test_two_blocks_are_one_problem(seed: int) -> None:
    rng, H = np.random.default_rng(seed), np.zeros((30, 30))
    for block in (slice(0, 20), slice(20, 30)):
        root = rng.normal(size=(30, 30))[block]
        H[block, block] = root @ root.T + 0.1 * np.eye(len(root))
    g, lower, upper = 10 * rng.normal(size=30), -rng.uniform(0.0, 0.5, 30), rng.uniform(0.0, 0.5, 30)
    whole = run(H, g, lower, upper)
    H[:20, 20:] = H[20:, :20] = np.nan  # nobody reads it
    steps, x = run(H, g, lower, upper, split=20)
    assert steps == whole[0] > 1
    np.testing.assert_array_equal(x, whole[1])


def test_one_newton_step_without_active_bounds() -> None:
    H, g = np.array([[2.0, 0.5], [0.5, 1.0]]), np.array([1.0, -1.0])
    steps, x = run(H, g, np.full(2, -9.0), np.full(2, 9.0))
    assert steps == 1
    np.testing.assert_allclose(x, -np.linalg.solve(H, g), atol=1e-14)


def test_says_when_it_did_not_solve() -> None:
    H, g, wide = np.eye(2), np.ones(2), np.full(2, 9.0)
    assert run(H, g, -wide, wide, steps=0)[0] == NOT_SOLVED
    assert run(H, np.array([np.nan, 0.0]), -wide, wide)[0] == NOT_SOLVED
    assert run(-H, g, -wide, wide)[0] == NOT_SOLVED

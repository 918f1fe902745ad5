"""Work is what solvers did, the same whenever it is done; what is beyond its limit is done by nobody."""

from __future__ import annotations

import numpy as np
import pytest

from planners.budget import Work
from planners.errors import Infeasible, OutOfWork, PlanningError, SolverFailed
from planners.mixed_integer import Affine, Model
from planners.solvers import compute_lower_bound, solve


def make_knapsack(size: int = 20) -> Model:
    """Return a knapsack with correlated weights, which takes many nodes."""
    rng = np.random.default_rng(3)
    weight = rng.uniform(1.0, 2.0, (3, size))
    value = weight.sum(axis=0) + rng.uniform(0.0, 0.1, size)
    model = Model("knapsack")
    chosen = [model.binary() for _ in value]
    for row in weight:
        model.require(sum((w * z for w, z in zip(row, chosen, strict=True)), Affine({})) - 0.5 * row.sum())
    model.objective = sum((-v * z for v, z in zip(value, chosen, strict=True)), Affine({}))
    return model


def test_the_same_problem_takes_the_same_work() -> None:
    first, second = Work(nodes=50), Work(nodes=50)
    found = [solve(make_knapsack(), np.inf, work=work) for work in (first, second, second)]
    assert first.done > 10.0
    assert second.done == pytest.approx(2.0 * first.done)
    for solution in found[1:]:
        np.testing.assert_array_equal(solution.x, found[0].x)


def test_nodes_are_limited() -> None:
    few, many = Work(nodes=1), Work(nodes=100)
    rough = solve(make_knapsack(), np.inf, work=few)
    better = solve(make_knapsack(), np.inf, work=many)
    assert few.done < many.done
    assert rough.bound <= better.bound + 1e-6
    assert better.objective <= rough.objective + 1e-6


def test_the_limit_is_no_failure_of_a_plan() -> None:
    """What tries something else after a PlanningError must not go on."""
    work = Work(limit=1.0)
    with pytest.raises(OutOfWork, match="1 are allowed"):
        compute_lower_bound(make_knapsack(), np.inf, 0, work=work)
    assert not issubclass(OutOfWork, PlanningError)


def test_no_point_within_the_nodes_is_a_typed_failure() -> None:
    """Whole numbers never add up to half of one; no relaxation finds that out."""
    model = Model("parity")
    chosen = [model.binary() for _ in range(24)]
    rng = np.random.default_rng(5)
    weights = rng.integers(10**5, 10**6, 24)
    total = sum((float(w) * z for w, z in zip(weights, chosen, strict=True)), Affine({}))
    model.require_equal(total - (float(weights.sum() // 2) + 0.5))
    with pytest.raises((SolverFailed, Infeasible)):
        solve(model, np.inf, work=Work(nodes=1))

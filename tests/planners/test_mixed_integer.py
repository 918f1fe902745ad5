import itertools

import numpy as np
import pytest

from planners.cones import solve_cones
from planners.errors import Infeasible
from planners.mixed_integer import Affine, Model, evaluate, solve_mixed_integer


def test_expressions_are_affine() -> None:
    model = Model("test")
    x, y = model.variable(0, 1), model.variable(-1, 2)
    expression = 2.0 * (x - 3 * y) + 1.0
    assert expression.value(np.array([0.5, 2.0])) == 2 * (0.5 - 6) + 1
    assert model.limits(expression) == (-11.0, 9.0)
    assert (1.0 - x).value(np.array([0.25, 0.0])) == 0.75


def test_arrays_of_expressions_obey_linear_algebra() -> None:
    model = Model("test")
    p = model.vector(np.zeros(2), np.ones(2))
    H = np.array([[1.0, 2.0], [-3.0, 4.0]])
    x = np.array([0.3, 0.9])
    np.testing.assert_allclose(evaluate(H @ p - np.ones(2), x), H @ x - 1.0)


def test_knapsack_equals_enumeration() -> None:
    rng = np.random.default_rng(3)
    value, weight = rng.uniform(1, 2, 8), rng.uniform(1, 2, 8)
    model = Model("knapsack")
    chosen = [model.binary() for _ in value]
    model.require(sum((w * z for w, z in zip(weight, chosen, strict=True)), Affine({})) - 6.0)
    model.objective = sum((-v * z for v, z in zip(value, chosen, strict=True)), Affine({}))
    solution = solve_mixed_integer(model, 10.0)
    best = max(value @ z for z in itertools.product((0, 1), repeat=8) if weight @ z <= 6.0)
    assert -solution.objective == pytest.approx(best, abs=1e-7)
    assert solution.bound <= solution.objective + 1e-9


def test_one_of_several_alternatives_holds() -> None:
    model = Model("alternatives")
    x = model.variable(0.0, 10.0)
    model.require_any([[x - 2.0], [7.0 - x], [12.0 - x]])
    model.require(3.0 - x)
    model.objective = x
    assert sum(model.integer) == 2  # the third cannot hold and costs no binary
    assert solve_mixed_integer(model, 10.0).x[0] == pytest.approx(7.0)


def test_implied_rows_are_dropped_and_impossible_ones_refused() -> None:
    model = Model("impossible")
    x = model.variable(0.0, 1.0)
    model.require_any([[x - 1.0], [x - 0.5]])
    assert not model.inequalities
    with pytest.raises(Infeasible, match="impossible"):
        model.require_any([[2.0 - x], [3.0 - x]])


def test_infeasible_is_typed() -> None:
    model = Model("empty")
    x = model.variable(0.0, 1.0, integer=True)
    model.require(0.4 - x)
    model.require(x - 0.6)
    with pytest.raises(Infeasible) as error:
        solve_mixed_integer(model, 10.0)
    assert error.value.problem == "empty"
    assert error.value.remedy


def test_shares_are_quotients() -> None:
    """Two legs over distances 3 and 1 in 8 s: least effort is the common speed, J = 4^2 / 8."""
    model = Model("legs")
    t = [model.variable(0.1, 8.0), model.variable(0.1, 8.0)]
    e = [model.variable(0.0, 100.0), model.variable(0.0, 100.0)]
    model.require_equal(t[0] + t[1] - 8.0)
    model.objective = e[0] + e[1]
    x = solve_cones(model, np.zeros(4), [(e[0], Affine({}, 3.0), t[0]), (e[1], Affine({}, 1.0), t[1])])
    np.testing.assert_allclose(x, [6.0, 2.0, 1.5, 0.5], atol=1e-4)

import numpy as np
import pytest

from planners.cones import solve_cones
from planners.errors import Infeasible
from planners.mixed_integer import Affine, Model, evaluate
from planners.path_cost import PieceCost
from planners.solvers import solve


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


def test_one_of_several_alternatives_holds() -> None:
    model = Model("alternatives")
    x = model.variable(0.0, 10.0)
    model.require_any([[x - 2.0], [7.0 - x], [12.0 - x]])
    model.require(3.0 - x)
    model.objective = x
    assert sum(model.integer) == 2  # the third cannot hold and costs no binary
    assert solve(model, 10.0).x[0] == pytest.approx(7.0)


def test_implied_rows_are_dropped_and_impossible_ones_refused() -> None:
    model = Model("impossible")
    x = model.variable(0.0, 1.0)
    model.require_any([[x - 1.0], [x - 0.5]])
    assert not model.inequalities
    with pytest.raises(Infeasible, match="impossible"):
        model.require_any([[2.0 - x], [3.0 - x]])


def test_costs_are_quotients() -> None:
    """Two legs over distances 3 and 1 in 8 s: one speed on both costs least, J = 4^2 / 8."""
    model = Model("legs")
    t = [model.variable(0.1, 8.0), model.variable(0.1, 8.0)]
    e = [model.variable(0.0, 100.0), model.variable(0.0, 100.0)]
    model.require_equal(t[0] + t[1] - 8.0)
    model.objective = e[0] + e[1]
    costs = [PieceCost("body", e[k], Affine({}, move), t[k]) for k, move in enumerate((3.0, 1.0))]
    x = solve_cones(model, np.zeros(4), costs)
    np.testing.assert_allclose(x, [6.0, 2.0, 1.5, 0.5], atol=1e-4)

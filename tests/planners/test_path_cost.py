import numpy as np
import pytest

from planners.mixed_integer import Affine, Model
from planners.path_cost import Displacement, add_path_cost, compute_path_cost, measure_path_cost
from planners.solvers import solve


def _solve(move: float, duration: float, tangents: int) -> tuple[float, float]:
    """Return the least cost of one piece along x under its tangent planes, and its exact cost."""
    model = Model("piece")
    x = model.variable(-10.0, 10.0)
    model.require_equal(x - move)
    piece = Displacement("body", np.array([x, Affine({})]), duration, fastest=1.0)
    costs = add_path_cost(model, [piece], tangents)
    solution = solve(model, 10.0)
    return solution.objective, compute_path_cost(costs, solution.x)


@pytest.mark.parametrize("move", [-3.1, -1.0, 0.4, 2.0])
def test_tangent_planes_bound_the_cost_from_below(move: float) -> None:
    rough, exact = _solve(move, 4.0, 3)
    fine, _ = _solve(move, 4.0, 40)
    assert exact == pytest.approx(move**2 / 4.0)
    assert rough <= fine + 1e-9 <= exact + 2e-9
    assert fine == pytest.approx(exact, rel=0.05)


def test_a_tangent_plane_is_exact_at_its_speed() -> None:
    bound, exact = _solve(2.0, 4.0, 2)  # 0.5 m/s, half of the greatest speed
    assert bound == pytest.approx(exact, abs=1e-6)


def test_pieces_that_rest_cost_nothing_and_have_no_variables() -> None:
    model = Model("rest")
    assert add_path_cost(model, [Displacement("body", np.zeros(2), 5.0, fastest=0.0)], 4) == []
    assert not model.lower


def test_cost_of_a_polyline_is_least_at_uniform_speed() -> None:
    knots = np.array([[0.0, 0.0], [1.0, 0.0], [3.0, 0.0]])
    assert measure_path_cost(knots, np.array([0.0, 2.0, 6.0])) == pytest.approx(3.0**2 / 6.0)
    assert measure_path_cost(knots, np.array([0.0, 3.0, 6.0])) > 1.6

from itertools import pairwise

import numpy as np
import pytest

from planners.bezier import Curve
from planners.quintic_spline import Breakpoint, QuinticSpline, build_quintic_spline

TIMES = np.array([0.0, 1.0, 3.0, 3.5])
REST = (np.zeros(2), np.zeros(2))
JUMP = Breakpoint(np.array([1.0, 2.0]), (np.array([0.3, 0.1]), np.array([-0.2, 0.4])))


@pytest.fixture
def spline() -> QuinticSpline:
    return build_quintic_spline(TIMES, {0: Breakpoint(np.zeros(2), REST), 2: JUMP, 3: Breakpoint(None, REST)})


def _curve(spline: QuinticSpline, x: np.ndarray) -> Curve:
    return Curve(spline.times, spline.position.apply(x).reshape(-1, 6, 2))


def test_known_states_are_met_exactly_for_any_free_states(spline: QuinticSpline) -> None:
    curve = _curve(spline, np.random.default_rng(0).normal(size=(spline.size, 2)))
    np.testing.assert_array_equal(curve.position(0.0), [0.0, 0.0])
    np.testing.assert_array_equal(curve.position(3.0), JUMP.position)
    for side, velocity in zip(("left", "right"), JUMP.velocities, strict=True):
        np.testing.assert_allclose(curve.velocity(3.0, side), velocity, atol=1e-12)
    np.testing.assert_allclose(curve.velocity(3.5, "left"), [0.0, 0.0], atol=1e-12)


def test_free_nodes_are_twice_continuously_differentiable(spline: QuinticSpline) -> None:
    curve = _curve(spline, np.random.default_rng(1).normal(size=(spline.size, 2)))
    for value in (curve.position, curve.velocity, curve.acceleration):
        np.testing.assert_allclose(value(1.0, "left"), value(1.0, "right"), atol=1e-11)


def test_maps_are_the_derivatives_of_the_curve(spline: QuinticSpline) -> None:
    x = np.random.default_rng(2).normal(size=(spline.size, 2))
    curve = _curve(spline, x)
    np.testing.assert_allclose(spline.velocity.apply(x), curve.derivative.points.reshape(-1, 2), atol=1e-11)
    second = curve.derivative.derivative
    np.testing.assert_allclose(spline.acceleration.apply(x), second.points.reshape(-1, 2), atol=1e-9)
    np.testing.assert_allclose(spline.jerk.apply(x), second.derivative.points.reshape(-1, 2), atol=1e-7)


def test_cost_is_the_integral_of_squared_acceleration_and_jerk(spline: QuinticSpline) -> None:
    rng = np.random.default_rng(3)
    one, other = rng.normal(size=(2, spline.size, 2))
    quadratic, linear = spline.cost(0.7)

    def integral(x: np.ndarray) -> float:
        acceleration = _curve(spline, x).derivative.derivative
        total = 0.0
        nodes, weights = np.polynomial.legendre.leggauss(6)
        for start, end in pairwise(TIMES):
            t = start + (end - start) * (nodes + 1) / 2
            squares = acceleration.position(t) ** 2 + 0.7 * acceleration.derivative.position(t) ** 2
            total += (end - start) / 2 * float(weights @ squares.sum(axis=1))
        return total

    def cost(x: np.ndarray) -> float:
        return float(sum(0.5 * x[:, d] @ quadratic @ x[:, d] + linear[:, d] @ x[:, d] for d in range(2)))

    assert cost(one) - cost(other) == pytest.approx(integral(one) - integral(other), rel=1e-9)

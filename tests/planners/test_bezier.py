from math import comb

import numpy as np
import pytest

from impact_envs.errors import InputError
from planners.bezier import Curve


@pytest.fixture
def curve() -> Curve:
    points = np.random.default_rng(1).normal(size=(3, 6, 2))
    return Curve(np.array([0.0, 0.7, 1.5, 4.0]), points)


def test_position_is_the_bernstein_sum(curve: Curve) -> None:
    times = np.linspace(0.71, 1.49, 7)
    s = (times - 0.7) / 0.8
    weights = np.stack([comb(5, b) * (1 - s) ** (5 - b) * s**b for b in range(6)], axis=1)
    np.testing.assert_allclose(curve.position(times), weights @ curve.points[1], atol=1e-14)


def test_breakpoints_belong_to_both_sides(curve: Curve) -> None:
    np.testing.assert_array_equal(curve.position(0.7, side="left"), curve.points[0, -1])
    np.testing.assert_array_equal(curve.position(0.7), curve.points[1, 0])
    np.testing.assert_array_equal(curve.position([0.0, 4.0]), [curve.points[0, 0], curve.points[-1, -1]])


@pytest.mark.parametrize("side", ["left", "right"])
def test_derivatives_are_finite_differences(curve: Curve, side: str) -> None:
    for t in (0.3, 1.2, 3.9):
        h = 1e-5
        velocity = (curve.position(t + h) - curve.position(t - h)) / (2 * h)
        acceleration = (curve.velocity(t + h) - curve.velocity(t - h)) / (2 * h)
        np.testing.assert_allclose(curve.velocity(t, side), velocity, rtol=1e-7, atol=1e-7)
        np.testing.assert_allclose(curve.acceleration(t, side), acceleration, rtol=1e-6, atol=1e-5)


def test_velocity_has_one_sided_limits(curve: Curve) -> None:
    for side, sign in (("left", -1), ("right", 1)):
        h = sign * 1e-6
        difference = (curve.position(1.5 + h, side) - curve.position(1.5, side)) / h
        np.testing.assert_allclose(curve.velocity(1.5, side), difference, rtol=1e-3)


def test_outside_its_span_a_curve_rests_at_its_ends(curve: Curve) -> None:
    np.testing.assert_array_equal(curve.position([-1.0, 9.0]), [curve.points[0, 0], curve.points[-1, -1]])
    assert not curve.velocity([-1.0, 9.0]).any()
    assert not curve.acceleration([-1.0, 9.0]).any()


def test_one_instant_and_many_agree(curve: Curve) -> None:
    assert curve.position(0.2).shape == (2,)
    np.testing.assert_array_equal(curve.position(np.array([0.2, 3.0]))[1], curve.position(3.0))


def test_a_straight_line_has_no_acceleration() -> None:
    line = Curve([0.0, 2.0], [[[0.0, 0.0], [1.0, 3.0]]])
    np.testing.assert_array_equal(line.velocity(1.0), [0.5, 1.5])
    assert not line.acceleration(1.0).any()


@pytest.mark.parametrize(
    ("times", "points"),
    [
        ([0.0, 0.0], np.zeros((1, 2, 2))),
        ([0.0, 1.0], np.zeros((2, 2, 2))),
        ([0.0, 1.0], np.zeros((1, 2, 3))),
        ([0.0, 1.0], np.full((1, 2, 2), np.nan)),
        (["a", 1.0], np.zeros((1, 2, 2))),
    ],
)
def test_what_is_no_curve_is_refused_in_one_line(times: list, points: np.ndarray) -> None:
    with pytest.raises(InputError) as error:
        Curve(times, points)
    assert "\n" not in str(error.value)


def test_arrays_cannot_be_changed(curve: Curve) -> None:
    with pytest.raises(ValueError, match="read-only"):
        curve.points[0, 0, 0] = 1.0

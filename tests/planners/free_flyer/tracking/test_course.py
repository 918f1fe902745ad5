"""Courses start where the robot is, arrive where the impact is, go straight on if it does not come, and return."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import minimize

from planners.bezier import Curve
from planners.free_flyer.tracking.course import (
    COURSE,
    SHORTEST_RETURN,
    convert_curve,
    evaluate_course,
    evaluate_curve,
    evaluate_quintic,
    fit_detour,
    fit_quintic,
    plan_approach,
    read_clock,
    return_to_plan,
    set_clock,
)
from planners.free_flyer.tracking.course_sampling import sample_course
from planners.free_flyer.tracking.least_acceleration import minimise_acceleration, plan_least_acceleration

IMPACT, HORIZON = 30.0, 60.0
LONGEST, FASTEST = 12.0, 1.5


def make_curve() -> Curve:
    """Return a curve over [0, 60] that stops, turns and has a kink in its velocity at 30 s."""
    rng = np.random.default_rng(0)
    times, pieces, state = [0.0, 12.0, IMPACT, 41.0, HORIZON], [], rng.normal(size=(3, 2)) * [[1.0], [0.1], [0.01]]
    for k, h in enumerate(np.diff(times)):
        end = rng.normal(size=(3, 2)) * [[1.0], [0.1], [0.01]]
        v, a = h / 5, h * h / 20
        first = [state[0], state[0] + v * state[1], state[0] + 2 * v * state[1] + a * state[2]]
        last = [end[0] - 2 * v * end[1] + a * end[2], end[0] - v * end[1], end[0]]
        pieces.append([*first, *last])
        state = end.copy()
        if k == 1:
            state[1] += 0.05
    return Curve(times, pieces)


CURVE = make_curve()
POWER = convert_curve(CURVE)
# The curve is that of robot 1 of 2; a shorter one of lower degree is filled up.
BREAKS = np.array([[0.0, 60.0, np.inf, np.inf, np.inf], POWER.times])
COEFFICIENTS = np.stack([np.zeros_like(POWER.coefficients), POWER.coefficients])
COEFFICIENTS[0, 0, :2] = [[1.0, 2.0], [3.0, -6.0]]
CONTACT, SPEED = (0.3, -0.2), (0.04, 0.02)


def plan_at(t: float, left: bool = False) -> np.ndarray:
    return np.reshape(evaluate_curve(BREAKS, COEFFICIENTS, 1, t, left), (3, 2))


def make_course() -> np.void:
    return np.zeros(1, COURSE)[0]


def at(course: np.void, t: float) -> np.ndarray:
    return np.reshape(evaluate_course(course, BREAKS, COEFFICIENTS, 1, t), (3, 2))


def follow(time: float = IMPACT, planned: float = IMPACT, now: float = 0.0, tau: float = 0.0) -> np.void:
    """Return the course of robot 1, which follows its plan to an event."""
    course = make_course()
    set_clock(course, now, tau, time, planned, math.inf)
    return course


def approach_from(
    course: np.void, now: float, time: float = IMPACT, planned: float = IMPACT, contact: tuple = CONTACT
) -> np.void:
    """Return a copy that leads from the present reference to the impact."""
    new = course.copy()
    begin = evaluate_course(course, BREAKS, COEFFICIENTS, 1, now)
    plan_approach(new, BREAKS, COEFFICIENTS, 1, now, begin, contact, SPEED, time, planned)
    return new


def return_from(now: float, state: np.ndarray, time: float = HORIZON, planned: float = HORIZON) -> np.void:
    course = approach_from(follow(), 20.0)
    begin = tuple(float(value) for value in state.ravel())
    event = (IMPACT, time, planned, LONGEST, FASTEST)
    return_to_plan(course, BREAKS, COEFFICIENTS, 1, now, begin, *event)
    return course


@pytest.mark.parametrize("t", [-1.0, 0.0, 5.3, 12.0, 29.9, IMPACT, 33.0, 60.0, 61.0])
@pytest.mark.parametrize("side", ["left", "right"])
def test_power_basis_is_the_same_curve(t: float, side: str) -> None:
    out = plan_at(t, side == "left")
    np.testing.assert_allclose(out[0], CURVE.position(t, side), atol=1e-11)
    np.testing.assert_allclose(out[1], CURVE.velocity(t, side), atol=1e-11)
    np.testing.assert_allclose(out[2], CURVE.acceleration(t, side), atol=1e-11)


def test_shorter_curve_is_read_to_its_own_end() -> None:
    for t, share in ((30.0, 0.5), (60.0, 1.0), (70.0, 1.0)):
        motion = evaluate_curve(BREAKS, COEFFICIENTS, 0, t, False)
        np.testing.assert_allclose(motion[:2], [1 + 3 * share, 2 - 6 * share], atol=1e-12)
        np.testing.assert_allclose(motion[2:4], np.array([0.05, -0.1]) * (t <= 60), atol=1e-12)


def test_quintic_meets_both_ends() -> None:
    begin, end = np.random.default_rng(1).normal(size=(2, 3, 2))
    course = make_course()
    course["since"], course["until"] = 4.0, 7.0
    fit_quintic(course, tuple(begin.ravel()), tuple(end.ravel()))
    still = np.zeros_like(COEFFICIENTS)
    for t, motion in ((4.0, begin), (7.0, end)):
        out = evaluate_course(course, BREAKS, still, 1, t)
        np.testing.assert_allclose(np.reshape(out, (3, 2)), motion, atol=1e-10)


def test_following_is_the_plan() -> None:
    course = follow()
    for t in np.linspace(0, IMPACT - 0.01, 20):
        np.testing.assert_allclose(at(course, t), plan_at(t), atol=1e-15)


def test_clock_brings_the_plan_to_its_event_when_it_is_expected_and_stops_there() -> None:
    course = follow(time=40.0, planned=IMPACT, now=10.0, tau=10.0)
    assert course["rate"] == pytest.approx(2 / 3)
    assert read_clock(course, 40.0) == pytest.approx(IMPACT)
    motion = plan_at(20.0) * [[1], [2 / 3], [4 / 9]]  # slower by the clock's rate
    np.testing.assert_allclose(at(course, 25.0), motion, atol=1e-12)
    np.testing.assert_allclose(at(course, 45.0), [plan_at(IMPACT, left=True)[0], [0, 0], [0, 0]], atol=1e-12)


def test_clock_is_continuous_when_it_is_set_anew() -> None:
    course = follow()
    before = at(course, 13.0)
    set_clock(course, 13.0, read_clock(course, 13.0), 50.0, IMPACT, math.inf)
    np.testing.assert_allclose(at(course, 13.0)[0], before[0], atol=1e-13)
    assert read_clock(course, 50.0) == pytest.approx(IMPACT)


def test_clock_does_not_race_and_is_never_past_its_event() -> None:
    hurried = make_course()
    set_clock(hurried, 10.0, 10.0, 11.0, IMPACT, FASTEST)
    assert hurried["rate"] == FASTEST
    set_clock(hurried, 10.0, 35.0, 40.0, IMPACT, FASTEST)
    assert read_clock(hurried, 10.0) == hurried["stop"] == IMPACT


@pytest.mark.parametrize(("now", "time"), [(11.0, IMPACT), (20.0, IMPACT + 4.0), (29.0, IMPACT)])
def test_approach_leads_from_the_present_reference_to_the_impact_and_straight_on(now: float, time: float) -> None:
    course = follow()
    course_to = approach_from(course, now, time)
    np.testing.assert_allclose(at(course_to, now), at(course, now), atol=1e-12)
    np.testing.assert_allclose(at(course_to, time)[:2], [CONTACT, SPEED], atol=1e-12)
    late = at(course_to, time + 1.2)
    np.testing.assert_allclose(late, [np.add(CONTACT, 1.2 * np.array(SPEED)), SPEED, [0, 0]], atol=1e-12)


def test_approach_is_smooth_all_the_way() -> None:
    course, step = approach_from(follow(), 13.0, IMPACT + 2.5), 1e-5
    for t in np.linspace(13.5, IMPACT + 2.0, 23):
        before, here, after = (at(course, t + d) for d in (-step, 0.0, step))
        np.testing.assert_allclose((after[0] - before[0]) / (2 * step), here[1], atol=1e-8)
        np.testing.assert_allclose((after[1] - before[1]) / (2 * step), here[2], atol=1e-8)


def test_approach_to_the_planned_impact_is_the_plan() -> None:
    planned, course = plan_at(IMPACT, left=True), follow()
    begin = evaluate_course(course, BREAKS, COEFFICIENTS, 1, 14.0)
    contact, speed = (tuple(float(value) for value in row) for row in planned[:2])
    plan_approach(course, BREAKS, COEFFICIENTS, 1, 14.0, begin, contact, speed, IMPACT, IMPACT)
    for t in np.linspace(14.0, IMPACT, 15):
        np.testing.assert_allclose(at(course, t), plan_at(t, left=True), atol=1e-11)


def test_replanning_without_news_changes_nothing() -> None:
    first = approach_from(follow(), 12.0)
    second = approach_from(first, 21.0)
    for t in np.linspace(21.0, IMPACT, 10):
        np.testing.assert_allclose(at(second, t), at(first, t), atol=1e-10)


def test_approach_to_an_impact_that_is_none_of_the_plan_leaves_the_plan_standing() -> None:
    course = follow()
    extra = approach_from(course, 15.0, 22.0, planned=-1.0)
    assert read_clock(extra, 22.0) == pytest.approx(15.0)
    np.testing.assert_allclose(at(extra, 15.0), at(course, 15.0), atol=1e-12)
    np.testing.assert_allclose(at(extra, 22.0)[:2], [CONTACT, SPEED], atol=1e-12)


@pytest.mark.parametrize(("now", "expected"), [(30.1, 60.0), (33.0, 60.0), (30.1, 55.0)])
def test_return_joins_the_plan_smoothly_and_in_time(now: float, expected: float) -> None:
    state = np.array([[0.3, -0.2], [0.02, 0.1]])
    course = return_from(now, state, expected)
    end, rate = course["until"], course["rate"]
    np.testing.assert_allclose(at(course, now)[:2], state, atol=1e-12)
    assert end == pytest.approx(now + min(LONGEST, (expected - now) / 2))
    np.testing.assert_allclose(at(course, end - 1e-9), at(course, end + 1e-9), atol=1e-8)
    scale = np.array([[1.0], [rate], [rate**2]])  # the clock scales velocity and acceleration
    np.testing.assert_allclose(at(course, expected), scale * plan_at(HORIZON), atol=1e-9)


def test_return_does_not_race_through_the_plan_when_time_is_short() -> None:
    course = return_from(59.0, np.zeros((2, 2)))
    assert course["rate"] == FASTEST
    assert course["until"] == pytest.approx(59.0 + SHORTEST_RETURN)


def solve_equation_29(T: float, way: float, v_0: float, v_end: float, limit: float, miss: float) -> np.ndarray:
    """Return the control points (m, v_1) of one axis' velocity by a general solver, the integral by Simpson's rule."""

    def cost(x: np.ndarray) -> float:
        a = [2.0 * (x[0] - v_0) / T, (x[1] - v_0) / T, 2.0 * (x[1] - x[0]) / T]  # at the start, middle and end
        place = T * (v_0 + x[0] + x[1]) / 3.0
        effort = T / 6.0 * (a[0] ** 2 + 4.0 * a[1] ** 2 + a[2] ** 2)
        return effort + miss * ((place - way) ** 2 + (x[1] - v_end) ** 2)

    return minimize(cost, [0.0, 0.0], bounds=[(-limit, limit)] * 2, method="L-BFGS-B", tol=1e-15).x


@pytest.mark.parametrize("miss", [0.01, 1.0, 1e3])
@pytest.mark.parametrize("limit", [0.02, 0.1, 10.0])
def test_published_course_is_the_optimum_of_equation_29(limit: float, miss: float) -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        T, (way, v_0, v_end) = rng.uniform(1.0, 20.0), rng.uniform(-1.0, 1.0, 3) * [1.0, 0.1, 0.2]
        found = minimise_acceleration(T, way, v_0, v_end, limit, miss)
        np.testing.assert_allclose(found, solve_equation_29(T, way, v_0, v_end, limit, miss), atol=2e-5)


def test_published_course_starts_where_the_robot_is_and_hits_where_it_should() -> None:
    course = follow()
    begin, base = at(course, 8.0) + 0.01, plan_at(8.0)
    arguments = (tuple(begin.ravel()), tuple(base[0]), CONTACT, SPEED, 25.0, 10.0, 1e6)
    plan_least_acceleration(course, 8.0, *arguments)
    np.testing.assert_allclose(at(course, 8.0)[:2], begin[:2], atol=1e-12)
    np.testing.assert_allclose(at(course, 25.0)[:2], [CONTACT, SPEED], atol=1e-5)
    slow = at(course, 12.0)
    acceleration = (at(course, 12.0 + 1e-4)[1] - at(course, 12.0 - 1e-4)[1]) / 2e-4
    np.testing.assert_allclose(slow[2], acceleration, atol=1e-6)
    np.testing.assert_allclose(at(course, 26.0)[0], np.array(CONTACT) + SPEED, atol=1e-4)


def test_detour_goes_through_its_via_point_with_continuous_jerk_and_snap() -> None:
    """Two quintics of least jerk: position is given at the via point, five derivatives are continuous there."""
    course, ends = make_course(), np.random.default_rng(1).normal(size=(2, 6))
    course["until"] = 12.0
    fit_detour(course, tuple(ends[0]), tuple(ends[1]), (1.5, -0.4), 2.0, 7.0)
    assert evaluate_quintic(course, 2.0) == pytest.approx(ends[0])
    assert evaluate_quintic(course, 12.0) == pytest.approx(ends[1])
    assert evaluate_quintic(course, 7.0)[:2] == pytest.approx((1.5, -0.4))
    first, last = (np.polynomial.Polynomial(course[name][:, 0]) for name in ("first", "quintic"))
    for order in range(5):
        assert first.deriv(order)(5.0) == pytest.approx(last.deriv(order)(0.0), abs=1e-12), order
    mirror = make_course()
    mirror["until"] = 12.0
    fit_detour(mirror, tuple(-ends[0]), tuple(-ends[1]), (-1.5, 0.4), 2.0, 7.0)
    assert mirror["first"] == pytest.approx(-course["first"])


@pytest.mark.parametrize("now", [0.0, 11.55, 19.7, 28.8, 29.6, 31.0, 40.2, 58.9, 59.7])
def test_samples_are_the_course_bit_for_bit(now: float) -> None:
    """Through breakpoints, the ends of quintics, of the clock and of the plan."""
    detour = approach_from(follow(), 10.0)
    detour["until"] = 32.0
    fit_detour(detour, tuple(np.ones(6)), tuple(np.zeros(6)), (0.2, 0.1), 8.0, 30.0)
    slow = follow(time=33.0, planned=29.0)
    courses = [follow(), slow, approach_from(follow(), 10.0), approach_from(slow, 20.0, planned=10.0), detour]
    courses += [return_from(10.0, np.ones((2, 2))), return_from(31.0, np.zeros((2, 2)), planned=45.0)]
    durations = np.full(10, 0.1)
    durations[3:5] = 0.13, 0.07
    times = [now]
    for h in durations:
        times.append(times[-1] + h)
    for course in courses:
        for count in (11, 4):
            states = np.full((11, 6), np.nan)
            sample_course(course, BREAKS, COEFFICIENTS, 1, times[0], durations, count, states)
            expected = [evaluate_course(course, BREAKS, COEFFICIENTS, 1, t)[:4] for t in times[:count]]
            np.testing.assert_array_equal(states[:count][:, [0, 1, 3, 4]], expected)
            assert np.isnan(states[count:]).all()
            assert np.isnan(states[:, [2, 5]]).all()

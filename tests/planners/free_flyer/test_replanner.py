"""Courses start where the robot is, arrive where the impact is, and return to the plan."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from planners.bezier import Curve
from planners.free_flyer.course import (
    Course,
    PowerCurve,
    convert_curve,
    evaluate_course,
    evaluate_curve,
    fit_quintic,
)
from planners.free_flyer.replanner import (
    compute_desired_velocity,
    follow_plan,
    plan_approach,
    plan_return,
    sample_reference,
)
from planners.free_flyer.tracking import NO_JUMP, STAGES, build_tracking_problem
from planners.free_flyer.two_body import TwoBodyImpact, solve_two_body_impact

IMPACT = 30.0
PERIOD = 0.1
PROBLEM = build_tracking_problem(SimpleNamespace(mass=16.8, inertia=0.16, force_limit=1.5, torque_limit=0.5), PERIOD)
NORMAL = (math.cos(0.4), math.sin(0.4))


def make_curve() -> Curve:
    """Return a curve over [0, 60] that stops, turns and has a kink in its velocity at 30 s."""
    rng = np.random.default_rng(0)
    times, pieces, state = [0.0, 12.0, IMPACT, 41.0, 60.0], [], rng.normal(size=(3, 2)) * [[1.0], [0.1], [0.01]]
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
PLAN = convert_curve(CURVE)


def at(course: Course | PowerCurve, t: float, left: bool = False) -> np.ndarray:
    out = np.empty((3, 2))
    if isinstance(course, Course):
        evaluate_course(course, t, out)
    else:
        evaluate_curve(course, t, left, out)
    return out


def make_impact(shift: float = 0.1) -> TwoBodyImpact:
    position = tuple(CURVE.position(IMPACT) + shift)
    pairs = (position, (0.02, -0.01), (0.1, 0.04), (0.02, -0.01), NORMAL)
    return solve_two_body_impact(*pairs, 16.8, 16.8, 0.8, 0.4, 0.3)


@pytest.mark.parametrize("t", [-1.0, 0.0, 5.3, 12.0, 29.9, IMPACT, 33.0, 60.0, 61.0])
@pytest.mark.parametrize("side", ["left", "right"])
def test_power_basis_is_the_same_curve(t: float, side: str) -> None:
    out = at(PLAN, t, side == "left")
    np.testing.assert_allclose(out[0], CURVE.position(t, side), atol=1e-11)
    np.testing.assert_allclose(out[1], CURVE.velocity(t, side), atol=1e-11)
    np.testing.assert_allclose(out[2], CURVE.acceleration(t, side), atol=1e-11)


def test_quintic_meets_both_ends() -> None:
    begin, end = np.random.default_rng(1).normal(size=(2, 3, 2))
    c, T = fit_quintic(3.0, begin, end), 3.0
    powers = np.array([[T**j for j in range(6)], [j * T ** max(j - 1, 0) for j in range(6)]])
    bend = np.array([j * (j - 1) * T ** max(j - 2, 0) for j in range(6)])
    np.testing.assert_allclose([c[0], c[1], 2 * c[2]], begin, atol=1e-12)
    np.testing.assert_allclose([*(powers @ c), bend @ c], end, atol=1e-10)


def test_following_is_the_plan() -> None:
    course = follow_plan(PLAN, IMPACT)
    for t in np.linspace(0, IMPACT - 0.01, 20):
        np.testing.assert_array_equal(at(course, t), at(PLAN, t))


def test_approach_leads_from_the_present_reference_to_the_impact_and_straight_on() -> None:
    impact, course = make_impact(), follow_plan(PLAN, IMPACT)
    for now, time in ((11.0, IMPACT), (20.0, IMPACT + 4.0), (29.0, IMPACT)):
        approach = plan_approach(course, now, at(course, now), impact, time, IMPACT)
        np.testing.assert_allclose(at(approach, now), at(course, now), atol=1e-12)
        np.testing.assert_allclose(at(approach, time)[0], impact.contact, atol=1e-12)
        np.testing.assert_allclose(at(approach, time)[1], impact.robot_minus, atol=1e-12)
        late = at(approach, time + 1.2)
        np.testing.assert_allclose(late[0], np.add(impact.contact, 1.2 * np.array(impact.robot_minus)), atol=1e-12)
        np.testing.assert_allclose(late[1], impact.robot_minus, atol=1e-12)


def test_approach_to_the_planned_impact_is_the_plan() -> None:
    planned = at(PLAN, IMPACT, left=True)
    impact = make_impact()._replace(contact=tuple(planned[0]), robot_minus=tuple(planned[1]))
    course = follow_plan(PLAN, IMPACT)
    approach = plan_approach(course, 14.0, at(course, 14.0), impact, IMPACT, IMPACT)
    for t in np.linspace(14.0, IMPACT, 15):
        np.testing.assert_allclose(at(approach, t), at(PLAN, t, left=True), atol=1e-11)


def test_replanning_without_news_changes_nothing() -> None:
    impact, course = make_impact(), follow_plan(PLAN, IMPACT)
    first = plan_approach(course, 12.0, at(course, 12.0), impact, IMPACT, IMPACT)
    second = plan_approach(first, 21.0, at(first, 21.0), impact, IMPACT, IMPACT)
    for t in np.linspace(21.0, IMPACT, 10):
        np.testing.assert_allclose(at(second, t), at(first, t), atol=1e-10)


@pytest.mark.parametrize(("now", "expected"), [(30.1, 60.0), (33.0, 60.0), (30.1, 55.0)])
def test_return_joins_the_plan_smoothly_and_in_time(now: float, expected: float) -> None:
    state = np.array([[0.3, -0.2], [0.02, 0.1]])
    course = plan_return(PLAN, now, state, IMPACT, expected, 60.0)
    np.testing.assert_allclose(at(course, now)[:2], state, atol=1e-12)
    assert course.end == pytest.approx(now + min(12.0, (expected - now) / 2))
    before, after = at(course, course.end - 1e-9), at(course, course.end + 1e-9)
    np.testing.assert_allclose(before, after, atol=1e-8)
    scale = np.array([[1.0], [course.rate], [course.rate**2]])  # the clock scales velocity and acceleration
    np.testing.assert_allclose(at(course, expected), scale * at(PLAN, 60.0), atol=1e-9)


def test_return_does_not_race_through_the_plan_when_time_is_short() -> None:
    course = plan_return(PLAN, 59.0, np.zeros((2, 2)), IMPACT, 60.0, 60.0)
    assert course.rate <= 1.5
    assert course.end >= 60.0


def test_desired_velocity_leads_to_the_target_under_drift() -> None:
    position, target, drift, L = np.array([1.0, 2.0]), np.array([2.0, 1.5]), np.array([5e-4, -1e-3]), 20.0
    velocity = compute_desired_velocity(position, target, L, drift, 0.3)
    np.testing.assert_allclose(position + L * velocity + drift * L * L / 2, target, atol=1e-13)
    assert np.abs(compute_desired_velocity(position, target, 1.0, drift, 0.3)).max() == pytest.approx(0.3)


def test_reference_is_dynamically_consistent() -> None:
    now, heading = 17.3, 0.7
    reference = sample_reference(follow_plan(PLAN, IMPACT), now, PROBLEM, heading, 0.5, None, 0.0)
    assert reference.jump_node == NO_JUMP
    c, s = math.cos(heading), math.sin(heading)
    force = reference.inputs[:, :2] @ np.array([[c, s], [-s, c]])
    velocity = reference.states[0, 3:5] + np.cumsum(PERIOD * force / 16.8, axis=0)
    np.testing.assert_allclose(velocity, reference.states[1:, 3:5], atol=1e-12)
    middle = (reference.states[1:, 3:5] + reference.states[:-1, 3:5]) / 2
    np.testing.assert_allclose(np.diff(reference.states[:, :2], axis=0), PERIOD * middle, atol=2e-6)
    assert np.all(reference.states[:, 2] == 0.5)


@pytest.mark.parametrize("ahead", [0.0, 0.03, 0.26, 0.5, 0.94])
def test_reference_puts_a_node_onto_the_impact(ahead: float) -> None:
    impact, course = make_impact(), follow_plan(PLAN, IMPACT)
    approach = plan_approach(course, 20.0, at(course, 20.0), impact, IMPACT, IMPACT)
    reference = sample_reference(approach, IMPACT - ahead, PROBLEM, 0.0, 0.0, impact, 0.9)
    k = reference.jump_node
    assert 1 <= k < STAGES
    assert np.sum(reference.durations) == pytest.approx(STAGES * PERIOD)
    assert np.sum(reference.durations[:k]) == pytest.approx(ahead, abs=1e-9)
    np.testing.assert_allclose(reference.states[k, :2], impact.contact, atol=1e-9)
    np.testing.assert_allclose(reference.states[k, 3:5], impact.robot_minus, atol=1e-9)
    np.testing.assert_allclose(reference.states[k + 1 :, 3:5], np.tile(impact.robot_plus, (STAGES - k, 1)))
    assert reference.object_speed == pytest.approx(np.dot(impact.normal, impact.object_minus))
    n, gain = np.array(impact.normal), reference.jump_gain
    kick = gain * (n @ impact.robot_minus - reference.object_speed) * n
    np.testing.assert_allclose(np.array(impact.robot_minus) - kick, impact.robot_plus, atol=1e-12)


def test_reference_far_from_an_impact_and_after_it_has_no_jump() -> None:
    impact, course = make_impact(), follow_plan(PLAN, IMPACT)
    approach = plan_approach(course, 20.0, at(course, 20.0), impact, IMPACT, IMPACT)
    for now in (28.0, IMPACT + 0.3):
        assert sample_reference(approach, now, PROBLEM, 0.0, 0.0, impact, 0.9).jump_node == NO_JUMP

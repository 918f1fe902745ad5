"""The two-body solution satisfies the impact law, whatever the masses, and names what it cannot give."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import minimize

from impact_envs.physics.impact import compute_velocity_gain
from planners.free_flyer.next_impact.two_body import (
    Outcome,
    TwoBodyImpact,
    solve_soft_two_body_impact,
    solve_two_body_impact,
)

NO_LIMIT = 1e3


def solve(
    minus: np.ndarray,
    desired: np.ndarray,
    wish: np.ndarray | None = None,
    masses: tuple[float, float] = (16.8, 16.8),
    restitution: float = 0.8,
    limit: float = NO_LIMIT,
) -> TwoBodyImpact:
    wish = minus if wish is None else wish
    position, default = (3.0, 2.0), (1.0, 0.0)
    pairs = (position, tuple(minus), tuple(desired), tuple(wish), default)
    return solve_two_body_impact(*pairs, *masses, restitution, 0.4, limit)


def soften(
    minus: np.ndarray,
    desired: np.ndarray,
    wish: np.ndarray,
    masses: tuple[float, float] = (16.8, 16.8),
    restitution: float = 0.8,
    limit: float = NO_LIMIT,
    robot_weight: float = 0.1,
) -> TwoBodyImpact:
    pairs = ((3.0, 2.0), tuple(minus), tuple(desired), tuple(wish), (1.0, 0.0))
    return solve_soft_two_body_impact(*pairs, *masses, restitution, 0.4, limit, 1.0, robot_weight)


def compute_cost(answer: TwoBodyImpact, desired: np.ndarray, wish: np.ndarray, robot_weight: float) -> float:
    off, moved = np.subtract(answer.object_plus, desired), np.subtract(answer.robot_minus, wish)
    return float(off @ off + robot_weight * moved @ moved)


def random_cases(count: int) -> list[tuple[np.ndarray, np.ndarray, np.ndarray, tuple[float, float], float]]:
    rng = np.random.default_rng(1)
    return [
        (*rng.uniform(-0.3, 0.3, (3, 2)), tuple(rng.uniform(1.0, 40.0, 2)), rng.uniform(0.0, 1.0)) for _ in range(count)
    ]


@pytest.mark.parametrize("case", random_cases(50))
def test_satisfies_equation_6(case: tuple) -> None:
    minus, desired, wish, (m_r, m_o), e = case
    answer = solve(minus, desired, wish, (m_r, m_o), e)
    n = np.array(answer.normal)
    local = np.array([n, [-n[1], n[0]]])
    r_minus, r_plus = local @ np.array(answer.robot_minus), local @ np.array(answer.robot_plus)
    o_minus, o_plus = local @ minus, local @ np.array(answer.object_plus)
    matrix = np.array([[m_r, m_o, 0, 0], [0, 0, m_r, 0], [1, -1, 0, 0], [0, 0, 0, m_o]])
    left = matrix @ [r_plus[0], o_plus[0], r_plus[1], o_plus[1]]
    right = [m_r * r_minus[0] + m_o * o_minus[0], m_r * r_minus[1], -e * (r_minus[0] - o_minus[0]), m_o * o_minus[1]]
    np.testing.assert_allclose(left, right, atol=1e-12)
    assert answer.outcome == Outcome.EXACT
    np.testing.assert_allclose(answer.object_plus, desired, atol=1e-13)
    assert r_minus[0] > o_minus[0]  # they approach
    assert math.isclose(r_minus[1], (local @ wish)[1], abs_tol=1e-13)  # the tangential wish is granted
    np.testing.assert_allclose(np.array([3.0, 2.0]) - answer.contact, 0.4 * n, atol=1e-14)


def test_mirror_image_problem_has_mirror_image_solution() -> None:
    for minus, desired, wish, masses, e in random_cases(20):
        answer = solve(minus, desired, wish, masses, e, 0.25)
        flip = np.array([1.0, -1.0])
        mirrored = solve(flip * minus, flip * desired, flip * wish, masses, e, 0.25)
        assert mirrored.outcome == answer.outcome
        for name in ("normal", "robot_minus", "robot_plus", "object_plus"):
            np.testing.assert_allclose(getattr(mirrored, name), flip * getattr(answer, name), atol=1e-14)


def test_compiled_and_interpreted_source_agree() -> None:
    for minus, desired, wish, masses, e in random_cases(10):
        arguments = ((0.0, 0.0), tuple(minus), tuple(desired), tuple(wish), (1.0, 0.0), *masses, e, 0.4, 0.2)
        compiled, plain = solve_two_body_impact(*arguments), solve_two_body_impact.py_func(*arguments)
        assert compiled.outcome == plain.outcome
        np.testing.assert_allclose(compiled[1:], plain[1:], atol=1e-14)


def test_speed_limit_keeps_the_direction_of_the_impulse() -> None:
    seen = 0
    for minus, desired, wish, masses, e in random_cases(200):
        free = solve(minus, desired, wish, masses, e)
        answer = solve(minus, desired, wish, masses, e, 0.2)
        assert max(map(abs, answer.robot_minus)) <= 0.2 + 1e-12
        assert answer.normal == free.normal
        gained, wanted = np.array(answer.object_plus) - minus, desired - minus
        if answer.outcome == Outcome.TOO_FAST and gained @ wanted < wanted @ wanted:
            seen += 1
            # no faster robot within the limits: its speed along the normal is the support of the speed box
            n = np.array(answer.normal)
            assert math.isclose(n @ answer.robot_minus, 0.2 * np.abs(n).sum(), rel_tol=1e-12)
        assert abs(gained[0] * wanted[1] - gained[1] * wanted[0]) < 1e-12
    assert seen > 10


def test_no_impact_needed_means_matching_the_object() -> None:
    velocity = np.array([0.1, -0.05])
    answer = solve(velocity, velocity)
    assert answer.outcome == Outcome.NOT_NEEDED
    np.testing.assert_allclose(answer.robot_minus, velocity, atol=1e-15)
    np.testing.assert_allclose(answer.robot_plus, answer.robot_minus)
    assert answer.normal == (1.0, 0.0)


def test_object_that_flees_too_fast_is_out_of_reach() -> None:
    minus = np.array([0.5, 0.0])
    answer = solve(minus, np.array([0.6, 0.0]), limit=0.3)
    assert answer.outcome == Outcome.OUT_OF_REACH
    np.testing.assert_array_equal(answer.object_plus, minus)


def test_velocity_gain_of_a_heavy_robot_is_one_plus_restitution() -> None:
    assert math.isclose(compute_velocity_gain(0.8, 1e9, 1.0), 1.8, rel_tol=1e-8)
    assert compute_velocity_gain(1.0, 2.0, 2.0) == 1.0  # equal elastic discs swap their normal velocities


@pytest.mark.parametrize("case", random_cases(15))
@pytest.mark.parametrize("robot_weight", [1e-2, 1.0])
def test_soft_form_is_the_numerical_minimum(case: tuple, robot_weight: float) -> None:
    minus, desired, wish, (m_r, m_o), e = case
    gain = (1.0 + e) * m_r / (m_r + m_o)

    def separate(z: np.ndarray) -> tuple[np.ndarray, float]:
        n = np.array([math.cos(z[0]), math.sin(z[0])])
        return n, float(n @ (z[1:] - minus))

    def cost(z: np.ndarray) -> float:
        n, approach = separate(z)
        off, moved = minus + gain * approach * n - desired, z[1:] - wish
        return float(off @ off + robot_weight * moved @ moved)

    rule = {"type": "ineq", "fun": lambda z: separate(z)[1]}
    starts = [np.array([angle, *wish]) for angle in np.arange(8) * math.pi / 4]
    found = [minimize(cost, z, method="SLSQP", constraints=rule, options={"ftol": 1e-13}) for z in starts]
    least = min(result.fun for result in found if result.success and separate(result.x)[1] > -1e-9)
    answer = soften(minus, desired, wish, (m_r, m_o), e, robot_weight=robot_weight)
    assert answer.outcome == Outcome.EXACT
    assert math.isclose(compute_cost(answer, desired, wish, robot_weight), least, rel_tol=1e-5, abs_tol=1e-9)


def test_soft_form_keeps_momentum_and_restitution() -> None:
    for minus, desired, wish, (m_r, m_o), e in random_cases(50):
        answer = soften(minus, desired, wish, (m_r, m_o), e)
        before = m_r * np.array(answer.robot_minus) + m_o * minus
        after = m_r * np.array(answer.robot_plus) + m_o * np.array(answer.object_plus)
        np.testing.assert_allclose(after, before, atol=1e-13)
        n = np.array(answer.normal)
        approach = n @ np.subtract(answer.robot_minus, minus)
        assert approach > 0.0
        assert math.isclose(n @ np.subtract(answer.object_plus, answer.robot_plus), e * approach, abs_tol=1e-14)


def test_soft_form_goes_to_the_hard_one_as_the_robots_weight_vanishes() -> None:
    for minus, desired, wish, masses, e in random_cases(20):
        hard = solve(minus, desired, wish, masses, e)
        off = []
        for weight in (1e-3, 1e-5, 1e-7):
            soft = soften(minus, desired, wish, masses, e, robot_weight=weight)
            off.append(float(np.abs(np.subtract(soft.object_plus, desired)).max()))
        assert off[0] > 3.0 * off[1] > 9.0 * off[2]
        np.testing.assert_allclose(soft[1:], hard[1:], atol=1e-4)


def test_soft_form_of_a_heavy_robots_weight_keeps_its_velocity() -> None:
    for minus, desired, wish, masses, e in random_cases(20):
        np.testing.assert_allclose(
            soften(minus, desired, wish, masses, e, robot_weight=1e7).robot_minus, wish, atol=1e-5
        )


def test_soft_form_does_not_hit_what_is_as_wished() -> None:
    velocity, wish = np.array([0.1, -0.05]), np.array([-0.1, 0.2])
    answer = soften(velocity, velocity, wish)
    assert answer.outcome == Outcome.NOT_NEEDED
    np.testing.assert_allclose(answer.object_plus, velocity, atol=1e-12)
    np.testing.assert_allclose(answer.robot_minus, wish, atol=1e-12)
    assert soften(velocity, velocity, velocity).normal == (1.0, 0.0)


def test_soft_form_obeys_the_speed_limit_and_says_so() -> None:
    outcomes = set()
    for minus, desired, wish, masses, e in random_cases(200):
        free, answer = soften(minus, desired, wish, masses, e), soften(minus, desired, wish, masses, e, 0.2)
        outcomes.add(answer.outcome)
        assert max(map(abs, answer.robot_minus)) <= 0.2 + 1e-12
        assert answer.normal == free.normal
        if answer.outcome == Outcome.TOO_FAST:
            n = np.array(answer.normal)
            assert math.isclose(abs(n @ answer.robot_minus), 0.2 * np.abs(n).sum(), rel_tol=1e-12)
    assert outcomes == {Outcome.EXACT, Outcome.TOO_FAST}
    fleeing = np.array([0.5, 0.0])
    answer = soften(fleeing, np.array([0.6, 0.0]), fleeing, limit=0.3)
    assert answer.outcome == Outcome.OUT_OF_REACH
    np.testing.assert_array_equal(answer.object_plus, fleeing)

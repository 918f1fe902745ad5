"""The condensed MPC solves the problem it claims to, and is LQR where nothing is bounded."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cvxpy as cp
import numpy as np
import pytest

from planners.errors import SolverFailed
from planners.free_flyer.tracking import (
    NO_JUMP,
    STAGES,
    Reference,
    Tracker,
    TrackingProblem,
    build_tracking_problem,
    compute_lqr,
)

PERIOD = 0.1


@dataclass(frozen=True)
class Craft:
    mass: float = 16.8
    inertia: float = 0.16
    force_limit: float = 1.5
    torque_limit: float = 0.5


PROBLEM = build_tracking_problem(Craft(), PERIOD)
BOUNDLESS = build_tracking_problem(Craft(force_limit=1e6, torque_limit=1e6), PERIOD)
REST = Reference(np.zeros((STAGES + 1, 6)), np.zeros((STAGES, 3)), np.full(STAGES, PERIOD))


def random_reference(rng: np.random.Generator, jump_node: int) -> Reference:
    durations = np.full(STAGES, PERIOD)
    if jump_node != NO_JUMP:
        moved = rng.uniform(-0.05, 0.05)
        durations[jump_node - 1] += moved
        durations[jump_node] -= moved
    angle = rng.uniform(0, 2 * math.pi)
    states, inputs = 0.1 * rng.normal(size=(STAGES + 1, 6)), 0.3 * rng.normal(size=(STAGES, 3))
    return Reference(states, inputs, durations, jump_node, (math.cos(angle), math.sin(angle)), 0.9, 0.05)


def solve_with_clarabel(problem: TrackingProblem, state: np.ndarray, r: Reference) -> np.ndarray:
    """Solve the same problem with the states as variables, by another solver; return the first input."""
    c, s = math.cos(state[2]), math.sin(state[2])
    push = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ np.diag(problem.gains)
    n = np.array([*r.normal, 0.0])
    x, u, cost, rules = cp.Variable((STAGES + 1, 6)), cp.Variable((STAGES, 3)), 0, []
    for k in range(STAGES):
        q, v, h = x[k, :3], x[k, 3:], r.durations[k]
        if k == r.jump_node and k > 0:
            v = v - r.jump_gain * n * (n @ v - r.object_speed)
        rules += [x[k + 1, :3] == q + h * v + h**2 / 2 * push @ u[k], x[k + 1, 3:] == v + h * push @ u[k]]
        W = np.zeros((6, 6))
        for axis, (pp, pv, vv) in enumerate(problem.weights[int(k == STAGES - 1)]):
            W[axis, axis], W[axis, 3 + axis], W[3 + axis, axis], W[3 + axis, 3 + axis] = pp, pv, pv, vv
        cost += cp.sum_squares(np.linalg.cholesky(W).T @ (x[k + 1] - r.states[k + 1]))
        cost += cp.sum_squares(cp.multiply(np.sqrt(problem.effort), u[k] - r.inputs[k]))
        rules += [cp.abs(u[k]) <= problem.limits]
    task = cp.Problem(cp.Minimize(cost), [x[0] == state, *rules])
    task.solve(cp.CLARABEL, tol_gap_abs=1e-12, tol_gap_rel=1e-12, tol_feas=1e-12)
    return u.value[0]


@pytest.mark.parametrize(("seed", "jump_node"), [(0, NO_JUMP), (1, 1), (2, 4), (3, 9)])
def test_first_input_is_that_of_an_independent_solver(seed: int, jump_node: int) -> None:
    rng = np.random.default_rng(seed)
    reference = random_reference(rng, jump_node)
    state = rng.normal(size=6) * [0.1, 0.1, 1.0, 0.1, 0.1, 0.3]
    u, source = Tracker(PROBLEM).control(state, reference)
    assert source == "mpc"
    np.testing.assert_allclose(u, solve_with_clarabel(PROBLEM, state, reference), atol=1e-6)


def test_without_bounds_it_is_lqr() -> None:
    state = np.array([0.3, -0.2, 0.4, 0.05, 0.1, -0.2])
    u, _ = Tracker(BOUNDLESS).control(state, REST)
    np.testing.assert_allclose(u, compute_lqr(BOUNDLESS, state, REST), rtol=1e-9)


def test_lqr_brings_every_state_to_rest() -> None:
    A = np.array([[1.0, PERIOD], [0.0, 1.0]])
    for gain, feedback in zip(PROBLEM.gains, PROBLEM.feedback, strict=True):
        B = gain * np.array([[PERIOD**2 / 2], [PERIOD]])
        assert np.abs(np.linalg.eigvals(A - B @ feedback[None])).max() < 1.0


def test_on_the_reference_only_the_feed_forward_acts_through_an_impact() -> None:
    n, gain, object_speed, speed = (0.6, 0.8), 0.9, -0.1, 0.05
    bounced = speed - gain * (speed - object_speed)
    states, durations = np.zeros((STAGES + 1, 6)), np.full(STAGES, PERIOD)
    for k in range(STAGES):
        along = speed if k < 3 else bounced
        states[k + 1, :2] = states[k, :2] + PERIOD * along * np.array(n)
        states[k + 1, 3:5] = along * np.array(n)
    start = np.array([0.0, 0.0, 0.0, speed * n[0], speed * n[1], 0.0])
    reference = Reference(states, np.zeros((STAGES, 3)), durations, 3, n, gain, object_speed)
    np.testing.assert_allclose(Tracker(PROBLEM).solve(start, reference), 0.0, atol=1e-9)
    blind = Tracker(PROBLEM).solve(start, replace(reference, jump_node=NO_JUMP))
    assert np.abs(blind[0, :2]).max() > 0.3  # unaware of the impact it would brake by itself


def test_body_frame_input_does_not_depend_on_the_world_frame() -> None:
    rng = np.random.default_rng(5)
    reference, state = random_reference(rng, 4), 0.2 * rng.normal(size=6)
    turn = np.eye(3)
    c, s = math.cos(1.1), math.sin(1.1)
    turn[:2, :2] = [[c, -s], [s, c]]
    both = np.kron(np.eye(2), turn)
    lift = np.array([0.0, 0.0, 1.1, 0.0, 0.0, 0.0])
    turned = replace(
        reference, states=reference.states @ both.T + lift, normal=tuple(turn[:2, :2] @ np.array(reference.normal))
    )
    u, _ = Tracker(PROBLEM).control(state, reference)
    np.testing.assert_allclose(Tracker(PROBLEM).control(both @ state + lift, turned)[0], u, atol=1e-9)


def test_limits_are_kept_far_from_the_reference() -> None:
    rng = np.random.default_rng(6)
    for _ in range(50):
        u, source = Tracker(PROBLEM).control(3 * rng.normal(size=6), random_reference(rng, NO_JUMP))
        assert source == "mpc"
        assert np.all(np.abs(u) <= PROBLEM.limits)


def test_fallbacks_in_their_order() -> None:
    state = np.array([0.02, 0.0, 0.0, 0.0, 0.0, 0.0])
    tracker = Tracker(PROBLEM)
    plan = tracker.solve(state, REST).copy()
    assert tracker.control(state, REST)[1] == "mpc"
    tracker.max_steps = 0
    with pytest.raises(SolverFailed, match="tracking QP"):
        tracker.solve(state, REST)
    for k in range(1, STAGES):
        u, source = tracker.control(state, REST)
        assert source == "shifted_plan"
        np.testing.assert_array_equal(u, plan[k])
    u, source = tracker.control(state, REST)
    assert source == "lqr"
    np.testing.assert_array_equal(u, compute_lqr(PROBLEM, state, REST))

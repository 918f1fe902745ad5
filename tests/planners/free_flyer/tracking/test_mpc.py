"""The condensed MPC solves the problem it claims to, is LQR where nothing is bounded, and tells when it fails."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cvxpy as cp
import numpy as np
import pytest

from impact_envs import load_scenario, parallel_env
from impact_envs.free_flyer.schema import FreeFlyerScenario
from planners.free_flyer.expert import FreeFlyerExpert
from planners.free_flyer.tracking.condensing import FORCES, condense, find_unknown, jump
from planners.free_flyer.tracking.mpc import Workspace, make_workspace, solve_freely, solve_tracking
from planners.free_flyer.tracking.problem import (
    INPUT_LIMIT,
    NO_JUMP,
    STAGES,
    TrackingProblem,
    build_tracking_problem,
)
from tests.frozen.freeze import get_plan

PERIOD = 0.1


@dataclass(frozen=True)
class Craft:
    mass: float = 16.8
    inertia: float = 0.16
    force_limit: float = 1.5
    torque_limit: float = 0.5


PROBLEM = build_tracking_problem(Craft(), PERIOD)
BOUNDLESS = build_tracking_problem(Craft(force_limit=1e6, torque_limit=1e6), PERIOD)


def at_rest() -> Workspace:
    """Return a workspace whose reference is to stay at the origin."""
    workspace = make_workspace()
    workspace.durations[:] = PERIOD
    return workspace


def random_workspace(rng: np.random.Generator, jump_node: int, size: float = 1.0) -> Workspace:
    workspace = at_rest()
    if jump_node != NO_JUMP:
        moved = rng.uniform(-0.05, 0.05)
        workspace.durations[0, jump_node - 1] += moved
        workspace.durations[0, jump_node] -= moved
    angle = rng.uniform(0, 2 * math.pi)
    workspace.states[0] = 0.1 * size * rng.normal(size=(STAGES + 1, 6))
    workspace.inputs[0] = 0.3 * size * rng.normal(size=(STAGES, 3))
    workspace.node[0], workspace.jump[0] = jump_node, [math.cos(angle), math.sin(angle), 0.9, 0.05]
    return workspace


def solve(problem: TrackingProblem, state: np.ndarray, workspace: Workspace) -> np.ndarray:
    """Return the inputs of all stages, shape (10, 3)."""
    workspace.state[0] = state
    assert solve_tracking(workspace, 0, problem.row)
    return workspace.solution[0].reshape(STAGES, 3).copy()


def solve_with_clarabel(problem: TrackingProblem, state: np.ndarray, workspace: Workspace) -> np.ndarray:
    """Solve the same problem with the states as variables, by another solver; return the first input."""
    c, s = math.cos(state[2]), math.sin(state[2])
    push = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ np.diag(problem.gains)
    n, gain, object_speed = np.array([*workspace.jump[0, :2], 0.0]), workspace.jump[0, 2], workspace.jump[0, 3]
    states, inputs, durations = workspace.states[0], workspace.inputs[0], workspace.durations[0]
    x, u, cost, rules = cp.Variable((STAGES + 1, 6)), cp.Variable((STAGES, 3)), 0, []
    for k in range(STAGES):
        q, v, h = x[k, :3], x[k, 3:], durations[k]
        if k == workspace.node[0] and k > 0:
            v = v - gain * n * (n @ v - object_speed)
        rules += [x[k + 1, :3] == q + h * v + h**2 / 2 * push @ u[k], x[k + 1, 3:] == v + h * push @ u[k]]
        W = np.zeros((6, 6))
        for axis, (pp, pv, vv) in enumerate(problem.weights[int(k == STAGES - 1)]):
            W[axis, axis], W[axis, 3 + axis], W[3 + axis, axis], W[3 + axis, 3 + axis] = pp, pv, pv, vv
        cost += cp.sum_squares(np.linalg.cholesky(W).T @ (x[k + 1] - states[k + 1]))
        cost += cp.sum_squares(cp.multiply(np.sqrt(problem.effort), u[k] - inputs[k]))
        rules += [cp.abs(u[k]) <= problem.limits]
    task = cp.Problem(cp.Minimize(cost), [x[0] == state, *rules])
    task.solve(cp.CLARABEL, tol_gap_abs=1e-12, tol_gap_rel=1e-12, tol_feas=1e-12)
    return u.value[0]


@pytest.mark.parametrize(("seed", "jump_node"), [(0, NO_JUMP), (1, 1), (2, 4), (3, 9)])
def test_first_input_is_that_of_an_independent_solver(seed: int, jump_node: int) -> None:
    rng = np.random.default_rng(seed)
    workspace = random_workspace(rng, jump_node)
    state = rng.normal(size=6) * [0.1, 0.1, 1.0, 0.1, 0.1, 0.3]
    u = solve(PROBLEM, state, workspace)[0]
    np.testing.assert_allclose(u, solve_with_clarabel(PROBLEM, state, workspace), atol=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_free_solution_is_the_unconstrained_minimum_of_the_condensed_problem(seed: int) -> None:
    rng = np.random.default_rng(seed)
    workspace = random_workspace(rng, NO_JUMP)
    workspace.state[0] = rng.normal(size=6) * [0.1, 0.1, 1.0, 0.1, 0.1, 0.3]
    H, g = np.zeros((3 * STAGES, 3 * STAGES)), np.zeros(3 * STAGES)
    reference = (workspace.states[0], workspace.inputs[0], workspace.durations[0], NO_JUMP, workspace.jump[0])
    condense(workspace.state[0], *reference, BOUNDLESS.row, np.zeros((6, 3 * STAGES + 1)), H, g)
    assert not H[:FORCES, FORCES:].any()
    assert solve_freely(workspace, 0, BOUNDLESS.row)
    places = [find_unknown(k, channel) for k in range(STAGES) for channel in range(3)]
    expected = workspace.inputs[0].ravel() - np.linalg.solve(H, g)[places]
    np.testing.assert_allclose(workspace.solution[0], expected, atol=1e-9)


def test_free_solution_is_refused_where_a_limit_binds_and_the_qp_takes_over() -> None:
    workspace, state = at_rest(), np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.0])
    workspace.state[0] = state
    assert not solve_freely(workspace, 0, PROBLEM.row)
    assert np.abs(workspace.solution[0]).max() > 1.5
    u = solve(PROBLEM, state, workspace)
    assert np.abs(u).max() == 1.5
    np.testing.assert_allclose(u[0], solve_with_clarabel(PROBLEM, state, workspace), atol=1e-6)


def test_free_solution_and_qp_agree_where_no_limit_binds() -> None:
    rng = np.random.default_rng(7)
    for _ in range(20):
        workspace, state = random_workspace(rng, NO_JUMP, 0.02), 0.005 * rng.normal(size=6)
        workspace.state[0] = state
        assert solve_freely(workspace, 0, PROBLEM.row)
        free = workspace.solution[0].copy()
        workspace.node[0], workspace.jump[0, 2] = 4, 0.0  # a jump without effect makes it go by the QP
        np.testing.assert_allclose(solve(PROBLEM, state, workspace).ravel(), free, atol=1e-7)


def test_without_bounds_it_is_lqr() -> None:
    state = np.array([0.3, -0.2, 0.4, 0.05, 0.1, -0.2])
    c, s = math.cos(state[2]), math.sin(state[2])
    world = -np.sum(BOUNDLESS.feedback * np.stack([state[:3], state[3:]], axis=1), axis=1)
    body = [c * world[0] + s * world[1], c * world[1] - s * world[0], world[2]]
    np.testing.assert_allclose(solve(BOUNDLESS, state, at_rest())[0], body, rtol=1e-9)


def test_lqr_brings_every_state_to_rest() -> None:
    A = np.array([[1.0, PERIOD], [0.0, 1.0]])
    for gain, feedback in zip(PROBLEM.gains, PROBLEM.feedback, strict=True):
        B = gain * np.array([[PERIOD**2 / 2], [PERIOD]])
        assert np.abs(np.linalg.eigvals(A - B @ feedback[None])).max() < 1.0


def test_on_the_reference_only_the_feed_forward_acts_through_an_impact() -> None:
    n, gain, object_speed, speed = np.array([0.6, 0.8]), 0.9, -0.1, 0.05
    bounced = speed - gain * (speed - object_speed)
    workspace = at_rest()
    states = workspace.states[0]
    for k in range(STAGES):
        along = speed if k < 3 else bounced
        states[k + 1, :2] = states[k, :2] + PERIOD * along * n
        states[k + 1, 3:5] = along * n
    start = np.array([0.0, 0.0, 0.0, *speed * n, 0.0])
    workspace.node[0], workspace.jump[0] = 3, [*n, gain, object_speed]
    np.testing.assert_allclose(solve(PROBLEM, start, workspace), 0.0, atol=1e-9)
    workspace.node[0] = NO_JUMP
    assert np.abs(solve(PROBLEM, start, workspace)[0, :2]).max() > 0.3  # unaware of it, it would brake by itself


@pytest.mark.parametrize("jump_node", [NO_JUMP, 4])
def test_body_frame_input_does_not_depend_on_the_world_frame(jump_node: int) -> None:
    rng = np.random.default_rng(5)
    workspace, state = random_workspace(rng, jump_node), 0.2 * rng.normal(size=6)
    u = solve(PROBLEM, state, workspace)
    turn = np.eye(3)
    c, s = math.cos(1.1), math.sin(1.1)
    turn[:2, :2] = [[c, -s], [s, c]]
    both, lift = np.kron(np.eye(2), turn), np.array([0.0, 0.0, 1.1, 0.0, 0.0, 0.0])
    workspace.states[0] = workspace.states[0] @ both.T + lift
    workspace.jump[0, :2] = turn[:2, :2] @ workspace.jump[0, :2]
    np.testing.assert_allclose(solve(PROBLEM, both @ state + lift, workspace), u, atol=1e-9)


def test_limits_are_kept_far_from_the_reference() -> None:
    rng = np.random.default_rng(6)
    for k in range(50):
        u = solve(PROBLEM, 3 * rng.normal(size=6), random_workspace(rng, k % STAGES))
        assert np.all(np.abs(u) <= PROBLEM.row[INPUT_LIMIT : INPUT_LIMIT + 3] + 1e-15)


def test_threads_do_not_share_anything() -> None:
    rng = np.random.default_rng(8)
    both, alone = make_workspace(2), [random_workspace(rng, node) for node in (NO_JUMP, 4)]
    states = rng.normal(size=(2, 6)) * 0.2
    for c, single in enumerate(alone):
        for name in ("states", "inputs", "durations", "node", "jump"):
            getattr(both, name)[c] = getattr(single, name)[0]
        both.state[c] = states[c]
    assert solve_tracking(both, 1, PROBLEM.row)
    assert solve_tracking(both, 0, PROBLEM.row)
    for c, single in enumerate(alone):
        np.testing.assert_array_equal(both.solution[c], solve(PROBLEM, states[c], single).ravel())


def test_says_when_it_did_not_solve() -> None:
    workspace = at_rest()
    workspace.state[0, 0], workspace.steps[0] = 0.1, 0
    assert not solve_tracking(workspace, 0, PROBLEM.row)  # a limit binds: no Newton step, no solution
    workspace.state[0, 0] = 0.001
    assert solve_tracking(workspace, 0, PROBLEM.row)  # none binds: none is needed
    workspace.state[0, 0] = np.nan
    assert not solve_tracking(workspace, 0, PROBLEM.row)


@pytest.fixture(scope="module")
def catch() -> list[tuple[float, np.ndarray, Workspace]]:
    """Return (seconds to the catch, coming impact, workspace) of the catching robot at every step of an episode."""
    scenario = load_scenario("throw_and_catch")
    assert isinstance(scenario, FreeFlyerScenario)
    expert, env, seen = FreeFlyerExpert(scenario, get_plan(scenario.name, "nominal")), parallel_env(scenario), []
    observations, _ = env.reset(seed=0)
    expert.reset(0)
    while not env.impacts or env.time < 15.0:
        observations, *_ = env.step(expert.act(observations))
        strike = expert.memory.strike[0, 0].copy()
        # What is left in the workspace is of the last robot, which catches.
        workspace = Workspace(*(array.copy() for array in expert.workspace))
        ahead = strike["time"] - expert.memory.time[0] if strike["robot"] == 1 else math.inf
        seen.append((ahead, strike, workspace))
    return seen


def test_reference_is_what_its_feed_forward_does(catch: list[tuple[float, np.ndarray, Workspace]]) -> None:
    for _, _, workspace in [step for step in catch if step[2].node[0] == NO_JUMP][::10]:
        states, heading = workspace.states[0], workspace.state[0, 2]
        c, s = math.cos(heading), math.sin(heading)
        force = workspace.inputs[0, :, :2] @ np.array([[c, s], [-s, c]])
        velocity = states[0, 3:5] + np.cumsum(PERIOD * force / 16.8, axis=0)
        np.testing.assert_allclose(velocity, states[1:, 3:5], atol=1e-12)
        middle = (states[1:, 3:5] + states[:-1, 3:5]) / 2
        np.testing.assert_allclose(np.diff(states[:, :2], axis=0), PERIOD * middle, atol=1e-5)


def test_reference_puts_a_node_onto_the_impact(catch: list[tuple[float, np.ndarray, Workspace]]) -> None:
    near = [step for step in catch if 0.0 < step[0] < 0.9]
    assert len(near) >= 8  # 9 if the impact is not at a control step
    for ahead, strike, workspace in near:
        node, durations, states = workspace.node[0], workspace.durations[0], workspace.states[0]
        assert 1 <= node < STAGES
        assert np.sum(durations) == pytest.approx(STAGES * PERIOD)
        assert np.sum(durations[:node]) == pytest.approx(ahead, abs=1e-9)
        np.testing.assert_allclose(states[node, :2], strike["contact"], atol=1e-9)
        np.testing.assert_allclose(states[node, 3:5], strike["robot_minus"], atol=1e-9)
        after = states[node + 1 :, 3:5]
        np.testing.assert_allclose(after, np.tile(strike["robot_plus"], (STAGES - node, 1)))
        # The predicted jump is the one that the robot's reference makes.
        column = np.array([0.0, 0.0, 0.0, *states[node, 3:5], 0.0])[:, None]
        jump(column, 0, workspace.jump[0], workspace.jump[0, 3])
        np.testing.assert_allclose(column[3:5, 0], strike["robot_plus"], atol=1e-9)


def test_reference_has_no_jump_before_the_impact_is_near(catch: list[tuple[float, np.ndarray, Workspace]]) -> None:
    assert all(workspace.node[0] == NO_JUMP for ahead, _, workspace in catch if ahead > STAGES * PERIOD)

"""The tracking MPC gives the first input that CasADi finds for the problem with the heading free to turn."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest

from impact_envs.errors import InputError
from planners.errors import SolverFailed
from planners.free_flyer.tracking.casadi_mpc import build_casadi_tracking, has_fatrop, solve_casadi_tracking
from planners.free_flyer.tracking.mpc import Workspace, make_workspace, solve_tracking, view_task
from planners.free_flyer.tracking.problem import NO_JUMP, PUBLISHED_WEIGHTS, STAGES, build_tracking_problem
from planners.free_flyer.tracking.published_mpc import (
    PublishedTracker,
    build_published_tracking,
    solve_published_tracking,
)

PERIOD = 0.1
NORMAL, GAIN, OBJECT_SPEED, SPEED = np.array([0.6, 0.8]), 0.9, -0.05, 0.1


@dataclass(frozen=True)
class Craft:
    mass: float = 16.8
    inertia: float = 0.1594
    force_limit: float = 1.5
    torque_limit: float = 0.5


PROBLEM = build_tracking_problem(Craft(), PERIOD)


def make_reference(node: int, heading: float = 0.0) -> Workspace:
    """Return a workspace that follows a gentle turn in the plane; with an impact, a straight line and its bounce."""
    workspace, turn = make_workspace(), 0.2
    workspace.durations[:] = PERIOD
    states, times = workspace.states[0], PERIOD * np.arange(STAGES + 1)
    states[:, 2] = heading
    if node == NO_JUMP:
        states[:, 0], states[:, 1] = np.sin(turn * times), 1.0 - np.cos(turn * times)
        states[:, 3], states[:, 4] = turn * np.cos(turn * times), turn * np.sin(turn * times)
        return workspace
    workspace.durations[0, node - 1] -= 0.03
    workspace.durations[0, node] += 0.03
    bounced = SPEED - GAIN * (SPEED - OBJECT_SPEED)
    states[0, 3:5] = SPEED * NORMAL
    for k in range(STAGES):
        along = bounced if k >= node else SPEED
        states[k + 1, :2] = states[k, :2] + workspace.durations[0, k] * along * NORMAL
        states[k + 1, 3:5] = along * NORMAL
    workspace.node[0], workspace.jump[0] = node, [*NORMAL, GAIN, OBJECT_SPEED]
    return workspace


def start_near(rng: np.random.Generator, workspace: Workspace) -> None:
    """Measure a state near the reference; the feed-forward force is given in the frame of the measured heading."""
    workspace.state[0] = workspace.states[0, 0] + rng.normal(size=6) * [0.003, 0.003, 0.02, 0.005, 0.005, 0.02]
    if workspace.node[0] == NO_JUMP:
        force = 16.8 * np.diff(workspace.states[0, :, 3:5], axis=0) / PERIOD
        c, s = math.cos(workspace.state[0, 2]), math.sin(workspace.state[0, 2])
        workspace.inputs[0, :, :2] = force @ np.array([[c, -s], [s, c]])


@pytest.mark.parametrize(
    "solver",
    [pytest.param("fatrop", marks=pytest.mark.skipif(not has_fatrop(), reason="CasADi without fatrop")), "ipopt"],
)
@pytest.mark.parametrize("node", [NO_JUMP, 1, 4, 9])
def test_first_input_is_casadis_to_a_hundredth_of_the_limits(node: int, solver: str) -> None:
    rng = np.random.default_rng(node)
    mpc = build_casadi_tracking(PROBLEM, solver)
    for heading in (0.0, 0.7, -2.0):
        workspace = make_reference(node, heading)
        for _ in range(4):
            start_near(rng, workspace)
            assert solve_tracking(workspace, 0, PROBLEM.row)
            first = workspace.solution[0, :3].copy()
            off = np.abs(first - solve_casadi_tracking(mpc, view_task(workspace, 0))[0]) / PROBLEM.limits
            assert off.max() < 0.01
            assert np.abs(first / PROBLEM.limits).max() > 0.005


def test_saturated_force_is_casadis() -> None:
    mpc, workspace = build_casadi_tracking(PROBLEM), make_reference(NO_JUMP)
    workspace.state[0] = workspace.states[0, 0] + [0.3, -0.2, 0.0, 0.0, 0.0, 0.0]
    assert solve_tracking(workspace, 0, PROBLEM.row)
    found = solve_casadi_tracking(mpc, view_task(workspace, 0))
    assert np.abs(found).max() <= 1.5 + 1e-6
    assert math.isclose(np.abs(found[0]).max(), 1.5, abs_tol=1e-5)
    np.testing.assert_allclose(found[0, :2], workspace.solution[0, :2], atol=1e-5)
    assert abs(found[0, 2]) > 0.005  # it also turns, so that later forces act along a diagonal of the thrusters


def test_without_the_jump_in_the_horizon_casadi_brakes() -> None:
    """The map of the impact makes the difference."""
    mpc, workspace = build_casadi_tracking(PROBLEM), make_reference(4)
    workspace.state[0] = workspace.states[0, 0]
    np.testing.assert_allclose(solve_casadi_tracking(mpc, view_task(workspace, 0)), 0.0, atol=1e-5)
    workspace.node[0] = NO_JUMP
    assert np.abs(solve_casadi_tracking(mpc, view_task(workspace, 0))[0, :2]).max() > 0.3


@pytest.mark.parametrize("node", [NO_JUMP, 4])
def test_published_form_pushes_towards_the_reference_and_turns_back(node: int) -> None:
    mpc, workspace = build_published_tracking(PROBLEM), make_reference(node)
    slow = 0.02 * workspace.states[0, 0, 3:5] / np.hypot(*workspace.states[0, 0, 3:5])
    workspace.state[0] = workspace.states[0, 0] - [0.0, 0.0, -0.2, *slow, 0.0]
    force_x, force_y, torque = solve_published_tracking(mpc, view_task(workspace, 0))
    c, s = math.cos(0.2), math.sin(0.2)
    world = np.array([c * force_x - s * force_y, s * force_x + c * force_y])
    assert world @ slow > 0.0
    assert torque < 0.0
    assert max(abs(force_x), abs(force_y)) <= 1.5 + 1e-6
    assert abs(torque) <= 0.5


def test_published_form_needs_no_force_on_a_straight_line() -> None:
    mpc, workspace = build_published_tracking(PROBLEM), make_reference(4)
    workspace.state[0] = workspace.states[0, 0]
    np.testing.assert_allclose(solve_published_tracking(mpc, view_task(workspace, 0)), 0.0, atol=5e-3)


def test_failures_are_typed() -> None:
    with pytest.raises(InputError, match=r"solver 'snopt' is unknown; .*choices: fatrop, ipopt"):
        build_casadi_tracking(PROBLEM, "snopt")
    mpc, workspace = build_casadi_tracking(PROBLEM, "ipopt"), make_reference(NO_JUMP)
    workspace.state[0, 0] = math.nan
    with pytest.raises(SolverFailed, match="tracking MPC by ipopt: Invalid_Number"):
        solve_casadi_tracking(mpc, view_task(workspace, 0))


def test_published_form_thrusts_nothing_where_its_solver_fails() -> None:
    tracker, workspace = PublishedTracker(), make_reference(NO_JUMP)
    tracker.reset({"craft": PROBLEM})
    assert np.abs(tracker.track("craft", view_task(workspace, 0))).max() > 0.0
    workspace.state[0, 0] = math.nan
    np.testing.assert_array_equal(tracker.track("craft", view_task(workspace, 0)), np.zeros((1, 3)))


@pytest.mark.parametrize("node", [NO_JUMP, 4])
def test_with_the_papers_weights_the_compiled_mpc_is_the_papers_in_the_plane(node: int) -> None:
    """Unturned, with no torque, Eqs. 31 and 33 are linear: App. B's weights change when an impact is near."""
    problem = build_tracking_problem(Craft(force_limit=20.0), PERIOD, PUBLISHED_WEIGHTS)
    mpc, workspace = build_casadi_tracking(problem), make_reference(node)
    workspace.state[0] = workspace.states[0, 0] + [0.02, -0.01, 0.0, 0.003, 0.002, 0.0]
    assert solve_tracking(workspace, 0, problem.row)
    expected = solve_casadi_tracking(mpc, view_task(workspace, 0))
    np.testing.assert_allclose(workspace.solution[0].reshape(STAGES, 3)[0], expected[0], rtol=1e-4, atol=1e-5)


def test_an_impact_ahead_moves_the_papers_weights_from_position_to_velocity() -> None:
    problem = build_tracking_problem(Craft(), PERIOD, PUBLISHED_WEIGHTS)
    np.testing.assert_array_equal(problem.select_weights(NO_JUMP)[0, 0], [5.0, 0.0, 0.8])
    np.testing.assert_array_equal(problem.select_weights(4)[0, 0], [1e-3, 0.0, 8e3])
    np.testing.assert_array_equal(problem.select_weights(4)[1], 10.0 * problem.select_weights(4)[0])

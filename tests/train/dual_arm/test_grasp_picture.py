"""The picture of a grasp shows what happened in it."""

import json
from dataclasses import replace

import numpy as np
import pytest

from impact_envs import load_scenario, parallel_env, rollout
from impact_envs.errors import InputError
from impact_envs.rollout import ZeroPolicy
from planners import make_expert
from train.cli.main import main
from train.dual_arm.arms_panel import place_joints
from train.dual_arm.grasp_picture import draw_grasp, find_controller

# Ends soon after the grasp.
SOON = {"horizon": 1.0, "formula": "G[0,1] box.lag <= 0.015"}


@pytest.fixture(scope="module")
def played():
    scenario = load_scenario("dual_arm_grasp").override(SOON)
    expert = make_expert(scenario)
    return scenario, expert, rollout(parallel_env(scenario), expert, 0)


def panels(figure):
    return {axes.get_title(loc="left"): axes for axes in figure.axes}


def curve(axes, label):
    return next(line for line in axes.lines if line.get_label() == label).get_xydata().T


def test_curves_are_the_episodes(played):
    scenario, expert, episode = played
    shown = panels(draw_grasp(scenario, find_controller(expert), {"expert": episode, "again": episode}))
    times, velocity = curve(shown["velocity along y [m/s]"], "box")
    first = round(times[0] / episode.period)
    assert times[0] < episode.impacts[0].time < times[-1]
    np.testing.assert_array_equal(velocity, episode.signals["box.vy"][first : first + len(times)])
    (time,), (predicted,) = curve(shown["velocity along y [m/s]"], "predicted")
    assert time == expert.controller.switches["post"]
    assert predicted == expert.controller.predicted[1]
    _, path = curve(shown["ante-impact reference with its extension"], "arm 1: pad's path")
    np.testing.assert_array_equal(path, episode.signals["arm_1.y"][: len(path)])
    torques = [axes for title, axes in shown.items() if "joint torques" in title]
    assert len(torques) == 2
    times, torque = curve(torques[0], "arm 2, joint 2")
    first = round(times[0] / episode.period)
    np.testing.assert_allclose(torque, 70.0 * episode.actions["arm_2"][first : first + len(times), 1])


def test_arms_are_drawn_where_their_joints_are():
    """At the start the joints are the scenario's, and an arm's links keep their lengths at all times."""
    scenario = load_scenario("dual_arm_grasp").override(SOON)
    chains = []
    env = parallel_env(scenario, render_mode="rgb_array")
    episode = rollout(env, ZeroPolicy(env), 0, on_step=lambda shown: chains.append(shown.make_frame().chains))
    for sample in (0, 100, 400):
        for name, joints in place_joints(scenario, episode, sample).items():
            np.testing.assert_allclose(joints, chains[sample][name], atol=1e-9)


def test_robustness_has_an_axis_that_says_what_its_unit_is(played):
    scenario, expert, episode = played
    axes = draw_grasp(scenario, find_controller(expert), {"expert": episode}).axes
    panel = next(panel for panel in axes if panel.get_ylabel().startswith("robustness"))
    assert panel.get_ylabel() == "robustness [predicates’ units]"
    assert panel.lines[-1].get_xydata()[-1].tolist() == [episode.times[-1], episode.robustness]


def test_what_cannot_be_drawn_is_refused(played):
    scenario, expert, episode = played
    with pytest.raises(InputError, match="policy 'zero' follows no reference"):
        find_controller(ZeroPolicy(parallel_env(scenario)))
    with pytest.raises(InputError, match="policy 'expert' touched nothing with seed 0"):
        draw_grasp(scenario, expert.controller, {"expert": replace(episode, impacts=())})


def test_command_writes_the_picture(capsys, tmp_path):
    path = tmp_path / "grasp.png"
    values = [f"{key}={value if key == 'formula' else json.dumps(value)}" for key, value in SOON.items()]
    assert main(["run", "dual_arm_grasp", "--set", *values, "--plot", str(path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["success"]
    assert path.read_bytes().startswith(b"\x89PNG")

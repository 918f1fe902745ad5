"""The picture of an episode shows what happened in it."""

import json
from functools import cache

import numpy as np
import pytest

from impact_envs import load_scenario, parallel_env, rollout
from planners import make_expert
from train.cli.main import main
from train.floating_manipulator.motion_picture import draw_manipulator_episode
from train.floating_manipulator.motion_record import ManipulatorRecord

# Two seconds, with the box so near that the tip hits it in the first.
SOON = {"horizon": 2.0, "formula": "F[0,2] distance(tip, target) <= 5", "requirements": {}, "box.start": [6.98, 1.5]}


@cache
def watch(name):
    scenario = load_scenario(name).override(SOON | {"safety_pause": 0.5})
    policy = make_expert(scenario)
    record = ManipulatorRecord(scenario, policy)
    return record, rollout(parallel_env(scenario), policy, 0, on_step=record.add)


def panels(figure):
    return {axes.get_title(loc="left"): axes for axes in figure.axes}


def curve(axes, label):
    return next(line for line in axes.lines if line.get_label() == label).get_xydata().T


@pytest.mark.parametrize("name", ["floating_manipulator", "floating_manipulator_thrusters"])
def test_curves_are_the_episodes(name):
    record, episode = watch(name)
    assert len(record.collisions) >= 1
    shown = panels(draw_manipulator_episode(record, episode))
    assert ("base: thrusters [N], wheel [N m]" in shown) == name.endswith("thrusters")
    times, torque = curve(shown["joint 2: torque [N m]"], "torque")
    np.testing.assert_allclose(times, episode.times[1:])
    np.testing.assert_array_equal(torque, episode.signals["link_2.torque"][1:])
    _, momentum = curve(shown["box: momenta [N s], [N m s]"], "x")
    struck = round(record.collisions[0].impact.time / episode.period) + 1
    assert momentum[0] == 0.0
    assert momentum[struck] == pytest.approx(record.collisions[0].impact.impulse[0], abs=1e-9)
    _, rate = curve(shown["joint rates [rad/s]"], "joint 3")
    np.testing.assert_allclose(rate, episode.signals["link_3.joint_velocity"], atol=1e-9)


def test_snapshots_show_start_impact_end_of_the_pause_and_end():
    record, episode = watch("floating_manipulator_thrusters")
    struck = record.collisions[0].impact.time
    titles = list(panels(draw_manipulator_episode(record, episode)))[:6]
    assert titles[0] == "0.00 s"
    assert f"{struck:.2f} s, impact" in titles
    assert f"{struck + 0.5:.2f} s, end of the safety pause" in titles
    assert titles[-1] == "2.00 s"
    assert [float(title.split()[0]) for title in titles] == sorted(float(title.split()[0]) for title in titles)


def test_a_snapshots_paths_end_where_the_bodies_are():
    record, episode = watch("floating_manipulator")
    figure = draw_manipulator_episode(record, episode)
    for axes in figure.axes[:6]:
        sample = round(float(axes.get_title(loc="left").split()[0]) / episode.period)
        for body in ("tip", "base", "box"):
            x, y = curve(axes, body)
            place = [episode.signals[f"{body}.{axis}"][[sample - 1, sample, min(sample + 1, 400)]] for axis in "xy"]
            assert np.hypot(place[0] - x[-1], place[1] - y[-1]).min() < 1e-12


def test_torques_lie_within_their_bounds():
    record, episode = watch("floating_manipulator_thrusters")
    low, high = record.torque_limits.transpose(1, 0, 2)
    torques = np.array([episode.signals[f"link_{k}.torque"][1:] for k in (1, 2, 3)]).T
    assert np.all(high - low == pytest.approx(28.0))
    assert np.all((low - 1e-9 <= torques) & (torques <= high + 1e-9))


def test_command_writes_the_picture(capsys, tmp_path):
    path = tmp_path / "episode.png"
    values = (f"{key}={value if key == 'formula' else json.dumps(value)}" for key, value in SOON.items())
    assert main(["run", "floating_manipulator", "--set", *values, "--plot", str(path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["impact_time"] < 2.0
    assert path.read_bytes().startswith(b"\x89PNG")
    assert main(["run", "floating_manipulator", "--plot", str(tmp_path / "no/such.png"), "--json"]) == 2
    assert "no/such.png" in capsys.readouterr().err

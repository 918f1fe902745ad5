import json

import imageio.v3 as iio
import numpy as np
import pytest

from impact_envs.env import parallel_env
from impact_envs.errors import InputError
from impact_envs.rollout import ZeroPolicy, rollout
from train.cli.main import main
from train.pictures.film import HOLD, Viewer
from train.pictures.pilot import GENTLE_SHARE, Pilot


def make_pilot(robot=None):
    env = parallel_env("throw_and_catch", render_mode="rgb_array")
    return env, Pilot(dict.fromkeys(env.possible_agents, 3), ZeroPolicy(env), robot)


def test_held_keys_are_the_action_of_one_robot():
    env, pilot = make_pilot()
    observations, _ = env.reset(seed=0)
    pilot.press("right", True)
    pilot.press("d", True)
    assert pilot.act(observations)["snap"].tolist() == [1, 0, -1]
    pilot.press("left", True)  # both ways at once is no way
    pilot.press("left shift", True)
    assert pilot.act(observations)["snap"].tolist() == [0, 0, -GENTLE_SHARE]
    for key in ("right", "left", "d", "left shift"):
        pilot.press(key, False)
    pilot.press("tab", True)
    pilot.press("up", True)
    actions = pilot.act(observations)
    assert actions["crackle"].tolist() == [0, 1, 0] and not actions["snap"].any()


def test_nobody_at_the_keys_is_no_control():
    env, pilot = make_pilot("crackle")
    played, still = rollout(env, pilot, seed=3), rollout(env, ZeroPolicy(env), seed=3)
    assert played.robustness == still.robustness
    assert all(np.array_equal(played.signals[name], still.signals[name]) for name in still.signals)


def test_unknown_robot_is_named():
    with pytest.raises(InputError, match="robot 'snapp' is unknown; did you mean 'snap'"):
        make_pilot("snapp")


def test_run_without_a_display_shows_a_window(monkeypatch, capsys):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    monkeypatch.setattr("train.pictures.film.HOLD", 0.0)
    arguments = ["run", "throw_and_catch", "--policy", "zero", "--render", "human", "--speed", "60", "--json"]
    assert main(arguments) == 0
    assert not json.loads(capsys.readouterr().out.splitlines()[-1])["success"]


def test_a_film_is_named_when_it_is_written(capsys, tmp_path):
    path = tmp_path / "film.gif"
    assert main(["run", "throw_and_catch", "--policy", "zero", "--render", str(path), "--speed", "60"]) == 0
    assert f"wrote {path}" in "".join(capsys.readouterr())
    assert path.stat().st_size > 10_000


def test_play_without_a_display_flies_and_says_the_robustness(monkeypatch, capsys):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    monkeypatch.setattr("train.pictures.film.HOLD", 0.0)
    import pygame

    act = Pilot.act

    def fly(self, observations):  # a person who holds up all the time
        if pygame.display.get_init():
            pygame.event.post(pygame.event.Event(pygame.KEYDOWN, key=pygame.K_UP))
        return act(self, observations)

    monkeypatch.setattr(Pilot, "act", fly)
    assert main(["play", "throw_and_catch", "--speed", "60", "--json"]) == 0
    said = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert said["robustness"] < 0 and said["unit"] == "m" and not said["success"] and said["effort"] > 0
    assert said["impacts"] > 0  # straight into the object, and into a wall
    assert not pygame.display.get_init()


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["play", "throw_and_catch", "--others", "nobody"], "--others nobody is unknown"),
        (["play", "throw_and_catch", "--speed", "0"], "--speed 0 is no speed"),
        (["run", "throw_and_catch", "--speed", "2"], "shows nothing without --render"),
        (["run", "throw_and_catch", "--render", "a.mp4", "--speed", "nan"], "--speed nan is no speed"),
    ],
)
def test_bad_arguments_are_one_line(arguments, says, capsys):
    assert main(arguments) == 2
    assert says in capsys.readouterr().err


@pytest.mark.parametrize(("speed", "frames"), [(15.0, 61), (30.0, 31)])
def test_a_film_is_as_long_as_its_speed_says(tmp_path, speed, frames):
    env, pilot = make_pilot()
    path = tmp_path / "film.mp4"
    with Viewer(str(path), env.scenario, speed, "") as viewer:
        rollout(env, pilot, seed=0, on_step=viewer.add)
    seconds = iio.immeta(path)["duration"]
    assert seconds == pytest.approx(30.0 / speed + HOLD, abs=0.1)
    assert len(iio.imread(path)) == pytest.approx(frames + HOLD * 30, abs=1)

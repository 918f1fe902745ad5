"""Rewards, observations and rollouts say what they promise."""

import subprocess
import sys

import gymnasium
import numpy as np
import pytest

import impact_envs
from impact_envs import parallel_env, rollout
from impact_envs.errors import InputError
from impact_envs.free_flyer.sensing import VELOCITY_WINDOW
from impact_envs.observation import Layout
from impact_envs.reward import EFFORT_WEIGHT
from impact_envs.rollout import RandomPolicy, ZeroPolicy

SHORT = impact_envs.load_scenario("throw_and_catch").override({"horizon": 5.0, "formula": "F[0,5] pop in goal"})


def test_importing_is_light():
    code = (
        "import sys, impact_envs, impact_envs.picture.render as render;"
        "print([m for m in ('torch','casadi','cvxpy','numba','pygame','stable_baselines3') if m in sys.modules]);"
        "render.Renderer((0, 0), (1, 1), []).draw(render.Frame(0.0, {}))"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"  # and pygame, once it draws, greets nobody


def test_rewards_add_up_to_robustness_gained_minus_effort():
    env = parallel_env(SHORT)
    episode = rollout(env, RandomPolicy(env), seed=5)
    bounds = episode.robustness_bounds
    assert np.all(np.diff(bounds[:, 0]) >= 0)
    assert np.all(np.diff(bounds[:, 1]) <= 0)
    assert bounds[-1, 0] == bounds[-1, 1] == pytest.approx(episode.robustness, abs=1e-12)
    effort = sum(float(np.mean(a**2)) for agent in episode.actions.values() for a in agent)
    total = sum(float(r.sum()) for r in episode.rewards.values())
    middle = bounds.mean(axis=1)
    expected = middle[-1] - middle[0] + episode.robustness - EFFORT_WEIGHT * effort
    assert total == pytest.approx(expected, abs=1e-9)


def test_effort_is_the_propulsion_spent():
    env = parallel_env(SHORT)

    class Full(ZeroPolicy):
        def act(self, observations):
            return {agent: np.array([1.0, 0.0, 0.0]) for agent in observations}

    assert rollout(env, Full(env), seed=0).effort == pytest.approx(2 * 1.5 * 5.0)
    assert rollout(env, ZeroPolicy(env), seed=0).effort == 0.0


def test_joint_env_is_the_parallel_env_seen_as_one():
    joint = gymnasium.make("impact_envs/ThrowAndCatch-v2")
    parallel = parallel_env("throw_and_catch")
    vector, _ = joint.reset(seed=4)
    observations, _ = parallel.reset(seed=4)
    rng = np.random.default_rng(0)
    for _ in range(30):
        action = rng.uniform(-1, 1, 6)
        vector, reward, *_ = joint.step(action)
        observations, rewards, *_ = parallel.step({"snap": action[:3], "crackle": action[3:]})
        assert reward == pytest.approx(sum(rewards.values()))
    joint_layout, layouts = parallel.task.joint_layout, parallel.task.layouts
    for agent, body in (("snap", "snap"), ("crackle", "crackle"), ("snap", "pop"), ("crackle", "pop")):
        assert np.array_equal(vector[joint_layout[body]], observations[agent][layouts[agent][body]])


def test_observation_reads_back_what_is_true_when_undisturbed():
    env = parallel_env("corridor")
    observations, _ = env.reset(seed=0)
    for _ in range(50):
        observations, *_ = env.step({"snap": np.array([0.3, 1.0, 0.2]), "crackle": np.array([0.0, -1.0, -0.1])})
    for agent, vector in observations.items():
        layout = env.task.layouts[agent]
        for name, (x, y, vx, vy, heading, omega) in zip(env.scenario.bodies, env.model.state(), strict=True):
            truth = [x, y, vx, vy, np.cos(heading), np.sin(heading), omega]
            assert vector[layout[name]] == pytest.approx(truth, abs=1e-12), (agent, name)
        assert vector[layout["time"]] * env.scenario.horizon == pytest.approx(5.0)
        lower, upper = vector[layout["robustness"]].reshape(-1, 2).T
        assert len(lower) == 2  # the goal, and the corridor
        assert (lower.min(), upper.min()) == env.bounds


def test_sensing_is_noisy_late_and_without_velocity():
    scenario = impact_envs.load_scenario("throw_and_catch").suite("sensing")
    env = parallel_env(scenario)
    observations, _ = env.reset(seed=0)
    push = {"snap": np.array([0.0, 1.0, 0.0]), "crackle": np.zeros(3)}
    measured, true = [], [env.model.state()[0]]
    for _ in range(60):
        observations, *_ = env.step(push)
        measured.append(observations["snap"][env.task.layouts["snap"]["snap"]])
        true.append(env.model.state()[0])
    measured, late = np.array(measured), np.array(true[:-1])
    error = measured[:, :2] - late[:, :2]
    assert 0.003 < error.std() < 0.007
    # The difference quotient reports the velocity of half its window ago, noise apart.
    ahead = slice(VELOCITY_WINDOW + 5, None)
    lag = measured[ahead, 3] - late[ahead, 3]
    acceleration = 1.5 / 16.8
    assert lag.mean() == pytest.approx(-acceleration * VELOCITY_WINDOW * 0.1 / 2, abs=0.01)


def test_contact_is_felt_by_the_robot_that_hits():
    scenario = SHORT.override({"robots.snap.start": [0.5, 0.95]})
    env = parallel_env(scenario)
    env.reset(seed=0)
    push = {"snap": np.array([0.0, 1.0, 0.0]), "crackle": np.zeros(3)}
    for _ in range(50):
        observations, *_ = env.step(push)
        contact = [observations[name][env.task.layouts[name]["contact"]].item() for name in ("snap", "crackle")]
        if env.impacts:
            assert contact == [1.0, 0.0]
            break
        assert contact == [0.0, 0.0]
    else:
        pytest.fail("the robot never hit the object")


@pytest.mark.parametrize(
    ("actions", "message"),
    [
        ({"snap": np.zeros(3)}, "actions must name every robot once, not so: crackle"),
        ({"snap": np.zeros(3), "crackle": np.zeros(3), "plop": np.zeros(3)}, "not so: plop"),
        ({"snap": np.zeros(3), "crackle": np.array([0.0, np.nan, 0.0])}, r"action of crackle = \[0\.0, nan, 0\.0\]"),
        ({"snap": np.array([0.0, np.inf, 0.0]), "crackle": np.zeros(3)}, r"action of snap = \[0\.0, inf, 0\.0\]"),
        ({"snap": np.zeros(2), "crackle": np.zeros(3)}, r"action of snap = \[0\.0, 0\.0\]: three finite numbers"),
        ({"snap": np.zeros(1), "crackle": np.zeros(1)}, r"action of snap = \[0\.0\]: three finite numbers"),
        ({"snap": np.zeros((1, 3)), "crackle": np.zeros((1, 3))}, "action of snap = .*: three finite numbers"),
    ],
)
def test_bad_actions_are_said_in_one_line_and_nothing_is_stepped(actions, message):
    env = parallel_env("throw_and_catch")
    env.reset(seed=0)
    with pytest.raises(InputError, match=message) as error:
        env.step(actions)
    assert "\n" not in str(error.value)
    assert env.time == env.model.time == 0.0
    env.step({agent: np.zeros(3) for agent in env.agents})


def test_layout_describes_every_element_and_names_its_fields():
    layout = parallel_env("throw_and_catch").task.layouts["snap"]
    lines = layout.describe().splitlines()
    assert len(lines) == layout.size
    assert lines[layout["pop"].start].split() == [str(layout["pop"].start), "pop:", "x", "[m]"]
    with pytest.raises(InputError, match="no field 'popp'; did you mean 'pop'"):
        layout["popp"]
    with pytest.raises(InputError, match="'time' names two fields"):
        Layout(("time", ["x [m]"]), ("time", ["time / horizon"]))


def test_robots_share_no_memory_in_what_they_observe():
    env = parallel_env("throw_and_catch")
    observations, _ = env.reset(seed=0)
    kept = observations["crackle"].copy()
    observations["snap"][:] = np.nan
    assert np.array_equal(observations["crackle"], kept)
    assert np.all(np.isfinite(env.state()))


def test_cut_horizon_reports_what_was_still_certain():
    env = parallel_env("corridor", max_cycles=5)
    episode = rollout(env, ZeroPolicy(env), seed=0)
    assert len(episode.times) == 6
    assert episode.robustness == episode.robustness_bounds[-1, 0]
    assert not episode.success

"""The floating manipulator behind the environment's door: what is observed, commanded, and said in formulas."""

import math

import gymnasium
import numpy as np
import pytest

from impact_envs import gym_id, load_scenario, parallel_env, rollout
from impact_envs.errors import ScenarioError
from impact_envs.floating_manipulator.task import LINK_WIDTH
from impact_envs.rollout import RandomPolicy, ZeroPolicy
from impact_envs.stl import Trace, satisfied
from tests.impact_envs.floating_manipulator.reading import read_observations

NAMES = ("", "_thrusters", "_near_goal", "_passive")


def short(name="floating_manipulator", **values):
    shortened = {"horizon": 1.0, "formula": "F[0,1] distance(tip, target) <= 1", "requirements": {}}
    return load_scenario(name).override(shortened | values)


def play(env, steps, seed=0):
    """Random actions; returns the last observations."""
    observations, _ = env.reset(seed=seed)
    rng = np.random.default_rng(seed)
    for _ in range(steps):
        actions = {agent: rng.uniform(-1, 1, env.action_space(agent).shape) for agent in env.possible_agents}
        observations, *_ = env.step(actions)
    return observations


@pytest.mark.parametrize("name", [f"floating_manipulator{name}" for name in NAMES])
def test_every_scenario_has_its_gymnasium_id(name):
    title = "".join(word.capitalize() for word in name.split("_"))
    assert gym_id(name) == f"impact_envs/{title}-v2"
    env = gymnasium.make(gym_id(name))
    observation, _ = env.reset(seed=0)
    base_too = name.endswith(("thrusters", "near_goal"))
    assert env.action_space.shape == (6 if base_too else 3,)
    assert observation.shape == (30,)  # two conjuncts
    assert observation.dtype == np.float64
    assert env.unwrapped.parallel.possible_agents == (["arm", "base"] if base_too else ["arm"])


def test_observation_reads_back_what_is_true():
    env = parallel_env(short("floating_manipulator_thrusters"))
    observations = play(env, 60)
    read = read_observations(env.scenario, observations)
    q, v = env.model.coordinates()
    np.testing.assert_allclose(read.q, q, atol=1e-12)
    np.testing.assert_allclose(read.v, v, atol=1e-12)
    assert read.time == pytest.approx(0.3)
    assert not read.contact
    states = env.model.state()
    vector = observations["arm"]
    np.testing.assert_allclose(vector[13:17], [*(states[-3, :2] - [3.0, 0.0]), *states[-3, 2:4]], atol=1e-12)
    np.testing.assert_allclose(vector[17:21], states[-2, :4], atol=1e-12)
    assert (math.atan2(vector[22], vector[21]), vector[23]) == pytest.approx((states[-2, 4], states[-2, 5]))
    assert vector[25] == pytest.approx(0.3)
    assert vector[26:].tolist() == env.conjuncts
    assert (min(env.conjuncts[::2]), min(env.conjuncts[1::2])) == env.bounds
    assert np.array_equal(observations["base"], vector)
    assert not np.shares_memory(observations["base"], vector)


def test_contact_is_felt_in_the_step_of_the_impact():
    # The box comes towards a resting arm: it is hit once, and felt once.
    env = parallel_env(short(**{"box.start": [6.98, 1.5]}))
    env.reset(seed=0)
    states = env.model.state()
    states[-2, 2] = 0.2
    env.model.set_state(states)
    felt = []
    for _ in range(100):
        observations, *_ = env.step({"arm": np.zeros(3)})
        felt.append(bool(observations["arm"][24]))
        assert felt[-1] == bool(env.impacts)
    assert sum(felt) == 1


def test_actions_are_scaled_and_limited_by_motors_and_thrusters():
    env = parallel_env(short("floating_manipulator_thrusters"))
    env.reset(seed=0)
    env.step({"arm": np.array([1.0, 0.1, -9.0]), "base": np.array([0.5, 0.019, 0.1])})
    # Motors at rest give 14 N m; thrusters 50 N or nothing; the wheel what is asked for.
    assert env.model.torques == pytest.approx([14.0, 4.2, -14.0])
    assert env.model.base_forces == pytest.approx([50.0, 0.0, 6.0])
    assert env.impulse == pytest.approx(50.0 * 0.005)
    assert env.signals["link_2.torque"] == env.model.torques[1]


def test_signals_are_the_models_own():
    env = parallel_env(short("floating_manipulator_thrusters").suite("all"))
    play(env, 150, seed=4)
    s, model = env.signals, env.model
    of_arm = [s[f"base.{name}"] for name in ("momentum_x", "momentum_y", "angular_momentum")]
    of_box = [s[f"box.{name}"] for name in ("momentum_x", "momentum_y", "angular_momentum")]
    np.testing.assert_allclose([of_arm, of_box], model.momenta(), atol=1e-9)
    assert [s[f"link_{k}.torque"] for k in (1, 2, 3)] == pytest.approx(list(model.torques), abs=1e-9)
    assert [s[f"link_{k}.joint_velocity"] for k in (1, 2, 3)] == pytest.approx(list(model.coordinates()[1][3:]))
    assert s["tip.since_impact"] == env.scenario.horizon


def test_impulse_and_time_since_impact():
    env = parallel_env(short(**{"box.start": [6.98, 1.5], "believed.restitution": 0.5}))
    env.reset(seed=0)
    states = env.model.state()
    states[-2, 2] = 0.2
    env.model.set_state(states)
    impulses, hit = [], None
    for _ in range(100):
        env.step({"arm": np.zeros(3)})
        impulses.append(env.signals["tip.impulse"])
        if env.impacts:
            hit = env.impacts[0]
            assert impulses[-1] == pytest.approx(math.hypot(*hit.impulse))
        if hit:
            assert env.signals["tip.since_impact"] == pytest.approx(env.time - hit.time)
    assert hit is not None
    assert sum(value > 0 for value in impulses) == 1


def test_propulsion_is_what_the_thrusters_spend():
    env = parallel_env(short("floating_manipulator_thrusters"))

    class Full(ZeroPolicy):
        def act(self, observations):
            return {"arm": np.zeros(3), "base": np.array([1.0, -0.5, 1.0])}

    assert rollout(env, Full(env), seed=0).effort == pytest.approx(2 * 50.0 * 1.0)
    assert rollout(env, ZeroPolicy(env), seed=0).effort == 0.0
    arm_only = parallel_env(short())
    assert rollout(arm_only, RandomPolicy(arm_only), seed=0).effort == 0.0


def test_formulas_may_speak_of_torques_momenta_and_impulses():
    text = "G[0,1] link_2.torque <= 20 & G[0,1] base.momentum_x <= 0.001 & F[0,1] tip.since_impact >= 1"
    env = parallel_env(short(formula=text))
    episode = rollout(env, RandomPolicy(env), seed=1)
    assert episode.success  # the arm alone cannot change its momentum
    trace = Trace(episode.signals, 0.005, {}, env.scenario.bodies)
    assert satisfied(env.scenario.specification, trace)
    with pytest.raises(ScenarioError, match=r"signal 'tip\.torque' is unknown"):
        short(formula="G[0,1] tip.torque <= 20")
    with pytest.raises(ScenarioError, match="signal 'torqe' is unknown; did you mean 'torque'"):
        short(formula="G[0,1] link_2.torqe <= 20")


def test_renderer_draws_arm_base_box_and_goal():
    env = parallel_env(short("floating_manipulator_thrusters"), render_mode="rgb_array")
    env.reset(seed=0)
    shapes = {shape.body: shape for shape in env.task.shapes()}
    assert list(shapes) == [None, "box", "base", "link_1", "link_2", "link_3", "tip"]
    # Each link as drawn starts where the one before it ends, and the last one ends at the tip.
    at = dict(zip(env.scenario.bodies, env.model.state()[:, [0, 1, 4]], strict=True))
    end = place((0.905, -0.391), at["base"])
    for name in ("link_1", "link_2", "link_3"):
        along = [x for x, _ in shapes[name].vertices]
        assert place((min(along) + LINK_WIDTH / 2, 0.0), at[name]) == pytest.approx(end)
        end = place((max(along), 0.0), at[name])
    assert end == pytest.approx((7.5, 1.5))
    picture = env.render()
    play(env, 20)
    assert not np.array_equal(picture, env.render())


def place(point, pose):
    (x, y), (px, py, heading) = point, pose
    c, s = math.cos(heading), math.sin(heading)
    return px + c * x - s * y, py + s * x + c * y


def test_noise_and_delay_are_the_measurements_only():
    quiet = short("floating_manipulator_thrusters")
    noisy = quiet.override({"true.position_noise": 0.01, "true.rate_noise": 0.02, "true.delay_steps": 3})
    seen = {}
    for name, scenario in (("quiet", quiet), ("noisy", noisy)):
        env = parallel_env(scenario)
        observations, _ = env.reset(seed=4)
        seen[name] = [observations["arm"]]
        states = []
        while env.agents:
            observations, *_ = env.step({"arm": np.full(3, 0.02), "base": np.zeros(3)})
            seen[name].append(observations["arm"])
            states.append(env.model.state())
        seen[name + " states"] = np.array(states)
    np.testing.assert_array_equal(seen["quiet states"], seen["noisy states"])
    true, measured = np.array(seen["quiet"]), np.array(seen["noisy"])
    np.testing.assert_array_equal(true[:, -3], measured[:, -3])  # time is exact
    error = measured[3:] - true[:-3]
    assert error[:, 0].std() == pytest.approx(0.01, rel=0.15)
    assert error[:, 10].std() == pytest.approx(0.02 * math.sqrt(2), rel=0.15)
    assert not error[:, [2, 3, 4, 5, 6, 7, 8]].any()  # headings and velocities have no noise here
    assert not (measured[:4, 2:9] - true[0, 2:9]).any()  # the first sample until the delay is over

"""Reward "progress": the sum telescopes, the asked-for stays the same, and a throw is rewarded when it is thrown."""

import gymnasium
import numpy as np
import pytest

from agents.vec_env import ImpactVecEnv
from impact_envs import JointEnv, gym_id, load_scenario, parallel_env, vector_env
from impact_envs.errors import InputError
from impact_envs.reward import EFFORT_WEIGHT
from impact_envs.stl import Trace, robustness

WORLDS, SEED = 3, 1_000_000
NESTED = (  # operators inside operators remember every sample
    "F[0,3] G[0,1] pop in goal & G[0,4] F[0,2] all in corridor & F[0,2] (speed(snap) <= 1 & G[0,2] pop.y <= 2) & "
    "(all in corridor U[1,5] pop.y >= 1)"
)
CASES = {
    "throw_and_catch": {},
    "corridor": {"true.friction": 0.3, "true.center_of_mass_offset": 0.03},
    "obstacle_avoidance": {},
    "crew": {},
    "nested": {"formula": NESTED, "horizon": 8.0},
}


def make_scenario(case):
    scenario = load_scenario("corridor" if case == "nested" else case)
    strong = {f"robots.{name}.force_limit": 40.0 for name in scenario.agents}  # much is hit
    return scenario.override(CASES[case] | strong)


def fly_on(scenario, history, states):
    """Return the readable evaluator's robustness of a history and straight flight at every sample from there on."""
    (x0, y0), (x1, y1) = scenario.world.lower, scenario.world.upper
    now, period = history[-1], scenario.control_period
    left = scenario.steps + 1 - len(history)
    samples = {name: [sample[name] for sample in history] for name in now}
    for body, state in zip(scenario.bodies, states, strict=True):
        for step in range(1, left + 1):
            t = step * period
            place = np.clip(state[:2] + t * state[2:4], (x0, y0), (x1, y1))
            moved = (*place, *state[2:4], state[4] + t * state[5], state[5])
            for name, value in zip(("x", "y", "vx", "vy", "heading", "omega"), moved, strict=True):
                samples[f"{body}.{name}"].append(value)
    signals = {name: np.array(values) for name, values in samples.items()}
    trace = Trace(signals, period, scenario.areas, scenario.bodies)
    return float(robustness(scenario.specification.expand(scenario.bodies), trace))


@pytest.mark.parametrize("case", CASES)
def test_the_sum_is_twice_the_robustness_less_the_potential_at_the_start(case):
    scenario = make_scenario(case)
    worlds = vector_env(scenario, WORLDS, threads=1, reward="progress")
    singles = [JointEnv(scenario, reward="progress") for _ in range(WORLDS)]
    worlds.reset(seed=SEED)
    for k, env in enumerate(singles):
        env.reset(seed=SEED + k)
    start = fly_on(scenario, [singles[0].parallel.signals], singles[0].parallel.model.state())
    rng, total, effort, hits = np.random.default_rng(0), np.zeros(WORLDS), np.zeros(WORLDS), 0
    for step in range(scenario.steps):
        if step % 20 == 0:
            actions = rng.uniform(-1.2, 1.2, worlds.action_space.shape) * (step % 100 == 0)
        _, rewards, _, over, infos = worlds.step(actions)
        for k, env in enumerate(singles):
            assert env.step(actions[k])[1] == rewards[k]
        total += rewards
        effort += len(scenario.agents) * np.mean(np.clip(actions, -1, 1) ** 2, axis=1)
        hits += infos["impacts"].sum()
    assert over.all()
    assert hits > 0
    expected = 2 * infos["robustness_lower"] - start - EFFORT_WEIGHT * effort
    np.testing.assert_allclose(total, expected, rtol=0, atol=1e-12 * scenario.steps)


@pytest.mark.parametrize("case", ["nested", "throw_and_catch"])
def test_the_potential_is_the_robustness_of_history_and_straight_flight(case):
    scenario = make_scenario(case)
    env, rng, history, rewards = JointEnv(scenario, reward="progress"), np.random.default_rng(1), [], []
    env.reset(seed=SEED)
    potentials = []
    for step in range(40):
        history.append(env.parallel.signals)
        potentials.append(fly_on(scenario, history, env.parallel.model.state()))
        action = rng.uniform(-1, 1, env.action_space.shape) if step % 20 == 0 else np.zeros(env.action_space.shape)
        rewards.append(env.step(action)[1] + EFFORT_WEIGHT * len(scenario.agents) * np.mean(action**2))
    seen = np.cumsum([potentials[0], *rewards])
    for second in range(0, 40, 10):
        assert seen[second] == pytest.approx(potentials[second], abs=1e-12)


def test_a_throw_is_rewarded_when_it_is_thrown():
    thrown = {"robots.snap.start": [0.5, 0.9], "robots.snap.start_velocity": [0.0, 0.03], "true.restitution": 1.0}
    env = JointEnv(load_scenario("throw_and_catch").override(thrown), reward="progress")
    env.reset(seed=0)
    rewards, hits = [], []
    for _ in range(env.parallel.scenario.steps):
        _, reward, _, _, info = env.step(np.zeros(6))
        rewards.append(reward)
        hits += [len(rewards) - 1] * len(env.parallel.impacts)
    (hit,) = hits
    gained = info["robustness"] + 0.5  # at rest the object is .5 m short of the goal
    assert gained > 0.5
    assert rewards[hit] == pytest.approx(gained, abs=1e-9)
    assert rewards[-1] == pytest.approx(info["robustness"], abs=1e-9)
    assert np.abs(np.delete(rewards, [hit, len(rewards) - 1])).max() < 1e-9


def test_bodies_stop_at_the_walls_of_the_world():
    """The object would fly out of the world; that it cannot is known."""
    scenario = load_scenario("throw_and_catch").override({"objects.pop.start_velocity": [0.0, 0.4]})
    env = parallel_env(scenario, reward="progress", max_cycles=1)
    env.reset(seed=0)
    assert env.referee.predict(env.signals, 0) == pytest.approx(2.5 - scenario.world.upper[1])


def test_where_max_cycles_cuts_the_sum_ends_at_the_flight_from_there():
    scenario = make_scenario("throw_and_catch")
    env, history, total = JointEnv(scenario, max_cycles=37, reward="progress"), [], 0.0
    env.reset(seed=SEED)
    history.append(env.parallel.signals)
    start = fly_on(scenario, history, env.parallel.model.state())
    push = np.full(6, 0.5)
    for _ in range(37):
        _, reward, _, over, info = env.step(push)
        history.append(env.parallel.signals)
        total += reward + 2 * EFFORT_WEIGHT * 0.25
    assert over
    end = fly_on(scenario, history, env.parallel.model.state())
    assert total == pytest.approx(end - start + info["robustness_lower"], abs=1e-11)


DOORS = {
    "parallel_env": lambda name, reward: parallel_env(name, reward=reward),
    "JointEnv": lambda name, reward: JointEnv(name, reward=reward),
    "vector_env": lambda name, reward: vector_env(name, reward=reward),
    "ImpactVecEnv": lambda name, reward: ImpactVecEnv(name, dtype="float64", reward=reward),
    "make": lambda name, reward: gymnasium.make(gym_id(name), reward=reward),
    "make_vec": lambda name, reward: gymnasium.make_vec(gym_id(name), reward=reward),
}


@pytest.mark.parametrize("door", DOORS)
def test_every_door_takes_it_or_says_why_not(door):
    DOORS[door]("throw_and_catch", "progress").close()
    with pytest.raises(InputError, match="reward 'progres' is unknown; did you mean 'progress'"):
        DOORS[door]("throw_and_catch", "progres")
    for name in ("dual_arm_grasp", "floating_manipulator"):
        with pytest.raises(InputError, match="do not fly freely; choose 'robustness'") as error:
            DOORS[door](name, "progress")
        assert "\n" not in str(error.value)

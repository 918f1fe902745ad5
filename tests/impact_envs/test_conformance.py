"""The contract battery: every domain passes the suites of Gymnasium, PettingZoo and SB3; every id is played."""

import pickle
import types
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from pettingzoo.test import (
    api_test,
    max_cycles_test,
    parallel_api_test,
    parallel_seed_test,
    render_test,
    state_test,
)
from pettingzoo.utils.conversions import parallel_to_aec

from impact_envs import gym_id, list_scenarios, load_scenario, parallel_env

SCENARIOS = list_scenarios()
# One scenario of each domain, and one of seven bodies.
VARIED = ("throw_and_catch", "crew", "floating_manipulator_thrusters", "dual_arm_grasp")
EVERY = [pytest.param(name, marks=() if name in VARIED else pytest.mark.slow) for name in SCENARIOS]
CYCLES = 60

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")


@pytest.fixture(autouse=True)
def _no_window(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")


def module(name):
    """What PettingZoo's tests expect of an environment's module."""

    def parallel(max_cycles=CYCLES, render_mode=None):
        return parallel_env(name, render_mode=render_mode, max_cycles=max_cycles)

    def env(max_cycles=CYCLES, render_mode=None):
        return parallel_to_aec(parallel(max_cycles, render_mode))

    return types.SimpleNamespace(parallel_env=parallel, env=env)


@pytest.mark.parametrize("name", EVERY)
def test_pettingzoo_battery(name):
    made = module(name)
    parallel_api_test(made.parallel_env(), num_cycles=CYCLES)
    api_test(made.env(), num_cycles=CYCLES)
    parallel_seed_test(made.parallel_env, num_cycles=CYCLES)
    max_cycles_test(made)
    render_test(made.env)
    state_test(made.env(), made.parallel_env())


@pytest.mark.parametrize("name", EVERY)
def test_gymnasium_and_sb3_checkers(name):
    from stable_baselines3.common.env_checker import check_env as sb3_check

    env = gymnasium.make(gym_id(name), render_mode="rgb_array")
    with warnings.catch_warnings():
        # Positions have no useful bound a learner could scale by; the checker only warns of it.
        warnings.simplefilter("ignore")
        check_env(env.unwrapped)
        sb3_check(env, warn=True, skip_render_check=False)
    env.close()


@pytest.mark.parametrize("name", VARIED)
@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_vector_envs_in_every_autoreset_mode(name, mode):
    limit = 3

    def make():
        return gymnasium.make(gym_id(name), max_cycles=limit)

    envs = SyncVectorEnv([make, make], autoreset_mode=mode)
    first, _ = envs.reset(seed=[1, 2])
    zeros = np.zeros(envs.action_space.shape, dtype=np.float32)
    ended = []
    for _ in range(limit):
        observations, _, terminated, truncated, infos = envs.step(zeros)
        assert not terminated.any()
        ended.append(truncated.all())
    assert ended == [False] * (limit - 1) + [True]
    if mode is AutoresetMode.SAME_STEP:
        assert "final_obs" in infos
        assert np.allclose(observations, first)
    elif mode is AutoresetMode.NEXT_STEP:
        observations, rewards, _, truncated, _ = envs.step(zeros)
        assert not rewards.any()
        assert not truncated.any()
    else:
        observations, _ = envs.reset(options={"reset_mask": truncated})
        assert np.allclose(observations, first)
    envs.close()


def test_vector_env_by_spawn():
    envs = gymnasium.make_vec(
        "impact_envs:impact_envs/Corridor-v1",
        num_envs=2,
        vectorization_mode="async",
        vector_kwargs={"context": "spawn"},
    )
    observations, _ = envs.reset(seed=0)
    assert observations.shape[0] == 2
    envs.step(np.zeros(envs.action_space.shape, dtype=np.float32))
    envs.close()


def record(env, rng, steps):
    trace = []
    for _ in range(steps):
        actions = {agent: rng.uniform(-1, 1, 3) for agent in env.possible_agents}
        observations, rewards, *_ = env.step(actions)
        trace.append(np.concatenate([*observations.values(), list(rewards.values())]))
    return np.array(trace)


@pytest.mark.parametrize("name", VARIED)
def test_same_seed_same_episode_bit_for_bit(name):
    scenario = load_scenario(name).suite("all")
    runs = []
    for _ in range(2):
        env = parallel_env(scenario)
        env.reset(seed=11)
        first = record(env, np.random.default_rng(0), 40)
        env.reset()  # the chain after a seed is reproducible too
        runs.append(np.concatenate([first, record(env, np.random.default_rng(1), 40)]))
    assert np.array_equal(runs[0], runs[1])
    env.reset(seed=12)
    assert not np.array_equal(record(env, np.random.default_rng(0), 40), runs[0][:40])


@pytest.mark.parametrize("name", VARIED)
def test_pickled_in_flight_it_goes_on_the_same(name):
    env = parallel_env(name)
    env.reset(seed=3)
    record(env, np.random.default_rng(0), 20)
    twin = pickle.loads(pickle.dumps(env))
    assert np.array_equal(record(env, np.random.default_rng(1), 20), record(twin, np.random.default_rng(1), 20))


def test_a_scenario_of_every_domain_is_checked():
    assert {load_scenario(name).domain for name in VARIED} == {load_scenario(name).domain for name in SCENARIOS}


@pytest.mark.parametrize("name", SCENARIOS)
def test_every_id_gives_observations_in_its_space(name):
    env = gymnasium.make(gym_id(name), max_cycles=4)
    observation, _ = env.reset(seed=0)
    assert observation in env.observation_space
    observation, reward, *_ = env.step(np.zeros(env.action_space.shape, np.float32))
    assert observation in env.observation_space
    assert np.isfinite(reward)
    env.close()


@pytest.mark.parametrize("name", SCENARIOS)
def test_horizon_truncates_and_never_terminates(name):
    env = parallel_env(name, max_cycles=4)
    env.reset(seed=0)
    actions = {agent: np.zeros(3) for agent in env.possible_agents}
    for step in range(4):
        _, _, terminations, truncations, infos = env.step(actions)
        assert not any(terminations.values())
        assert all(truncations.values()) == (step == 3)
    assert not env.agents
    assert set(infos[env.possible_agents[0]]) >= {"robustness", "success"}


def test_observations_are_fresh_arrays():
    env = parallel_env("corridor")
    first, _ = env.reset(seed=0)
    kept = {agent: vector.copy() for agent, vector in first.items()}
    for vector in env.step({agent: np.ones(3) for agent in env.possible_agents})[0].values():
        vector[:] = np.nan
    assert all(np.array_equal(first[agent], kept[agent]) for agent in first)
    again, *_ = env.step({agent: np.ones(3) for agent in env.possible_agents})
    assert all(np.all(np.isfinite(vector)) for vector in again.values())

"""Stable-Baselines3 sees floating manipulators as JointEnv does."""

import numpy as np
import pytest

from agents.vec_env import ImpactVecEnv
from impact_envs import JointEnv, load_scenario
from impact_envs.errors import InputError

NAME, SEED = "floating_manipulator_thrusters", 5


def test_worlds_are_joint_envs_across_episodes():
    scenario = load_scenario(NAME).suite("hard")
    envs = ImpactVecEnv(scenario, 2, max_cycles=4, dtype="float64", threads=1)
    envs.seed(SEED)
    singles = [JointEnv(scenario, max_cycles=4) for _ in range(2)]
    assert np.array_equal(envs.reset(), [env.reset(seed=SEED + k)[0] for k, env in enumerate(singles)])
    for actions in np.random.default_rng(0).uniform(-1.0, 1.0, (10, 2, 6)):
        seen, rewards, ended, infos = envs.step(actions)
        for k, env in enumerate(singles):
            wanted, reward, _, cut, _ = env.step(actions[k])
            assert (rewards[k], ended[k]) == (reward, cut)
            if cut:
                assert np.array_equal(infos[k]["terminal_observation"], wanted)
                wanted, _ = env.reset()
            assert np.array_equal(seen[k], wanted)


def test_arm_and_base_share_a_policy_only_if_their_actions_are_alike():
    envs = ImpactVecEnv(NAME, 2, per_robot=True, max_cycles=4, dtype="float64", threads=1)
    envs.seed(SEED)
    seen = envs.reset()
    assert np.array_equal(seen[0::2], seen[1::2])  # they share all sensors
    env = JointEnv(NAME)
    assert np.array_equal(seen[2], env.reset(seed=SEED + 1)[0])
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (4, 3))
    seen, rewards, _, _ = envs.step(actions)
    wanted, reward, *_ = env.step(actions[2:].ravel())
    assert np.array_equal(seen[2], wanted)
    assert rewards[2] + rewards[3] == reward
    link = load_scenario(NAME).links["link_1"].model_dump()
    two = {
        "links": {"upper": link, "lower": link},
        "arm": {"goal": [3.0, 0.0], "joints": [0.3, 0.3]},
        "requirements": {},
    }
    with pytest.raises(InputError, match="has 2 joints; a shared policy needs 3"):
        ImpactVecEnv(load_scenario(NAME).override(two), 2, per_robot=True, threads=1)

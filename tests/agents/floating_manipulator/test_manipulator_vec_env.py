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


def test_agents_of_different_actions_share_no_policy():
    with pytest.raises(InputError, match=f"per_robot: the agents of scenario '{NAME}' differ"):
        ImpactVecEnv(NAME, 2, per_robot=True, threads=1)

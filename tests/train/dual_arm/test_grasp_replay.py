"""A replay of two arms holds what places their joints."""

import numpy as np

from impact_envs import load_scenario, parallel_env, rollout
from impact_envs.dual_arm.arm import solve_inverse_kinematics
from impact_envs.rollout import ZeroPolicy
from train.evaluation.replay import episode_to_dict

# Arms that nobody drives, for a twentieth of a second.
SHORT = {"horizon": 0.05, "formula": "G[0,0.05] box.lag <= 0.015"}


def test_links_and_pads_give_the_joints():
    scenario = load_scenario("dual_arm_grasp").override(SHORT)
    env = parallel_env(scenario)
    replay = episode_to_dict(rollout(env, ZeroPolicy(env), 0), scenario, "nominal", env.task.shapes())
    chains = env.task.chains(env.model.state())
    assert replay["links"].keys() == chains.keys()
    for name, numbers in zip(scenario.arms, scenario.arm_numbers(), strict=True):
        links = replay["links"][name]
        pad = np.array([replay["signals"][f"{name}.{axis}"][-1] for axis in ("x", "y", "heading")])
        q = solve_inverse_kinematics(numbers, pad, links["elbow"])
        elbow = np.array(links["base"]) + links["lengths"][0] * np.array([np.cos(q[0]), np.sin(q[0])])
        np.testing.assert_allclose(elbow, chains[name][1], atol=1e-4)


def test_other_domains_have_no_links():
    scenario = load_scenario("throw_and_catch").shorten(0.1)
    env = parallel_env(scenario)
    assert episode_to_dict(rollout(env, ZeroPolicy(env), 0), scenario, "nominal", env.task.shapes())["links"] == {}

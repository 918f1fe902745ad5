"""The oracle believes what it is told, acts the same in one world and in many, and is the expert otherwise."""

from __future__ import annotations

import numpy as np
import pytest

from impact_envs import InputError, load_scenario, parallel_env, rollout, vector_env
from impact_envs.free_flyer.schema import DRIFT_X, DRIFT_Y, MASS, OFFSET_X, OFFSET_Y, RESTITUTION
from planners import make_expert, make_oracle, make_oracle_batch
from planners.free_flyer.oracle import CERTAIN, FreeFlyerOracle, Truth, read_truth
from tests.frozen.freeze import get_plan
from train.evaluation.oracle import OraclePolicy

SEED = 1_000_000
NAME = "throw_and_catch"
PLAN = get_plan(NAME, "nominal")
CALM = {"plan_anew": False}


def make_reading(told, heading, rate, centre, velocity):
    """Return the joint observation of a scenario of two robots and one object, whose geometric centre is read."""
    cos, sin = np.cos(heading), np.sin(heading)
    x, y = cos * told[0] - sin * told[1], sin * told[0] + cos * told[1]
    joint = np.zeros((1, 7 * 3 + 2 + 3))
    joint[0, 14:21] = centre[0] - x, centre[1] - y, velocity[0] + rate * y, velocity[1] - rate * x, cos, sin, rate
    return joint


def test_a_turning_body_is_read_where_its_mass_is():
    scenario = load_scenario(NAME)
    truth = Truth(scenario, PLAN, 1)
    truth.told["offset"] = 0.02, -0.01
    for heading in np.linspace(-3.0, 3.0, 7):
        joint = make_reading((0.02, -0.01), heading, 0.4, (1.5, 2.0), (0.03, -0.02))
        read_truth(truth.told, 0.1, 30.0, joint, np.zeros((1, 3), make_filter()), False)
        assert joint[0, 14:18] == pytest.approx([1.5, 2.0, 0.03, -0.02], abs=1e-15)


def make_filter():
    from planners.free_flyer.belief.world_memory import FILTER

    return FILTER


def test_the_belief_opens_with_the_truth():
    scenario = load_scenario(NAME).suite("hard").override({"true.restitution_speed": 0.0})
    env, oracle = parallel_env(scenario), make_oracle(scenario, PLAN, CALM)
    physics = scenario.draw(np.random.default_rng(SEED))
    observations, _ = env.reset(seed=SEED)
    oracle.reset(SEED)
    oracle.tell(physics)
    for _ in range(2):
        observations, *_ = env.step(oracle.act(observations))
    pop = scenario.bodies.index("pop")
    for r, robot in enumerate(scenario.robots):
        pair = oracle.estimates()[robot, "pop"]
        assert pair.restitution == pytest.approx(physics.contact[RESTITUTION], abs=1e-12)
        assert pair.mass_ratio == pytest.approx(physics.body[pop, MASS] / physics.body[r, MASS], rel=1e-12)
        assert pair.restitution_spread == pytest.approx(CERTAIN)
    z, place = oracle.memory.filter[0, pop], np.array(scenario.objects["pop"].start)
    offset = physics.body[pop, OFFSET_X : OFFSET_Y + 1]  # heading 0
    assert z["position"] - place == pytest.approx(offset, abs=1e-3)
    assert np.hypot(*z["drift"]) == pytest.approx(np.hypot(*physics.body[pop, [DRIFT_X, DRIFT_Y]]), rel=1e-9)


def test_many_worlds_act_as_one_each_bit_for_bit():
    scenario, worlds, steps = load_scenario(NAME).suite("hard"), 3, 120
    envs, oracles = vector_env(scenario, num_envs=worlds, threads=1), make_oracle_batch(scenario, worlds, PLAN, CALM)
    uniforms = [np.random.default_rng(SEED + k).random(scenario.draw_count) for k in range(worlds)]
    oracles.tell(scenario.draw_many(np.array(uniforms)))
    joint, _ = envs.reset(seed=SEED)
    played = []
    for _ in range(steps):
        actions = oracles.act(joint)
        played.append(actions)
        joint, *_ = envs.step(actions)
    for k in range(worlds):
        env, oracle = parallel_env(scenario), OraclePolicy(scenario, PLAN, CALM)
        observations, _ = env.reset(seed=SEED + k)
        oracle.reset(SEED + k)
        for t in range(steps):
            actions = oracle.act(observations)
            alone = np.concatenate([actions[name] for name in scenario.agents])
            assert np.array_equal(played[t][k], alone), (k, t)
            observations, *_ = env.step(actions)


def test_an_oracle_that_is_told_nothing_is_the_expert():
    scenario = load_scenario(NAME).suite("all")
    env = parallel_env(scenario, max_cycles=100)
    oracle = FreeFlyerOracle(scenario, PLAN, parts=())
    told = rollout(env, oracle, SEED)
    oracle.reset(SEED)
    oracle.tell(scenario.draw(np.random.default_rng(SEED)))
    expert = rollout(env, make_expert(scenario, PLAN), SEED)
    for name, actions in expert.actions.items():
        assert np.array_equal(told.actions[name], actions)


def test_an_episode_repeats():
    scenario = load_scenario(NAME).suite("hard")
    env, oracle = parallel_env(scenario, max_cycles=150), OraclePolicy(scenario, PLAN, CALM)
    first, _, again = (rollout(env, oracle, seed) for seed in (SEED, SEED + 1, SEED))
    for name, actions in first.actions.items():
        assert np.array_equal(again.actions[name], actions)


def test_what_cannot_be_told_is_one_line():
    with pytest.raises(InputError, match="'dual_arm' cannot be told the truth; domains with an oracle: free_flyer"):
        make_oracle("dual_arm_grasp")
    with pytest.raises(InputError, match="part 'mas' of the truth is unknown; did you mean 'mass'"):
        Truth(load_scenario(NAME), PLAN, 1, ("mas",))

"""The oracle believes what it is told, acts the same in one world and in many, and is the expert otherwise."""

from __future__ import annotations

import numpy as np
import pytest

from impact_envs import InputError, load_scenario, parallel_env, rollout, vector_env
from impact_envs.free_flyer.truth import DRIFT_X, DRIFT_Y, MASS, OFFSET_X, OFFSET_Y, RESTITUTION
from planners import make_expert, make_oracle, make_oracle_batch
from planners.free_flyer.belief.world_memory import FILTER
from planners.free_flyer.oracle import CERTAIN, FreeFlyerOracle, Truth, turn_drifts
from tests.frozen.freeze import get_plan
from train.evaluation.oracle import OraclePolicy

SEED = 1_000_000
NAME = "throw_and_catch"
PLAN = get_plan(NAME, "nominal")
CALM = {"plan_anew": False}


def test_a_drift_that_is_told_turns():
    truth, filters, joint = Truth(load_scenario(NAME), PLAN, 1), np.zeros((1, 3), FILTER), np.zeros((1, 7 * 3 + 2 + 3))
    truth.told["drift"], truth.told["turn"] = (3e-4, 0.0), 0.05
    joint[0, 23] = 20.0 / 30.0  # of the horizon
    turn_drifts(truth.told, 0.1, 30.0, joint, filters)
    assert filters["drift"][0, 2] == pytest.approx([3e-4 * np.cos(1.0), 3e-4 * np.sin(1.0)], abs=3e-6)


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
    assert z["offset"] == pytest.approx(-physics.body[pop, OFFSET_X : OFFSET_Y + 1], abs=1e-9)
    assert z["position"] == pytest.approx(place, abs=1e-3)
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

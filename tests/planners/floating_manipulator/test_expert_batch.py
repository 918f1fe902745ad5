"""Experts of many manipulators act as one expert each, corrections included."""

import copy

import numpy as np
import pytest

from impact_envs import list_scenarios, load_scenario, parallel_env, vector_env
from impact_envs.errors import InputError
from planners import make_expert, make_expert_batch
from planners.floating_manipulator.options import VARIANTS
from tests.planners.floating_manipulator.oracle.drive import play

NAMES = [name for name in list_scenarios() if load_scenario(name).domain == "floating_manipulator"]
WORLDS, SEED = 3, 1_000_000
SOON = {
    "horizon": 2.0,
    "formula": "F[0,2] distance(tip, target) <= 5",
    "requirements": {},
    "box.start": [6.98, 1.5],
    "safety_pause": 0.5,
}


def drive(worlds, experts, seed, steps):
    """Play worlds, correcting as `play` does; return actions, features at corrections, and counts, by world."""
    rngs = [np.random.default_rng(seed + k) for k in range(WORLDS)]
    seen, _ = worlds.reset(seed=seed)
    actions, features = [], [[] for _ in rngs]
    for _ in range(steps):
        awaiting = experts.observe(seen)
        if awaiting.any():
            known, chosen = experts.features(), np.flatnonzero(awaiting)
            for k in chosen.tolist():
                features[k].append(known[k])
            corrections = [rngs[k].uniform(-1.0, 1.0, experts.correction_size) for k in chosen.tolist()]
            experts.correct(awaiting, np.array(corrections))
        actions.append(experts.control())
        seen = worlds.step(actions[-1])[0]
    return np.array(actions), features, experts.counts


def check_same(scenario, variant, seed, threads=1):
    worlds = vector_env(scenario, WORLDS, threads=threads, autoreset_mode="Disabled")
    experts = make_expert_batch(scenario, WORLDS, variant=variant, threads=threads)
    actions, features, counts = drive(worlds, experts, seed, scenario.steps)
    env, expert = parallel_env(scenario), make_expert(scenario, variant=variant)
    for k in range(WORLDS):
        wanted, known, fallbacks = play(env, [expert], seed + k, scenario.steps)[0]
        np.testing.assert_array_equal(actions[:, k], wanted)
        np.testing.assert_array_equal(np.array(features[k]), np.array(known))
        assert {name: count[k] for name, count in counts.items() if count[k]} == fallbacks


@pytest.mark.parametrize("variant", [None, *VARIANTS])
@pytest.mark.parametrize("suite", ["nominal", "sensing"])
@pytest.mark.parametrize("name", ["floating_manipulator", "floating_manipulator_thrusters"])
def test_worlds_act_as_single_experts_with_random_corrections(name, suite, variant):
    check_same(load_scenario(name).suite(suite).override(SOON), variant, SEED, threads=2)


@pytest.mark.slow
@pytest.mark.parametrize("suite", ["nominal", "all", "sensing", "hard"])
@pytest.mark.parametrize("name", NAMES)
def test_whole_episodes_are_those_of_single_experts(name, suite):
    for first in range(SEED, SEED + 6, WORLDS):
        check_same(load_scenario(name).suite(suite), None, first)


def test_a_new_episode_forgets_the_last_one_and_a_copy_goes_on():
    scenario = load_scenario("floating_manipulator_thrusters").suite("sensing").override(SOON)
    worlds, experts = vector_env(scenario, 2, max_cycles=60, threads=1), make_expert_batch(scenario, 2)
    fresh = make_expert_batch(scenario, 2)
    seen, _ = worlds.reset(seed=SEED)
    for k in range(130):
        if k == 61:  # the next episode has begun
            assert (seen[:, -3] == 0.0).all()
            fresh.act(seen)
        actions = experts.act(seen)
        if k > 61:
            assert np.array_equal(actions, fresh.act(seen))
        if k == 100:
            fresh = copy.deepcopy(experts)
        seen = worlds.step(actions)[0]


def test_bad_input_is_refused_in_one_line():
    scenario = load_scenario("floating_manipulator").override(SOON)
    experts, worlds = make_expert_batch(scenario, 2), vector_env(scenario, 2, threads=1)
    with pytest.raises(InputError, match=r"observations have shape \(2, 5\)"):
        experts.act(np.zeros((2, 5)))
    with pytest.raises(InputError, match="count = 0: a whole number from 1"):
        make_expert_batch(scenario, 0)
    with pytest.raises(InputError, match="follows no plan"):
        make_expert_batch(scenario, 2, plan=object())
    seen, _ = worlds.reset(seed=0)
    assert experts.observe(seen).all()
    with pytest.raises(InputError, match="correction of world 1 must be 5 finite numbers"):
        experts.correct([1], np.full((1, 5), np.nan))
    experts.correct([1], np.ones((1, 5)))
    with pytest.raises(InputError, match="world 1 awaits no correction now"):
        experts.correct(np.array([True, True]), np.zeros((2, 5)))

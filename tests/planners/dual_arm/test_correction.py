"""The expert takes corrections of grip and load, and zero changes nothing."""

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from agents.residual import ResidualEnv, ResidualPolicy
from impact_envs import load_scenario, parallel_env, rollout
from impact_envs.errors import InputError
from planners import make_expert
from train.evaluation.player import make_policy

NAME = "dual_arm_grasp"
# Ends a quarter of a second after the grasp.
SHORT = {"horizon": 1.15, "formula": "G[0,1.15] box.lag <= 0.015"}


@pytest.fixture(scope="module")
def scenario():
    return load_scenario(NAME).override(SHORT)


def play(scenario, actor, suite="nominal"):
    return rollout(parallel_env(scenario.suite(suite)), ResidualPolicy(make_expert(scenario), actor), 1_000_000)


def test_zero_is_the_expert_bit_for_bit():
    scenario = load_scenario(NAME)
    alone = rollout(parallel_env(scenario), make_expert(scenario), 1_000_000)
    zero = play(scenario, lambda features: np.zeros(2))
    assert zero.robustness == alone.robustness
    for name in alone.signals:
        assert np.array_equal(zero.signals[name], alone.signals[name])
    for name in alone.actions:
        assert np.array_equal(zero.actions[name], alone.actions[name])


def test_a_correction_grips_harder_and_is_asked_for_seldom(scenario):
    asked = []

    def grip(features):
        asked.append(features.copy())
        return np.array([1.0, 0.0])

    harder, alone = play(scenario, grip), play(scenario, lambda features: np.zeros(2))
    assert 1 <= len(asked) <= 3
    assert all(features.shape == (22,) and np.isfinite(features).all() for features in asked)
    assert asked[0][0] == pytest.approx(0.02, abs=1e-9)
    force = harder.signals["box.force_min"][-1]
    assert force == pytest.approx(25.0 * np.exp(0.7), rel=0.15)
    assert alone.signals["box.force_min"][-1] == pytest.approx(25.0, rel=0.15)
    # Rate-limited: the torques move on without a step.
    assert np.abs(np.diff(harder.actions["arm_1"], axis=0)[900:]).max() < 0.05


def test_a_heavier_box_shows_and_a_correction_of_the_load_carries_it(scenario):
    heavy = scenario.override({"true.mass_scale": 2.0})
    lags = {}
    for name, world, load in (("light", scenario, 0.0), ("heavy", heavy, 0.0), ("corrected", heavy, 1.0)):
        seen = []

        def answer(features, seen=seen, load=load):
            seen.append(features[15])
            return np.array([0.5, load])

        rollout(parallel_env(world), ResidualPolicy(make_expert(scenario), answer), 1_000_000)
        lags[name] = seen
    assert lags["heavy"][0] > 0.03 > 0.01 > lags["light"][0]
    assert lags["heavy"][1] > 0.02
    assert abs(lags["corrected"][1]) < 0.3 * lags["heavy"][1]


def test_an_unanswered_request_counts_as_zero(scenario):
    env, expert = parallel_env(scenario), make_expert(scenario)
    observations, _ = env.reset(seed=1_000_000)
    requests = 0
    while env.agents:
        expert.observe(observations)
        requests += expert.awaiting_correction
        if expert.awaiting_correction and requests == 1:
            expert.correct(np.ones(2))
        observations, *_ = env.step(expert.control())
    assert requests == 2
    assert np.array_equal(expert.features()[-2:], np.zeros(2))


def test_bad_corrections_are_refused(scenario):
    expert = make_expert(scenario)
    with pytest.raises(InputError, match="no correction is awaited now"):
        expert.correct(np.zeros(2))
    for values in (np.zeros(3), np.array([0.0, np.nan])):
        with pytest.raises(InputError, match="correction must be 2 finite numbers"):
            expert.correct(values)


@pytest.mark.filterwarnings("ignore:.*:UserWarning")
def test_the_residual_environment_passes_the_checker(scenario):
    check_env(ResidualEnv(scenario.override({"control_period": 0.01}), "hard"), skip_render_check=True)


def test_the_shipped_policy_loads_and_fits(scenario):
    policy = make_policy("dual_arm_grasp_hard", scenario)
    assert isinstance(policy, ResidualPolicy)
    correction = policy.actor(np.zeros(22))
    assert correction.shape == (2,) and np.all(np.abs(correction) <= 1.0)
    episode = rollout(parallel_env(scenario), policy, 1_000_000)
    assert not episode.fallbacks

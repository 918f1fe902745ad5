"""Episodes of many worlds: zeros are the expert, and neither chunks nor threads nor one world alone change one."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import torch

from agents import ResidualPolicy, ResidualVectorEnv
from agents.actor import Actor
from agents.play import Played, play_episodes
from impact_envs import load_scenario, parallel_env, rollout
from planners import make_expert
from planners.free_flyer.expert_batch import FreeFlyerExpertBatch
from tests.frozen.freeze import get_plan

SEEDS = np.arange(40, 47)
SIZES = FreeFlyerExpertBatch.feature_size, FreeFlyerExpertBatch.correction_size


def make_worlds(count: int, name: str = "throw_and_catch", suite: str = "all", **options) -> ResidualVectorEnv:
    settings = {"threads": 1, "options": {"plan_anew": False}} | options
    return ResidualVectorEnv(name, count, suite, get_plan(name, suite), **settings)


@cache
def make_actor() -> Actor:
    torch.manual_seed(0)
    actor = Actor(*SIZES, (8,))
    for parameter in actor.parameters():
        torch.nn.init.normal_(parameter, std=0.1)
    return actor


@cache
def play(count: int, name: str = "throw_and_catch") -> Played:
    return play_episodes(make_worlds(count, name), SEEDS, make_actor().correction)


def check_same(one: Played, two: Played) -> None:
    """Chunks may differ in the order of the corrections, and a network's sums in the last bit."""
    np.testing.assert_allclose(one.robustness, two.robustness, atol=1e-6)
    np.testing.assert_array_equal(one.success, two.success)
    assert one.filtered == pytest.approx(two.filtered, abs=1e-12)
    for name in ("features", "corrections"):
        for episode in range(len(SEEDS)):
            a, b = (getattr(played, name)[played.episode == episode] for played in (one, two))
            np.testing.assert_allclose(a, b, atol=1e-5)


@pytest.mark.parametrize("name", ["throw_and_catch", "pong"])
def test_zeros_are_the_expert_bit_for_bit(name: str) -> None:
    played = play_episodes(make_worlds(3, name), SEEDS[:3])
    world = load_scenario(name).suite("all")
    env, expert = parallel_env(world), make_expert(world, get_plan(name, "all"), options={"plan_anew": False})
    for k, seed in enumerate(SEEDS[:3].tolist()):
        episode = rollout(env, expert, seed)
        assert (played.robustness[k], played.success[k]) == (episode.robustness, episode.success)
    assert not played.corrections.any()
    assert played.filtered == 0.0


def test_an_episode_is_that_of_the_policy_alone() -> None:
    world = load_scenario("throw_and_catch").suite("all")
    expert = make_expert(world, get_plan("throw_and_catch", "all"), options={"plan_anew": False})
    env, policy = parallel_env(world), ResidualPolicy(expert, make_actor().correction)
    alone = [rollout(env, policy, seed).robustness for seed in SEEDS.tolist()]
    np.testing.assert_allclose(play(len(SEEDS)).robustness, alone, atol=1e-6)
    assert np.ptp(play(len(SEEDS)).corrections) > 0.1


@pytest.mark.parametrize("count", [2, 3, 16])
def test_chunks_change_nothing(count: int) -> None:
    check_same(play(count), play(len(SEEDS)))


def test_worlds_remember_nothing_of_earlier_episodes() -> None:
    worlds = make_worlds(4)
    play_episodes(worlds, SEEDS[::-1], lambda features: np.ones((len(features), SIZES[1])))
    check_same(play_episodes(worlds, SEEDS, make_actor().correction), play(len(SEEDS)))


def test_every_correction_says_of_which_episode_it_is() -> None:
    played = play(3)
    assert played.features.shape == (len(played.episode), SIZES[0])
    assert played.corrections.shape == (len(played.episode), SIZES[1])
    assert set(played.episode.tolist()) == set(range(len(SEEDS)))
    # The chunk of worlds 0 to 2 comes first, and in each episode the impacts in their order.
    assert (np.diff(played.episode // 3) >= 0).all()
    for episode in range(len(SEEDS)):
        numbers = played.features[played.episode == episode, :6].argmax(axis=1)
        assert (np.diff(numbers) >= 0).all()


def test_corrections_beyond_the_limits_are_cut_but_remembered() -> None:
    at_limit, beyond = (
        play_episodes(make_worlds(3), SEEDS[:3], lambda features, size=size: np.full((len(features), SIZES[1]), size))
        for size in (1.0, 5.0)
    )
    np.testing.assert_array_equal(at_limit.robustness, beyond.robustness)
    assert (beyond.corrections == 5.0).all()


def test_share_filtered_counts_what_the_expert_did_not_take_whole() -> None:
    loud = lambda features: np.tile([1.0, 1.0, 0.0], (len(features), 1))  # noqa: E731
    filtered = play_episodes(make_worlds(7), SEEDS, loud)
    whole = play_episodes(make_worlds(7, options={"plan_anew": False, "filter": False}), SEEDS, loud)
    assert 0.0 < filtered.filtered <= 1.0
    assert whole.filtered == 0.0
    assert filtered.success.sum() >= whole.success.sum()

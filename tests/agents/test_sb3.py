"""PPO over whole episodes: starts at the expert, compares episodes of a seed, and learns what it should."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest
import torch
from stable_baselines3.common.utils import set_random_seed

from agents.sb3 import compute_advantages, compute_statistics, explore, update
from tests.agents.target import SIZES, STATISTICS, compute_rewards, draw_features, export, make_small, practise

FEATURES = draw_features(5, 200)


def get_weights(model) -> bytes:
    return b"".join(parameter.detach().numpy().tobytes() for parameter in model.policy.parameters())


@pytest.mark.parametrize("hidden", [(8, 4), (64, 64)])
def test_a_new_model_corrects_nothing_and_explores_as_asked(hidden: tuple[int, ...]) -> None:
    model = make_small(hidden=hidden, log_std=-2.3)
    assert np.array_equal(export(model).correction(FEATURES), np.zeros((200, 2)))
    set_random_seed(0)
    drawn = explore(model, np.zeros((20_000, SIZES[0]), np.float32))
    assert drawn.shape == (20_000, 2)
    assert drawn.std(axis=0) == pytest.approx(np.exp(-2.3), rel=0.03)
    assert np.abs(drawn.mean(axis=0)).max() < 0.003


def test_a_model_makes_no_folder_to_log_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    practise(make_small())
    assert not list(tmp_path.iterdir())


def test_an_exported_actor_is_the_models_deterministic_policy() -> None:
    model = make_small()
    practise(model, 3)
    predicted, _ = model.predict(STATISTICS.normalize(FEATURES), deterministic=True)
    corrections = export(model).correction(FEATURES)
    np.testing.assert_allclose(corrections, predicted, atol=1e-6)
    assert np.ptp(corrections) > 1e-3


def test_an_exported_actor_is_a_copy() -> None:
    model = make_small()
    actor = export(model)
    practise(model)
    assert np.array_equal(actor.correction(FEATURES), np.zeros((200, 2)))


def test_statistics_normalise_and_a_constant_feature_is_not_blown_up() -> None:
    normalized = STATISTICS.normalize(draw_features(0, 1000))
    assert normalized.dtype == np.float32
    np.testing.assert_allclose(normalized.mean(axis=0), 0.0, atol=1e-5)
    np.testing.assert_allclose(normalized.std(axis=0), [1.0, 1.0, 1.0, 1.0, 0.0], atol=0.01)
    assert np.abs(STATISTICS.normalize(np.full((1, 5), 1e9))).max() == 10.0
    assert compute_statistics(np.ones((4, 3))).std == pytest.approx(1e-3)


@pytest.mark.parametrize("group", [2, 3, 8])
def test_an_advantage_is_over_the_mean_of_the_others_of_the_seed(group: int) -> None:
    rng = np.random.default_rng(0)
    scores = rng.normal(size=(5, group))
    found = compute_advantages(scores.reshape(-1), group).reshape(5, group)
    for row, advantages in zip(scores, found, strict=True):
        for i in range(group):
            assert advantages[i] == pytest.approx(row[i] - np.delete(row, i).mean(), abs=1e-12)
    np.testing.assert_allclose(found.sum(axis=1), 0.0, atol=1e-12)
    # What a seed is worth is no merit of an episode.
    shifted = scores + rng.normal(scale=100.0, size=(5, 1))
    np.testing.assert_allclose(compute_advantages(shifted.reshape(-1), group), found.reshape(-1), atol=1e-11)
    assert not compute_advantages(np.full(4 * group, 0.7), group).any()


def test_a_world_that_is_lost_by_chance_counts_no_more_than_the_cut() -> None:
    scores = np.array([0.1, 0.2, 0.3, -50.0])
    found = compute_advantages(scores, 4, cut=1.0)
    by_hand = [np.mean([np.clip(scores[i] - scores[j], -1.0, 1.0) for j in range(4) if j != i]) for i in range(4)]
    np.testing.assert_allclose(found, by_hand, atol=1e-15)
    assert found[3] == -1.0
    assert found.sum() == pytest.approx(0.0, abs=1e-15)
    np.testing.assert_array_equal(compute_advantages(scores, 4, cut=1e6), compute_advantages(scores, 4))


def test_an_update_makes_corrections_of_positive_advantage_more_probable() -> None:
    model = make_small()
    set_random_seed(0)
    normalized = STATISTICS.normalize(draw_features(3, 64))
    corrections = explore(model, normalized)
    advantages = np.where(np.arange(64) % 2, 1.0, -1.0)

    def measure() -> np.ndarray:
        with torch.no_grad():
            taken = torch.from_numpy(corrections)
            return model.policy.evaluate_actions(torch.from_numpy(normalized), taken)[1].numpy()

    before = measure()
    update(model, normalized, corrections, advantages)
    change = measure() - before
    assert change[advantages > 0].mean() > 0.0 > change[advantages < 0].mean()
    assert model.num_timesteps == 64


def test_without_any_advantage_nothing_is_learned() -> None:
    model = make_small()
    weights, normalized = get_weights(model), STATISTICS.normalize(draw_features(3, 64))
    update(model, normalized, explore(model, normalized), np.zeros(64))
    assert get_weights(model) == weights


def test_practice_makes_perfect_and_the_same_seed_the_same_weights() -> None:
    model, twin, other = make_small(), make_small(), make_small(seed=1)
    normalized = STATISTICS.normalize(FEATURES)
    start = compute_rewards(normalized, export(model).correction(FEATURES)).mean()
    for each in (model, twin, other):
        practise(each, 25)
    assert get_weights(model) == get_weights(twin) != get_weights(other)
    assert compute_rewards(normalized, export(model).correction(FEATURES)).mean() > 0.5 * start  # both negative

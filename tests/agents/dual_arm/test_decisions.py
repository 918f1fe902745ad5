"""Worlds run from decision to decision in one compiled call are residual environments, bit for bit."""

import numpy as np
import pytest

from agents.dual_arm.decisions import DualArmDecisions
from agents.residual import ResidualEnv
from impact_envs import load_scenario
from planners import make_expert_batch

NAME, SEED = "dual_arm_grasp", 1_000_000
# Two decisions after the grasp, in most draws.
SHORT = load_scenario(NAME).override({"horizon": 1.3, "formula": "G[0,1.3] box.lag <= 0.015"})


def make_decisions(scenario, count, threads=1, max_cycles=None):
    return DualArmDecisions(scenario, make_expert_batch(scenario, count, threads=threads), max_cycles)


def draw(seed):
    """Yield the corrections of an episode."""
    rng = np.random.default_rng(seed)
    while True:
        yield rng.uniform(-1.0, 1.0, 2)


def play_single(scenario, seed, max_cycles=None):
    """Return features, rewards and lengths of all steps of an episode, and its last infos."""
    env, corrections = ResidualEnv(scenario, max_cycles=max_cycles), draw(seed)
    features, infos = env.reset(seed=seed)
    seen, rewards, lengths, over = [features], [], [infos["control_steps"]], False
    while not over:
        features, reward, terminated, truncated, infos = env.step(next(corrections))
        over = terminated or truncated
        seen.append(features)
        rewards.append(reward)
        lengths.append(infos["control_steps"])
    return np.array(seen), rewards, lengths, infos


def check_equal(scenario, count, threads=1, max_cycles=None):
    decisions = make_decisions(scenario, count, threads, max_cycles)
    corrections = [draw(SEED + k) for k in range(count)]
    everyone = np.ones(count, bool)
    decisions.start(everyone, np.arange(SEED, SEED + count))
    features, rewards = [[row] for row in decisions.features()], [[] for _ in range(count)]
    lengths = [[steps] for steps in decisions.steps.tolist()]
    open_ = everyone.copy()
    requests = decisions.awaiting_correction.sum()
    while open_.any():
        waiting = decisions.awaiting_correction
        answers = np.zeros((count, 2))
        for k in np.flatnonzero(open_):
            answers[k] = next(corrections[k])
        decisions.answer(waiting, answers)
        seen, earned = decisions.features(), decisions.take_rewards(open_)
        for k in np.flatnonzero(open_):
            features[k].append(seen[k])
            rewards[k].append(earned[k])
            lengths[k].append(decisions.steps[k])
        requests += decisions.awaiting_correction.sum()
        open_ &= ~decisions.over
    robustness, success = decisions.judge()
    for k in range(count):
        single = play_single(scenario, SEED + k, max_cycles)
        assert np.array_equal(features[k], single[0])
        assert rewards[k] == single[1]
        assert lengths[k][: len(single[2]) - 1] == single[2][:-1]
        assert (robustness[k], success[k]) == (single[3]["robustness"], single[3]["success"])
        assert decisions.decided[k] == single[3]["decided"]
    decisions.close()
    return int(requests)


@pytest.mark.parametrize("suite", ["nominal", "hard"])
def test_worlds_equal_residual_environments(suite):
    assert check_equal(SHORT.suite(suite), 3, threads=2) >= 4


def test_episodes_cut_short_and_without_a_decision():
    assert check_equal(SHORT, 2, max_cycles=1100) >= 2
    assert check_equal(SHORT, 2, max_cycles=50) == 0


@pytest.mark.slow
@pytest.mark.parametrize("suite", ["nominal", "mass", "start_pose", "all", "hard"])
def test_whole_episodes_equal_residual_environments(suite):
    check_equal(load_scenario(NAME).suite(suite), 10, threads=2)


def test_some_worlds_start_again_while_others_wait():
    decisions = make_decisions(SHORT, 2)
    decisions.start(np.array([True, True]), np.array([SEED, SEED + 1]))
    first = decisions.features()
    decisions.start(np.array([True, False]), np.array([SEED + 1]))
    again = decisions.features()
    assert np.array_equal(again[1], first[1])
    assert np.array_equal(again[0], again[1])

"""A correction of zero is the expert, bit for bit; steps last from one awaited correction to the next."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as check_env_sb3

from agents import ResidualEnv, ResidualPolicy
from impact_envs import InputError, Scenario, gym_id, list_scenarios, load_scenario, parallel_env, rollout
from impact_envs.rollout import Diagnostics, Episode, ZeroPolicy
from planners import make_expert
from planners.plan import Plan
from tests.frozen.freeze import get_plan


class Pusher:
    """A tiny expert: every robot pushes along x, and asks for a correction of the push every few steps."""

    name = "pusher"
    correction_size = 2
    feature_size = 3

    def __init__(self, agents: tuple[str, ...], every: int | None) -> None:
        self._agents, self._every = agents, every
        self.reset(0)

    def reset(self, seed: int) -> None:
        self.count, self._push, self._position = -1, np.zeros(2), np.zeros(2)
        self.awaiting_correction = False

    def observe(self, observations: dict[str, np.ndarray]) -> None:
        self.count += 1
        self._position = next(iter(observations.values()))[:2]
        self.awaiting_correction = self._every is not None and self.count % self._every == 0

    def features(self) -> np.ndarray:
        return np.array([float(self.count), *self._position])

    def correct(self, correction: np.ndarray) -> None:
        assert self.awaiting_correction
        self._push, self.awaiting_correction = correction, False

    def control(self) -> dict[str, np.ndarray]:
        self.awaiting_correction = False
        push = np.array([0.1, 0.0, 0.0]) + 0.5 * np.append(self._push, 0.0)
        return {agent: push.copy() for agent in self._agents}

    def act(self, observations: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        self.observe(observations)
        return self.control()

    def diagnostics(self) -> Diagnostics:
        return Diagnostics()


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return load_scenario("throw_and_catch")


@pytest.fixture(scope="module")
def short(scenario: Scenario) -> Scenario:
    """Three seconds, thirty control steps."""
    return scenario.shorten(0.1)


@pytest.fixture(scope="module")
def plan(scenario: Scenario) -> Plan:
    return get_plan(scenario.name, "nominal")


def make_pusher_env(short: Scenario, every: int | None, **options: Any) -> ResidualEnv:
    return ResidualEnv(short, expert=Pusher(short.agents, every), **options)


def play(env: ResidualEnv, seed: int, action: np.ndarray) -> tuple[float, list[int], dict[str, Any]]:
    """Return of the episode, control steps of each step, and the last info."""
    env.reset(seed=seed)
    total, lengths, over = 0.0, [], False
    for _ in range(1000):
        _, reward, terminated, truncated, info = env.step(action)
        total += reward
        lengths.append(info["control_steps"])
        over = terminated or truncated
        if over:
            break
    assert over
    return total, lengths, info


def assert_same_episode(a: Episode, b: Episode) -> None:
    assert a.signals.keys() == b.signals.keys()
    for name, values in a.signals.items():
        np.testing.assert_array_equal(values, b.signals[name])
    for agent in a.actions:
        np.testing.assert_array_equal(a.actions[agent], b.actions[agent])
        np.testing.assert_array_equal(a.rewards[agent], b.rewards[agent])
    assert a.robustness == b.robustness
    assert len(a.impacts) == len(b.impacts)


@pytest.mark.parametrize("suite", ["nominal", "restitution"])
def test_zero_policy_is_the_expert_bit_for_bit(scenario: Scenario, plan: Plan, suite: str) -> None:
    env = parallel_env(scenario.suite(suite))
    expert, corrected = make_expert(scenario, plan), make_expert(scenario, plan)
    policy = ResidualPolicy(corrected, lambda features: np.zeros(3))
    for seed in (3, 4):
        assert_same_episode(rollout(env, expert, seed), rollout(env, policy, seed))


def test_zero_action_is_the_expert_bit_for_bit(scenario: Scenario, plan: Plan) -> None:
    episode = rollout(parallel_env(scenario.suite("restitution")), make_expert(scenario, plan), 5)
    env = ResidualEnv(scenario, "restitution", plan)
    total, lengths, info = play(env, 5, np.zeros(3, np.float32))
    assert info["success"] == episode.success
    assert info["robustness"] == pytest.approx(episode.robustness, abs=1e-9)
    assert total == pytest.approx(sum(rewards.sum() for rewards in episode.rewards.values()), abs=1e-12)
    # The last true state, and so all before it, is the same.
    final = [episode.signals[name][-1] for name in env.parallel.signals]
    assert list(env.parallel.signals.values()) == final
    assert len(lengths) == len(plan.impacts)


def test_a_correction_changes_the_episode(scenario: Scenario, plan: Plan) -> None:
    env = ResidualEnv(scenario, "nominal", plan)
    ends = [play(env, 5, np.array(action, np.float32))[2]["robustness"] for action in (*np.zeros((1, 3)), *np.eye(3))]
    assert len(set(ends)) == 4


def test_reward_counts_every_control_step_once(short: Scenario) -> None:
    action = np.array([0.3, -0.2], np.float32)
    totals = {}
    for every in (1, 4, 7, 30):
        total, lengths, _ = play(make_pusher_env(short, every), 2, action)
        totals[every] = total
        assert sum(lengths) == short.steps
        assert lengths[0] == min(every, short.steps)
    assert max(totals.values()) - min(totals.values()) < 1e-12


def test_asking_at_every_step_is_an_ordinary_residual(short: Scenario) -> None:
    env = make_pusher_env(short, every=1)
    _, info = env.reset(seed=0)
    assert info["control_steps"] == 0
    for _ in range(short.steps - 1):
        _, _, terminated, truncated, info = env.step(env.action_space.sample())
        assert (terminated, truncated, info["control_steps"]) == (False, False, 1)
    assert env.step(env.action_space.sample())[3] is True


def test_an_expert_that_never_asks_hands_out_the_whole_return(short: Scenario) -> None:
    env = make_pusher_env(short, every=None)
    _, info = env.reset(seed=0)
    assert info["control_steps"] == short.steps
    _, reward, terminated, truncated, info = env.step(np.zeros(2, np.float32))
    asked, _, _ = play(make_pusher_env(short, every=1), 0, np.zeros(2, np.float32))
    assert (terminated, truncated) == (False, True)
    assert reward == pytest.approx(asked, abs=1e-12)
    assert "robustness" in info


def test_every_end_is_a_truncation_and_only_the_horizon_decides(short: Scenario) -> None:
    action = np.zeros(2, np.float32)
    for max_cycles, decided in ((None, True), (short.steps, True), (10, False)):
        env = make_pusher_env(short, 10, max_cycles=max_cycles)
        env.reset(seed=0)
        for _ in range(short.steps):
            features, _, terminated, truncated, info = env.step(action)
            if truncated:
                break
        assert (terminated, truncated, info["decided"]) == (False, True, decided)
        if not decided:
            assert features[0] == 10.0  # what a learner bootstraps from is the state at the cut


def test_episodes_without_a_seed_are_a_reproducible_chain_of_training_seeds(short: Scenario) -> None:
    env = make_pusher_env(short, 10)
    chains = []
    for _ in range(2):
        seeds = [env.reset(seed=11)[1]["seed"]]
        seeds += [env.reset()[1]["seed"] for _ in range(5)]
        chains.append(seeds)
    assert chains[0] == chains[1]
    assert chains[0][0] == 11
    assert len(set(chains[0])) == 6
    assert all(0 <= seed < 1_000_000 for seed in chains[0])


def test_passes_the_checkers_of_gymnasium_and_sb3(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    env = gymnasium.make("impact_envs/ThrowAndCatchResidual-v5", render_mode="rgb_array").unwrapped
    check_env(env)
    check_env_sb3(env, warn=True, skip_render_check=False)
    frame = env.render()
    assert frame.dtype == np.uint8
    assert frame.ndim == 3
    env.close()


def test_unknown_suite_and_scenario_are_named(short: Scenario) -> None:
    with pytest.raises(InputError, match="suite 'restitutoin' is unknown; did you mean 'restitution'"):
        make_pusher_env(short, 10, suite="restitutoin")
    with pytest.raises(InputError, match="throw_and_cathc"):
        ResidualEnv("throw_and_cathc")


ONCE_PER_IMPACT = {"free_flyer"}  # domains whose experts ask for a correction of every impact


@pytest.mark.parametrize("name", [n for n in list_scenarios() if load_scenario(n).domain in ONCE_PER_IMPACT])
def test_every_scenario_has_a_residual_twin_that_starts_at_its_expert(name: str) -> None:
    env = gymnasium.make(gym_id(name, residual=True), plan=get_plan(name, "nominal")).unwrapped
    assert isinstance(env, ResidualEnv)
    env.reset(seed=1_000_000)
    truncated, decisions = False, 0
    while not truncated and decisions < 12:
        features, _, _, truncated, info = env.step(np.zeros(3, np.float32))
        assert np.all(np.isfinite(features))
        decisions += 1
    assert truncated
    assert decisions >= 2
    assert info["success"]


@pytest.mark.parametrize("name", [n for n in list_scenarios() if load_scenario(n).domain not in ONCE_PER_IMPACT])
def test_every_domain_has_residual_twins(name: str) -> None:
    env = gymnasium.make(gym_id(name, residual=True), max_cycles=50).unwrapped
    assert isinstance(env, ResidualEnv)
    features, _ = env.reset(seed=1_000_000)
    assert features.shape == (env.expert.feature_size,)
    assert env.action_space.shape == (env.expert.correction_size,)


def test_an_expert_that_takes_no_corrections_is_refused_in_one_line() -> None:
    still: Any = ZeroPolicy(parallel_env("throw_and_catch"))
    with pytest.raises(InputError, match=r"scenario 'throw_and_catch': the expert of domain .* takes no corrections"):
        ResidualEnv("throw_and_catch", expert=still)

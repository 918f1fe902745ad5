"""An object that keeps its velocity flies straight on after a second, whatever pulls at it."""

from __future__ import annotations

import numpy as np
import pytest

import impact_envs
from impact_envs import Scenario, ScenarioError, load_scenario, parallel_env, rollout
from impact_envs.free_flyer.disc_model import DiscModel
from impact_envs.free_flyer.schema import FreeFlyerScenario
from planners import make_expert

DRIFT = 1e-3
PERIOD = 0.1


def load(keep_force: float) -> FreeFlyerScenario:
    change = {"objects.pop.keep_force": keep_force, "true.drift": DRIFT}
    loaded: Scenario = load_scenario("throw_and_catch").override(change)
    assert isinstance(loaded, FreeFlyerScenario)
    return loaded


def fly(keep_force: float, seconds: float = 14.0) -> np.ndarray:
    """Hit the object with the first robot and return its states after the impact, one row per period."""
    scenario = load(keep_force)
    model = DiscModel(scenario)
    model.reset(scenario.draw(np.random.default_rng(4)))
    states = model.state()
    states[0, :4], states[1, :2] = (0.5, 1.05, 0.0, 0.2), (-0.5, 4.0)
    model.set_state(states)
    controls = {name: np.zeros(3) for name in scenario.robots}
    rows, hit = [], False
    for _ in range(round(seconds / PERIOD)):
        hit = bool(model.step(controls)) or hit
        if hit:
            rows.append(model.state()[2])
    return np.array(rows)


def test_flies_straight_after_a_second() -> None:
    kept, free = fly(0.5), fly(0.0)
    np.testing.assert_allclose(kept[:11, 2:4] - kept[0, 2:4], free[:11, 2:4] - free[0, 2:4], atol=1e-12)  # averaging
    mean = (kept[10, :2] - kept[0, :2]) / 1.0
    np.testing.assert_allclose(kept[110:, 2:4], np.broadcast_to(mean, kept[110:, 2:4].shape), atol=1e-4)
    times = PERIOD * np.arange(len(kept) - 10)
    beside = kept[10:, :2] - (kept[10, :2] + times[:, None] * mean)
    # At rest beside its line where the law w^2 d balances the drift.
    assert np.hypot(*beside.T).max() < 1.05 * DRIFT / 0.25
    assert np.hypot(*(free[-1] - kept[-1])[:2]) > 0.05


def test_keeps_its_place_before_any_impact_and_within_its_force() -> None:
    for force, away in ((0.5, 1.05 * DRIFT / 0.25), (0.0, np.inf)):
        env = parallel_env(load(force))
        env.reset(seed=3)
        start = env.model.state()[2, :2]
        for _ in range(250):
            env.step({name: np.zeros(3) for name in env.agents})
        moved = float(np.hypot(*(env.model.state()[2, :2] - start)))
        assert moved < away
        assert force > 0 or moved == pytest.approx(DRIFT * 25.0**2 / 2, rel=1e-6)


def test_world_of_many_is_the_single_one() -> None:
    scenario = load(0.3)
    worlds = impact_envs.vector_env(scenario, num_envs=2)
    single = parallel_env(scenario)
    worlds.reset(seed=11)
    single.reset(seed=12)
    rng = np.random.default_rng(0)
    for _ in range(80):
        actions = rng.uniform(-1, 1, (2, 6))
        worlds.step(actions)
        single.step(dict(zip(single.agents, actions[1].reshape(2, 3), strict=True)))
        np.testing.assert_array_equal(worlds.batch.states[1], single.model.state())


def test_expert_throws_and_catches_it_on_an_uneven_floor() -> None:
    scenario = load(0.5)
    expert = make_expert(scenario)
    for seed in (1_000_000, 1_000_001):
        episode = rollout(parallel_env(scenario), expert, seed)
        assert episode.success
        assert episode.robustness > 0.2


def test_only_the_exact_engine_has_it() -> None:
    with pytest.raises(ScenarioError, match=r"objects\.pop\.keep_force = 0\.5: only the exact engine has it"):
        load(0.5).override({"engine": "pymunk"})


def test_an_episode_does_not_feel_the_impact_that_ended_the_last_one() -> None:
    scenario = load(0.3)
    x, y = scenario.objects["pop"].start
    scenario = scenario.override({"robots.snap.start": (x, y - 0.62), "robots.snap.start_velocity": (0.0, 0.5)})
    worlds = impact_envs.vector_env(scenario, num_envs=1, threads=1, max_cycles=5, autoreset_mode="Disabled")
    single = impact_envs.JointEnv(scenario, max_cycles=5)
    for seed in (3, None):
        worlds.reset(seed=seed)
        single.reset(seed=seed)
        for _ in range(5):
            many, *_, infos = worlds.step(np.zeros((1, 6)))
            one, *_ = single.step(np.zeros(6))
            assert np.array_equal(many[0], one)
        assert infos["impacts"].tolist() == [1]

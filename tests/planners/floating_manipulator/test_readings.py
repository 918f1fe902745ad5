"""The floating manipulator's expert acts on what its model predicts where readings cannot be; it counts that."""

from __future__ import annotations

import numpy as np
import pytest

from impact_envs import load_scenario, parallel_env, rollout
from impact_envs.floating_manipulator.observation import make_layout
from impact_envs.floating_manipulator.schema import FloatingManipulatorScenario
from planners.floating_manipulator.expert import FloatingManipulatorExpert

NAME = "floating_manipulator_thrusters"
SEED = 1_000_000


@pytest.fixture(scope="module")
def scenario() -> FloatingManipulatorScenario:
    loaded = load_scenario(NAME)
    assert isinstance(loaded, FloatingManipulatorScenario)
    return loaded


@pytest.fixture(scope="module")
def expert(scenario: FloatingManipulatorScenario) -> FloatingManipulatorExpert:
    return FloatingManipulatorExpert(scenario)


def spoil(scenario: FloatingManipulatorScenario, seen: np.ndarray, k: int) -> np.ndarray:
    """Return what is read instead of an observation: twenty periods of a kind every second."""
    kind, since = divmod(k, 200)
    if not 100 <= since < 120:
        return seen
    at, wrong = make_layout(scenario), seen.copy()
    if kind == 0:
        wrong[:] = np.nan
    elif kind == 1:
        wrong[:] = 0.0
    elif kind == 2:
        wrong[:] = np.inf
    elif kind == 3:
        wrong *= -1.0
    elif kind == 4:
        wrong[at["base"].start] += 3.0
    elif kind == 5:
        wrong[at["joints"].start + 1] = 1e154
    elif kind == 6:
        wrong[at["joint_rates"]] += 4.0
    elif kind == 7:
        wrong[at["box"].start] += 1e3
    elif kind == 8:
        wrong[at["time"]] = -1e3
    elif kind == 9:
        wrong[at["contact"]] = 1.0 if since == 110 else 7.0
    elif kind == 10:
        wrong[at["base"]] = wrong[at["base"]][[1, 0, 3, 2]]
    elif kind in (11, 25):
        wrong[:] = 1e3 * np.random.default_rng(k).standard_normal(len(wrong))
    elif kind == 12:
        wrong[at["base"].start + 2 : at["base"].stop] *= -1.0
    return wrong


class Spoiled:
    """An expert with wrong sensors."""

    name = "spoiled"

    def __init__(self, expert: FloatingManipulatorExpert, scenario: FloatingManipulatorScenario) -> None:
        self.expert, self.scenario = expert, scenario
        self.diagnostics = expert.diagnostics

    def reset(self, seed: int) -> None:
        self.expert.reset(seed)
        self.k = 0

    def act(self, observations: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        read = {name: spoil(self.scenario, seen, self.k) for name, seen in observations.items()}
        self.k += 1
        actions = self.expert.act(read)
        assert all(np.isfinite(action).all() for action in actions.values())
        return actions


def test_impossible_readings_of_every_kind_do_no_harm(
    scenario: FloatingManipulatorScenario, expert: FloatingManipulatorExpert
) -> None:
    episode = rollout(parallel_env(scenario), Spoiled(expert, scenario), SEED)
    assert episode.success
    assert episode.fallbacks["rejected"] > 100
    assert episode.fallbacks["no_measurement"] > 50
    assert "taken_up" not in episode.fallbacks
    assert np.diff(episode.times).min() > 0.0


def test_the_case_that_was_found_gives_numbers(
    scenario: FloatingManipulatorScenario, expert: FloatingManipulatorExpert
) -> None:
    env = parallel_env(scenario)
    seen, _ = env.reset(seed=3)
    expert.reset(3)
    for _ in range(60):
        seen = env.step(expert.act(seen))[0]
    for value in (np.nan, np.inf, -np.inf):
        actions = expert.act({name: np.full_like(vector, value) for name, vector in seen.items()})
        assert all(np.isfinite(action).all() for action in actions.values())
    assert expert.diagnostics().fallbacks["no_measurement"] == 6  # of manipulator and box


def test_a_manipulator_that_is_elsewhere_is_believed_after_a_while(
    scenario: FloatingManipulatorScenario, expert: FloatingManipulatorExpert
) -> None:
    env = parallel_env(scenario)
    seen, _ = env.reset(seed=3)
    expert.reset(3)
    moved, patience = make_layout(scenario)["base"].start, expert.options.readings.patience
    for _ in range(round(patience / scenario.control_period) + 2):
        for vector in seen.values():
            vector[moved] += 0.5
        seen = env.step(expert.act(seen))[0]
    assert expert.diagnostics().fallbacks["taken_up"] == 1


@pytest.mark.parametrize("suite", ["all", "hard"])
def test_right_readings_are_never_rejected(suite: str) -> None:
    world = (
        load_scenario(NAME).suite(suite).override({"horizon": 5.0, "formula": "G[0,5] tip.x >= 0", "requirements": {}})
    )
    episode = rollout(parallel_env(world), FloatingManipulatorExpert(world), SEED)
    assert not {"rejected", "taken_up", "no_measurement"} & set(episode.fallbacks)

"""Objects that spin at the start: every door of the environment begins with the spin, and free flight keeps it."""

from __future__ import annotations

import numpy as np
import pytest

from impact_envs import parallel_env, rollout, vector_env
from impact_envs.errors import ScenarioError
from impact_envs.free_flyer.disc_model import DiscModel
from impact_envs.free_flyer.model import FreeFlyerModel
from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.scenario import load_scenario
from planners import make_expert

RATE = 1.5


@pytest.fixture(scope="module")
def scenario() -> FreeFlyerScenario:
    return load_scenario("throw_and_catch").override({"objects.pop.start_rate": RATE})  # type: ignore[return-value]


@pytest.mark.parametrize("engine", [DiscModel, FreeFlyerModel])
def test_spin_is_kept_in_free_flight(scenario: FreeFlyerScenario, engine: type[DiscModel | FreeFlyerModel]) -> None:
    model = engine(scenario)
    heading, rate = model.state()[2, 4:6]
    assert rate == RATE
    for _ in range(20):
        model.step({name: np.zeros(3) for name in scenario.robots})
    assert model.state()[2, 5] == RATE
    assert model.state()[2, 4] == pytest.approx(heading + 2.0 * RATE, abs=1e-12)
    np.testing.assert_array_equal(model.state()[2, :4], scenario.starts[2, :4])


def test_many_worlds_equal_one_bit_for_bit(scenario: FreeFlyerScenario) -> None:
    single, worlds = parallel_env(scenario), vector_env(scenario, 2)
    single.reset(seed=5)
    worlds.reset(seed=[5, 6])
    rng = np.random.default_rng(0)
    for _ in range(40):
        np.testing.assert_array_equal(worlds.batch.states[0], single.model.state())
        action = rng.uniform(-1.0, 1.0, (2, 3))
        single.step(dict(zip(scenario.agents, action, strict=True)))
        worlds.step(np.stack([action, action]).reshape(worlds.action_space.shape))
    assert worlds.batch.states[0, 2, 5] == RATE


def test_the_expert_throws_a_spinning_disc(scenario: FreeFlyerScenario) -> None:
    episode = rollout(parallel_env(scenario), make_expert(scenario), 0)
    assert episode.success
    assert len(episode.impacts) >= 2
    assert episode.signals["pop.omega"][-1] == pytest.approx(RATE, abs=1e-12)  # no friction, no torque


def test_a_rate_is_a_finite_number_of_an_object() -> None:
    for values in ({"objects.pop.start_rate": float("nan")}, {"robots.snap.start_rate": 1.0}):
        with pytest.raises(ScenarioError, match="start_rate"):
            load_scenario("throw_and_catch").override(values)

"""Bodies that move at the start: every door of the environment begins with the same states."""

import numpy as np
import pytest

from impact_envs import vector_env
from impact_envs.errors import ScenarioError
from impact_envs.free_flyer.disc_model import DiscModel, make_model
from impact_envs.free_flyer.model import FreeFlyerModel
from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.scenario import load_scenario

STARTS = {
    "robots.snap.start_velocity": [0.1, 0.2],
    "robots.crackle.start_velocity": [0.02, -0.05],
    "objects.pop.start_velocity": [-0.05, 0.03],
}
STEPS = 80


@pytest.fixture(scope="module")
def scenario() -> FreeFlyerScenario:
    return load_scenario("throw_and_catch").override(STARTS)  # type: ignore[return-value]


def fly(model: DiscModel | FreeFlyerModel) -> tuple[np.ndarray, int]:
    """Return the states at all steps without thrust, and the number of impacts."""
    states, impacts = [model.state()], 0
    for _ in range(STEPS):
        impacts += len(model.step({name: np.zeros(3) for name in model.scenario.robots}))
        states.append(model.state())
    return np.array(states), impacts


def test_bodies_fly_straight_until_they_meet(scenario: FreeFlyerScenario) -> None:
    states, impacts = fly(DiscModel(scenario))
    np.testing.assert_array_equal(states[0], scenario.starts)
    assert impacts == 1
    free = scenario.starts[:, :2] + 0.1 * np.arange(11)[:, None, None] * scenario.starts[:, 2:4]
    np.testing.assert_allclose(states[:11, :, :2], free, atol=1e-12)
    assert np.abs(states[-1, 0, 2:4] - states[0, 0, 2:4]).max() > 0.01


def test_exact_engine_pymunk_and_many_worlds_agree(scenario: FreeFlyerScenario) -> None:
    exact, impacts = fly(DiscModel(scenario))
    pymunk, others = fly(FreeFlyerModel(scenario))
    assert impacts == others
    np.testing.assert_allclose(exact, pymunk, atol=1e-9)
    worlds = vector_env(scenario, 3)
    worlds.reset(seed=0)
    for step in range(STEPS + 1):
        np.testing.assert_array_equal(worlds.batch.states, np.stack([exact[step]] * 3))
        worlds.step(np.zeros(worlds.action_space.shape))


def test_an_object_that_keeps_its_velocity_keeps_the_one_it_starts_with() -> None:
    values = STARTS | {"objects.pop.keep_force": 0.5, "true.drift": 0.002, "robots.snap.start_velocity": [0.0, 0.0]}
    scenario = load_scenario("throw_and_catch").override(values)
    model = make_model(scenario)  # type: ignore[arg-type]
    model.reset(scenario.draw(np.random.default_rng(0)))  # type: ignore[attr-defined]
    states, impacts = fly(model)
    assert impacts == 0
    straight = states[0, 2, :2] + 0.1 * STEPS * np.array([-0.05, 0.03])
    np.testing.assert_allclose(states[-1, 2, :2], straight, atol=0.02)  # 0.064 m without thrusters


def test_a_velocity_is_two_finite_numbers() -> None:
    with pytest.raises(ScenarioError, match="start_velocity"):
        load_scenario("throw_and_catch").override({"robots.snap.start_velocity": [0.0, float("nan")]})

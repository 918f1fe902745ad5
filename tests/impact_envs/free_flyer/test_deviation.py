"""Deviations of the velocity after impacts: as great as the scenario says, drawn anew, and momentum stays."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from impact_envs import load_scenario, parallel_env, rollout, vector_env
from impact_envs.free_flyer.disc_model import make_model
from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.free_flyer.truth import CORNERS, DEVIATION
from impact_envs.rollout import ZeroPolicy

DELTA, SPEED, PUSH = 0.02, 0.3, "objects.pop.start_velocity"
STILL = {"snap": np.zeros(3), "crackle": np.zeros(3)}


def make_scenario(engine: str = "exact", delta: Any = DELTA, mass: float = 8.4) -> FreeFlyerScenario:
    scenario = load_scenario("throw_and_catch")
    assert isinstance(scenario, FreeFlyerScenario)
    changes = {"engine": engine, "true.impact_deviation": delta, "objects.pop.mass": mass}
    return scenario.override(changes)


def hit(model: Any, turn: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Let snap hit pop head on; return the change of pop's velocity and of the total momentum."""
    states = model.state()
    way = np.array([np.cos(turn), np.sin(turn)])
    states[0, :2], states[0, 2:4] = states[2, :2] - 0.41 * way, SPEED * way
    states[2, 2:4] = 0.0
    model.set_state(states)
    masses = np.array([model.scenario.body(name).mass for name in model.scenario.bodies])
    before = masses @ model.state()[:, 2:4]
    (impact,) = model.step(STILL)
    change = model.state()[2, 2:4]
    np.testing.assert_allclose(impact.impulse, model.scenario.objects["pop"].mass * change, atol=1e-12)
    return change, masses @ model.state()[:, 2:4] - before


@pytest.mark.parametrize("engine", ["exact", "pymunk"])
def test_each_impact_deviates_anew_and_momentum_stays(engine: str) -> None:
    scenario = make_scenario(engine)
    law = 1.8 * 16.8 / (16.8 + 8.4) * SPEED
    found, corners = [], []
    for seed in range(40):
        model = make_model(scenario)
        physics = scenario.draw(np.random.default_rng(seed))
        model.reset(physics)
        for turn in (0.0, 2.0):
            change, momentum = hit(model, turn)
            np.testing.assert_allclose(momentum, 0.0, atol=1e-12)
            found.append(change - law * np.array([np.cos(turn), np.sin(turn)]))
            corners.append(physics.body[2, CORNERS] > 0)
    deviations, at_corners = np.array(found), np.array(corners)
    assert np.abs(deviations).max() <= DELTA * (1 + 1e-9)
    np.testing.assert_allclose(np.abs(deviations[at_corners]), DELTA, rtol=1e-9)
    assert 20 < at_corners.sum() < 60
    assert len(np.unique(deviations[~at_corners].round(9))) > 1.9 * (~at_corners).sum()
    assert np.abs(deviations.mean(axis=0)).max() < 0.3 * DELTA


def test_both_engines_draw_the_same() -> None:
    changes = []
    for engine in ("exact", "pymunk"):
        model = make_model(make_scenario(engine))
        model.reset(model.scenario.draw(np.random.default_rng(3)))
        changes.append([hit(model, turn)[0] for turn in (0.0, 1.0, 2.0)])
    np.testing.assert_allclose(*changes, atol=1e-9)


def test_the_numbers_of_an_impact_are_independent_and_uniform() -> None:
    scenario = make_scenario()
    found = []
    for seed in range(400):
        model = make_model(scenario)
        physics = scenario.draw(np.random.default_rng(seed))
        physics.body[2, CORNERS] = 0.0
        model.reset(physics)
        law = hit_law(model)
        found.append(np.concatenate([hit(model)[0] - law, hit(model)[0] - law]) / DELTA)
    shares = np.array(found)
    assert np.abs(shares.mean(axis=0)).max() < 0.12
    assert np.abs(shares.std(axis=0) - 3**-0.5).max() < 0.06
    assert np.abs(np.corrcoef(shares.T) - np.eye(4)).max() < 0.18


def hit_law(model: Any) -> np.ndarray:
    robot, item = model.scenario.robots["snap"].mass, model.scenario.objects["pop"].mass
    return np.array([1.8 * robot / (robot + item) * SPEED, 0.0])


def test_only_robots_and_objects_deviate() -> None:
    """A wall throws the object back as the law says, whatever impacts of robots do."""
    scenario = make_scenario().override({"objects.pop.start_velocity": [0.3, 0.0], "objects.pop.start": [1.5, 1.5]})
    model = make_model(scenario)
    model.reset(scenario.draw(np.random.default_rng(1)))
    while not (impacts := model.step(STILL)):
        pass
    assert {impacts[0].a, impacts[0].b} == {"pop", "wall_right"} or "pop" in (impacts[0].a, impacts[0].b)
    np.testing.assert_allclose(model.state()[2, 2:4], [-0.24, 0.0], atol=1e-12)


def test_unset_it_draws_and_changes_nothing() -> None:
    scenario = load_scenario("throw_and_catch")
    assert make_scenario().draw_count == scenario.draw_count + 2
    physics = scenario.draw(np.random.default_rng(0))
    assert not physics.body[:, DEVIATION].any()


def test_sizes_are_drawn_per_world_and_a_batch_has_the_same() -> None:
    scenario = make_scenario(delta={"uniform": [0.0, DELTA]})
    sizes = [scenario.draw(np.random.default_rng(seed)).body[2, DEVIATION] for seed in range(50)]
    assert 0.0 < min(sizes) < 0.2 * DELTA < 0.8 * DELTA < max(sizes) < DELTA
    # The object flies into a robot at rest: three single worlds and a batch of them.
    moving = scenario.override({PUSH: [-0.11, 0.385]}).shorten(0.3)
    envs = vector_env(moving, num_envs=3)
    joint, _ = envs.reset(seed=5)
    for _ in range(moving.steps):
        joint, *_ = envs.step(np.zeros((3, 6)))
    singles = [rollout(env := parallel_env(moving), ZeroPolicy(env), 5 + k) for k in range(3)]
    assert all(episode.impacts for episode in singles)
    pop = parallel_env(moving).task.joint_layout["pop"].start
    ends = [[episode.signals[f"pop.{key}"][-1] for key in ("x", "y", "vx", "vy")] for episode in singles]
    np.testing.assert_array_equal(joint[:, pop : pop + 4], ends)
    assert len(np.unique(np.array(ends)[:, 2])) == 3  # each with its own deviation

"""True worlds of a batch are those of the single environment, and a draw is what the scenario says."""

import math

import numpy as np
import pytest

from impact_envs import list_scenarios, load_scenario
from impact_envs.free_flyer.schema import DrawnPhysics
from impact_envs.stream import draw_doubles, make_stream, seed_streams

EVERYTHING = {
    "true.restitution": {"uniform": [0.3, 0.9]},
    "true.restitution_speed": {"uniform": [0.1, 0.9]},
    "true.friction": {"uniform": [0.0, 0.3]},
    "true.robot_mass_scale": {"uniform": [0.8, 1.2]},
    "true.object_mass_scale": {"uniform": [0.7, 1.3]},
    "true.center_of_mass_offset": {"uniform": [0.0, 0.03]},
    "true.drift": {"uniform": [0.0, 1e-3]},
    "true.thruster_gain": {"uniform": [0.8, 1.1]},
    "true.weak_thruster": {"uniform": [0.3, 0.7]},
}
PLANAR = [name for name in list_scenarios() if load_scenario(name).domain == "free_flyer"]


def draw_rows(scenario, seeds):
    """Draw one world per seed; return them and the streams."""
    streams = seed_streams(seeds)
    uniforms = draw_doubles(streams, np.arange(len(seeds)), scenario.draw_count)
    return scenario.draw_many(uniforms), streams


def as_row(scenario, physics):
    """Return one world's physics as a row of DrawnPhysics."""
    bodies, zero = scenario.bodies, np.zeros(2)
    return DrawnPhysics(
        physics.restitution,
        physics.restitution_speed,
        physics.friction,
        [physics.masses[name] for name in bodies],
        [physics.inertias[name] for name in bodies],
        [physics.center_of_mass[name] for name in bodies],
        [physics.drift.get(name, zero) for name in bodies],
        [physics.thruster_gain[name] for name in scenario.robots],
    )


@pytest.mark.parametrize("name", PLANAR)
def test_world_of_a_batch_is_the_single_one(name):
    scenario = load_scenario(name)
    for world in [scenario.suite(suite) for suite in ("nominal", "all", "hard")] + [scenario.override(EVERYTHING)]:
        drawn, streams = draw_rows(world, range(20))
        for seed in range(20):
            rng = np.random.default_rng(seed)
            row = as_row(world, world.draw(rng))
            for field, many, one in zip(DrawnPhysics._fields, drawn, row, strict=True):
                assert np.array_equal(many[seed], one), (field, seed)
            assert np.array_equal(streams[seed], make_stream(rng))


def test_worlds_do_not_depend_on_the_batch():
    scenario = load_scenario("crew").override(EVERYTHING)
    uniforms = draw_doubles(seed_streams(range(1000)), np.arange(1000), scenario.draw_count)
    drawn = scenario.draw_many(uniforms)
    for k in range(0, 1000, 7):
        alone = scenario.draw_many(uniforms[k : k + 1])
        assert all(np.array_equal(many[k], one[0]) for many, one in zip(drawn, alone, strict=True)), k


def test_order_of_draws():
    scenario = load_scenario("throw_and_catch").override(EVERYTHING)
    for seed in range(50):
        physics, rng = scenario.draw(np.random.default_rng(seed)), np.random.default_rng(seed)
        assert physics.restitution == rng.uniform(0.3, 0.9)
        assert physics.friction == rng.uniform(0.0, 0.3)
        for name in scenario.bodies:
            scale = rng.uniform(0.8, 1.2) if name in scenario.robots else rng.uniform(0.7, 1.3)
            assert physics.masses[name] == scenario.body(name).mass * scale
            assert physics.inertias[name] == scenario.body(name).inertia * scale
        assert physics.restitution_speed == rng.uniform(0.1, 0.9)
        for vectors, limit in ((physics.center_of_mass, 0.03), (physics.drift, 1e-3)):
            for name in scenario.objects:
                length, angle = rng.uniform(0.0, limit), rng.uniform(0.0, 2 * math.pi)
                assert vectors[name] == pytest.approx([length * math.cos(angle), length * math.sin(angle)], rel=1e-15)
        gains = {name: rng.uniform(0.8, 1.1) for name in scenario.robots}
        weakest, which = rng.uniform(0.3, 0.7), (rng.random(3) * [len(gains), 2, 2]).astype(int)
        for i, (name, gain) in enumerate(gains.items()):
            expected = np.full((3, 2), gain)
            if i == which[0]:
                expected[which[1], which[2]] *= weakest
            assert np.array_equal(physics.thruster_gain[name], expected)


def test_count_of_draws():
    scenario = load_scenario("throw_and_catch")  # one object
    assert scenario.draw_count == 2 + 3
    assert scenario.suite("restitution").draw_count == 6
    assert scenario.suite("actuation").draw_count == 5 + len(scenario.robots)


def test_one_force_of_one_robot_is_weak():
    scenario = load_scenario("crew").override({"true.weak_thruster": 0.5})
    gains = draw_rows(scenario, range(4000))[0].thruster_gain
    assert np.array_equal(np.sum(gains == 0.5, axis=(1, 2, 3)), np.ones(4000))
    counts = np.sum(gains == 0.5, axis=0)
    assert not np.any(counts[:, 2])  # never the torque
    expected = 4000 / (len(scenario.robots) * 4)
    assert np.all(np.abs(counts[:, :2] - expected) < 5 * np.sqrt(expected))


def test_robots_neither_drift_nor_lean():
    drawn, _ = draw_rows(load_scenario("crew").override(EVERYTHING), range(100))
    robots = drawn.thruster_gain.shape[1]
    for vectors in (drawn.center_of_mass, drawn.drift):
        assert not np.any(vectors[:, :robots])
        assert np.all(np.any(vectors[:, robots:], axis=2))

"""True worlds of a batch are those of the single environment, and a draw is what the scenario says."""

import math

import numpy as np
import pytest

from impact_envs import InputError, ScenarioError, list_scenarios, load_scenario, parallel_env, vector_env
from impact_envs.free_flyer.truth import (
    DRIFT_X,
    DRIFT_Y,
    FADE,
    FRICTION,
    INERTIA,
    MASS,
    OFFSET_X,
    OFFSET_Y,
    RESTITUTION,
    RESTITUTION_SPEED,
    START_X,
    START_Y,
    TURN,
)
from impact_envs.stream import draw_doubles, seed_streams

TABLES = ("contact", "body", "thruster", "sensor")

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
    "true.drift_turn": {"uniform": [-0.1, 0.1]},
    "true.thruster_fade": {"uniform": [0.2, 0.8]},
    "true.delay_steps": {"uniform": [1, 4]},
    "true.dropout_rate": {"uniform": [0.0, 0.1]},
}
PLANAR = [name for name in list_scenarios() if load_scenario(name).domain == "free_flyer"]


def draw_rows(scenario, seeds):
    """Draw one world per seed; return them and the streams."""
    streams = seed_streams(seeds)
    uniforms = draw_doubles(streams, np.arange(len(seeds)), scenario.draw_count)
    return scenario.draw_many(uniforms), streams


@pytest.mark.parametrize("name", PLANAR)
def test_world_of_a_batch_is_the_single_one(name):
    scenario = load_scenario(name)
    for world in [scenario.suite(suite) for suite in ("nominal", "all", "hard")] + [scenario.override(EVERYTHING)]:
        drawn, streams = draw_rows(world, range(20))
        for seed in range(20):
            rng = np.random.default_rng(seed)
            one = world.draw(rng)
            for field in TABLES:
                assert np.array_equal(getattr(drawn, field)[seed], getattr(one, field)), (field, seed)
            assert draw_doubles(streams, np.array([seed]), 1) == rng.random()


def test_worlds_do_not_depend_on_the_batch():
    scenario = load_scenario("crew").override(EVERYTHING)
    uniforms = draw_doubles(seed_streams(range(1000)), np.arange(1000), scenario.draw_count)
    drawn = scenario.draw_many(uniforms)
    for k in range(0, 1000, 7):
        alone = scenario.draw_many(uniforms[k : k + 1])
        assert all(np.array_equal(getattr(drawn, field)[k], getattr(alone, field)[0]) for field in TABLES), k


def test_order_of_draws():
    scenario = load_scenario("throw_and_catch").override(EVERYTHING)
    for seed in range(50):
        physics, rng = scenario.draw(np.random.default_rng(seed)), np.random.default_rng(seed)
        bodies = dict(zip(scenario.bodies, physics.body, strict=True))
        assert physics.contact[RESTITUTION] == rng.uniform(0.3, 0.9)
        assert physics.contact[FRICTION] == rng.uniform(0.0, 0.3)
        for name, row in bodies.items():
            scale = rng.uniform(0.8, 1.2) if name in scenario.robots else rng.uniform(0.7, 1.3)
            assert row[MASS] == scenario.body(name).mass * scale
            assert row[INERTIA] == scenario.body(name).inertia * scale
        assert physics.contact[RESTITUTION_SPEED] == rng.uniform(0.1, 0.9)
        for columns, limit in (([OFFSET_X, OFFSET_Y], 0.03), ([DRIFT_X, DRIFT_Y], 1e-3)):
            for name in scenario.objects:
                length, angle = rng.uniform(0.0, limit), rng.uniform(0.0, 2 * math.pi)
                expected = [length * math.cos(angle), length * math.sin(angle)]
                assert bodies[name][columns] == pytest.approx(expected, rel=1e-15)
        gains = {name: rng.uniform(0.8, 1.1) for name in scenario.robots}
        weakest, which = rng.uniform(0.3, 0.7), (rng.random(3) * [len(gains), 2, 2]).astype(int)
        for i, gain in enumerate(gains.values()):
            expected = np.full((3, 2), gain)
            if i == which[0]:
                expected[which[1], which[2]] *= weakest
            assert np.array_equal(physics.thruster[i, :FADE], expected.ravel())
        for name in scenario.objects:
            assert bodies[name][TURN] == -0.1 + 0.2 * rng.random()
        for i in range(len(gains)):
            lost, which = rng.uniform(0.2, 0.8), (2 * rng.random(2)).astype(int)
            expected = np.zeros((3, 2))
            expected[which[0], which[1]] = lost / scenario.horizon
            assert np.array_equal(physics.thruster[i, FADE:], expected.ravel())
        assert physics.sensor[0] == 1 + math.floor(4 * rng.random())
        assert physics.sensor[1] == rng.uniform(0.0, 0.1)


def test_count_of_draws():
    scenario = load_scenario("throw_and_catch")  # one object
    assert scenario.draw_count == 2 + 3
    assert scenario.suite("restitution").draw_count == 6
    assert scenario.suite("actuation").draw_count == 5 + len(scenario.robots)


def test_one_force_of_one_robot_is_weak():
    scenario = load_scenario("crew").override({"true.weak_thruster": 0.5})
    gains = draw_rows(scenario, range(4000))[0].thruster[:, :, :FADE].reshape(4000, -1, 3, 2)
    assert np.array_equal(np.sum(gains == 0.5, axis=(1, 2, 3)), np.ones(4000))
    counts = np.sum(gains == 0.5, axis=0)
    assert not np.any(counts[:, 2])  # never the torque
    expected = 4000 / (len(scenario.robots) * 4)
    assert np.all(np.abs(counts[:, :2] - expected) < 5 * np.sqrt(expected))


def test_every_delay_is_equally_likely():
    scenario = load_scenario("throw_and_catch").override({"true.delay_steps": {"uniform": [1, 4]}})
    delays = draw_rows(scenario, range(4000))[0].sensor[:, 0]
    assert np.all(np.abs([np.sum(delays == steps) for steps in (1, 2, 3, 4)] - np.full(4, 1000)) < 5 * math.sqrt(1000))
    largest = scenario.draw_many(np.full((1, scenario.draw_count), 1 - 2**-53))
    assert largest.sensor[0, 0] == 4


@pytest.mark.parametrize("delay", [{"uniform": [1, 2.5]}, {"uniform": [0, 51]}, 51, -1, 1.5])
def test_delays_are_whole_numbers_of_periods(delay):
    with pytest.raises(InputError, match="delay_steps"):
        load_scenario("throw_and_catch").override({"true.delay_steps": delay})


def test_one_thruster_of_every_robot_fades():
    scenario = load_scenario("crew").override({"true.thruster_fade": 0.5})
    fades = draw_rows(scenario, range(400))[0].thruster[:, :, FADE:].reshape(400, -1, 3, 2)
    assert np.array_equal(np.sum(fades == 0.5 / scenario.horizon, axis=(2, 3)), np.ones(fades.shape[:2]))
    assert not np.any(fades[:, :, 2])  # never the torque


def test_robots_neither_drift_nor_lean():
    drawn, _ = draw_rows(load_scenario("crew").override(EVERYTHING), range(100))
    robots = drawn.thruster.shape[1]
    for vectors in (drawn.body[:, :, OFFSET_X : OFFSET_Y + 1], drawn.body[:, :, DRIFT_X : DRIFT_Y + 1]):
        assert not np.any(vectors[:, :robots])
        assert np.all(np.any(vectors[:, robots:], axis=2))


SPREAD = {"objects.pop.start_uncertainty": [0.1, 0.05], "true.start_spread": 1.0}


def test_an_object_starts_anywhere_in_its_box():
    scenario = load_scenario("throw_and_catch").override(SPREAD)
    starts = draw_rows(scenario, range(2000))[0].body[:, :, START_X : START_Y + 1]
    robots = len(scenario.robots)
    assert not np.any(starts[:, :robots])
    sides = starts[:, robots] / [0.1, 0.05]
    assert np.all(np.abs(sides) <= 1.0)
    assert np.all(np.abs(sides.mean(axis=0)) < 0.05)
    assert np.all(np.abs(sides.std(axis=0) - 1 / math.sqrt(3)) < 0.03)
    assert abs(np.corrcoef(sides.T)[0, 1]) < 0.08
    half = draw_rows(scenario.override({"true.start_spread": 0.5}), range(10))[0].body[
        :, robots:, START_X : START_Y + 1
    ]
    np.testing.assert_allclose(half[:, 0], starts[:10, robots] / 2, rtol=1e-12)


def test_every_body_may_start_beside_where_it_is_believed():
    ranges = {f"true.{kind}_start_{axis}": {"uniform": [-0.05, 0.1]} for kind in ("robot", "object") for axis in "xy"}
    scenario = load_scenario("throw_and_catch").override(ranges)
    starts = draw_rows(scenario, range(500))[0].body[:, :, START_X : START_Y + 1]
    assert np.all((starts >= -0.05) & (starts <= 0.1))
    assert np.all(np.abs(starts.mean(axis=0) - 0.025) < 0.01)
    np.testing.assert_array_equal(
        scenario.place_bodies(scenario.draw(np.random.default_rng(0)))[:, 2:], scenario.starts[:, 2:]
    )


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"true.robot_start_x": 30.0}, "true.robot_start_x, true.robot_start_y: snap could start outside"),
        ({"true.object_start_y": {"uniform": [-2.1, 0.0]}}, "pop could start outside"),
        ({"true.object_start_y": {"uniform": [-0.8, 0.0]}, "true.object_start_x": -0.4}, "could start in"),
    ],
)
def test_starts_inside_of_something_else_are_refused(values, words):
    with pytest.raises(ScenarioError, match=words):
        load_scenario("throw_and_catch").override(values)


def test_what_is_not_asked_for_draws_nothing():
    """Worlds of earlier versions are the same: new draws come last, and only where asked for."""
    scenario = load_scenario("throw_and_catch").suite("all")
    new = ("true.drift_turn", "true.thruster_fade", "true.delay_steps", "true.dropout_rate")
    more = scenario.override({name: EVERYTHING[name] for name in new})
    assert more.draw_count == scenario.draw_count + 1 + 3 * len(scenario.robots) + 2
    uniforms = np.random.default_rng(0).random((5, more.draw_count))
    old, drawn = scenario.draw_many(uniforms[:, : scenario.draw_count]), more.draw_many(uniforms)
    assert np.array_equal(drawn.contact, old.contact)
    assert np.array_equal(drawn.body[:, :, :TURN], old.body[:, :, :TURN])
    assert np.array_equal(drawn.thruster[:, :, :FADE], old.thruster[:, :, :FADE])


def test_without_a_spread_nothing_more_is_drawn():
    scenario = load_scenario("throw_and_catch")
    uncertain = scenario.override({"objects.pop.start_uncertainty": [0.1, 0.05]})
    assert uncertain.draw_count == scenario.draw_count
    assert uncertain.override({"true.start_spread": 1.0}).draw_count == scenario.draw_count + 2


@pytest.mark.parametrize("more", [{}, {"true.center_of_mass_offset": 0.03}, {"objects.pop.keep_force": 0.5}])
def test_a_world_that_starts_elsewhere_is_one_of_many(more):
    scenario = load_scenario("throw_and_catch").override(SPREAD | more)
    env, envs = parallel_env(scenario), vector_env(scenario, num_envs=3)
    joint, _ = envs.reset(seed=7)
    for k in range(3):
        env.reset(seed=7 + k)
        place = env.signals["pop.x"], env.signals["pop.y"]
        assert place != scenario.objects["pop"].start
        assert np.abs(np.subtract(place, scenario.objects["pop"].start) / [0.1, 0.05]).max() <= 1.0
        assert set(place) <= set(joint[k].tolist())


@pytest.mark.parametrize(
    ("box", "message"), [([3.0, 0.0], "outside the world"), ([0.9, 0.9], r"pop could start in (snap|crackle)")]
)
def test_a_box_that_reaches_into_others_is_refused(box, message):
    with pytest.raises(InputError, match=message):
        load_scenario("throw_and_catch").override(SPREAD | {"objects.pop.start_uncertainty": box})

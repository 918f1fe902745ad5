"""Sensors of many worlds are those of one, and do what the scenario says."""

import numpy as np
import pytest

from impact_envs import load_scenario
from impact_envs.compiled import retarget
from impact_envs.free_flyer.observation import (
    Sensors,
    join_observations,
    make_joint_layout,
    make_layout,
    observed_order,
)
from impact_envs.free_flyer.sensing import (
    VELOCITY_WINDOW,
    Sensing,
    compute_memory_size,
    count_uniforms,
    take_sample,
    write_agent_observation,
    write_joint_observation,
)
from impact_envs.free_flyer.truth import DROPOUT
from impact_envs.stream import draw_doubles, seed_streams

SCENARIO = load_scenario("crew")
CONJUNCTS = 4  # of its formula
BODIES, ROBOTS = len(SCENARIO.bodies), len(SCENARIO.robots)
PERIOD = SCENARIO.control_period
NOISY = Sensing(PERIOD, 0.005, False, 3)


def observe(sensing, states, contacts, uniforms=None, memory=None, take=take_sample, sensors=None):
    """Take all samples of worlds with states (steps, worlds, bodies, 6); return what they measured and felt."""
    steps, worlds = states.shape[:2]
    sensors = np.tile([sensing.delay_steps, 0.0], (worlds, 1)) if sensors is None else sensors
    if memory is None:
        memory = np.zeros((worlds, compute_memory_size(sensing, BODIES, ROBOTS)))
    measured, felt = np.full_like(states, np.nan), np.full_like(contacts, np.nan)
    uniforms = np.zeros((steps, worlds, 0)) if uniforms is None else uniforms
    for t in range(steps):
        for k in range(worlds):
            take(sensing, k, t, states[t], contacts[t], sensors, uniforms[t], memory, measured[t], felt[t])
    return measured, felt


def make_motion(steps, worlds, seed=0):
    rng = np.random.default_rng(seed)
    states = np.cumsum(rng.normal(size=(steps, worlds, BODIES, 6)), axis=0)
    return states, rng.integers(0, 2, (steps, worlds, ROBOTS)).astype(float)


@pytest.mark.parametrize("noise", [0.0, 0.005])
@pytest.mark.parametrize("velocity_measured", [True, False])
@pytest.mark.parametrize("delay", [0, 1, 3, 20])
@pytest.mark.parametrize("lost_steps", [0, 4])
def test_worlds_that_started_at_different_times_are_single_worlds(noise, velocity_measured, delay, lost_steps):
    worlds, steps = 9, 80
    sensing = Sensing(PERIOD, noise, velocity_measured, delay, lost_steps)
    true = {"position_noise": noise, "velocity_measured": velocity_measured, "delay_steps": delay}
    true |= {"dropout_rate": 0.5, "dropout_seconds": lost_steps * PERIOD} if lost_steps else {}
    scenario = SCENARIO.override({f"true.{name}": value for name, value in true.items()})
    drawn = scenario.draw(np.random.default_rng(0))
    # Worlds differ in their delay; the line holds the longest one.
    sensors = np.array([(k % (delay + 1), drawn.sensor[DROPOUT]) for k in range(worlds)])
    physics = [drawn._replace(sensor=row) for row in sensors]
    states, contacts = make_motion(steps, worlds)
    streams, rngs = seed_streams(range(worlds)), [np.random.default_rng(seed) for seed in range(worlds)]
    singles = [Sensors(SCENARIO) for _ in range(worlds)]
    memory = np.full((worlds, compute_memory_size(sensing, BODIES, ROBOTS)), np.nan)
    measured, felt = np.empty((worlds, BODIES, 6)), np.empty((worlds, ROBOTS))
    samples = np.zeros(worlds, dtype=int)
    for t in range(steps):
        uniforms = draw_doubles(streams, np.arange(worlds), count_uniforms(sensing, BODIES))
        for k in range(worlds):
            if t % (11 + 5 * k) == 0:  # a new episode; its generator goes on
                singles[k].reset(physics[k], rngs[k])
                samples[k] = 0
            take_sample(sensing, k, samples[k], states[t], contacts[t], sensors, uniforms, memory, measured, felt)
            samples[k] += 1
            state, contact = singles[k].measure(states[t, k], contacts[t, k])
            assert np.array_equal(measured[k], state)
            assert np.array_equal(felt[k], contact)


def test_ideal_sensors_tell_the_truth_and_remember_nothing():
    sensing = Sensing(PERIOD, 0.0, True, 0)
    assert compute_memory_size(sensing, BODIES, ROBOTS) == 0
    states, contacts = make_motion(20, 3)
    measured, felt = observe(sensing, states, contacts)
    assert np.array_equal(measured, states)
    assert np.array_equal(felt, contacts)


@pytest.mark.parametrize("delay", [1, 2, 7])
def test_delayed_samples_are_old_ones_and_the_first_until_then(delay):
    states, contacts = make_motion(30, 2)
    measured, felt = observe(Sensing(PERIOD, 0.0, True, delay), states, contacts)
    seen = np.maximum(np.arange(30) - delay, 0)
    assert np.array_equal(measured, states[seen])
    assert np.array_equal(felt, contacts[seen])


def test_every_world_has_its_own_delay():
    states, contacts = make_motion(30, 5)
    delays = np.array([0, 1, 2, 4, 4])
    sensors = np.stack([delays, np.zeros(5)], axis=1)
    measured, felt = observe(Sensing(PERIOD, 0.0, True, 4), states, contacts, sensors=sensors)
    for k, delay in enumerate(delays):
        seen = np.maximum(np.arange(30) - delay, 0)
        assert np.array_equal(measured[:, k], states[seen, k])
        assert np.array_equal(felt[:, k], contacts[seen, k])


@pytest.mark.parametrize("delay", [0, 3])
def test_a_loss_repeats_what_arrived_last_for_its_time(delay):
    steps, lost = 40, 10
    states, contacts = make_motion(steps, 1)
    uniforms = np.ones((steps, 1, 1))
    uniforms[[0, 7, 9], 0, 0] = 0.0  # the first sample always arrives, and no loss begins while one goes on
    sensors, sensing = np.array([[delay, 0.05]]), Sensing(PERIOD, 0.0, True, delay, lost)
    measured, felt = observe(sensing, states, contacts, uniforms, sensors=sensors)
    seen = np.maximum(np.arange(steps) - delay, 0)
    assert np.array_equal(felt, contacts[seen])  # robots feel for themselves
    seen[7 : 7 + lost] = seen[6]
    assert np.array_equal(measured, states[seen])


def test_losses_begin_as_often_as_said():
    steps, rate = 20000, 0.5
    scenario = SCENARIO.override({"true.dropout_rate": rate, "true.dropout_seconds": 2 * PERIOD})
    sensors, rng = Sensors(scenario), np.random.default_rng(6)
    sensors.reset(scenario.draw(rng), rng)
    clock = np.zeros((BODIES, 6))
    seen = []
    for t in range(steps):
        clock[:, 0] = t
        seen.append(sensors.measure(clock, np.zeros(ROBOTS))[0][0, 0])
    repeated = np.diff(seen) == 0
    begun = np.sum(repeated[1:] & ~repeated[:-1])
    # Between losses, one begins with probability rate PERIOD; two in a row count as one, to second order.
    p = rate * PERIOD
    assert np.sum(repeated) == pytest.approx(steps * 2 * p / (1 + 2 * p), rel=0.1)
    assert begun <= np.sum(repeated) / 2


def test_velocity_is_the_difference_to_the_start_of_the_window():
    states, contacts = make_motion(50, 2)
    measured, _ = observe(Sensing(PERIOD, 0.0, False, 0), states, contacts)
    assert not np.any(measured[0, :, :, 2:4])
    for t in range(1, 50):
        periods = min(t, VELOCITY_WINDOW)
        difference = states[t, :, :, :2] - states[t - periods, :, :, :2]
        assert np.array_equal(measured[t, :, :, 2:4], difference / (periods * PERIOD))
    assert np.array_equal(np.delete(measured, [2, 3], axis=-1), np.delete(states, [2, 3], axis=-1))


def test_noise_is_part_of_the_sample_that_is_delayed():
    states, contacts = make_motion(40, 4)
    uniforms = np.random.default_rng(1).random((40, 4, 2 * BODIES))
    prompt, _ = observe(NOISY._replace(delay_steps=0), states, contacts, uniforms)
    late, _ = observe(NOISY, states, contacts, uniforms)
    assert np.array_equal(late, prompt[np.maximum(np.arange(40) - 3, 0)])


def test_noise_has_the_given_deviation_in_each_axis():
    steps, worlds = 100, 40
    states, contacts = make_motion(steps, worlds)
    streams = seed_streams(range(worlds))
    uniforms = np.array([draw_doubles(streams, np.arange(worlds), 2 * BODIES) for _ in range(steps)])
    sensing = Sensing(PERIOD, 0.005, True, 0)
    error = (observe(sensing, states, contacts, uniforms)[0] - states) / sensing.noise
    assert np.all(np.abs(error[..., 2:]) == 0)
    z = error[..., :2].reshape(steps * worlds, -1)
    n = len(z)
    # Five standard errors.
    assert np.all(np.abs(z.mean(axis=0)) < 5 / np.sqrt(n))
    assert np.all(np.abs(z.var(axis=0) - 1) < 5 * np.sqrt(2 / n))
    correlation = np.corrcoef(z.T) - np.eye(z.shape[1])
    assert np.max(np.abs(correlation)) < 5 / np.sqrt(n)


def test_an_episode_does_not_remember_the_last_one():
    states, contacts = make_motion(40, 2)
    uniforms = np.random.default_rng(2).random((40, 2, 2 * BODIES))
    size = (2, compute_memory_size(NOISY, BODIES, ROBOTS))
    fresh = observe(NOISY, states, contacts, uniforms)
    used = observe(NOISY, states, contacts, uniforms, np.full(size, np.nan))
    assert all(np.array_equal(a, b) for a, b in zip(fresh, used, strict=True))


def test_uncompiled_is_the_same():
    states, contacts = make_motion(40, 2)
    uniforms = np.random.default_rng(3).random((40, 2, 2 * BODIES))
    plain = retarget(take_sample, lambda function: function)
    compiled = observe(NOISY, states, contacts, uniforms)
    reference = observe(NOISY, states, contacts, uniforms, take=plain)
    assert np.allclose(compiled[0], reference[0], rtol=1e-14, atol=1e-14)
    assert np.array_equal(compiled[1], reference[1])


def make_observations(states, contacts, fraction, low, high):
    """Return the joint observations and all robots' observations of worlds (worlds, bodies, 6)."""
    worlds = len(states)
    joint = np.full((worlds, make_joint_layout(SCENARIO).size), np.nan)
    own = np.full((worlds, ROBOTS, make_layout(SCENARIO, SCENARIO.agents[0]).size), np.nan)
    for k in range(worlds):
        write_joint_observation(k, states, contacts, fraction, np.tile([low, high], (worlds, CONJUNCTS)), joint)
        for agent in range(ROBOTS):
            write_agent_observation(k, agent, BODIES, joint, own)
    return joint, own


def test_layout_of_the_observations():
    states, contacts = (rows[0] for rows in make_motion(1, 3))
    joint, own = make_observations(states, contacts, 0.25, -1.5, 2.5)
    x, y, vx, vy, heading, omega = np.moveaxis(states, 2, 0)
    blocks = np.stack([x, y, vx, vy, np.cos(heading), np.sin(heading), omega], axis=2)
    tail = np.tile([0.25, *[-1.5, 2.5] * CONJUNCTS], (3, 1))
    assert np.allclose(joint, np.hstack([blocks.reshape(3, -1), contacts, tail]), rtol=0, atol=1e-15)
    for agent, name in enumerate(SCENARIO.agents):
        order = [SCENARIO.bodies.index(body) for body in observed_order(SCENARIO, name)]
        expected = np.hstack([blocks[:, order].reshape(3, -1), contacts[:, [agent]], tail])
        assert np.allclose(own[:, agent], expected, rtol=0, atol=1e-15)


def test_fields_stand_where_the_layouts_say():
    states, contacts = (rows[0] for rows in make_motion(1, 1, seed=5))
    (joint,), (own,) = make_observations(states, contacts, 0.25, -1.5, 2.5)
    blocks = [(joint, make_joint_layout(SCENARIO), contacts[0])]
    blocks += [(own[i], make_layout(SCENARIO, name), contacts[0, i]) for i, name in enumerate(SCENARIO.agents)]
    for vector, layout, felt in blocks:
        assert layout.size == len(vector)
        for name, state in zip(SCENARIO.bodies, states[0], strict=True):
            assert np.array_equal(vector[layout[name]][[0, 1, 2, 3, 6]], state[[0, 1, 2, 3, 5]])
        assert np.all(vector[layout["contact"]] == felt)
        assert vector[layout["time"]].tolist() == [0.25]
        assert vector[layout["robustness"]].tolist() == [-1.5, 2.5] * CONJUNCTS


def test_robots_together_observe_what_is_measured_once():
    states, contacts = (rows[0] for rows in make_motion(1, 1, seed=4))
    joint, own = make_observations(states, contacts, 0.5, 0.0, 1.0)
    joined = np.full_like(joint[0], np.nan)
    join_observations(SCENARIO, dict(zip(SCENARIO.agents, own[0], strict=True)), joined)
    assert np.array_equal(joined, joint[0])

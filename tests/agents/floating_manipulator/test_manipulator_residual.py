"""A floating manipulator's residual starts at its expert, asks while the tip is under way, and is bounded."""

import math
from pathlib import Path

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import agents
from agents.residual import ResidualEnv, ResidualPolicy
from impact_envs import list_scenarios, load_scenario, parallel_env, rollout
from impact_envs.errors import InputError
from impact_envs.floating_manipulator.observation import Measurement
from planners import make_expert
from tests.planners.floating_manipulator.oracle.output_regulator import OutputRegulator

# Two seconds, with the box so near that the tip hits it in the first.
SOON = {
    "horizon": 2.0,
    "formula": "F[0,2] distance(tip, target) <= 5",
    "requirements": {},
    "box.start": [6.98, 1.5],
    "safety_pause": 0.5,
}
NAMES = [name for name in list_scenarios() if load_scenario(name).domain == "floating_manipulator"]
SHIPPED = sorted((Path(agents.__file__).parent / "checkpoints").glob("floating_manipulator*"))


def soon(name="floating_manipulator_thrusters"):
    return load_scenario(name).override(SOON)


def at_rest(scenario, time=0.0, contact=False, q=None):
    q = scenario.start if q is None else q
    return Measurement(time, q, np.zeros(len(q)), contact, np.array([*scenario.box.start, 0.0, 0.0, 0.0, 0.0]))


@pytest.mark.parametrize("name", NAMES)
def test_zero_is_the_expert_bit_for_bit_and_one_is_not(name):
    scenario, asked = soon(name), []
    env = parallel_env(scenario)
    plain = rollout(env, make_expert(scenario), 3)

    def corrected(value):
        policy = ResidualPolicy(make_expert(scenario), lambda f: asked.append(f) or np.full(5, value))
        return rollout(env, policy, 3)

    assert len(plain.impacts) >= 1
    zero = corrected(0.0)
    assert len(asked) >= 2
    assert all(zero.signals[key].tobytes() == values.tobytes() for key, values in plain.signals.items())
    assert np.abs(corrected(1.0).signals["tip.x"] - plain.signals["tip.x"]).max() > 1e-3


def test_a_correction_is_awaited_every_three_seconds_but_not_in_a_pause_nor_near_the_goal():
    scenario = load_scenario("floating_manipulator_thrusters")
    expert, asked = make_expert(scenario), []
    env = parallel_env(scenario)

    class Asking:
        name, reset, diagnostics = "asking", expert.reset, expert.diagnostics

        def act(self, observations):
            expert.observe(observations)
            if expert.awaiting_correction:
                asked.append((env.time, expert.phase, math.hypot(*expert.features()[4:6])))
            return expert.control()

    rollout(env, Asking(), 0)
    times, phases, distances = zip(*asked, strict=True)
    assert 4 <= len(asked) <= 10
    assert set(phases) == {"before", "after"}
    assert min(distances) > 0.1
    assert np.diff(times).min() > 3.0 - 1e-6


def test_torques_are_added_and_weights_scaled_within_their_bounds():
    scenario = load_scenario("floating_manipulator_thrusters")
    plain, corrected = make_expert(scenario), make_expert(scenario)
    for expert in (plain, corrected):
        expert.take_measurement(at_rest(scenario))
    corrected.correct(np.array([1.0, -1.0, 0.5, 0.0, 0.0]))
    added = corrected.compute_controls()["arm"] - plain.compute_controls()["arm"]
    np.testing.assert_allclose(added, [0.7, -0.7, 0.35], atol=1e-12)
    corrected.reset(0)
    corrected.take_measurement(at_rest(scenario))
    corrected.correct(np.array([0.0, 0.0, 0.0, 1.0, -9.0]))  # clipped to -1
    regulator = OutputRegulator(scenario.chain(), scenario.arm.goal)
    wanted, _ = regulator.control(scenario.start, np.zeros(6), math.exp(2.0), np.zeros(3), math.exp(-2.0))
    np.testing.assert_allclose(corrected.compute_controls()["arm"], wanted, rtol=1e-12)


def test_an_unanswered_request_counts_as_zero():
    scenario = load_scenario("floating_manipulator_thrusters")
    plain, corrected = make_expert(scenario), make_expert(scenario)
    for k in range(3):
        for expert in (plain, corrected):
            expert.take_measurement(at_rest(scenario, 3.0 * k))
        if k == 0:
            corrected.correct(np.ones(5))
        same = np.array_equal(plain.compute_controls()["arm"], corrected.compute_controls()["arm"])
        assert same == (k > 0)


def test_bad_corrections_are_refused():
    scenario = load_scenario("floating_manipulator_thrusters")
    expert = make_expert(scenario)
    expert.take_measurement(at_rest(scenario))
    for bad in (np.zeros(2), np.full(5, np.nan), np.zeros((5, 1))):
        with pytest.raises(InputError, match="correction must be 5 finite numbers"):
            expert.correct(bad)
    expert.control()
    expert.take_measurement(at_rest(scenario, 0.005))
    with pytest.raises(InputError, match="no correction is awaited now"):
        expert.correct(np.zeros(5))
    expert.take_measurement(at_rest(scenario, 1.005, contact=True))
    assert not expert.awaiting_correction


def test_environment_passes_the_checker():
    env = ResidualEnv(soon(), render_mode="rgb_array")
    assert env.observation_space.shape == (33,)
    check_env(env)


def test_features_are_what_they_say():
    scenario = load_scenario("floating_manipulator_thrusters")
    expert = make_expert(scenario)
    expert.take_measurement(at_rest(scenario, 15.0))
    features = expert.features()
    assert features.shape == (expert.feature_size,)
    np.testing.assert_allclose(features[:8], [0.5, 1, 0, 0, 4.5, 1.5, 0, 0], atol=1e-9)
    np.testing.assert_allclose(features[8:13], [math.cos(0.1), math.sin(0.1), *scenario.start[3:]], atol=1e-9)
    assert not features[13:23].any()
    # nearest point of the box to the tip at (7.5, 1.5): the corner (4, 0)
    np.testing.assert_allclose(features[23], math.hypot(3.5, 1.5) - 0.009, atol=1e-9)
    np.testing.assert_allclose(features[25:27], np.array([3.5, 1.5]) / math.hypot(3.5, 1.5), atol=1e-9)
    np.testing.assert_allclose(features[27:29], [0.5, 0.5], atol=1e-9)


@pytest.mark.parametrize("folder", SHIPPED, ids=lambda path: path.name)
def test_shipped_checkpoint_loads_and_fits(folder):
    policy = ResidualPolicy.load(folder, soon())
    expert = policy.expert
    expert.take_measurement(at_rest(soon()))
    assert np.abs(policy.actor(expert.features())).max() <= 1.0
    assert np.all(np.isfinite(rollout(parallel_env(soon()), policy, 0).signals["tip.x"]))

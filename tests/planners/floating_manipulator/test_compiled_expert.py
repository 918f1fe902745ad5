"""The compiled expert is the readable one: actions, features and counted fallbacks of whole episodes."""

import numpy as np
import pytest

from impact_envs import list_scenarios, load_scenario, parallel_env
from impact_envs.floating_manipulator.observation import Measurement
from planners.floating_manipulator.expert import FloatingManipulatorExpert
from planners.floating_manipulator.options import VARIANTS
from tests.planners.floating_manipulator.oracle.drive import play
from tests.planners.floating_manipulator.oracle.expert import ReadableExpert

NAMES = [name for name in list_scenarios() if load_scenario(name).domain == "floating_manipulator"]
# Two seconds, with the box so near that the tip hits it in the first.
SOON = {
    "horizon": 2.0,
    "formula": "F[0,2] distance(tip, target) <= 5",
    "requirements": {},
    "box.start": [6.98, 1.5],
    "safety_pause": 0.5,
}
SEED = 1_000_000


def check_same(scenario, variant, seed, steps):
    env = parallel_env(scenario)
    experts = [expert(scenario, variant) for expert in (FloatingManipulatorExpert, ReadableExpert)]
    found, wanted = play(env, experts, seed, steps)
    np.testing.assert_allclose(found[0], wanted[0], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(np.array(found[1]), np.array(wanted[1]), rtol=0.0, atol=1e-9)
    assert found[2] == wanted[2]


@pytest.mark.parametrize("variant", [None, *VARIANTS])
@pytest.mark.parametrize("suite", ["nominal", "sensing"])
@pytest.mark.parametrize("name", ["floating_manipulator", "floating_manipulator_thrusters"])
def test_short_episodes_with_random_corrections_are_the_same(name, suite, variant):
    check_same(load_scenario(name).suite(suite).override(SOON), variant, SEED, 400)


@pytest.mark.slow
@pytest.mark.parametrize("suite", ["nominal", "all", "sensing", "hard"])
@pytest.mark.parametrize("name", NAMES)
def test_whole_episodes_with_random_corrections_are_the_same(name, suite):
    scenario = load_scenario(name).suite(suite)
    for seed in range(SEED, SEED + 4):
        check_same(scenario, None, seed, scenario.steps)


@pytest.mark.parametrize("variant", [None, "published"])
def test_lost_readings_are_replaced_and_counted_the_same(variant):
    scenario = load_scenario("floating_manipulator_thrusters").override(SOON)
    env = parallel_env(scenario)
    experts = [expert(scenario, variant) for expert in (FloatingManipulatorExpert, ReadableExpert)]
    rng = np.random.default_rng(2)
    seen, _ = env.reset(seed=SEED)
    while env.agents:
        if rng.random() < 0.3:
            spoiled = seen["arm"].copy()
            spoiled[rng.integers(len(spoiled) - 2)] = rng.choice([np.nan, np.inf, 0.0, -1.0, 1e150])
            seen = dict.fromkeys(seen, spoiled)
        one, two = (expert.act(seen) for expert in experts)
        for agent in one:
            np.testing.assert_allclose(one[agent], two[agent], rtol=0.0, atol=1e-9)
        seen = env.step(one)[0]
    counts = [dict(expert.diagnostics().fallbacks) for expert in experts]
    assert counts[0] == counts[1]
    assert {"no_measurement", "rejected"} <= counts[0].keys()


def test_a_stretched_arm_is_driven_by_the_last_gain_and_counted_the_same():
    scenario = load_scenario("floating_manipulator").override({"base.mount": [1.0, 0.0], "arm.last_heading": 0.2})
    experts = [expert(scenario) for expert in (FloatingManipulatorExpert, ReadableExpert)]
    stretched, bent, box = np.zeros(6), np.array([0.0, 0.0, 0.0, 0.5, 0.8, -0.7]), np.array([9.0, 9.0, 0, 0, 0, 0])
    for k, q in enumerate((stretched, bent, stretched)):
        torques = []
        for expert in experts:
            expert.take_measurement(Measurement(0.005 * k, q, np.zeros(6), False, box))
            torques.append(expert.compute_controls()["arm"])
        np.testing.assert_array_equal(*torques)
        assert torques[0].any() == (k > 0)
    for expert in experts:
        assert expert.diagnostics().fallbacks == {"none": 1, "last_gain": 1}


def test_a_control_that_is_no_number_does_nothing_and_is_counted():
    scenario = load_scenario("floating_manipulator_thrusters")
    for make in (FloatingManipulatorExpert, ReadableExpert):
        expert = make(scenario)
        q = scenario.start.copy()
        q[4] = np.nan
        expert.take_measurement(Measurement(0.0, q, np.zeros(6), False, np.zeros(6)))
        actions = expert.control()
        assert not actions["arm"].any()
        assert expert.diagnostics().fallbacks["no_action"] == 1

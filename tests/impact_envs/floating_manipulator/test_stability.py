"""Motors too strong for the control period are refused at load, with the longest period that works."""

import numpy as np
import pytest

from impact_envs import list_scenarios, load_scenario
from impact_envs.errors import InputError
from impact_envs.floating_manipulator.stability import find_longest_period
from impact_envs.physics.multibody import make_chain

SCENARIO = load_scenario("floating_manipulator_thrusters")
SHIPPED = [name for name in list_scenarios() if load_scenario(name).domain == "floating_manipulator"]


def test_one_joint_between_heavy_base_and_link_has_the_period_of_a_damped_wheel():
    """A link on a base that stands still is a wheel of inertia I + m c^2: v+ = (1 - T d / I) v."""
    chain = make_chain((1e9, 1e9), (0.0, 0.0), [(2.0, 0.5, 1.0, 0.5)])
    motor, period = find_longest_period(chain, np.array([0.0, 3.0]))
    assert motor == 1
    assert period == pytest.approx(2.0 * (0.5 + 2.0 * 0.25) / 3.0)


def test_no_motor_needs_no_period():
    assert find_longest_period(make_chain((1.0, 1.0)), np.zeros(1)) == (0, np.inf)


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"control_period": 0.2}, "control_period = 0.2: links.link_2"),
        ({"links.link_2.no_load_speed": 0.01}, "links.link_2.no_load_speed = 0.01"),
        ({"links.link_1.stall_torque": 1000.0}, "links.link_1.stall_torque = 1000"),
        ({"wheel.no_load_speed": 1e-6}, "wheel.no_load_speed = 1e-06"),
        ({"true.stall_torque_scale": {"uniform": [1.0, 100.0]}}, "links.link_2"),
    ],
)
def test_too_strong_motors_are_refused_in_one_line(changes, named):
    with pytest.raises(InputError) as error:
        SCENARIO.override(changes)
    assert named in str(error.value)
    assert "is stable up to" in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("name", SHIPPED)
def test_every_suite_is_stable(name):
    scenario = load_scenario(name)
    for suite in scenario._suites():
        scenario.suite(suite)

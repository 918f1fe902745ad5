"""Springs too stiff for the integration step are refused at load, with the longest step that works."""

import re

import numpy as np
import pytest

from impact_envs import load_scenario
from impact_envs.dual_arm.plant import CONTACTS, STATE, advance_state, make_plant
from impact_envs.dual_arm.stability import find_longest_steps
from impact_envs.errors import InputError

SCENARIO = load_scenario("dual_arm_grasp")


def test_longest_steps_are_the_ends_of_runge_kuttas_region():
    steps = find_longest_steps(np.array([-1.0, -10.0, 2j, 0.0]))
    assert steps == pytest.approx([2.7852936, 0.27852936, np.sqrt(2.0), np.inf], rel=1e-4)


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"joints.damping": [5921.0, 15.0, 4.0]}, "joints.damping[0] = 5921"),
        ({"joints.damping": [15.0, 5921.0, 4.0]}, "joints.damping[1] = 5921"),
        ({"joints.stiffness": [1e4, 1e4, 1e8]}, "joints.stiffness[2] = 1e+08"),
        ({"joints.shaped_inertia": [0.1, 1e-6, 0.02]}, "joints.stiffness[1]"),
        ({"true.joint_stiffness_scale": {"uniform": [1.0, 1e6]}}, "joints.stiffness"),
        ({"pads.damping": 1e7}, "pads.damping = 1e+07"),
        ({"table.damping": 1e9}, "table.damping = 1e+09"),
    ],
)
def test_too_stiff_springs_are_refused_in_one_line(changes, named):
    with pytest.raises(InputError) as error:
        SCENARIO.override(changes)
    assert named in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("suite", SCENARIO._suites())
def test_every_suite_is_stable(suite):
    SCENARIO.suite(suite)


def test_the_step_that_is_named_is_the_longest_that_works():
    stiff = {"joints.damping": [5921.0, 15.0, 4.0]}
    with pytest.raises(InputError) as error:
        SCENARIO.override(stiff)
    longest = float(re.search(r"up to (\S+)", str(error.value))[1])
    finer = SCENARIO.override(stiff | {"physics_step": 2.5e-5})
    plant = make_plant(finer, finer.draw(np.random.default_rng(0)))
    for step, stable in ((0.9 * longest, True), (1.2 * longest, False)):
        s = np.zeros(STATE)
        s[:24] = np.tile([0.4, 0.7, -0.3, 0.0, 0.0, 0.0, 0.401, 0.7, -0.3, 0.0, 0.0, 0.0], 2)
        s[24:26] = 0.0, 5.0
        advance_state(
            plant, np.zeros((2, 3)), s, 2000, step, np.zeros((6, STATE)), np.zeros((CONTACTS, 5)), np.zeros((4, 2))
        )
        assert bool(np.abs(s).max() < 100.0) is stable

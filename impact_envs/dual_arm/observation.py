"""What two arms measure: what stands where in an observation. Experts import this module and never the task."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from impact_envs.dual_arm.schema import GRASP_SIGNALS, DualArmScenario
from impact_envs.interface.agent_vectors import read_vectors
from impact_envs.observation import MOTION, Layout

# What is measured of one arm; with "own", "other" or the arm's name before them these are fields of an observation.
ARM = Layout(
    ("angles", ("q1 [rad]", "q2 [rad]", "q3 [rad]")),
    ("rates", ("q1' [rad/s]", "q2' [rad/s]", "q3' [rad/s]")),
    ("forces", ("normal force at the first corner of its pad [N]", "normal force at the second corner [N]")),
    (
        "pad",
        ("x [m]", "y [m]", "cos(heading)", "sin(heading)", "vx [m/s]", "vy [m/s]", "omega [rad/s]"),
    ),
)
# A row of the true state; of the box what the arms alone have is zero.
TRUTH = (
    *MOTION,
    *(element for name in ("angles", "rates", "forces") for element in ARM.fields[name]),
    *(f"{name} of the grasp [N, N m, m, s]" for name in GRASP_SIGNALS),
)
TIME = ("time", ("time / horizon",))


def make_layout() -> Layout:
    """Return the layout of an arm's observation: itself, the other arm, time."""
    return _make_layout("own", "other")


def make_joint_layout(scenario: DualArmScenario) -> Layout:
    """Return the layout of everything measured once: both arms, time."""
    return _make_layout(*scenario.arms)


def _make_layout(*arms: str) -> Layout:
    return Layout(*((f"{arm} {name}", elements) for arm in arms for name, elements in ARM.fields.items()), TIME)


def join_observations(scenario: DualArmScenario, observations: Mapping[str, np.ndarray], joint: np.ndarray) -> None:
    """Write the joint observation of both arms; each reports itself.

    Args:
        scenario: names the arms.
        observations: arm to its own observation.
        joint: takes the joint observation, laid out as `make_joint_layout` says.

    Raises:
        InputError: an arm is missing or unknown, or its observation is not as long as `make_layout` says.
    """
    read = read_vectors(observations, dict.fromkeys(scenario.arms, make_layout().size), "observation", finite=False)
    first, second = (read[name] for name in scenario.arms)
    joint[: ARM.size], joint[ARM.size : -1], joint[-1] = first[: ARM.size], second[: ARM.size], first[-1]

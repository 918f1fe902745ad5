"""The readable form of what the compiled expert reads of an observation."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from impact_envs.floating_manipulator.observation import Measurement, make_layout
from impact_envs.floating_manipulator.schema import FloatingManipulatorScenario
from impact_envs.interface.agent_vectors import read_vectors


def read_observations(scenario: FloatingManipulatorScenario, observations: Mapping[str, np.ndarray]) -> Measurement:
    """Read what the manipulator measured; its agents share all sensors.

    Args:
        scenario: says how many joints there are.
        observations: agent to its observation vector.

    Returns:
        The measurement of this control step; psi and the box's heading lie in [-pi, pi], NaN if what was read is no
        direction.

    Raises:
        InputError: an agent is missing or unknown, or its observation is not as long as `make_layout` says.
    """
    layout = make_layout(scenario)
    sizes = dict.fromkeys(scenario.agents, layout.size)
    vector = read_vectors(observations, sizes, "observation", finite=False)[scenario.agents[0]]
    x, y, cos, sin = vector[layout["base"]]
    q = np.array([x, y, _read_heading(cos, sin), *vector[layout["joints"]]])
    v = np.concatenate([vector[layout["base_rates"]], vector[layout["joint_rates"]]])
    box_x, box_y, box_vx, box_vy, box_cos, box_sin, omega = vector[layout["box"]]
    box = np.array([box_x, box_y, _read_heading(box_cos, box_sin), box_vx, box_vy, omega])
    (contact,), (fraction,) = vector[layout["contact"]], vector[layout["time"]]
    return Measurement(float(fraction) * scenario.horizon, q, v, bool(0.5 < contact < 1.5), box)


def _read_heading(cos: float, sin: float) -> float:
    """Return the angle of a direction; NaN if its length is not about 1 [rad]."""
    return math.atan2(sin, cos) if abs(math.hypot(cos, sin) - 1.0) <= 0.25 else math.nan

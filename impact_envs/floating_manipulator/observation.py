"""What a floating manipulator measures. Experts import this module and never the task."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit

from impact_envs.floating_manipulator.schema import FloatingManipulatorScenario
from impact_envs.physics.impact import Impact

FELT_SPEED = 1e-3  # slower impacts are not felt [m/s]
BOX_SIZE, TAIL_SIZE = 7, 4  # elements of the box, and of contact, time and robustness


@dataclass(frozen=True, eq=False)
class Measurement:
    """One control step's measurements.

    Attributes:
        time: since the start of the episode [s].
        q: base x, y, psi and joint angles, shape (n + 3,) [m], [rad].
        v: their rates, shape (n + 3,) [m/s], [rad/s].
        contact: the arm felt an impact in the last control period.
        box: x, y, heading, vx, vy, omega of the box, shape (6,) [m], [rad], [m/s], [rad/s].
    """

    time: float
    q: np.ndarray
    v: np.ndarray
    contact: bool
    box: np.ndarray


def observation_size(scenario: FloatingManipulatorScenario) -> int:
    """Return the length of an observation vector, for n joints 2 n + 22."""
    return 2 * len(scenario.links) + 11 + BOX_SIZE + TAIL_SIZE


def select_felt(impacts: Sequence[Impact]) -> list[Impact]:
    """Return the impacts that the arm feels.

    Args:
        impacts: of one control period.
    """
    return [impact for impact in impacts if impact.speed > FELT_SPEED]


@njit(cache=True)
def write_observation(
    states: np.ndarray, contact: bool, fraction: float, bounds: tuple[float, float], vector: np.ndarray
) -> None:
    """Write one observation (see the task for every element).

    Args:
        states: rows x, y, vx, vy, heading, omega of base, n links, tip, box, target, shape (n + 4, 6).
        contact: an impact was felt.
        fraction: time / horizon.
        bounds: interval of robustness still possible.
        vector: result, shape (2 n + 22,).
    """
    n = len(states) - 4
    base, tip, box, target = states[0], states[n + 1], states[n + 2], states[n + 3]
    vector[0], vector[1], vector[2], vector[3] = base[0], base[1], math.cos(base[4]), math.sin(base[4])
    for i in range(n):
        vector[4 + i] = states[1 + i, 4] - states[i, 4]
        vector[n + 7 + i] = states[1 + i, 5] - states[i, 5]
    vector[n + 4], vector[n + 5], vector[n + 6] = base[2], base[3], base[5]
    k = 2 * n + 7
    vector[k], vector[k + 1], vector[k + 2], vector[k + 3] = tip[0] - target[0], tip[1] - target[1], tip[2], tip[3]
    k += 4
    vector[k], vector[k + 1], vector[k + 2], vector[k + 3] = box[0], box[1], box[2], box[3]
    vector[k + 4], vector[k + 5], vector[k + 6] = math.cos(box[4]), math.sin(box[4]), box[5]
    k += BOX_SIZE
    vector[k], vector[k + 1], vector[k + 2], vector[k + 3] = 1.0 if contact else 0.0, fraction, bounds[0], bounds[1]


def read_observations(scenario: FloatingManipulatorScenario, observations: Mapping[str, np.ndarray]) -> Measurement:
    """Read what the manipulator measured; its agents share all sensors.

    Args:
        scenario: says how many joints there are.
        observations: agent to its observation vector.

    Returns:
        The measurement of this control step; psi and the box's heading lie in [-pi, pi].
    """
    vector, n = next(iter(observations.values())), len(scenario.links)
    x, y, cos, sin = vector[:4]
    q = np.array([x, y, math.atan2(sin, cos), *vector[4 : n + 4]])
    contact, fraction = vector[-TAIL_SIZE], vector[1 - TAIL_SIZE]
    box_x, box_y, box_vx, box_vy, box_cos, box_sin, omega = vector[2 * n + 11 : 2 * n + 11 + BOX_SIZE]
    box = np.array([box_x, box_y, math.atan2(box_sin, box_cos), box_vx, box_vy, omega])
    v = vector[n + 4 : 2 * n + 7].copy()
    return Measurement(float(fraction) * scenario.horizon, q, v, bool(contact > 0.5), box)

"""What a floating manipulator measures. Experts import this module and never the task."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np

from impact_envs.compiled import compiled
from impact_envs.elementary import cos_sin
from impact_envs.floating_manipulator.schema import FloatingManipulatorScenario
from impact_envs.observation import Layout, describe_robustness
from impact_envs.physics.impact import Impact

FELT_SPEED = 1e-3  # slower impacts are not felt [m/s]


class Places(NamedTuple):
    """Where each field of an observation begins; the names are those of the layout's fields."""

    base: int
    joints: int
    base_rates: int
    joint_rates: int
    tip: int
    box: int
    contact: int
    time: int
    robustness: int


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


def make_layout(scenario: FloatingManipulatorScenario) -> Layout:
    """Return the layout of an observation, which is the same for both agents."""
    return _make_layout(tuple(scenario.links), describe_robustness(scenario.specification))


@cache
def _make_layout(links: tuple[str, ...], robustness: tuple[str, ...]) -> Layout:
    return Layout(
        ("base", ("x [m]", "y [m]", "cos(psi)", "sin(psi)")),
        ("joints", [f"angle of {name} [rad]" for name in links]),
        ("base_rates", ("vx [m/s]", "vy [m/s]", "dpsi/dt [rad/s]")),
        ("joint_rates", [f"rate of {name} [rad/s]" for name in links]),
        ("tip", ("x - goal [m]", "y - goal [m]", "vx [m/s]", "vy [m/s]")),
        ("box", ("x [m]", "y [m]", "vx [m/s]", "vy [m/s]", "cos(heading)", "sin(heading)", "omega [rad/s]")),
        ("contact", ("the arm felt an impact in the last step, 0 or 1",)),
        ("time", ("time / horizon",)),
        ("robustness", robustness),
    )


def find_places(layout: Layout) -> Places:
    """Return where the fields begin, for compiled functions."""
    return Places(*(layout[name].start for name in Places._fields))


def observation_size(scenario: FloatingManipulatorScenario) -> int:
    """Return the length of an observation vector, for n joints and c conjuncts 2 n + 2 c + 20."""
    return make_layout(scenario).size


def select_felt(impacts: Sequence[Impact]) -> list[Impact]:
    """Return the impacts that the arm feels.

    Args:
        impacts: of one control period.
    """
    return [impact for impact in impacts if impact.speed > FELT_SPEED]


@compiled
def write_observation(
    states: np.ndarray, contact: bool, fraction: float, robustness: np.ndarray, at: Places, vector: np.ndarray
) -> None:
    """Write one observation (see `make_layout` for every element).

    Args:
        states: rows x, y, vx, vy, heading, omega of base, n links, tip, box, target, shape (n + 4, 6).
        contact: an impact was felt.
        fraction: time / horizon.
        robustness: lower and upper end of each conjunct's interval still possible, shape (2 c,).
        at: where the fields begin.
        vector: result, shape (2 n + 2 c + 20,).
    """
    n = len(states) - 4
    base, tip, box, target = states[0], states[n + 1], states[n + 2], states[n + 3]
    k = at.base
    vector[k], vector[k + 1] = base[0], base[1]
    vector[k + 2], vector[k + 3] = cos_sin(base[4])
    for i in range(n):
        vector[at.joints + i] = states[1 + i, 4] - states[i, 4]
        vector[at.joint_rates + i] = states[1 + i, 5] - states[i, 5]
    k = at.base_rates
    vector[k], vector[k + 1], vector[k + 2] = base[2], base[3], base[5]
    k = at.tip
    vector[k], vector[k + 1], vector[k + 2], vector[k + 3] = tip[0] - target[0], tip[1] - target[1], tip[2], tip[3]
    k = at.box
    vector[k], vector[k + 1], vector[k + 2], vector[k + 3] = box[0], box[1], box[2], box[3]
    vector[k + 4], vector[k + 5] = cos_sin(box[4])
    vector[k + 6] = box[5]
    vector[at.contact], vector[at.time] = 1.0 if contact else 0.0, fraction
    for i in range(len(robustness)):
        vector[at.robustness + i] = robustness[i]

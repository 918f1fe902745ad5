"""What a learner observes of a floating manipulator on its way to the goal, and what it may change."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from impact_envs.floating_manipulator.contact import compute_contact
from impact_envs.floating_manipulator.observation import Measurement
from impact_envs.floating_manipulator.schema import FloatingManipulatorScenario
from impact_envs.physics.multibody import Chain, compute_directions, compute_point
from planners.floating_manipulator.options import CorrectionOptions

PHASES = ("before", "pause", "after")


@dataclass(frozen=True, eq=False)
class Correction:
    """Change of the OSDRE over one period of corrections.

    Attributes:
        torques: added before the motors' limits, shape (n,) [N m].
        effort: factor on R.
        speed_weight: factor on the weights of the tip's velocity in Q.
    """

    torques: np.ndarray
    effort: float
    speed_weight: float


def get_correction_size(scenario: FloatingManipulatorScenario) -> int:
    """Return the length of a correction, for n joints n + 2."""
    return len(scenario.links) + 2


def get_feature_size(scenario: FloatingManipulatorScenario) -> int:
    """Return the length of the features, for n joints 2 n + 27."""
    return 2 * len(scenario.links) + 27


def scale_correction(scenario: FloatingManipulatorScenario, c: np.ndarray, options: CorrectionOptions) -> Correction:
    """Scale a correction to physical units.

    Args:
        scenario: as believed, with the stall torques of the motors.
        c: in [-1, 1], shape (n + 2,): for n torques, the weight R, and the weights of the tip's velocity in Q.
        options: ranges.
    """
    stall = np.array([link.stall_torque for link in scenario.links.values()])
    effort, speed_weight = (math.exp(options.log_range * float(value)) for value in c[-2:])
    return Correction(options.torque_share * stall * c[:-2], effort, speed_weight)


def compute_tip(chain: Chain, q: np.ndarray, v: np.ndarray) -> tuple[float, float, float, float, float, float]:
    """Return x, y, vx, vy of the tip, and the ax, ay that come from its rates alone [m], [m/s], [m/s^2].

    Args:
        chain: of the manipulator.
        q, v: coordinates and rates, shape (n + 3,).
    """
    w, rates = np.zeros((len(q) - 2, 2)), np.zeros(len(q) - 2)
    compute_directions(chain, q, v, w, rates)
    return compute_point(q, v, w, rates, chain.levers[-1])


def compute_features(
    scenario: FloatingManipulatorScenario,
    chain: Chain,
    measurement: Measurement,
    phase: str,
    momenta: np.ndarray,
    impacts: int,
) -> np.ndarray:
    """Compute what a learner may observe.

    Args:
        scenario: as believed.
        chain: of the manipulator, as believed.
        measurement: of this control step.
        phase: one of `PHASES`.
        momenta: used by the OSDRE: P_x, P_y and L about the world's origin, shape (3,) [N s], [N m s].
        impacts: number felt so far.

    Returns:
        Shape (2 n + 27,): time / horizon; one-hot phase (3); tip relative to its goal (2) [m] and its velocity (2)
        [m/s]; cos(psi), sin(psi); joint angles (n) [rad]; base rates (3) [m/s], [rad/s]; joint rates (n) [rad/s];
        momenta (3); impacts; gap between tip and box [m], its rate [m/s], normal from box to tip (2), nearest point
        relative to the box's centre (2) [m], speed along the box [m/s]; velocity of the box (3) [m/s], [rad/s].
    """
    q, v, box = measurement.q, measurement.v, measurement.box
    tip = compute_tip(chain, q, v)
    length, width = scenario.box.size
    contact = compute_contact(tip, scenario.load.radius, tuple(box.tolist()), length / 2, width / 2)
    parts = (
        [measurement.time / scenario.horizon],
        [float(phase == name) for name in PHASES],
        [tip[0] - scenario.arm.goal[0], tip[1] - scenario.arm.goal[1], tip[2], tip[3]],
        [math.cos(q[2]), math.sin(q[2])],
        q[3:],
        v,
        momenta,
        [float(impacts)],
        contact[:-1],
        box[3:],
    )
    return np.concatenate(parts)

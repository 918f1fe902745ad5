"""The drawn physics of two arms and a box as one vector with named elements, for critics and oracles."""

from __future__ import annotations

import numpy as np

from impact_envs.dual_arm.schema import DualArmScenario, Physics
from impact_envs.observation import Layout

POSE = ("x [m]", "y [m]", "heading [rad]")


def make_secrets_layout(scenario: DualArmScenario) -> Layout:
    """Return what stands where in the vector of drawn physics."""
    return Layout(
        ("true box", (*(f"{name} at the start" for name in POSE), "mass [kg]", "inertia [kg m^2]")),
        ("true pads", ("friction", "stiffness [N/m^c]", "damping [N s/m^(c+1)]")),
        ("true joints", tuple(f"stiffness of joint {i + 1} [N m/rad]" for i in range(3))),
        *((f"true start of {name}", POSE) for name in scenario.arms),
    )


def list_secrets(physics: Physics) -> np.ndarray:
    """Return the vector of a world's drawn physics, with the fields of `make_secrets_layout`."""
    return np.concatenate(
        [
            [*physics.box, physics.mass, physics.inertia],
            [physics.friction, physics.stiffness, physics.damping],
            physics.joint_stiffness,
            physics.starts.ravel(),
        ]
    )

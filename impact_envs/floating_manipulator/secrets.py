"""The drawn physics of a floating manipulator as one vector with named elements, for critics and oracles."""

from __future__ import annotations

import numpy as np

from impact_envs.floating_manipulator.schema import FloatingManipulatorScenario, Physics
from impact_envs.observation import Layout


def make_secrets_layout(scenario: FloatingManipulatorScenario) -> Layout:
    """Return what stands where in the vector of drawn physics."""
    return Layout(
        ("true contact", ("restitution at zero speed", "v_e of e(v) = e exp(-v / v_e) [m/s], 0 for constant e")),
        (
            "true arm",
            (
                "mass of base, links and load [kg]",
                "inertia of the base [kg m^2]",
                "sum of m l of the last link and load [kg m]",
            ),
        ),
        ("true box", ("mass [kg]", "inertia [kg m^2]", "start x [m]", "start y [m]", "heading at the start [rad]")),
        *((f"true motor of {name}", ("stall torque [N m]", "no-load speed [rad/s]")) for name in scenario.links),
        ("true thrusters", ("force of each when on [N]",)),
    )


def list_secrets(physics: Physics) -> np.ndarray:
    """Return the vector of a world's drawn physics, with the fields of `make_secrets_layout`."""
    motors = np.column_stack([physics.stall_torque, physics.no_load_speed])
    chain = physics.chain
    return np.concatenate(
        [
            [physics.restitution, physics.restitution_speed],
            [chain.mass, chain.inertia[0], chain.first[-1]],
            [physics.box_mass, physics.box_inertia, *physics.box_start],
            motors.ravel(),
            [physics.thruster_force],
        ]
    )

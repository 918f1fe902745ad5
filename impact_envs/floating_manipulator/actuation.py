"""What motors, thrusters and wheel give of what they are commanded."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from impact_envs.floating_manipulator.schema import FloatingManipulatorScenario, Motor, Physics


def compute_forces(
    scenario: FloatingManipulatorScenario, physics: Physics, v: np.ndarray, controls: Mapping[str, np.ndarray]
) -> np.ndarray:
    """Compute the forces and torques held over a control period.

    Joints: |u + stall_torque / no_load_speed * speed| <= stall_torque, likewise the wheel. Thrusters are on or off.

    Args:
        scenario: says what there is to drive the base.
        physics: limits of the true world.
        v: rates at the start of the period: of base x, y, psi and the joints, shape (n + 3,) [m/s], [rad/s].
        controls: ``arm`` to joint torques, shape (n,) [N m]; where it can be driven, ``base`` to forces along the
            world's axes and torque, shape (3,) [N], [N m].

    Returns:
        Fx, Fy and torque on the base, then joint torques, shape (n + 3,) [N], [N m].

    Source: Nekoo, Sharf & Ollero, Eq. 34 and Sec. 4.4.
    """
    force = np.zeros(len(v))
    drop = physics.stall_torque * v[3:] / physics.no_load_speed
    force[3:] = np.clip(controls["arm"], -physics.stall_torque - drop, physics.stall_torque - drop)
    if "base" in controls:
        fx, fy, torque = controls["base"]
        dead = scenario.thrusters.dead_zone if scenario.thrusters else 0.0
        for axis, command in enumerate((fx, fy)):
            force[axis] = np.sign(command) * physics.thruster_force if abs(command) > dead else 0.0
        force[2] = _limit_torque(scenario.wheel, torque, v[2])
    return force


def _limit_torque(motor: Motor | None, torque: float, speed: float) -> float:
    """Return what a motor gives of a torque at a speed; nothing without a motor."""
    if motor is None:
        return 0.0
    drop = motor.stall_torque * speed / motor.no_load_speed
    return min(max(torque, -motor.stall_torque - drop), motor.stall_torque - drop)

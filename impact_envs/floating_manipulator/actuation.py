"""Limits of the actuators: the forces and torques that motors, thrusters and wheel deliver when commanded."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from impact_envs.compiled import compiled
from impact_envs.floating_manipulator.schema import FloatingManipulatorScenario, Motor, Physics


def compute_forces(
    scenario: FloatingManipulatorScenario, physics: Physics, v: np.ndarray, controls: Mapping[str, np.ndarray]
) -> np.ndarray:
    """Compute the forces and torques held over a control period.

    Joints: |u + stall_torque / no_load_speed * speed| <= stall_torque, likewise the wheel. Thrusters are on or off.

    Args:
        scenario: its thrusters and wheel.
        physics: limits of the true world.
        v: rates at the start of the period: of base x, y, psi and the joints, shape (n + 3,) [m/s], [rad/s].
        controls: ``arm``: joint torques, shape (n,) [N m]; where the base is actuated, ``base``: forces along the
            world's axes and torque, shape (3,) [N], [N m].

    Returns:
        Fx, Fy and torque on the base, then joint torques, shape (n + 3,) [N], [N m].

    Source: Nekoo, Sharf & Ollero, Eq. 34 and Sec. 4.4.
    """
    force = np.zeros(len(v))
    limit_torques(v, physics.stall_torque, physics.no_load_speed, controls["arm"], force)
    if "base" in controls:
        fx, fy, torque = controls["base"].tolist()
        dead = scenario.thrusters.dead_zone if scenario.thrusters else 0.0
        for axis, command in enumerate((fx, fy)):
            force[axis] = math.copysign(physics.thruster_force, command) if abs(command) > dead else 0.0
        force[2] = _limit_torque(scenario.wheel, torque, float(v[2]))
    return force


@compiled
def limit_torques(
    v: np.ndarray, stall_torque: np.ndarray, no_load_speed: np.ndarray, command: np.ndarray, force: np.ndarray
) -> None:
    """Compute the torques that the joints' motors deliver.

    Args:
        v: rates of base and joints, shape (n + 3,).
        stall_torque, no_load_speed: of the motors, shape (n,) [N m], [rad/s].
        command: torques, shape (n,) [N m].
        force: its last n elements are written, shape (n + 3,).
    """
    for j in range(len(command)):
        drop = stall_torque[j] * v[3 + j] / no_load_speed[j]
        force[3 + j] = min(max(command[j], -stall_torque[j] - drop), stall_torque[j] - drop)


def _limit_torque(motor: Motor | None, torque: float, speed: float) -> float:
    """Return the torque that a motor delivers at a speed; 0 without a motor."""
    if motor is None:
        return 0.0
    drop = motor.stall_torque * speed / motor.no_load_speed
    return min(max(torque, -motor.stall_torque - drop), motor.stall_torque - drop)

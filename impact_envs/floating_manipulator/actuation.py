"""Limits of the actuators: the forces and torques that motors, thrusters and wheel deliver when commanded."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from impact_envs.compiled import compiled
from impact_envs.floating_manipulator.schema import FloatingManipulatorScenario, Physics


class Actuators(NamedTuple):
    """The actuators of one world.

    Attributes:
        stall_torque, no_load_speed: of the joints' motors, shape (n,) [N m], [rad/s].
        thruster_force: of each thruster when on, 0 without thrusters [N].
        dead_zone: smaller commands leave the thrusters off [N].
        wheel_torque, wheel_speed: stall torque, 0 without a wheel, and no-load speed of the wheel [N m], [rad/s].
    """

    stall_torque: np.ndarray
    no_load_speed: np.ndarray
    thruster_force: float
    dead_zone: float
    wheel_torque: float
    wheel_speed: float


def make_actuators(scenario: FloatingManipulatorScenario, physics: Physics) -> Actuators:
    """Collect the actuators of a world.

    Args:
        scenario: its thrusters and wheel.
        physics: limits of the drawn world.
    """
    thrusters, wheel = scenario.thrusters, scenario.wheel
    return Actuators(
        stall_torque=physics.stall_torque,
        no_load_speed=physics.no_load_speed,
        thruster_force=float(physics.thruster_force),
        dead_zone=float(thrusters.dead_zone) if thrusters else 0.0,
        wheel_torque=float(wheel.stall_torque) if wheel else 0.0,
        wheel_speed=float(wheel.no_load_speed) if wheel else 1.0,
    )


def join_limits(scenario: FloatingManipulatorScenario) -> np.ndarray:
    """Return the commands of an action of 1 as `join_controls` orders them; 0 of a base that is not actuated."""
    commands = scenario.largest_commands
    return np.concatenate([commands.get("base", np.zeros(3)), commands["arm"]])


def join_controls(controls: Mapping[str, np.ndarray], joints: int) -> np.ndarray:
    """Return the controls of all agents as one vector: Fx, Fy and torque on the base, then joint torques.

    Args:
        controls: ``arm``: joint torques, shape (n,) [N m]; where the base is actuated, ``base``: forces along the
            world's axes and torque, shape (3,) [N], [N m].
        joints: n.

    Returns:
        Shape (n + 3,) [N], [N m].
    """
    command = np.zeros(joints + 3)
    command[3:] = controls["arm"]
    if "base" in controls:
        command[:3] = controls["base"]
    return command


@compiled
def compute_forces(actuators: Actuators, v: np.ndarray, command: np.ndarray, force: np.ndarray) -> None:
    """Compute the forces and torques held over a control period.

    Joints: |u + stall_torque / no_load_speed * speed| <= stall_torque, likewise the wheel. Thrusters are on or off.

    Args:
        actuators: of the world.
        v: rates at the start of the period: of base x, y, psi and the joints, at least n + 3 [m/s], [rad/s].
        command: Fx, Fy and torque on the base, then joint torques, shape (n + 3,) [N], [N m].
        force: takes what is delivered of each, at least n + 3 [N], [N m].

    Source: Nekoo, Sharf & Ollero, Eq. 34 and Sec. 4.4.
    """
    for axis in range(2):
        on = abs(command[axis]) > actuators.dead_zone
        force[axis] = math.copysign(actuators.thruster_force, command[axis]) if on else 0.0
    force[2] = 0.0
    if actuators.wheel_torque > 0.0:
        force[2] = limit_torque(actuators.wheel_torque, actuators.wheel_speed, command[2], v[2])
    for j in range(3, len(command)):
        force[j] = limit_torque(actuators.stall_torque[j - 3], actuators.no_load_speed[j - 3], command[j], v[j])


@compiled
def scale_action(limits: np.ndarray, action: np.ndarray, command: np.ndarray) -> None:
    """Scale an action, clipped to [-1, 1], to commands.

    Args:
        limits: commands of an action of 1, shape (n + 3,) [N], [N m].
        action: of base and joints, shape (n + 3,).
        command: result, shape (n + 3,) [N], [N m].
    """
    for i in range(len(limits)):
        command[i] = min(max(action[i], -1.0), 1.0) * limits[i]


@compiled
def limit_torque(stall_torque: float, no_load_speed: float, torque: float, speed: float) -> float:
    """Return the torque that a motor delivers at a speed [N m]."""
    drop = stall_torque * speed / no_load_speed
    return min(max(torque, -stall_torque - drop), stall_torque - drop)

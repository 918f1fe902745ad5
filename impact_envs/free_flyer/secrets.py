"""The drawn physics of free-flyers as one vector with named elements, for critics and oracles."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.free_flyer.truth import CORNERS, INERTIA, Physics
from impact_envs.observation import Layout

CONTACT = ("restitution at zero speed", "v_e of e(v) = e exp(-v / v_e) [m/s], 0 for constant e", "Coulomb coefficient")
BODY = (
    "mass [kg]",
    "inertia [kg m^2]",
    "centre of mass x in the body frame [m]",
    "centre of mass y in the body frame [m]",
    "drift x at the start [m/s^2]",
    "drift y at the start [m/s^2]",
    "start x from where the scenario says [m]",
    "start y from where the scenario says [m]",
    "turning of the drift [rad/s]",
    "greatest deviation of its velocity after an impact [m/s]",
)
CHANNELS = [f"{channel} {side}" for channel in ("Fx", "Fy", "torque") for side in ("positive", "negative")]
THRUSTERS = tuple(
    [f"{channel}: true over commanded" for channel in CHANNELS] + [f"{channel}: lost [1/s]" for channel in CHANNELS]
)
SENSOR = ("delay [control periods]", "losses of readings [1/s]")


def make_secrets_layout(scenario: FreeFlyerScenario) -> Layout:
    """Return what stands where in the vector of drawn physics."""
    robots, objects = scenario.robots, scenario.objects
    return Layout(
        ("true contact", CONTACT),
        *((f"true {name}", BODY[: INERTIA + 1]) for name in robots),
        *((f"true {name}", BODY) for name in objects),
        *((f"true thrusters of {name}", THRUSTERS) for name in robots),
        ("true sensors", SENSOR),
    )


def list_secrets(contact: Any, body: Any, thruster: Any, sensor: Any) -> np.ndarray:
    """Return the vectors of drawn physics of N worlds, with the fields of `make_secrets_layout`.

    Args:
        contact, body, thruster, sensor: as Physics's, with a leading axis N.

    Returns:
        Shape (N, size).
    """
    return np.column_stack(list(_list_parts(contact, body, thruster, sensor)))


def list_secrets_of_one(physics: Physics) -> np.ndarray:
    """Return the vector of one world's drawn physics, shape (size,)."""
    return list_secrets(physics.contact[None], physics.body[None], physics.thruster[None], physics.sensor[None])[0]


def _list_parts(contact: np.ndarray, body: np.ndarray, thruster: np.ndarray, sensor: np.ndarray) -> Iterator[Any]:
    count, robots = len(contact), thruster.shape[1]
    yield contact
    yield body[:, :robots, : INERTIA + 1].reshape(count, -1)
    yield body[:, robots:, :CORNERS].reshape(count, -1)
    yield thruster.reshape(count, -1)
    yield sensor

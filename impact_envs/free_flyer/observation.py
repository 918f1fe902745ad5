"""What free-flyers measure: the sensors, the layout of an observation, and how to read one.

Experts import this module and never the task, so what they know is what a robot can measure.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from impact_envs.free_flyer.schema import FreeFlyerScenario, Physics
from impact_envs.free_flyer.sensing import (
    BODY_SIZE,
    STATE_SIZE,
    TAIL_SIZE,
    Sensing,
    compute_memory_size,
    sample_alone,
)
from impact_envs.free_flyer.sensing import VELOCITY_WINDOW as VELOCITY_WINDOW


@dataclass(frozen=True)
class Measurement:
    """One control step's measurements, read from the robots' observations.

    Attributes:
        time: since the start of the episode [s].
        robots, objects: name to [x, y, vx, vy, heading, omega], shape (6,) [m, m/s, rad, rad/s].
        contact: robot name to whether its IMU felt an impact in the last step seen.
    """

    time: float
    robots: dict[str, np.ndarray]
    objects: dict[str, np.ndarray]
    contact: dict[str, bool]


class Sensors:
    """Noise, velocity by filtered difference and delay between true states and observation: ``sensing``, one world."""

    def __init__(self, scenario: FreeFlyerScenario) -> None:
        self._period = float(scenario.control_period)
        self._bodies, self._robots = len(scenario.bodies), len(scenario.robots)

    def reset(self, physics: Physics, rng: np.random.Generator) -> None:
        """Forget the last episode.

        Args:
            physics: position noise, whether velocity is measured, delay.
            rng: the episode's generator; with noise, every sample takes two doubles per body from it.
        """
        noise, delay = float(physics.position_noise), int(physics.delay_steps)
        sensing = Sensing(self._period, noise, bool(physics.velocity_measured), delay)
        self._sensing, self._rng, self._samples = tuple(sensing), rng, 0
        self._uniforms = np.zeros((1, 2 * self._bodies if noise > 0 else 0))
        self._memory = np.zeros((1, compute_memory_size(sensing, self._bodies, self._robots)))
        self._ideal = self._memory.size + self._uniforms.size == 0

    def measure(self, states: np.ndarray, contacts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Take one sample; call once per control step.

        Args:
            states: true [x, y, vx, vy, heading, omega] of all bodies, shape (bodies, 6).
            contacts: which robots felt an impact, shape (robots,), 0 or 1.

        Returns:
            Measured states and contacts of the same shapes, as old as the delay (the first ones until then); of ideal
            sensors the arguments themselves.
        """
        if self._ideal:
            return states, contacts
        if self._uniforms.size:
            self._rng.random(out=self._uniforms)
        measured, felt = np.empty((1, self._bodies, STATE_SIZE)), np.empty((1, self._robots))
        world = (states[None], contacts[None], self._uniforms, self._memory, measured, felt)
        sample_alone(self._sensing, self._samples, *world)
        self._samples += 1
        return measured[0], felt[0]


def observed_order(scenario: FreeFlyerScenario, agent: str) -> tuple[str, ...]:
    """Return the bodies in the order of an agent's observation: itself, other robots, objects."""
    return (agent, *(name for name in scenario.bodies if name != agent))


def read_observations(scenario: FreeFlyerScenario, observations: Mapping[str, np.ndarray]) -> Measurement:
    """Read what the team measured; each robot reports itself, the first one the objects.

    Args:
        scenario: says who is in the observation.
        observations: agent to its observation vector.

    Returns:
        The measurement of this control step.
    """
    robots, contact = {}, {}
    for agent, vector in observations.items():
        robots[agent] = _read_body(vector[:BODY_SIZE])
        contact[agent] = bool(vector[-TAIL_SIZE] > 0.5)
    agent, vector = next(iter(observations.items()))
    order = observed_order(scenario, agent)
    objects = {
        name: _read_body(vector[i * BODY_SIZE : (i + 1) * BODY_SIZE])
        for i, name in enumerate(order)
        if name in scenario.objects
    }
    return Measurement(float(vector[-TAIL_SIZE + 1]) * scenario.horizon, robots, objects, contact)


def _read_body(block: np.ndarray) -> np.ndarray:
    x, y, vx, vy, cos, sin, omega = block
    return np.array([x, y, vx, vy, np.arctan2(sin, cos), omega])

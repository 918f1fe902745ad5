"""What free-flyers measure: the sensors, the layout of an observation, and how to read one.

Experts import this module and never the task, so what they know is what a robot can measure.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from impact_envs.free_flyer.schema import FreeFlyerScenario, Physics

BODY_SIZE = 7  # x, y, vx, vy, cos(heading), sin(heading), omega
TAIL_SIZE = 4  # contact, time / horizon, robustness_lower, robustness_upper
# The published replanner averages the differences of its last 15 positions, which is this difference quotient.
VELOCITY_WINDOW = 15


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
    """Noise, velocity by filtered difference and delay between the true states and an observation."""

    def __init__(self, scenario: FreeFlyerScenario) -> None:
        self._period = scenario.control_period

    def reset(self, physics: Physics, rng: np.random.Generator) -> None:
        """Forget the last episode.

        Args:
            physics: position noise, whether velocity is measured, delay.
            rng: the episode's generator.
        """
        self._physics, self._rng = physics, rng
        self._positions: deque[np.ndarray] = deque(maxlen=VELOCITY_WINDOW + 1)
        self._delayed: deque[tuple[np.ndarray, np.ndarray]] = deque(maxlen=physics.delay_steps + 1)

    def measure(self, states: np.ndarray, contacts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Take one sample; call once per control step.

        Args:
            states: true [x, y, vx, vy, heading, omega] of all bodies, shape (bodies, 6).
            contacts: which robots felt an impact, shape (robots,), 0 or 1.

        Returns:
            Measured states and contacts of the same shapes, as old as the delay (the first ones until then).
        """
        measured = states.copy()
        noise = self._physics.position_noise
        if noise > 0:
            measured[:, :2] += self._rng.normal(0.0, noise, (len(states), 2))
        if not self._physics.velocity_measured:
            measured[:, 2:4] = self._difference(measured[:, :2])
        self._delayed.append((measured, contacts.copy()))
        return self._delayed[0]

    def _difference(self, positions: np.ndarray) -> np.ndarray:
        self._positions.append(positions.copy())
        span = (len(self._positions) - 1) * self._period
        return (positions - self._positions[0]) / span if span > 0 else np.zeros_like(positions)


def body_block(state: np.ndarray) -> np.ndarray:
    """Return the seven observed numbers of a body.

    Args:
        state: [x, y, vx, vy, heading, omega], shape (6,).
    """
    x, y, vx, vy, heading, omega = state
    return np.array([x, y, vx, vy, np.cos(heading), np.sin(heading), omega])


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

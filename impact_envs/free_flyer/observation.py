"""What free-flyers measure: the sensors, and what stands where in an observation.

Experts import this module and never the task, so what they know is what a robot can measure.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.free_flyer.sensing import (
    BODY,
    BODY_SIZE,
    STATE_SIZE,
    TIME_ELEMENTS,
    compute_memory_size,
    count_uniforms,
    make_sensing,
    sample_alone,
)
from impact_envs.free_flyer.truth import Physics
from impact_envs.interface.agent_vectors import read_vectors
from impact_envs.observation import Layout, describe_robustness

__all__ = [
    "BODY_SIZE",
    "Sensors",
    "join_observations",
    "make_joint_layout",
    "make_layout",
    "observed_order",
]


class Sensors:
    """Noise, velocity by filtered difference and delay between true states and observation: ``sensing``, one world."""

    def __init__(self, scenario: FreeFlyerScenario) -> None:
        self._period = float(scenario.control_period)
        self._bodies, self._robots = len(scenario.bodies), len(scenario.robots)

    def reset(self, physics: Physics, rng: np.random.Generator) -> None:
        """Forget the last episode.

        Args:
            physics: says what the sensors are like.
            rng: the episode's generator; every sample takes as many doubles from it as ``count_uniforms`` says.
        """
        sensing = make_sensing(self._period, physics.true)
        self._sensing, self._rng, self._samples = tuple(sensing), rng, 0
        self._uniforms = np.zeros((1, count_uniforms(sensing, self._bodies)))
        self._memory = np.zeros((1, compute_memory_size(sensing, self._bodies, self._robots)))
        self._drawn = physics.sensor[None].astype(float)
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
        world = (states[None], contacts[None], self._drawn, self._uniforms, self._memory, measured, felt)
        sample_alone(self._sensing, self._samples, *world)
        self._samples += 1
        return measured[0], felt[0]


def observed_order(scenario: FreeFlyerScenario, agent: str) -> tuple[str, ...]:
    """Return the bodies in the order of an agent's observation: itself, other robots, objects."""
    return (agent, *(name for name in scenario.bodies if name != agent))


def make_joint_layout(scenario: FreeFlyerScenario) -> Layout:
    """Return the layout of everything measured once: bodies in scenario order, contacts, time, robustness intervals."""
    contacts = [f"{name} felt an impact in the last step, 0 or 1" for name in scenario.agents]
    return _make_layout(scenario, scenario.bodies, contacts)


def make_layout(scenario: FreeFlyerScenario, agent: str) -> Layout:
    """Return the layout of a robot's own observation: itself, other robots, objects; its contact, and the same end."""
    return _make_layout(scenario, observed_order(scenario, agent), ["it felt an impact in the last step, 0 or 1"])


def _make_layout(scenario: FreeFlyerScenario, bodies: Sequence[str], contacts: Sequence[str]) -> Layout:
    blocks = [(name, BODY) for name in bodies]
    robustness = describe_robustness(scenario.specification)
    return Layout(*blocks, ("contact", contacts), ("time", TIME_ELEMENTS), ("robustness", robustness))


def join_observations(scenario: FreeFlyerScenario, observations: Mapping[str, np.ndarray], joint: np.ndarray) -> None:
    """Write the joint observation of a team; each robot reports itself, the first one the objects.

    Args:
        scenario: says who is in the observations.
        observations: robot to its own observation.
        joint: takes the joint observation, laid out as `make_joint_layout` says.

    Raises:
        InputError: a robot is missing or unknown, or its observation is not as long as `make_layout` says.
    """
    n = BODY_SIZE * len(scenario.bodies)
    sizes = dict.fromkeys(scenario.agents, len(joint) - len(scenario.agents) + 1)
    observations = read_vectors(observations, sizes, "observation", finite=False)
    first = observations[scenario.agents[0]]
    joint[:n] = first[:n]  # the first robot sees all bodies in scenario order
    for i, name in enumerate(scenario.agents):
        joint[BODY_SIZE * i : BODY_SIZE * (i + 1)] = observations[name][:BODY_SIZE]
        joint[n + i] = observations[name][n]
    joint[n + len(scenario.agents) :] = first[n + 1 :]

"""What an environment is joined of: a model says what the world does, a task what is asked of its agents."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from gymnasium.spaces import Box

from impact_envs.interface.shape import Shape
from impact_envs.observation import Layout
from impact_envs.physics.impact import Impact


class Model(Protocol):
    """What the world does."""

    def reset(self, physics: Any) -> None:
        """Put the bodies at their start in a world with these physics."""

    def step(self, controls: Mapping[str, np.ndarray]) -> list[Impact]:
        """Advance one control period under held controls; return the impacts in order of time.

        Raises:
            SimulationFailed: the world cannot be followed any further.
        """

    def state(self) -> np.ndarray:
        """Return the true state, one row per body."""


class Task(Protocol):
    """What is asked of the agents."""

    scenario: Any
    action_spaces: Mapping[str, Box]
    action_elements: Mapping[str, Sequence[str]]  # of each agent, with what an element of 1 is: "torque [0.5 N m]"
    observation_spaces: Mapping[str, Box]
    joint_observation_space: Box
    layouts: Mapping[str, Layout]
    joint_layout: Layout
    state_layout: Layout
    secrets_layout: Layout

    def reset(self, physics: Any, states: np.ndarray, rng: np.random.Generator) -> None:
        """Start an episode."""

    def controls(self, actions: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Scale actions to physical controls."""

    def effort(self, action: np.ndarray) -> float:
        """Return an agent's effort in one control period, in [0, 1]."""

    def impulse(self, controls: Mapping[str, np.ndarray]) -> float:
        """Return the propulsion spent in one control period."""

    def sense(self, states: np.ndarray, impacts: list[Impact]) -> None:
        """Take the sensors' sample."""

    def observe(self, time: float, robustness: Sequence[float]) -> dict[str, np.ndarray]:
        """Return each agent's observation, in which intervals of the formula's conjuncts may stand."""

    def observe_jointly(self, time: float, robustness: Sequence[float]) -> np.ndarray:
        """Return all agents' observation as one vector."""

    def list_secrets(self, physics: Any) -> np.ndarray:
        """Return a world's drawn physics as one vector, which no expert sees."""

    def signals(self, states: np.ndarray) -> dict[str, float]:
        """Return the signals the formula speaks of."""

    def signal_bounds(self) -> dict[str, tuple[float, float]]:
        """Return bounds of signals known beforehand."""

    def shapes(self) -> tuple[Shape, ...]:
        """Return what is drawn."""

    def chains(self, states: np.ndarray) -> dict[str, np.ndarray]:
        """Return polylines from bodies to what holds them, drawn with them."""

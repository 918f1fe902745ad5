"""What is asked of the puck."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from gymnasium.spaces import Box
from impact_envs.point_mass.schema import Physics, PointMassScenario

from impact_envs.interface.shape import Shape
from impact_envs.observation import MOTION, Layout
from impact_envs.physics.impact import Impact
from impact_envs.stl import SIGNALS


class PointMassTask:
    """Observation: x, y, vx, vy, time / horizon. Action: force over its limit, in [-1, 1]."""

    def __init__(self, scenario: PointMassScenario) -> None:
        self.scenario = scenario
        self.action_spaces = {"puck": Box(-1.0, 1.0, (2,), np.float32)}
        self.joint_observation_space = Box(-np.inf, np.inf, (5,), np.float64)
        self.observation_spaces = {"puck": self.joint_observation_space}
        self.state_layout, self.secrets_layout = Layout(("puck", MOTION)), Layout(("true wall", ("restitution",)))

    def reset(self, physics: Physics, states: np.ndarray, rng: np.random.Generator) -> None:
        self.sense(states, [])

    def controls(self, actions: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        return {name: np.clip(action, -1.0, 1.0) * self.scenario.force_limit for name, action in actions.items()}

    def effort(self, action: np.ndarray) -> float:
        return float(np.mean(np.clip(action, -1.0, 1.0) ** 2))

    def impulse(self, controls: Mapping[str, np.ndarray]) -> float:
        return float(np.abs(controls["puck"]).sum()) * self.scenario.control_period

    def sense(self, states: np.ndarray, impacts: Sequence[Impact]) -> None:
        self._measured = states[0, :4].copy()

    def observe(self, time: float, bounds: tuple[float, float]) -> dict[str, np.ndarray]:
        return {"puck": self.observe_jointly(time, bounds)}

    def observe_jointly(self, time: float, bounds: tuple[float, float]) -> np.ndarray:
        return np.append(self._measured, time / self.scenario.horizon)

    def signals(self, states: np.ndarray) -> dict[str, float]:
        return {f"puck.{name}": float(value) for name, value in zip(SIGNALS, states[0], strict=True)}

    def signal_bounds(self) -> dict[str, tuple[float, float]]:
        return {}

    def list_secrets(self, physics: Physics) -> np.ndarray:
        return np.array(physics)

    def shapes(self) -> tuple[Shape, ...]:
        areas = [Shape(None, "region", vertices=a.corners, label=n) for n, a in self.scenario.regions.items()]
        return (*areas, Shape("puck", "robot", radius=0.05, label="puck"))

    def chains(self, states: np.ndarray) -> dict[str, np.ndarray]:
        return {}

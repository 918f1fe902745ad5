"""Motion of the puck, exact under a held force between walls."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from impact_envs.point_mass.schema import Physics, PointMassScenario

from impact_envs.physics.impact import Impact

WALLS = (("left", "right"), ("bottom", "top"))  # below and above, of each axis


class PointMassModel:
    """Physics of a point-mass scenario."""

    def __init__(self, scenario: PointMassScenario) -> None:
        self.scenario = scenario

    def reset(self, physics: Physics) -> None:
        self.physics = physics
        self._position, self._velocity = np.array(self.scenario.start), np.zeros(2)
        self._steps = 0

    def step(self, controls: Mapping[str, np.ndarray]) -> list[Impact]:
        """Advance one control period; a wall that is reached in it reflects the puck at its end."""
        scenario, period = self.scenario, self.scenario.control_period
        acceleration = controls["puck"] / scenario.mass
        self._position = self._position + period * self._velocity + period**2 / 2 * acceleration
        self._velocity = self._velocity + period * acceleration
        self._steps += 1
        impacts = []
        for axis in range(2):
            for wall, limit, side in zip(
                WALLS[axis], (scenario.world.lower[axis], scenario.world.upper[axis]), (1.0, -1.0), strict=True
            ):
                speed = -side * self._velocity[axis]
                if side * (self._position[axis] - limit) >= 0.0 or speed <= 0.0:
                    continue
                normal = np.zeros(2)
                normal[axis] = side
                change = (1.0 + self.physics.restitution) * speed * normal
                self._position[axis] = limit
                self._velocity = self._velocity + change
                impulse = scenario.mass * change
                vectors = (tuple(map(float, vector)) for vector in (self._position, normal, impulse))
                impacts.append(Impact(self._steps * period, wall, "puck", *vectors, float(speed)))
        return impacts

    def state(self) -> np.ndarray:
        """Return x, y, vx, vy, heading, omega, shape (1, 6)."""
        return np.array([[*self._position, *self._velocity, 0.0, 0.0]])

    def kinetic_energy(self) -> float:
        return self.scenario.mass * math.hypot(*self._velocity) ** 2 / 2

"""PD control of the puck to its goal."""

from __future__ import annotations

import numpy as np
from impact_envs.point_mass.schema import PointMassScenario

from impact_envs.rollout import Diagnostics

STIFFNESS, DAMPING = 4.0, 5.0  # [N/m], [N s/m]


class PointMassExpert:
    """A Policy without plan, variants, options or corrections."""

    def __init__(self, scenario: PointMassScenario, variant: None = None) -> None:
        self.name = "expert"
        self._goal, self._limit = np.array(scenario.goal), scenario.force_limit

    def reset(self, seed: int) -> None:
        pass

    def act(self, observations: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        x, v = observations["puck"][:2], observations["puck"][2:4]
        force = STIFFNESS * (self._goal - x) - DAMPING * v
        return {"puck": np.clip(force / self._limit, -1.0, 1.0)}

    def diagnostics(self) -> Diagnostics:
        return Diagnostics()

"""The oracle as a policy: the evaluation draws the truth of an episode as the environment does, and hands it over."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium.utils import seeding

from impact_envs.rollout import Diagnostics
from impact_envs.scenario import Scenario
from planners import make_oracle
from planners.plan import Plan


class OraclePolicy:
    """The expert that is told the true physics of every episode.

    Args:
        scenario: with its true physics.
        plan: to follow; planned now without.
        options: of the expert, see planners.make_expert.

    Attributes:
        name: of the policy.
        expert: that is told.

    Raises:
        InputError, PlanningError: see planners.make_oracle.
    """

    name = "oracle"

    def __init__(self, scenario: Scenario, plan: Plan | None = None, options: Mapping[str, Any] | None = None) -> None:
        self._scenario: Any = scenario
        self.expert = make_oracle(scenario, plan, options)

    def reset(self, seed: int) -> None:
        """Forget the last episode, and tell the truth of the one with this seed."""
        self.expert.reset(seed)
        self.expert.tell(self._scenario.draw(seeding.np_random(seed)[0]))

    def act(self, observations: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Return each robot's action."""
        return self.expert.act(observations)

    def diagnostics(self) -> Diagnostics:
        """Return what the expert did since reset."""
        return self.expert.diagnostics()

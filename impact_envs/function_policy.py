"""Policies made of one function: what a trained network needs to be a Policy, and no more."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from impact_envs.domain import find_part
from impact_envs.errors import InputError
from impact_envs.interface.agent_vectors import read_vector
from impact_envs.rollout import Diagnostics
from impact_envs.scenario import Scenario, load_scenario

Act = Callable[[np.ndarray], Any]


class SharedPolicy:
    """One function that every agent shares: from an agent's own observation, as ImpactEnv's, to its action.

    Args:
        act: observation, shape (size,), to action in [-1, 1]; numbers beyond are clipped by the environment.
        name: of the policy.
    """

    def __init__(self, act: Act, name: str = "shared") -> None:
        self._act, self.name = act, name
        self._seconds: list[float] = []

    def reset(self, seed: int) -> None:
        """Forget how long the last episode's actions took; the function is without memory."""
        self._seconds = []

    def act(self, observations: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Return each agent's action."""
        start = time.perf_counter()
        actions = self._choose(observations)
        self._seconds.append(time.perf_counter() - start)
        return actions

    def diagnostics(self) -> Diagnostics:
        """Return how long each control step took."""
        return Diagnostics(solve_seconds=list(self._seconds))

    def _choose(self, observations: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        return {agent: np.asarray(self._act(observation), float) for agent, observation in observations.items()}


class JointPolicy(SharedPolicy):
    """One function for all agents together: from the observation of ``gymnasium.make`` to its action.

    Args:
        act: joint observation to joint action, both as JointEnv's.
        scenario: a shipped name, the path of a TOML file, or a Scenario.
        name: of the policy.

    Raises:
        InputError: the scenario's domain does not say how its agents' observations are joined.
    """

    def __init__(self, act: Act, scenario: str | Path | Scenario, name: str = "joint") -> None:
        super().__init__(act, name)
        self._scenario = loaded = load_scenario(scenario)
        self._join = find_part("impact_envs", loaded.domain, "JOIN")
        task = find_part("impact_envs", loaded.domain, "TASK")(loaded)
        self._joint = np.zeros(task.joint_observation_space.shape)
        if self._join is None and task.observation_spaces[loaded.agents[0]].shape != self._joint.shape:
            raise InputError(f"domain '{loaded.domain}' does not say how the observations of its agents are joined")
        sizes = [task.action_spaces[agent].shape[0] for agent in loaded.agents]
        ends = itertools.accumulate(sizes, initial=0)
        self._parts = dict(zip(loaded.agents, itertools.starmap(slice, itertools.pairwise(ends)), strict=True))
        self._size = sum(sizes)

    def _choose(self, observations: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        if self._join is None:  # every agent observes everything
            self._joint[:] = next(iter(observations.values()))
        else:
            self._join(self._scenario, observations, self._joint)
        action = read_vector(self._act(self._joint.copy()), self._size, "joint action")
        return {agent: action[part] for agent, part in self._parts.items()}

"""All agents seen as one, for single-agent learners and ``gymnasium.make``."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.envs.registration import EnvSpec
from gymnasium.spaces import Box

from impact_envs.env import parallel_env
from impact_envs.interface.agent_vectors import read_vector
from impact_envs.reward import ROBUSTNESS
from impact_envs.scenario import Scenario, load_scenario
from impact_envs.stream import check_seed


class JointEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """ImpactEnv with one action and one observation.

    Action space: ``Box(-1, 1)``, the agents' actions one after another in scenario order.

    Observation space: everything measured once (bodies in scenario order, contacts, time / horizon, robustness
    interval of each conjunct of the formula; ``env.unwrapped.parallel.task.joint_layout.describe()``).

    Rewards, starting state, episode end: as ImpactEnv; the reward is the sum over agents. ``max_cycles`` cuts an
    episode, and its last info has the verdict; Gymnasium's ``max_episode_steps`` cuts from outside, without one.

    Args:
        scenario, render_mode, max_cycles, reward: see `parallel_env`.
        suite: mismatch suite of the true world; what is believed stays.
    """

    metadata = {"render_modes": ["human", "rgb_array"], "render_fps": 30}

    def __init__(
        self,
        scenario: str | Path | Scenario,
        render_mode: str | None = None,
        max_cycles: int | None = None,
        reward: str = ROBUSTNESS,
        suite: str = "nominal",
    ) -> None:
        self._spec: EnvSpec | None = None
        loaded = load_scenario(scenario)
        chosen = loaded if suite == "nominal" else loaded.suite(suite)
        self.parallel = parallel_env(chosen, render_mode, max_cycles, reward)
        self.render_mode = render_mode
        sizes = [self.parallel.action_space(agent).shape[0] for agent in self.parallel.possible_agents]
        *starts, size = itertools.accumulate(sizes, initial=0)
        self._parts = [slice(*ends) for ends in itertools.pairwise([*starts, size])]
        self.action_space = Box(-1.0, 1.0, (size,), np.float32)
        self.observation_space = self.parallel.task.joint_observation_space

    @property
    def spec(self) -> EnvSpec | None:
        """Return Gymnasium's specification, with the length of an episode, which truncates itself without TimeLimit."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        if spec is not None and spec.max_episode_steps is None:
            spec.max_episode_steps = self._max_episode_steps
        self._spec = spec

    @property
    def _max_episode_steps(self) -> int:
        """Return the length of an episode, under the name by which LeRobot asks for it."""
        return min(self.parallel.max_cycles, self.parallel.scenario.steps)

    @property
    def task(self) -> str:
        """Return the name of what is asked."""
        return self.parallel.scenario.name

    @property
    def task_description(self) -> str:
        """Return what is asked, in a sentence."""
        return self.parallel.scenario.description

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Draw a world and start; see ImpactEnv.reset."""
        super().reset(seed=None if seed is None else check_seed(seed))
        _, infos = self.parallel.reset(seed=seed, options=options)
        return self._observe(), next(iter(infos.values()))

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Hold all agents' actions for one control period; see ImpactEnv.step."""
        agents = self.parallel.possible_agents
        action = read_vector(action, self._parts[-1].stop, "action", finite=False)
        actions = {agent: action[part] for agent, part in zip(agents, self._parts, strict=True)}
        _, rewards, terminations, truncations, infos = self.parallel.step(actions)
        first, total = agents[0], 0.0
        for reward in rewards.values():  # sum() rounds differently from one Python to the next
            total += reward
        return (
            self._observe(),
            total,
            terminations[first],
            truncations[first],
            infos[first],
        )

    def render(self) -> np.ndarray | None:
        """Draw the present step; see ImpactEnv.render."""
        return self.parallel.render()

    def close(self) -> None:
        """Close the window, if there is one."""
        self.parallel.close()

    def _observe(self) -> np.ndarray:
        return self.parallel.task.observe_jointly(self.parallel.time, self.parallel.conjuncts)

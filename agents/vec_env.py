"""Many worlds as a Stable-Baselines3 ``VecEnv``: one policy for all robots together, or one that every robot shares."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode

from agents.compiled_vec_env import CompiledVecEnv
from agents.residual_vector import ResidualVectorEnv
from impact_envs.reward import ROBUSTNESS
from impact_envs.scenario import Scenario
from impact_envs.vector import vector_env
from planners.plan import Plan


class ImpactVecEnv(CompiledVecEnv):
    """ImpactVectorEnv for SB3: a world whose episode ended starts the next one in the same step.

    Environment k is world k, seen as JointEnv. With ``per_robot``, robot i of world w is environment
    ``w * robots + i``, seen as its agent in ImpactEnv: PPO or SAC then learn one policy that all robots share.

    ``infos[k]`` is empty except at the end of an episode: ``terminal_observation`` (its last one, not the next
    episode's first), ``TimeLimit.truncated`` (whether ``max_cycles`` cut: the learner adds the value of the last
    observation; at the horizon the formula is decided, and nothing follows),
    ``episode`` (return ``r``, length ``l`` and seconds since ``reset`` ``t``, as SB3's Monitor), ``robustness``,
    ``success``, and ``is_success``, of which SB3 logs the rate.

    Args:
        scenario: a shipped name, the path of a TOML file, or a Scenario; free-flyers are discs.
        num_worlds: how many worlds.
        per_robot: one environment per robot rather than per world.
        max_cycles: truncate earlier than the horizon [control periods].
        dtype: of observations and of what the worlds store.
        threads: number that share the worlds; default: all cores.
        reward: ``robustness`` (learn with gamma 1) or, for free-flyers, ``progress`` (.999); see ImpactEnv.

    Raises:
        ScenarioError: the scenario cannot be read.
        InputError: polygons, another domain, or more worlds than fit into memory.
    """

    def __init__(
        self,
        scenario: str | Path | Scenario,
        num_worlds: int = 1,
        per_robot: bool = False,
        max_cycles: int | None = None,
        dtype: Literal["float64", "float32"] = "float32",
        threads: int | None = None,
        reward: str = ROBUSTNESS,
    ) -> None:
        worlds = vector_env(
            scenario,
            num_worlds,
            autoreset_mode=AutoresetMode.SAME_STEP,
            max_cycles=max_cycles,
            dtype=dtype,
            threads=threads,
            per_robot=per_robot,
            reward=reward,
        )
        self.per_robot, batch = per_robot, worlds.batch
        if per_robot:
            observation = Box(-np.inf, np.inf, (batch.agent_size,), batch.dtype)
            super().__init__(worlds, batch.robots, observation, Box(-1.0, 1.0, (3,), np.float32))
        else:
            super().__init__(worlds, 1, worlds.single_observation_space, worlds.single_action_space)

    def reset(self) -> np.ndarray:
        """Start an episode in every world, with the seeds given to ``seed`` since the last reset.

        Returns:
            Observations, shape (num_envs, size).
        """
        return self._view(self._start_worlds(), "agent_observations")

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Step all worlds.

        Returns:
            Observations, shape (num_envs, size); rewards and ends, shape (num_envs,); infos.

        Raises:
            InputError: before ``step_async``, or an action that is not finite.
        """
        observations, rewards, failed, cut, worlds = self.worlds.step(self._take_actions())
        rewards, observations = self._view(rewards, "agent_rewards"), self._view(observations, "agent_observations")
        final = worlds.get("final_agent_obs" if self.per_robot else "final_obs", observations)
        ended, infos = self._describe(failed | cut, rewards, 1, final.reshape(self.num_envs, -1), worlds)
        return observations, rewards, ended, infos

    def _view(self, of_worlds: np.ndarray, of_robots: str) -> np.ndarray:
        """Return the worlds' array, or the robots' with one row per robot."""
        if not self.per_robot:
            return of_worlds
        array = getattr(self.worlds, of_robots)
        return array.reshape(self.num_envs, *array.shape[2:])


class ResidualVecEnv(CompiledVecEnv):
    """ResidualVectorEnv for SB3: one step is one decision of every world, environment k is world k.

    Infos as ImpactVecEnv's; lengths of episodes are in control periods.

    Args:
        scenario: a shipped name, the path of a TOML file, or a Scenario.
        num_worlds: how many worlds.
        suite: mismatch suite of the true world.
        plan: for the experts to follow; made if not given.
        options: of the experts, see planners.list_options.
        max_cycles: truncate earlier than the horizon [control periods].
        threads: number that share the worlds; default: all cores.

    Raises:
        ScenarioError, InputError, PlanningError: as ResidualVectorEnv.
    """

    def __init__(
        self,
        scenario: str | Path | Scenario,
        num_worlds: int = 1,
        suite: str = "nominal",
        plan: Plan | None = None,
        options: Mapping[str, Any] | None = None,
        max_cycles: int | None = None,
        threads: int | None = None,
    ) -> None:
        worlds = ResidualVectorEnv(
            scenario, num_worlds, suite, plan, options, AutoresetMode.SAME_STEP, max_cycles, threads
        )
        super().__init__(worlds, 1, worlds.single_observation_space, worlds.single_action_space)

    def reset(self) -> np.ndarray:
        """Start an episode in every world, with the seeds given to ``seed`` since the last reset.

        Returns:
            Features, shape (num_envs, feature_size).
        """
        return self._start_worlds()

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Answer every world's correction, and run each to its next one.

        Returns:
            Features, shape (num_envs, feature_size); rewards and ends, shape (num_envs,); infos.

        Raises:
            InputError: before ``step_async``, or an action that is not finite.
        """
        features, rewards, failed, cut, worlds = self.worlds.step(self._take_actions())
        last = worlds.get("final_info", worlds)
        ended, infos = self._describe(
            failed | cut, rewards, last["control_steps"], worlds.get("final_obs", features), worlds
        )
        return features, rewards, ended, infos

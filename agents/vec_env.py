"""Many worlds as a Stable-Baselines3 ``VecEnv``: one policy for all robots together, or one that every robot shares."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecEnv

from impact_envs.errors import InputError, choices
from impact_envs.scenario import Scenario
from impact_envs.vector import vector_env


class ImpactVecEnv(VecEnv):
    """ImpactVectorEnv for SB3: a world whose episode ended starts the next one in the same step.

    Environment k is world k, seen as JointEnv. With ``per_robot``, robot i of world w is environment
    ``w * robots + i``, seen as its agent in ImpactEnv: PPO or SAC then learn one policy that all robots share.

    ``infos[k]`` is empty except at the end of an episode: ``terminal_observation`` (its last one, not the next
    episode's first), ``TimeLimit.truncated`` (always true: the learner adds the value of the last observation),
    ``episode`` (return ``r``, length ``l`` and seconds since ``reset`` ``t``, as SB3's Monitor), ``robustness``,
    ``success``, and ``is_success``, of which SB3 logs the rate.

    Args:
        scenario: a shipped name, the path of a TOML file, or a Scenario; of discs.
        num_worlds: how many worlds.
        per_robot: one environment per robot rather than per world.
        max_cycles: truncate earlier than the horizon [control periods].
        dtype: of observations and of what the worlds store.
        threads: number that share the worlds; default: all cores.

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
    ) -> None:
        self.worlds = vector_env(
            scenario,
            num_worlds,
            autoreset_mode=AutoresetMode.SAME_STEP,
            max_cycles=max_cycles,
            dtype=dtype,
            threads=threads,
            per_robot=per_robot,
        )
        self.scenario, self.per_robot = self.worlds.scenario, per_robot
        observation, action = self.worlds.single_observation_space, self.worlds.single_action_space
        self.envs_per_world = 1
        if per_robot:
            batch = self.worlds.batch
            self.envs_per_world = batch.robots
            observation = Box(-np.inf, np.inf, (batch.agent_size,), batch.dtype)
            action = Box(-1.0, 1.0, (3,), np.float32)
        self._shared = {
            "render_mode": None,
            "scenario": self.scenario,
            "observation_space": observation,
            "action_space": action,
        }
        super().__init__(num_worlds * self.envs_per_world, observation, action)
        self._actions: np.ndarray | None = None
        self._forget()

    def reset(self) -> np.ndarray:
        """Start an episode in every world, with the seeds given to ``seed`` since the last reset.

        Returns:
            Observations, shape (num_envs, size).
        """
        first = self._seeds[0]
        observations, _ = self.worlds.reset(seed=first)
        self._reset_seeds()
        self._forget()
        return self._view(observations, "agent_observations")

    def step_async(self, actions: np.ndarray) -> None:
        """Store the actions of the next step.

        Args:
            actions: in [-1, 1], shape (num_envs, 3 robots), or (num_envs, 3) per robot.

        Raises:
            InputError: another shape.
        """
        shape = (self.num_envs, *self.action_space.shape)  # type: ignore[misc]
        if np.shape(actions) != shape:
            raise InputError(f"actions have shape {np.shape(actions)}; {shape} is needed")
        self._actions = np.reshape(actions, (self.worlds.num_envs, -1))

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Step all worlds.

        Returns:
            Observations, shape (num_envs, size); rewards and ends, shape (num_envs,); infos.

        Raises:
            InputError: before ``step_async``, or an action that is not finite.
        """
        if self._actions is None:
            raise InputError("step_wait before step_async: call step_async or step first")
        actions, self._actions = self._actions, None
        observations, rewards, failed, cut, worlds = self.worlds.step(actions)
        over = failed | cut
        rewards = self._view(rewards, "agent_rewards")
        self._returns += rewards
        self._lengths += 1
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        ended = np.repeat(over, self.envs_per_world)
        if over.any():
            self._describe_ends(np.flatnonzero(ended), worlds, infos)
            self._returns[ended] = 0.0
            self._lengths[ended] = 0
        return self._view(observations, "agent_observations"), rewards, ended, infos

    def close(self) -> None:
        """Close the worlds."""
        self.worlds.close()

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Seed the worlds at the next reset; their generators continue after it.

        Args:
            seed: of world 0, world w gets seed + w; default: drawn at random.

        Returns:
            The seed of each environment's world.
        """
        if seed is None:
            seed = int(np.random.SeedSequence().generate_state(1)[0])
        self._seeds = [seed + k // self.envs_per_world for k in range(self.num_envs)]
        return self._seeds

    def set_options(self, options: list[dict[str, Any]] | dict[str, Any] | None = None) -> None:
        """Refuse options: a reset has none.

        Raises:
            InputError: an option.
        """
        if options and any(options if isinstance(options, list) else [options]):
            raise InputError(f"options {options}: a reset takes none; change the scenario instead")

    def get_attr(self, attr_name: str, indices: int | Iterable[int] | None = None) -> list[Any]:
        """Return what all environments share: ``scenario``, ``observation_space``, ``action_space``, ``render_mode``.

        Raises:
            AttributeError: another name; there is no environment object per world to have it.
        """
        if attr_name not in self._shared:
            raise AttributeError(f"worlds have no attribute '{attr_name}'; {choices(attr_name, self._shared)}")
        return [self._shared[attr_name] for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: int | Iterable[int] | None = None) -> None:
        """Refuse: there is no environment object per world.

        Raises:
            InputError: always.
        """
        raise InputError(f"attribute '{attr_name}' of single worlds cannot be set; make worlds of another scenario")

    def env_method(
        self, method_name: str, *method_args: Any, indices: int | Iterable[int] | None = None, **method_kwargs: Any
    ) -> list[Any]:
        """Refuse: there is no environment object per world.

        Raises:
            InputError: always.
        """
        raise InputError(f"method '{method_name}' of single worlds cannot be called; use JointEnv or ImpactEnv")

    def env_is_wrapped(self, wrapper_class: type[Any], indices: int | Iterable[int] | None = None) -> list[bool]:
        """Return whether each environment does the work of a wrapper; true for SB3's Monitor only."""
        return [wrapper_class is Monitor for _ in self._get_indices(indices)]

    def _view(self, of_worlds: np.ndarray, of_robots: str) -> np.ndarray:
        """Return the worlds' array, or the robots' with one row per robot."""
        if not self.per_robot:
            return of_worlds
        array = getattr(self.worlds, of_robots)
        return array.reshape(self.num_envs, *array.shape[2:])

    def _forget(self) -> None:
        self._returns, self._lengths = np.zeros(self.num_envs), np.zeros(self.num_envs, np.int64)
        self._actions = None
        self._start = time.time()

    def _describe_ends(self, ended: np.ndarray, worlds: dict[str, Any], infos: list[dict[str, Any]]) -> None:
        """Fill the infos of the environments whose episode ended."""
        last = worlds["final_agent_obs" if self.per_robot else "final_obs"].reshape(self.num_envs, -1)
        seconds = round(time.time() - self._start, 6)
        returns, lengths = self._returns.tolist(), self._lengths.tolist()
        failed = np.repeat(worlds.get("_failure", np.zeros(self.worlds.num_envs, bool)), self.envs_per_world)
        for k in ended.tolist():
            success = bool(worlds["success"][k // self.envs_per_world])
            infos[k] = {
                "terminal_observation": last[k],
                "TimeLimit.truncated": not failed[k],
                "episode": {"r": round(returns[k], 6), "l": lengths[k], "t": seconds},
                "robustness": float(worlds["robustness"][k // self.envs_per_world]),
                "success": success,
                "is_success": success,
            }

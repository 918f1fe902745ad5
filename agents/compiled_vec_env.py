"""What SB3 asks of a ``VecEnv`` and worlds of a compiled batch have in common: no environment object per world."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from gymnasium.spaces import Space
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecEnv

from agents.residual_vector import ResidualVectorEnv
from impact_envs.errors import InputError, choices
from impact_envs.interface.agent_vectors import REAL
from impact_envs.observation import Layout
from impact_envs.stream import check_seed
from impact_envs.vector import ImpactVectorEnv


class CompiledVecEnv(VecEnv):
    """Worlds behind ``VecEnv`` that start the next episode in the step that ends one.

    Args:
        worlds: with autoreset in the same step.
        per_world: environments of a world; environment k belongs to world k // per_world.
        observation, action: spaces of an environment.
    """

    _returns: np.ndarray
    _lengths: np.ndarray
    _actions: np.ndarray | None

    def __init__(
        self, worlds: ImpactVectorEnv | ResidualVectorEnv, per_world: int, observation: Space[Any], action: Space[Any]
    ) -> None:
        self.worlds: Any = worlds
        self.scenario, self.envs_per_world = self.worlds.scenario, per_world
        self._shared = {
            "render_mode": None,
            "scenario": self.scenario,
            "observation_space": observation,
            "action_space": action,
        }
        super().__init__(worlds.num_envs * per_world, observation, action)
        self._forget()

    def step_async(self, actions: np.ndarray) -> None:
        """Store the actions of the next step.

        Args:
            actions: in [-1, 1], shape (num_envs, 3 robots), or (num_envs, 3) per robot.

        Raises:
            InputError: another shape, or no numbers.
        """
        shape = (self.num_envs, *self.action_space.shape)  # type: ignore[misc]
        needed = f"real numbers of shape {shape} are needed"
        try:
            given = np.asarray(actions)
        except ValueError:
            raise InputError(f"actions have different lengths; {needed}") from None
        if given.shape != shape or given.dtype.kind not in REAL:
            raise InputError(f"actions have shape {given.shape}, {given.dtype}; {needed}")
        self._actions = given.reshape(self.worlds.num_envs, -1)

    def close(self) -> None:
        """Close the worlds."""
        self.worlds.close()

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Seed the worlds at the next reset; their generators continue after it.

        Args:
            seed: of world 0, world w gets seed + w; default: drawn at random.

        Returns:
            The seed of each environment's world.

        Raises:
            InputError: a seed that is none.
        """
        if seed is None:
            seed = int(np.random.SeedSequence().generate_state(1)[0])
        seed = check_seed(seed)
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

    def state(self, secrets: bool = False) -> np.ndarray:
        """Return the truth of each environment's world, as ``ImpactEnv.state``, shape (num_envs, size).

        Args:
            secrets: add the drawn physics, and what the formula remembers; no expert may see them.
        """
        return np.repeat(self.worlds.state(secrets), self.envs_per_world, axis=0)

    def state_layout(self, secrets: bool = False) -> Layout:
        """Return what stands where in ``state(secrets)``."""
        return self.worlds.state_layout(secrets)

    def _start_worlds(self) -> np.ndarray:
        """Start an episode in every world, with the seeds that were given; return observations."""
        observations, infos = self.worlds.reset(seed=self._seeds[0])
        self._reset_seeds()
        self._forget()
        self._lengths += infos.get("control_steps", 0)
        return observations

    def _take_actions(self) -> np.ndarray:
        """Return what ``step_async`` stored.

        Raises:
            InputError: before ``step_async``.
        """
        if self._actions is None:
            raise InputError("step_wait before step_async: call step_async or step first")
        actions, self._actions = self._actions, None
        return actions

    def _describe(
        self, over: np.ndarray, rewards: np.ndarray, lengths: np.ndarray | int, last: np.ndarray, worlds: dict[str, Any]
    ) -> tuple[np.ndarray, list[dict[str, Any]]]:
        """Return the ends and infos of all environments, empty except at the end of an episode.

        Args:
            over: worlds whose episode ended, shape (worlds,).
            rewards: of this step, shape (num_envs,).
            lengths: of this step [control periods], of all or of each environment.
            last: observations of the ends, shape (num_envs, size).
            worlds: the worlds' infos.
        """
        self._returns += rewards
        self._lengths += lengths
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        ended = np.repeat(over, self.envs_per_world)
        seconds = round(time.time() - self._start, 6)
        for k in np.flatnonzero(ended).tolist():
            world = k // self.envs_per_world
            success = bool(worlds["success"][world])
            infos[k] = {
                "terminal_observation": last[k],
                "TimeLimit.truncated": not worlds["decided"][world],
                "episode": {"r": round(float(self._returns[k]), 6), "l": int(self._lengths[k]), "t": seconds},
                "robustness": float(worlds["robustness"][world]),
                "success": success,
                "is_success": success,
            }
        self._returns[ended] = 0.0
        self._lengths = np.where(ended, worlds.get("control_steps", 0), self._lengths)
        return ended, infos

    def _forget(self) -> None:
        self._returns, self._lengths = np.zeros(self.num_envs), np.zeros(self.num_envs, np.int64)
        self._actions = None
        self._start = time.time()

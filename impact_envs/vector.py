"""Many worlds behind ``gymnasium.vector.VectorEnv``: compiled, in one process, without a Python loop over worlds."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from impact_envs.env import EFFORT_WEIGHT
from impact_envs.errors import InputError, choices
from impact_envs.free_flyer.batch import Batch
from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.scenario import Scenario, load_scenario

DTYPES = {"float64": np.float64, "float32": np.float32}


class ImpactVectorEnv(VectorEnv[Any, Any, Any]):
    """JointEnv many times over; world k with seed s + k is JointEnv with that seed, bit for bit in float64.

    Action and observation spaces, rewards, starting state, episode end: as JointEnv.

    Observations, rewards and infos are fresh arrays at every call. ``infos`` carries ``robustness_lower``,
    ``robustness_upper``, ``impacts`` (in the last control period) and ``overflow`` (control periods since reset with
    more events than are followed; 0 unless the engine's rules failed) of every world; where an episode ended also
    ``robustness`` and ``success``, marked by ``_robustness`` and ``_success``; with autoreset in the same step
    ``final_obs``, marked by ``_final_obs``.

    Args:
        scenario: a shipped name, the path of a TOML file, or a Scenario; of discs.
        num_envs: how many worlds.
        autoreset_mode: as Gymnasium defines them: ``NEXT_STEP``, ``SAME_STEP`` or ``DISABLED``.
        max_cycles: truncate earlier than the horizon [control periods].
        dtype: ``float64``, or ``float32`` to store and return less; arithmetic is float64.
        threads: that share the worlds; all cores if not given.
        tensors: take and return torch tensors that share memory with the arrays.
        per_robot: compute each robot's own observation too (``agent_observations``).

    Raises:
        ScenarioError: the scenario cannot be read.
        InputError: polygons, another domain, or more worlds than fit into memory.
    """

    def __init__(
        self,
        scenario: str | Path | Scenario,
        num_envs: int = 1,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        max_cycles: int | None = None,
        dtype: Literal["float64", "float32"] = "float64",
        threads: int | None = None,
        tensors: bool = False,
        per_robot: bool = False,
    ) -> None:
        loaded = load_scenario(scenario)
        if not isinstance(loaded, FreeFlyerScenario) or loaded.engine == "pymunk" or loaded.has_polygons:
            raise InputError(
                f"scenario '{loaded.name}' is not for the exact engine, which takes free-flyers and objects that are "
                "discs; gymnasium.vector.SyncVectorEnv runs every scenario"
            )
        if dtype not in DTYPES:
            raise InputError(f"dtype '{dtype}' is unknown; {choices(dtype, DTYPES)}")
        self.scenario, self.num_envs, self.tensors, self.per_robot = loaded, num_envs, tensors, per_robot
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {"autoreset_mode": self.autoreset_mode}
        threads = threads or len(os.sched_getaffinity(0))
        self.batch = Batch(loaded, num_envs, EFFORT_WEIGHT, max_cycles, DTYPES[dtype], threads)
        size = self.batch.joint_size
        self.single_observation_space = Box(-np.inf, np.inf, (size,), DTYPES[dtype])
        self.single_action_space = Box(-1.0, 1.0, (3 * self.batch.robots,), np.float32)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._output = self.batch.make_output(per_robot)
        self._over = np.zeros(num_envs, bool)
        self._seeded = False

    @property
    def agent_observations(self) -> Any:
        """Return each robot's own observation after the last call, as ImpactEnv's, shape (num_envs, robots, size)."""
        return self._give(self._output.agents)

    @property
    def agent_rewards(self) -> Any:
        """Return each robot's reward of the last step, as ImpactEnv's, shape (num_envs, robots) [m]."""
        return self._give(self._output.rewards)

    def reset(
        self, *, seed: int | Sequence[int] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Draw new worlds and start.

        Args:
            seed: of world 0, world k gets seed + k; or one for each world; without one the worlds' generators go on.
            options: ``reset_mask``, shape (num_envs,) bool, names the worlds to reset; all without.

        Returns:
            Observations and infos of all worlds.

        Raises:
            InputError: a mask or seeds of another shape, or a bad seed.
        """
        mask = self._check_mask((options or {}).get("reset_mask"))
        chosen = np.flatnonzero(mask)
        if seed is None and not self._seeded:
            seed = int(np.random.SeedSequence().entropy) % 2**62  # type: ignore[arg-type]
        if seed is not None:
            seeds = np.arange(seed, seed + self.num_envs) if isinstance(seed, int | np.integer) else np.asarray(seed)
            if seeds.shape != (self.num_envs,):
                raise InputError(f"seed has shape {seeds.shape}; one number, or one for each of {self.num_envs} worlds")
            self.batch.seed(chosen, seeds[chosen])
            self._seeded = True
        output = self._fresh(copy=not mask.all())
        self.batch.start(mask, output)
        self._output = output
        self._over[mask] = False
        return self._give(output.joint), self._infos(np.zeros(self.num_envs, bool))

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Hold the actions for one control period.

        Args:
            actions: in [-1, 1], shape (num_envs, 3 robots), robots in scenario order.

        Returns:
            Observations, rewards (summed over robots), terminations (never), truncations, infos.

        Raises:
            InputError: an action that is no finite number, naming world and robot; before ``reset``; or, without
                autoreset, a world whose episode is over. Nothing was stepped.
        """
        if not self._seeded:
            raise InputError("step before reset: call reset first")
        actions = np.asarray(actions).reshape(self.num_envs, -1, 3)
        if self.autoreset_mode == AutoresetMode.DISABLED and self._over.any():
            world = int(np.argmax(self._over))
            raise InputError(f"the episode of world {world} is over: reset it with options={{'reset_mask': ...}}")
        restart = self._over if self.autoreset_mode == AutoresetMode.NEXT_STEP else None
        output = self._fresh(copy=False)
        self.batch.step(actions, output, restart)
        self._output = output
        over = self.batch.over
        rewards = _sum_rows(output.rewards)
        infos = self._infos(over)
        if self.autoreset_mode == AutoresetMode.SAME_STEP and over.any():
            infos |= {"final_obs": self._give(output.joint.copy()), "_final_obs": self._give(over)}
            if self.per_robot:
                infos |= {"final_agent_obs": self._give(output.agents.copy()), "_final_agent_obs": self._give(over)}
            rewards_of_robots = output.rewards.copy()
            self.batch.start(over, output)
            output.rewards[:] = rewards_of_robots
            self._over = np.zeros(self.num_envs, bool)
        else:
            self._over = over.copy()
        give = self._give
        return give(output.joint), give(rewards), give(np.zeros(self.num_envs, bool)), give(over.copy()), infos

    def _fresh(self, copy: bool) -> Any:
        output = self.batch.make_output(self.per_robot)
        if copy:
            for new, old in zip(output, self._output, strict=True):
                new[:] = old
        return output

    def _infos(self, over: np.ndarray) -> dict[str, Any]:
        low, high = self.batch.bounds.T.copy()
        everywhere = np.ones(self.num_envs, bool)
        values = {
            "robustness_lower": low,
            "robustness_upper": high,
            "impacts": self.batch.impacts.copy(),
            "overflow": self.batch.overflow.copy(),
        }
        infos = values | {f"_{name}": everywhere.copy() for name in values}
        if over.any():
            infos |= {"robustness": np.where(over, low, 0.0), "_robustness": over.copy()}
            infos |= {"success": over & (low > 0), "_success": over.copy()}
        return {name: self._give(value) for name, value in infos.items()}

    def _check_mask(self, mask: Any) -> np.ndarray:
        if mask is None:
            return np.ones(self.num_envs, bool)
        mask = np.asarray(mask)
        if mask.shape != (self.num_envs,) or mask.dtype != bool or not mask.any():
            raise InputError(
                f"reset_mask of shape {mask.shape}, {mask.dtype}: {self.num_envs} truth values are needed, one of them "
                "true at least"
            )
        return mask

    def _give(self, array: np.ndarray) -> Any:
        """Return the array, or a tensor over the same memory."""
        if not self.tensors:
            return array
        import torch

        return torch.from_numpy(array)


def vector_env(scenario: str | Path | Scenario, num_envs: int = 1, **options: Any) -> ImpactVectorEnv:
    """Make many worlds of a scenario, stepped together.

    Args:
        scenario: a shipped name, the path of a TOML file, or a Scenario; of discs.
        num_envs: how many.
        options: see ImpactVectorEnv.

    Returns:
        A gymnasium.vector.VectorEnv.

    Raises:
        ScenarioError: the scenario cannot be read.
        InputError: polygons, another domain, or more worlds than fit into memory.
    """
    return ImpactVectorEnv(scenario, num_envs, **options)


def _sum_rows(rewards: np.ndarray) -> np.ndarray:
    """Return the sum over robots, added in their order as JointEnv does, shape (num_envs,)."""
    total = np.zeros(len(rewards))
    for column in rewards.T:
        total += column
    return total

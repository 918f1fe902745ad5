"""Many worlds behind ``gymnasium.vector.VectorEnv``: compiled, in one process, without a Python loop over worlds."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from impact_envs.domain import find_part
from impact_envs.errors import InputError, ResetNeeded, check_count, choices
from impact_envs.interface.agent_vectors import REAL
from impact_envs.interface.reset import make_seeds, read_mask
from impact_envs.interface.state import make_state_layout, read_state
from impact_envs.observation import Layout
from impact_envs.reward import PROGRESS, ROBUSTNESS, find_rates
from impact_envs.scenario import Scenario, load_scenario
from impact_envs.stl.verdict import judge

DTYPES = {"float64": np.float64, "float32": np.float32}
DEVICES = ("cpu", "cuda")
RENDER_MODES = ("rgb_array",)
# Infos that are there at every call, and their masks, which are true of all worlds.
VALUES = ("robustness_lower", "robustness_upper", "impacts", "overflow", "is_success")
ALWAYS = (*VALUES, *(f"_{name}" for name in VALUES))


class ImpactVectorEnv(VectorEnv[Any, Any, Any]):
    """JointEnv many times over; world k with seed s + k is JointEnv with that seed, bit for bit in float64.

    Action and observation spaces, rewards, starting state, episode end: as JointEnv.

    Observations, rewards and infos are fresh arrays at every call. ``infos`` carries ``robustness_lower``,
    ``robustness_upper``, ``impacts`` (in the last control period), ``overflow`` (1 where impacts did not end within
    it) and ``is_success`` (the formula holds for certain by now) of every world; where an episode ended also
    ``robustness``, ``success`` and ``decided`` (nothing follows: the horizon is reached, or the simulation failed),
    each with its mask, ``_robustness`` for example; where a simulation failed also ``failure``, an array of texts,
    marked by ``_failure``; with autoreset in the same step ``final_obs``, marked by ``_final_obs``, and
    ``final_info``, the infos of the end of all worlds.

    Args:
        scenario: a shipped name, the path of a TOML file, or a Scenario.
        num_envs: how many worlds.
        autoreset_mode: as Gymnasium defines them: ``NEXT_STEP``, ``SAME_STEP`` or ``DISABLED``.
        max_cycles: truncate earlier than the horizon [control periods].
        dtype: ``float64``, or ``float32`` to store and return less; arithmetic is float64.
        threads: that share the worlds; all cores if not given.
        per_robot: compute each robot's own observation too (``agent_observations``).
        device: of the torch tensors that are taken and returned: ``cpu``, where they share memory with the arrays, or
            ``cuda`` for worlds on a GPU; default: NumPy arrays.
        render_mode: ``rgb_array`` to draw the worlds.
        max_episode_steps: what ``gymnasium.make_vec`` calls ``max_cycles``.
        reward: ``robustness`` (learn with gamma 1) or, for free-flyers, ``progress`` (.999); see ImpactEnv.

    Raises:
        ScenarioError: the scenario cannot be read.
        InputError: polygons, a domain without a batched engine, more worlds than fit into memory, or no such device.
    """

    def __init__(
        self,
        scenario: str | Path | Scenario,
        num_envs: int = 1,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        max_cycles: int | None = None,
        dtype: Literal["float64", "float32"] = "float64",
        threads: int | None = None,
        per_robot: bool = False,
        device: Literal["cpu", "cuda"] | None = None,
        render_mode: Literal["rgb_array"] | None = None,
        max_episode_steps: int | None = None,
        reward: str = ROBUSTNESS,
    ) -> None:
        loaded = load_scenario(scenario)
        make_batch = find_part("impact_envs", loaded.domain, "BATCH")
        if make_batch is None:
            raise InputError(
                f"scenario '{loaded.name}': domain '{loaded.domain}' has no batched engine; "
                "gymnasium.vector.SyncVectorEnv runs every scenario"
            )
        find_rates(reward, loaded.domain)
        if render_mode not in (None, *RENDER_MODES):
            raise InputError(f"render_mode '{render_mode}' is unknown; {choices(str(render_mode), RENDER_MODES)}")
        if max_episode_steps is not None:
            if max_cycles is not None:
                raise InputError(f"max_cycles = {max_cycles}, max_episode_steps = {max_episode_steps}: give only one")
            check_count("max_episode_steps", max_episode_steps)
            max_cycles = max_episode_steps
        if dtype not in DTYPES:
            raise InputError(f"dtype '{dtype}' is unknown; {choices(dtype, DTYPES)}")
        if device not in (None, *DEVICES):
            raise InputError(f"device '{device}' is unknown; {choices(device, DEVICES)}")
        self.scenario, self.num_envs, self.per_robot = loaded, num_envs, per_robot
        self.tensors, self.on_gpu = device is not None, device == "cuda"
        modes = [mode.value for mode in AutoresetMode]
        if not isinstance(autoreset_mode, AutoresetMode) and autoreset_mode not in modes:
            raise InputError(f"autoreset_mode '{autoreset_mode}' is unknown; {choices(str(autoreset_mode), modes)}")
        check_count("num_envs", num_envs)
        for name, number in (("threads", threads), ("max_cycles", max_cycles)):
            if number is not None:
                check_count(name, number)
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {"autoreset_mode": self.autoreset_mode, "render_modes": list(RENDER_MODES), "render_fps": 30}
        self.render_mode = render_mode
        self._renderer: Any = None
        threads = threads or len(os.sched_getaffinity(0))
        self.reward, chosen = reward, {} if reward == ROBUSTNESS else {"reward": PROGRESS}  # not of every domain
        self.batch: Any = make_batch(loaded, num_envs, max_cycles, DTYPES[dtype], threads, device or "cpu", **chosen)
        size = self.batch.joint_size
        self.single_observation_space = Box(-np.inf, np.inf, (size,), DTYPES[dtype])
        self.single_action_space = Box(-1.0, 1.0, (math.prod(self.batch.action_shape),), np.float32)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._output = self.batch.make_output(per_robot)
        self._over = self._falses()
        self._zeros = self._take(np.zeros(num_envs))
        self._masks = self._take(np.ones((len(VALUES), num_envs), bool))
        self._started = self._ended = False  # any world, ever; any world in the last step

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
        mask = read_mask(options, self.num_envs, self._started)
        chosen = np.flatnonzero(mask)
        if seed is None and not self._started:
            seed = int(np.random.SeedSequence().entropy) % 2**62  # type: ignore[arg-type]
        if seed is not None:
            self.batch.seed(chosen, make_seeds(seed, self.num_envs, chosen))
            super().reset(seed=int(seed) if np.ndim(seed) == 0 else None)  # type: ignore[arg-type]
        self._started = True
        output = self._fresh(copy=not mask.all())
        self.batch.start(mask, output)
        self._output = output
        self._over &= self._take(~mask)
        return self._give(output.joint), self._infos()

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Hold the actions for one control period.

        Args:
            actions: in [-1, 1], the agents' one after another in scenario order, shape (num_envs, size).

        Returns:
            Observations, rewards (summed over robots), terminations (of failed simulations), truncations, infos.

        Raises:
            ResetNeeded: before ``reset``; or, without autoreset, a world whose episode is over.
            InputError: an action that is no finite number, naming world and robot. Nothing was stepped.
        """
        if not self._started:
            raise ResetNeeded("step before reset: call reset first")
        actions = self._take_actions(actions)
        if tuple(actions.shape) != self.action_space.shape:
            raise InputError(f"actions have shape {tuple(actions.shape)}; {self.action_space.shape} is needed")
        if self.autoreset_mode == AutoresetMode.DISABLED and _is_any(self._over):
            world = self._over.tolist().index(True)
            raise ResetNeeded(
                f"step after the end of the episode of world {world}: reset it with options={{'reset_mask': ...}}"
            )
        restart = self._over if self._ended and self.autoreset_mode == AutoresetMode.NEXT_STEP else None
        output = self._fresh(copy=False)
        self.batch.step(actions.reshape(self.num_envs, *self.batch.action_shape), output, restart)
        self._output = output
        over = self.batch.over
        self._ended = _is_any(over)
        rewards = self._sum_robots(output.rewards)
        infos = self._infos(over if self._ended else None)
        self._over = over
        if self._ended:
            terminations = self.batch.failed
            truncations = over & ~terminations
        else:
            terminations, truncations = self._falses(), self._falses()
        if self._ended and self.autoreset_mode == AutoresetMode.SAME_STEP:
            infos = self._start_over(over, output, infos)
        give = self._give
        return give(output.joint), give(rewards), give(terminations), give(truncations), infos

    def _start_over(self, over: Any, output: Any, infos: dict[str, Any]) -> dict[str, Any]:
        """Start the next episode where one is over; return infos of its start, and of the end."""
        ends = [
            name
            for end in ("robustness", "success", "decided", "failure")
            for name in (end, f"_{end}")
            if name in infos
        ]
        final = {"final_obs": self._give(_copy(output.joint)), "final_info": infos}
        if self.per_robot:
            final |= {"final_agent_obs": self._give(_copy(output.agents))}
        final |= {f"_{name}": self._give(_copy(over)) for name in final}
        rewards = _copy(output.rewards)
        self.batch.start(over, output)
        output.rewards[:] = rewards
        self._over = self._falses()
        return self._infos() | {name: infos[name] for name in ends} | final

    def state(self, secrets: bool = False) -> Any:
        """Return the truth of every world, for centralised critics; ``state_layout`` says what stands where.

        Args:
            secrets: add the drawn physics, and what the formula remembers; no expert may see them.

        Returns:
            World k's as ``ImpactEnv.state``, shape (num_envs, size), float64.

        Raises:
            ResetNeeded: before the first reset.
        """
        if not self._started:
            raise ResetNeeded("state before reset: call reset first")
        return self._give(self._take(read_state(self.batch, secrets)))

    def state_layout(self, secrets: bool = False) -> Layout:
        """Return what stands where in ``state(secrets)``."""
        return make_state_layout(self.batch.task, secrets)

    def render(self) -> tuple[np.ndarray, ...] | None:
        """Draw every world as it is now, without the paths that led there.

        Returns:
            An image of each world, shape (height, width, 3) uint8; None without ``render_mode``.

        Raises:
            ResetNeeded: before the first reset.
        """
        if not self._started:
            raise ResetNeeded("render before reset: call reset first")
        if self.render_mode is None:
            return None
        from impact_envs.picture.render import Frame, Renderer
        from impact_envs.picture.unit import find_unit
        from impact_envs.picture.view import find_view

        scenario: Any = self.scenario
        batch = self.batch
        if self._renderer is None:
            shapes = find_part("impact_envs", scenario.domain, "TASK")(scenario).shapes()
            self._renderer = Renderer(*find_view(scenario), shapes, self.render_mode)
        images, unit = [], find_unit(scenario.specification)
        for steps, states, bounds in zip(*(a.tolist() for a in (batch.steps, batch.states, batch.bounds)), strict=True):
            poses = {body: (s[0], s[1], s[4]) for body, s in zip(scenario.bodies, states, strict=True)}
            time = steps * scenario.control_period
            chains = batch.task.chains(np.array(states))
            frame = Frame(time, poses, chains, robustness=tuple(bounds), unit=unit, caption=scenario.name)
            images.append(self._renderer.draw(frame))
        return tuple(images)

    def close_extras(self, **kwargs: Any) -> None:
        """Let the threads go, and what draws."""
        self.batch.close()
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_renderer": None}

    def _fresh(self, copy: bool) -> Any:
        output = self.batch.make_output(self.per_robot)
        if copy:
            for new, old in zip(output, self._output, strict=True):
                new[:] = old
        return output

    def _infos(self, over: Any = None) -> dict[str, Any]:
        """Return the infos of all worlds; over says which episodes ended, if any did."""
        batch = self.batch
        low, high = _copy(batch.bounds.T)
        values = (low, high, _copy(batch.impacts), _copy(batch.overflow), batch.outcome > 0, *_copy(self._masks))
        infos = dict(zip(ALWAYS, values, strict=True))
        if over is not None:
            robustness, success = judge(batch.outcome)
            infos |= {"robustness": robustness * over, "_robustness": _copy(over)}
            infos |= {"success": success & over, "_success": _copy(over)}
            infos |= {"decided": batch.decided & over, "_decided": _copy(over)}
        failed = batch.failed if over is not None else None
        if self.tensors:
            infos = {name: self._give(value) for name, value in infos.items()}
        if failed is not None and failed.any():
            infos |= {"failure": batch.describe_failures(), "_failure": self._give(failed)}
        return infos

    def _take_actions(self, actions: Any) -> Any:
        """Return actions as the batch takes them, unless they are no real numbers."""
        try:
            taken = self._take(actions)
        except (ValueError, TypeError, RuntimeError):  # text, or of different lengths
            taken = np.empty(0, object)
        if not (taken.is_complex() if self.on_gpu and hasattr(taken, "is_complex") else taken.dtype.kind not in REAL):
            return taken
        raise InputError(f"actions: real numbers of shape {self.action_space.shape} are needed")

    def _take(self, values: Any) -> Any:
        """Return what a caller gives as the batch takes it."""
        if not self.on_gpu:
            return np.asarray(values)
        import torch

        return torch.as_tensor(values, device=self.batch.device)

    def _give(self, array: Any) -> Any:
        """Return an array, or a tensor over the same memory."""
        if self.on_gpu or not self.tensors:
            return array
        import torch

        return torch.from_numpy(array)

    def _falses(self) -> Any:
        falses = np.zeros(self.num_envs, bool)
        return self._take(falses) if self.on_gpu else falses

    def _sum_robots(self, rewards: Any) -> Any:
        """Return the sum over robots in float64, added in their order as JointEnv does, shape (num_envs,)."""
        total = self._zeros
        for robot in range(self.batch.robots):
            total = total + rewards[:, robot]
        return total


def vector_env(scenario: str | Path | Scenario, num_envs: int = 1, **options: Any) -> ImpactVectorEnv:
    """Make many worlds of a scenario, stepped together.

    Args:
        scenario: a shipped name, the path of a TOML file, or a Scenario.
        num_envs: how many.
        options: see ImpactVectorEnv.

    Returns:
        A gymnasium.vector.VectorEnv.

    Raises:
        ScenarioError: the scenario cannot be read.
        InputError: polygons, a domain without a batched engine, or more worlds than fit into memory.
    """
    return ImpactVectorEnv(scenario, num_envs, **options)


def _is_any(mask: Any) -> bool:
    """Return whether any world is marked; NumPy counts those of a few worlds in a tenth of the time of ``any``."""
    return bool(np.count_nonzero(mask) if isinstance(mask, np.ndarray) else mask.any())


def _copy(array: Any) -> Any:
    return array.copy() if isinstance(array, np.ndarray) else array.clone()

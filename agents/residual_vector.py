"""Many residual environments behind ``gymnasium.vector.VectorEnv``: one step is one decision of every world."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.spaces import Box
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from agents.decisions import Decisions
from agents.residual import TRAINING_SEEDS
from impact_envs.domain import find_part, list_domains
from impact_envs.errors import InputError, ResetNeeded, check_count, choices
from impact_envs.interface.agent_vectors import REAL
from impact_envs.interface.reset import make_seeds, read_mask
from impact_envs.interface.state import make_state_layout, read_state
from impact_envs.observation import Layout
from impact_envs.scenario import Scenario, load_scenario
from planners import make_expert_batch
from planners.plan import Plan

ALWAYS = ("seed", "control_steps", "is_success")  # infos that are there at every call


class ResidualVectorEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """ResidualEnv many times over: one step is one decision of every world, however long each takes (semi-Markov).

    World k with seed s + k is ResidualEnv with that seed, bit for bit: features, rewards, robustness. Physics, sensors,
    formula and expert of all worlds run in one compiled call, each world to its next awaited correction or its end.

    Action space, observation space, rewards, starting state, episode end: as ResidualEnv, of each world.

    ``infos`` carries ``seed``, ``control_steps`` (in this step) and ``is_success`` of every world; where an episode
    ended also ``robustness``, ``success``, ``decided`` (a learner has nothing to bootstrap) and, where a simulation
    failed, ``failure``, each with its mask; with autoreset in the same step ``final_obs`` and ``final_info``. Ctrl-C is
    answered within a second; then reset all worlds.

    Args:
        scenario: a shipped name, the path of a TOML file, or a Scenario.
        num_envs: how many worlds.
        suite: mismatch suite of the true world; the experts' beliefs stay.
        plan: for the experts to follow; made from the believed scenario if not given.
        options: of the experts, see planners.list_options, for example ``{"plan_anew": False}``.
        autoreset_mode: as Gymnasium defines them: ``NEXT_STEP``, ``SAME_STEP`` or ``DISABLED``.
        max_cycles: truncate earlier than the horizon [control periods].
        threads: that share the worlds; all cores if not given.
        render_mode: None; these worlds are not drawn.
        max_episode_steps: what ``gymnasium.make_vec`` calls ``max_cycles``, in control periods, too.
        variant: of the experts, see planners.list_variants.

    Raises:
        ScenarioError: the scenario or the suite is unknown.
        InputError: a domain or a scenario without a batched engine, an unknown option.
        PlanningError: the expert found no plan.
    """

    def __init__(
        self,
        scenario: str | Path | Scenario,
        num_envs: int = 1,
        suite: str = "nominal",
        plan: Plan | None = None,
        options: Mapping[str, Any] | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        max_cycles: int | None = None,
        threads: int | None = None,
        render_mode: None = None,
        max_episode_steps: int | None = None,
        variant: str | None = None,
    ) -> None:
        if render_mode is not None:
            raise InputError(
                f"render_mode '{render_mode}': decisions of many worlds are not drawn; "
                "gymnasium.make_vec(..., vectorization_mode='sync') draws each world"
            )
        if max_episode_steps is not None:
            if max_cycles is not None:
                raise InputError(f"max_cycles = {max_cycles}, max_episode_steps = {max_episode_steps}: give only one")
            check_count("max_episode_steps", max_episode_steps)
            max_cycles = max_episode_steps
        loaded = load_scenario(scenario).suite(suite)
        make_loop = find_part("agents", loaded.domain, "LOOP")
        if make_loop is None:
            able = [name for name in list_domains() if find_part("agents", name, "LOOP")]
            raise InputError(
                f"scenario '{loaded.name}': domain '{loaded.domain}' has no compiled loop; domains that have one: "
                f"{', '.join(able)}; gymnasium.vector.SyncVectorEnv runs ResidualEnv of every scenario"
            )
        modes = [mode.value for mode in AutoresetMode]
        if not isinstance(autoreset_mode, AutoresetMode) and autoreset_mode not in modes:
            raise InputError(f"autoreset_mode '{autoreset_mode}' is unknown; {choices(str(autoreset_mode), modes)}")
        check_count("num_envs", num_envs)
        for name, number in (("threads", threads), ("max_cycles", max_cycles)):
            if number is not None:
                check_count(name, number)
        self.scenario, self.num_envs = loaded, num_envs
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {"autoreset_mode": self.autoreset_mode}
        threads = threads or len(os.sched_getaffinity(0))
        self.experts = make_expert_batch(loaded, num_envs, plan, variant, options, threads)
        make_batch = find_part("impact_envs", loaded.domain, "BATCH")
        self.batch = make_batch(loaded, num_envs, max_cycles, threads=self.experts.threads)
        self.decisions = Decisions(self.batch, self.experts, make_loop)
        self.single_action_space = Box(-1.0, 1.0, (self.experts.correction_size,), np.float32)
        self.single_observation_space = Box(-np.inf, np.inf, (self.experts.feature_size,), np.float64)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self._generators: list[np.random.Generator] = []
        self._seeds = np.zeros(num_envs, np.int64)
        self._over = np.zeros(num_envs, bool)  # episodes whose end was returned
        self._started = False

    def reset(
        self, *, seed: int | Sequence[int] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start episodes and run them to the first awaited correction.

        Args:
            seed: of world 0's episode, world k gets seed + k; or one for each world; without one every world draws the
                seed of its episode below 1,000,000 from its generator, which the last given seed initialised.
            options: ``reset_mask``, shape (num_envs,) bool, names the worlds to reset; all without.

        Returns:
            Features, shape (num_envs, feature_size), and infos of all worlds.

        Raises:
            InputError: a mask or seeds of another shape, or a bad seed.
        """
        mask = read_mask(options, self.num_envs, self._started)
        if seed is not None:
            chosen = np.flatnonzero(mask)
            self._seeds[chosen] = make_seeds(seed, self.num_envs, chosen)
            super().reset(seed=int(self._seeds[0]))
            self._generators = self._generators or [seeding.np_random()[0] for _ in range(self.num_envs)]
            for k in chosen.tolist():
                self._generators[k] = seeding.np_random(int(self._seeds[k]))[0]
        else:
            self._generators = self._generators or [seeding.np_random()[0] for _ in range(self.num_envs)]
            self._draw_seeds(mask)
        self._start(mask)
        return self.experts.features(), self._infos()

    def step(self, actions: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Answer the correction that every world awaits, and run each to its next one, or to its end.

        Args:
            actions: corrections in [-1, 1], shape (num_envs, correction_size).

        Returns:
            Features, rewards [m], terminations (of failed simulations), truncations, infos. Where no correction was
            ever awaited, the first step only returns the episode's reward.

        Raises:
            ResetNeeded: before ``reset``; or, without autoreset, a world whose episode is over.
            InputError: an action that is no finite number, naming the world. Nothing was stepped.
        """
        if not self._started:
            raise ResetNeeded("step before reset: call reset first")
        corrections, decisions = self._check_actions(actions), self.decisions
        if self.autoreset_mode == AutoresetMode.DISABLED and self._over.any():
            raise ResetNeeded(
                f"step after the end of the episode of world {int(np.argmax(self._over))}: reset it with "
                "options={'reset_mask': ...}"
            )
        restart, running = self._over, decisions.awaiting_correction
        self._started = False  # unless all goes well: whoever interrupts leaves worlds at different times
        if running.any():
            decisions.answer(running, np.clip(corrections, -1.0, 1.0))
        self._started = True
        if restart.any():
            self._draw_seeds(restart)
            self._start(restart)
        rewards = decisions.take_rewards(~restart)
        over = self.batch.over & ~restart
        failed = self.batch.failed & over
        features, infos = self.experts.features(), self._infos(over)
        self._over = over
        if over.any() and self.autoreset_mode == AutoresetMode.SAME_STEP:
            features, infos = self._start_over(over, features, infos)
        return features, rewards, failed, over & ~failed, infos

    def state(self, secrets: bool = False) -> np.ndarray:
        """Return the truth of every world at its decision, as ``ImpactVectorEnv.state``, shape (num_envs, size)."""
        if not self._started:
            raise ResetNeeded("state before reset: call reset first")
        return read_state(self.batch, secrets)

    def state_layout(self, secrets: bool = False) -> Layout:
        """Return what stands where in ``state(secrets)``."""
        return make_state_layout(self.batch.task, secrets)

    def close_extras(self, **kwargs: Any) -> None:
        """Let the threads and the planners' processes go."""
        self.decisions.close()

    def _start_over(
        self, over: np.ndarray, features: np.ndarray, infos: dict[str, Any]
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start the next episode where one is over; return features and infos of its start, and of the end."""
        ends = {name: infos[name] for name in infos if name.removeprefix("_") not in ALWAYS}
        final = {"final_obs": features.copy(), "final_info": infos}
        self._draw_seeds(over)
        self._start(over)
        masks = {f"_{name}": over.copy() for name in final}
        return self.experts.features(), self._infos() | ends | final | masks

    def _start(self, worlds: np.ndarray) -> None:
        self._started = False
        self.decisions.start(worlds, self._seeds[worlds])
        self._started = True
        self._over = self._over & ~worlds

    def _draw_seeds(self, worlds: np.ndarray) -> None:
        for k in np.flatnonzero(worlds).tolist():
            self._seeds[k] = self._generators[k].integers(TRAINING_SEEDS)

    def _infos(self, over: np.ndarray | None = None) -> dict[str, Any]:
        """Return the infos of all worlds; over says which episodes ended."""
        everywhere = np.ones(self.num_envs, bool)
        infos: dict[str, Any] = {"seed": self._seeds.copy(), "_seed": everywhere}
        infos |= {"control_steps": self.decisions.steps.copy(), "_control_steps": everywhere.copy()}
        infos |= {"is_success": self.decisions.judge()[1], "_is_success": everywhere.copy()}
        if over is None or not over.any():
            return infos
        robustness, success = self.decisions.judge()
        values = {
            "robustness": robustness * over,
            "success": success & over,
            "decided": self.batch.decided & over,
        }
        if (failed := self.batch.failed & over).any():
            values["failure"] = np.where(failed, self.batch.describe_failures(), "")
        masks = {f"_{name}": over.copy() for name in values} | ({"_failure": failed} if failed.any() else {})
        return infos | values | masks

    def _check_actions(self, actions: Any) -> np.ndarray:
        """Return corrections in float64, or raise InputError."""
        try:
            taken = np.asarray(actions)
        except (ValueError, TypeError, RuntimeError):  # text, or of different lengths
            taken = np.empty(0, object)
        if taken.shape != self.action_space.shape or taken.dtype.kind not in REAL:
            raise InputError(
                f"actions of shape {taken.shape}, {taken.dtype}: "
                f"real numbers of shape {self.action_space.shape} are needed"
            )
        wrong = ~np.isfinite(taken).all(axis=1)
        if wrong.any():
            world = int(np.argmax(wrong))
            raise InputError(f"action of world {world} = {taken[world].tolist()}: finite numbers only")
        return taken.astype(np.float64)

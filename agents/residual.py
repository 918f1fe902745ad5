"""Bounded corrections to an expert: the environment to learn them in, and the policy that applies them."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import gymnasium
import numpy as np
from gymnasium.spaces import Box

from impact_envs.env import parallel_env
from impact_envs.errors import InputError, ResetNeeded
from impact_envs.interface.agent_vectors import read_vector
from impact_envs.rollout import Diagnostics, Policy
from impact_envs.scenario import Scenario, load_scenario
from impact_envs.stream import check_seed
from planners import make_expert
from planners.plan import Plan

if TYPE_CHECKING:
    from agents.actor import PolicyRecord

# Seeds below are for training; tuning and evaluation use higher ones.
TRAINING_SEEDS = 1_000_000


class CorrectableExpert(Policy, Protocol):
    """An expert that asks for a bounded correction now and then.

    A control step is ``observe(observations)``, then ``correct(correction)`` as long as ``awaiting_correction``, then
    ``control()``; ``act`` is observe and control. Several corrections may be due in one step, one after the other. A
    request left unanswered counts as zero, and zero changes nothing, bit for bit.

    Attributes:
        correction_size: length of a correction.
        feature_size: length of the features.
    """

    correction_size: int
    feature_size: int

    @property
    def awaiting_correction(self) -> bool:
        """Return whether a correction is due in this control step, and not given yet."""

    def observe(self, observations: dict[str, np.ndarray]) -> None:
        """Take this control step's measurements and decide whether a correction is awaited."""

    def features(self) -> np.ndarray:
        """Return what a learner may see of what is due: shape (feature_size,), from observations and beliefs only."""

    def correct(self, correction: np.ndarray) -> None:
        """Set the correction in [-1, 1], shape (correction_size,), until the next one is awaited."""

    def control(self) -> dict[str, np.ndarray]:
        """Return each agent's action in [-1, 1]."""


class ResidualEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """Correct an expert: one step lasts from one awaited correction to the next (semi-Markov).

    Where two corrections are due in the same control step, the step from the first to the second takes no time.

    Action space: ``Box(-1, 1, (correction_size,))``; zero is the expert, bit for bit. Each expert says what a
    correction changes; a free-flyer's scales and turns the impulse of the coming impact, and shifts its time.

    Observation space: the expert's features, float64, SI units, computed from measurements and beliefs only.

    Rewards: ImpactEnv's, summed over agents and over the control steps in between; those before the
    first awaited correction are added to the first step, so that the return is that of the whole episode.

    Starting state: the first time a correction is awaited. ``reset(seed=s)`` plays episode s; without a seed
    the episode's seed is drawn below 1,000,000 from the environment's generator, which the last given seed
    initialised.

    Episode end: ``truncated`` at the scenario's horizon, or where ``max_cycles`` cuts earlier; ``terminated`` where the
    simulation fails (see ImpactEnv).

    ``info`` carries ``seed``, ``control_steps`` (in this step) and ``is_success`` (see ImpactEnv); at the end also
    ``robustness``, ``success`` and ``decided``: the horizon is reached or the simulation failed (then with
    ``failure``, a text), and a learner has nothing to bootstrap.

    Args:
        scenario: a shipped name, the path of a TOML file, or a Scenario.
        suite: mismatch suite of the true world; the expert's beliefs stay.
        plan: plan for the expert to follow; made from the believed scenario if not given.
        expert: expert to correct; made from scenario and plan if not given.
        render_mode: None, ``human`` or ``rgb_array``.
        max_cycles: truncate earlier than the horizon [control periods].

    Raises:
        ScenarioError: the scenario or the suite is unknown.
        PlanningError: the expert found no plan.
    """

    metadata = {"render_modes": ["human", "rgb_array"], "render_fps": 30}

    def __init__(
        self,
        scenario: str | Path | Scenario,
        suite: str = "nominal",
        plan: Plan | None = None,
        expert: CorrectableExpert | None = None,
        render_mode: str | None = None,
        max_cycles: int | None = None,
    ) -> None:
        loaded = load_scenario(scenario).suite(suite)
        self.parallel = parallel_env(loaded, render_mode, max_cycles)
        self.expert: CorrectableExpert = expert or make_expert(loaded, plan)
        if not hasattr(self.expert, "correction_size"):
            raise InputError(f"scenario '{loaded.name}': the expert of domain '{loaded.domain}' takes no corrections")
        self.render_mode = render_mode
        self.action_space = Box(-1.0, 1.0, (self.expert.correction_size,), np.float32)
        self.observation_space = Box(-np.inf, np.inf, (self.expert.feature_size,), np.float64)
        self._reward, self._steps, self._infos = 0.0, 0, dict[str, Any]()
        self._ended: bool | None = None  # before the first reset

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode and run it to the first awaited correction.

        Args:
            seed: of the episode; without one it is drawn from the training seeds.
            options: accepted for the interface, unused.

        Returns:
            Features and info.
        """
        seed = None if seed is None else check_seed(seed)
        super().reset(seed=seed)
        episode = int(self.np_random.integers(TRAINING_SEEDS)) if seed is None else seed
        observations, infos = self.parallel.reset(seed=episode)
        self.expert.reset(episode)
        self._reward, self._steps, self._infos, self._ended = 0.0, 0, {"seed": episode}, False
        self._infos["is_success"] = next(iter(infos.values()))["is_success"]
        self.expert.observe(observations)
        if not self.expert.awaiting_correction:
            self._run_to_request()
        return self.expert.features().copy(), self._infos | {"control_steps": self._steps}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Answer the awaited correction and run to the next one, or to the end.

        Args:
            action: correction in [-1, 1], shape (correction_size,).

        Returns:
            Features, reward, terminated, truncated, info. If no correction was ever awaited, the first step
            only returns the episode's reward.

        Raises:
            ResetNeeded: before the first reset, or after the end of an episode.
            InputError: an action that is not its finite numbers; nothing was stepped.
        """
        if self._ended is not False:
            order = "before reset" if self._ended is None else "after the end of the episode"
            raise ResetNeeded(f"step {order}: call reset first")
        correction = read_vector(action, self.expert.correction_size, "action")
        if self.parallel.agents:
            self._steps = 0
            self.expert.correct(np.clip(correction, -1.0, 1.0))
            if not self.expert.awaiting_correction:
                self._run_to_request()
        self._ended = not self.parallel.agents
        reward, self._reward = self._reward, 0.0
        info = self._infos | {"control_steps": self._steps}
        over, failed = not self.parallel.agents, self.parallel.failure is not None
        return self.expert.features().copy(), reward, failed, over and not failed, info

    def render(self) -> np.ndarray | None:
        """Draw the present control step; see ImpactEnv.render."""
        return self.parallel.render()

    def close(self) -> None:
        """Close the window, if there is one."""
        self.parallel.close()

    def _run_to_request(self) -> None:
        """Control from an observed state until a correction is awaited or the episode is over."""
        while True:
            observations, rewards, _, _, infos = self.parallel.step(self.expert.control())
            self._reward += float(sum(rewards.values()))
            self._steps += 1
            self._infos["is_success"] = next(iter(infos.values()))["is_success"]
            failed = self.parallel.failure is not None
            decided = failed or self.parallel.steps >= self.parallel.scenario.steps
            if not decided:
                # Also where max_cycles cuts: a learner bootstraps there from the features.
                self.expert.observe(observations)
            if not self.parallel.agents:
                final = next(iter(infos.values()))
                self._infos |= {key: final[key] for key in ("robustness", "success", "failure") if key in final}
                self._infos["decided"] = decided
                return
            if self.expert.awaiting_correction:
                return


class ResidualPolicy:
    """An expert plus learned bounded corrections.

    Args:
        expert: to correct.
        actor: maps features, shape (feature_size,), to a correction in [-1, 1], shape (correction_size,).
        name: of the policy in episodes and tables.
    """

    def __init__(
        self,
        expert: CorrectableExpert,
        actor: Callable[[np.ndarray], np.ndarray],
        name: str = "residual",
    ) -> None:
        self.name, self.expert, self.actor = name, expert, actor
        self._unanswered = 0  # corrections that were no finite numbers, since reset

    @classmethod
    def load(
        cls,
        directory: str | Path,
        scenario: str | Path | Scenario,
        plan: Plan | None = None,
        options: Mapping[str, Any] | None = None,
    ) -> ResidualPolicy:
        """Read a checkpoint and put it on the scenario's expert.

        Args:
            directory: folder with policy.safetensors and policy.json; nothing in it is executed.
            scenario: a shipped name, the path of a TOML file, or a Scenario; only its believed part is used.
            plan: plan for the expert to follow; made if not given.
            options: of the expert, see planners.make_expert.

        Raises:
            InputError: the checkpoint is broken, or does not fit this scenario's expert. A policy of another expert or
                plan that fits is loaded with a warning.
            PlanningError: the expert found no plan.
        """
        # Imported here: residual environments need no torch.
        from agents.actor import load_policy

        actor, record = load_policy(directory)
        loaded = load_scenario(scenario)
        check_domain(directory, record, loaded)
        expert: CorrectableExpert = make_expert(loaded, plan, record.variant, options)
        check_fit(directory, record, loaded, expert, getattr(expert, "plan", None))
        return cls(expert, actor.correction, name=str(directory))

    def reset(self, seed: int) -> None:
        """Forget the last episode."""
        self.expert.reset(seed)
        self._unanswered = 0

    def act(self, observations: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Return the expert's actions, corrected where it asks.

        Args:
            observations: each agent's observation.

        Returns:
            Each agent's action in [-1, 1].
        """
        self.expert.observe(observations)
        while self.expert.awaiting_correction:
            correction = self.actor(self.expert.features())
            if not np.isfinite(correction).all():  # no answer counts as zero
                correction = np.zeros(self.expert.correction_size)
                self._unanswered += 1
            self.expert.correct(np.clip(correction, -1.0, 1.0))
        return self.expert.control()

    def diagnostics(self) -> Diagnostics:
        """Return the expert's diagnostics, and as a fallback how many corrections were no finite numbers."""
        found = self.expert.diagnostics()
        if self._unanswered:
            found.fallbacks["no_correction"] = self._unanswered
        return found


def check_domain(directory: str | Path, record: PolicyRecord, scenario: Scenario) -> None:
    """Raise unless a checkpoint is for a scenario's domain.

    Args:
        directory: of the checkpoint, for the message.
        record: of the checkpoint.
        scenario: that it is to play.

    Raises:
        InputError: it is for another.
    """
    if record.domain != scenario.domain:
        raise InputError(
            f"checkpoint '{directory}' is for domain '{record.domain}', "
            f"scenario '{scenario.name}' has domain '{scenario.domain}'"
        )


def check_fit(directory: str | Path, record: PolicyRecord, scenario: Scenario, expert: Any, plan: Plan | None) -> None:
    """Raise unless a checkpoint fits an expert's features and corrections; warn if it was trained on another.

    Args:
        directory, record, scenario: see `check_domain`.
        expert: of one world or many, that is to be corrected.
        plan: that it follows.

    Raises:
        InputError: it does not fit.
    """
    from agents.source import find_difference

    names = ", ".join(sorted({source.scenario for source in record.sources}))
    for key in ("feature_size", "correction_size"):
        trained, offered = getattr(record, key), getattr(expert, key)
        if trained != offered:
            raise InputError(
                f"checkpoint '{directory}' was trained on {names} with {key} {trained}; "
                f"the expert of '{scenario.name}' has {key} {offered}"
            )
    difference = find_difference(record.sources, scenario, plan)
    if difference is not None:
        warnings.warn(f"checkpoint '{directory}': {difference}", stacklevel=3)

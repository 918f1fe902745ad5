"""The one environment: a model and a task, joined in PettingZoo's parallel interface."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.spaces import Box
from gymnasium.utils import seeding
from pettingzoo import AECEnv, ParallelEnv
from pettingzoo.utils.conversions import parallel_to_aec

from impact_envs.domain import find_part
from impact_envs.errors import InputError, ResetNeeded, check_count, choices
from impact_envs.interface.failure import SimulationFailed, check_finite, explain_failure
from impact_envs.interface.parts import Model, Task
from impact_envs.interface.referee import Referee, share_reward
from impact_envs.interface.state import add_secrets, join_states, make_state_layout
from impact_envs.observation import Layout
from impact_envs.physics.impact import Impact, LastingContact
from impact_envs.reward import ROBUSTNESS
from impact_envs.scenario import Scenario, load_scenario
from impact_envs.stream import check_seed


class ImpactEnv(ParallelEnv):
    """Agents that reach a Signal Temporal Logic specification by hitting free-floating objects.

    Action space: per agent ``Box(-1, 1)``, scaled to its limits inside (see the task).

    Observation space: per agent a fresh float64 vector of measurements in SI units; ``task.layouts[agent]`` says what
    stands where (``print(env.task.layouts[agent].describe())``). Where robustness is observed, it is the interval still
    possible of every conjunct of the formula, from which a policy without memory knows what is done.

    Rewards: the team's part, shared equally, is the change of a potential, plus the robustness reached at the end;
    each agent pays for its effort (see `reward.py` and the task). The sum over agents is what JointEnv returns. With
    ``reward="robustness"`` the potential is the middle of the interval of robustness still possible (the online
    monitor's bounds, clipped to the world's diagonal): learn with gamma 1, because hardly anything comes before the
    end. With ``reward="progress"`` it is the robustness that would be reached if every body flew on as it moves now,
    walls apart through whatever is there (`flight.py`), clipped likewise, and looked at after impacts, once a second
    and at the end: a throw is rewarded when it is thrown; learn with gamma .999. Free-flyers alone have it.

    Starting state: as the scenario says; the true physics are drawn from the reset seed.

    Episode end: ``truncated`` at the scenario's horizon (or ``max_cycles``, if earlier); ``terminated`` only where the
    simulation fails: a state is not finite, or impacts do not end within a control period. The observation is then the
    last sample, the robustness minus the world's diagonal, and ``failure`` of the infos says what happened.

    ``infos[agent]`` carries ``overflow`` (1 where impacts did not end within the control period), ``is_success``
    (whether the formula holds for certain by now, whatever follows; at the end ``success``),
    ``robustness_lower``, ``robustness_upper``, both clipped to the world's diagonal; at the end
    also ``robustness``, not clipped, and ``success`` of the whole formula on the true signals. ``success`` is whether
    the formula holds: robustness above zero, or exactly zero where its predicates hold at equality (``in``, ``<=``,
    ``>=``; not ``not in``, ``<``, ``>``). If max_cycles cut the horizon, they say what was certain by then: the lower
    end of the interval, at least minus the diagonal. ``decided`` says that nothing follows, so that a learner has
    nothing to bootstrap: the horizon is reached, or the simulation failed.

    Raises:
        InputError: ``max_cycles`` is no whole number from 1, ``render_mode`` or ``reward`` is unknown, or bodies do
            not fly freely in this domain.
    """

    metadata: dict[str, Any] = {
        "name": "impact_envs",
        "render_modes": ["human", "rgb_array"],
        "render_fps": 30,
        "is_parallelizable": True,
    }

    def __init__(
        self,
        model: Model,
        task: Task,
        render_mode: str | None = None,
        max_cycles: int | None = None,
        reward: str = ROBUSTNESS,
    ) -> None:
        if render_mode is not None and render_mode not in (known := self.metadata["render_modes"]):
            raise InputError(f"render_mode '{render_mode}' is unknown; {choices(render_mode, known)}")
        self.model, self.task, self.render_mode = model, task, render_mode
        self.scenario: Any = task.scenario
        self._last, self._bodies = self.scenario.steps, self.scenario.bodies  # computed at every access
        if max_cycles is not None:
            check_count("max_cycles", max_cycles)
        self.max_cycles = self._last if max_cycles is None else max_cycles
        self.possible_agents = list(self.scenario.agents)
        self.agents: list[str] = []
        self.state_space = self.state_layout().make_space()
        self.reward, self.referee = reward, Referee(self.scenario, task.signal_bounds(), reward)
        self.monitor = self.referee.monitor
        self.curves: dict[str, np.ndarray] = {}  # polylines to draw under the bodies, for example a plan
        self.impacts: list[Impact] = []  # of the last control period
        self.lasting_contacts: list[LastingContact] = []  # of the last control period; free-flyers alone have them
        self.impulse = 0.0  # propulsion spent since reset
        self.failure: SimulationFailed | None = None  # that ended the episode
        self.infos: dict[str, Any] = {}  # what every agent was told last
        self.last_states: np.ndarray  # true ones, of the last control period that did not fail
        self._rng: np.random.Generator | None = None
        self._renderer: Any = None
        self.caption = ""  # over pictures; the scenario's name where nobody says more
        self.speed: float | None = None  # time shown in one second of a film, written into its pictures
        self.past: Any = None  # a `Past`, where pictures are drawn

    def observation_space(self, agent: str) -> Box:
        """Return the agent's observation space, the same object at every call."""
        return self._find(agent, self.task.observation_spaces)

    def action_space(self, agent: str) -> Box:
        """Return the agent's action space, the same object at every call."""
        return self._find(agent, self.task.action_spaces)

    @property
    def time(self) -> float:
        """Return the time since reset [s].

        Raises:
            ResetNeeded: before the first reset.
        """
        self._check_started("time")
        return self.steps * self.scenario.control_period

    @property
    def bounds(self) -> tuple[float, float]:
        """Return the interval of robustness still possible, clipped to the world's diagonal [m]."""
        return self.referee.bounds

    @property
    def conjuncts(self) -> list[float]:
        """Return lower and upper end of every conjunct's interval, clipped likewise [m]."""
        return self.referee.conjuncts

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, dict[str, Any]]]:
        """Draw a world and start.

        Args:
            seed: of the whole episode; without one the last episode's generator goes on.
            options: accepted for the interface, unused.

        Returns:
            Observations and infos by agent.

        Raises:
            InputError: a seed that is no whole number from 0 to 2**63 - 1.
        """
        if seed is not None or self._rng is None:
            self._rng, _ = seeding.np_random(None if seed is None else check_seed(seed))
        physics = self._physics = self.scenario.draw(self._rng)
        self.model.reset(physics)
        self.steps, self.impacts, self.lasting_contacts = 0, [], []
        self.impulse, self.failure = 0.0, None
        self.agents = list(self.possible_agents)
        self.last_states = self.model.state()
        self.task.reset(physics, self.last_states, self._rng)
        self.signals = self.task.signals(self.last_states)
        self.referee.reset(self.signals)
        self._start_past()
        self.infos = self.referee.make_info(None, over=False, decided=False)
        return self.task.observe(0.0, self.conjuncts), {agent: self.infos.copy() for agent in self.agents}

    def step(
        self, actions: Mapping[str, np.ndarray]
    ) -> tuple[
        dict[str, np.ndarray],
        dict[str, float],
        dict[str, bool],
        dict[str, bool],
        dict[str, dict[str, Any]],
    ]:
        """Hold the actions for one control period.

        Args:
            actions: agent to its action in [-1, 1].

        Returns:
            Observations, rewards, terminations, truncations, infos by agent.

        Raises:
            ResetNeeded: before the first reset, or after the end of an episode.
            InputError: an agent is missing or unknown, or its action is not its finite numbers; nothing was stepped.
        """
        if not self.agents:
            self._check_started("step")
            raise ResetNeeded("step after the end of the episode: call reset first")
        task, referee, agents = self.task, self.referee, self.agents
        controls = task.controls(actions)
        before, signals = referee.bounds, self.signals
        self._advance(controls)
        self.steps += 1
        self.impulse += task.impulse(controls)
        failed = self.failure is not None
        if failed:
            referee.fail()
        else:
            task.sense(self.last_states, self.impacts)
            self.signals = task.signals(self.last_states)
            referee.watch(self.signals)
        if self.past is not None:
            self.past.add(self.steps, signals, self.signals, self.impacts)
        over = failed or self.steps >= self._last or self.steps >= self.max_cycles
        team = referee.compute_team_reward(before, self.signals, self.steps, bool(self.impacts), over, failed)
        rewards = share_reward(team, {agent: task.effort(actions[agent]) for agent in agents})
        observations = task.observe(self.steps * self.scenario.control_period, referee.conjuncts)
        self.infos = referee.make_info(self.failure, over, decided=failed or self.steps >= self._last)
        infos = {agent: self.infos.copy() for agent in agents}
        if over:
            self.agents = []
        if self.render_mode == "human":
            self.render()
        return observations, rewards, dict.fromkeys(agents, failed), dict.fromkeys(agents, over and not failed), infos

    def state(self, secrets: bool = False) -> np.ndarray:
        """Return the truth of the present step, for centralised critics; ``state_layout`` says what stands where.

        Args:
            secrets: add the drawn physics, and what the formula remembers; no expert may see them.

        Returns:
            The true state of all bodies, row after row, time / horizon, and the secrets; shape (size,).

        Raises:
            ResetNeeded: before the first reset.
        """
        self._check_started("state")
        states = self.model.state() if self.failure is None else self.last_states
        state = join_states(states[None], np.array([self.time / self.scenario.horizon]))
        if secrets:
            physics = self.task.list_secrets(self._physics)
            state = add_secrets(state, physics[None], self.monitor.parts[None], self.referee.limit)
        return state[0]

    def state_layout(self, secrets: bool = False) -> Layout:
        """Return what stands where in ``state(secrets)``; ``print(env.state_layout().describe())``."""
        return make_state_layout(self.task, secrets)

    def render(self) -> np.ndarray | None:
        """Draw the present step.

        Returns:
            An image, shape (height, width, 3) uint8, in mode ``rgb_array``; None in mode ``human``.

        Raises:
            ResetNeeded: before the first reset.
        """
        self._check_started("render")
        if self.render_mode is None:
            return None
        if self._renderer is None:
            self._renderer = self.make_renderer(self.render_mode)
        return self._renderer.draw(self.make_frame(), last=not self.agents)

    def make_renderer(self, mode: str, **options: Any) -> Any:
        """Return what draws this world's frames.

        Args:
            mode: ``human`` or ``rgb_array``.
            options: of `impact_envs.picture.render.Renderer`, for example speed.
        """
        from impact_envs.picture.render import Renderer
        from impact_envs.picture.view import ARROW_SHARE, find_view

        arrow = ARROW_SHARE * self.scenario.horizon
        return Renderer(*find_view(self.scenario), self.task.shapes(), mode, arrow=arrow, **options)

    def make_frame(self) -> Any:
        """Return what is to be drawn of the present step; paths and impacts only with a ``render_mode``.

        Raises:
            ResetNeeded: before the first reset.
        """
        from impact_envs.picture.past import draw_world

        self._check_started("make_frame")
        return draw_world(self)

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_renderer": None}

    def _find(self, agent: str, spaces: Mapping[str, Box]) -> Box:
        if agent not in self.possible_agents:
            raise InputError(f"agent '{agent}' is unknown; {choices(agent, self.possible_agents)}")
        return spaces[agent]

    def _check_started(self, call: str) -> None:
        if self._rng is None:
            raise ResetNeeded(f"{call} before reset: call reset first")

    def _advance(self, controls: Mapping[str, np.ndarray]) -> None:
        """Move the world through one control period; where that fails, keep the last states and the failure."""
        self.impacts, self.lasting_contacts = [], []
        try:
            impacts = self.model.step(controls)
            states = self.model.state()
            check_finite(states, self._bodies)
        except InputError:
            raise
        except (SimulationFailed, ArithmeticError, ValueError) as error:
            self.failure = explain_failure(error, self.model.state, self._bodies)
        else:
            self.impacts, self.last_states = impacts, states
            self.lasting_contacts = getattr(self.model, "lasting_contacts", [])

    def _start_past(self) -> None:
        """Keep from now on what pictures show of the past, if there will be any."""
        self.past = None
        if self.render_mode is not None:
            from impact_envs.picture.past import Past

            self.past = Past(self._bodies, self.task.shapes(), self._last, self.signals)


def aec_env(
    scenario: str | Path | Scenario, render_mode: str | None = None, max_cycles: int | None = None
) -> AECEnv[str, np.ndarray, np.ndarray]:
    """Make the environment of a scenario in PettingZoo's other interface, in which agents act one after another.

    Args:
        scenario, render_mode, max_cycles: as parallel_env.
    """
    return parallel_to_aec(parallel_env(scenario, render_mode, max_cycles))


def parallel_env(
    scenario: str | Path | Scenario,
    render_mode: str | None = None,
    max_cycles: int | None = None,
    reward: str = ROBUSTNESS,
) -> ImpactEnv:
    """Make the environment of a scenario.

    Args:
        scenario: a shipped name, the path of a TOML file, or a Scenario.
        render_mode: None, ``human`` or ``rgb_array``.
        max_cycles: truncate earlier than the horizon [control periods].
        reward: ``robustness`` or, for free-flyers, ``progress``; see ImpactEnv.

    Returns:
        A PettingZoo ParallelEnv.

    Raises:
        ScenarioError: the scenario cannot be read.
        InputError: ``max_cycles`` is no whole number from 1, or ``render_mode`` or ``reward`` is unknown.
    """
    loaded = load_scenario(scenario)
    make_model, make_task = (find_part("impact_envs", loaded.domain, name) for name in ("MODEL", "TASK"))
    return ImpactEnv(make_model(loaded), make_task(loaded), render_mode, max_cycles, reward)

"""The one environment: a model and a task, joined in PettingZoo's parallel interface."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from gymnasium.spaces import Box
from gymnasium.utils import seeding
from pettingzoo import AECEnv, ParallelEnv
from pettingzoo.utils.conversions import parallel_to_aec

from impact_envs.domain import find_part
from impact_envs.errors import InputError, ResetNeeded, check_count, choices
from impact_envs.failure import NotFinite, SimulationFailed, TooManyEvents, check_finite
from impact_envs.flight import Forecast
from impact_envs.observation import Layout
from impact_envs.physics.impact import Impact, LastingContact
from impact_envs.reward import ROBUSTNESS, compute_progress_reward, compute_reward, compute_team_reward, find_rates
from impact_envs.scenario import Scenario, load_scenario
from impact_envs.shape import Shape
from impact_envs.state import add_secrets, join_states, make_state_layout
from impact_envs.stl import Monitor
from impact_envs.stl.verdict import compute_outcome, judge
from impact_envs.stream import check_seed


class Model(Protocol):
    """What the world does."""

    def reset(self, physics: Any) -> None:
        """Put the bodies at their start in a world with these physics."""

    def step(self, controls: Mapping[str, np.ndarray]) -> list[Impact]:
        """Advance one control period under held controls; return the impacts in order of time.

        Raises:
            SimulationFailed: the world cannot be followed any further.
        """

    def state(self) -> np.ndarray:
        """Return the true state, one row per body."""


class Task(Protocol):
    """What is asked of the agents."""

    scenario: Any
    action_spaces: Mapping[str, Box]
    action_elements: Mapping[str, Sequence[str]]  # of each agent, with what an element of 1 is: "torque [0.5 N m]"
    observation_spaces: Mapping[str, Box]
    joint_observation_space: Box
    layouts: Mapping[str, Layout]
    joint_layout: Layout
    state_layout: Layout
    secrets_layout: Layout

    def reset(self, physics: Any, states: np.ndarray, rng: np.random.Generator) -> None:
        """Start an episode."""

    def controls(self, actions: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Scale actions to physical controls."""

    def effort(self, action: np.ndarray) -> float:
        """Return an agent's effort in one control period, in [0, 1]."""

    def impulse(self, controls: Mapping[str, np.ndarray]) -> float:
        """Return the propulsion spent in one control period."""

    def sense(self, states: np.ndarray, impacts: list[Impact]) -> None:
        """Take the sensors' sample."""

    def observe(self, time: float, bounds: tuple[float, float]) -> dict[str, np.ndarray]:
        """Return each agent's observation."""

    def observe_jointly(self, time: float, bounds: tuple[float, float]) -> np.ndarray:
        """Return all agents' observation as one vector."""

    def list_secrets(self, physics: Any) -> np.ndarray:
        """Return a world's drawn physics as one vector, which no expert sees."""

    def signals(self, states: np.ndarray) -> dict[str, float]:
        """Return the signals the formula speaks of."""

    def signal_bounds(self) -> dict[str, tuple[float, float]]:
        """Return bounds of signals known beforehand."""

    def shapes(self) -> tuple[Shape, ...]:
        """Return what is drawn."""

    def chains(self, states: np.ndarray) -> dict[str, np.ndarray]:
        """Return polylines from bodies to what holds them, drawn with them."""


class ImpactEnv(ParallelEnv):
    """Agents that reach a Signal Temporal Logic specification by hitting free-floating objects.

    Action space: per agent ``Box(-1, 1)``, scaled to its limits inside (see the task).

    Observation space: per agent a fresh float64 vector of measurements in SI units; ``task.layouts[agent]`` says what
    stands where (``print(env.task.layouts[agent].describe())``).

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
        self._last, self._limit = self.scenario.steps, self.scenario.world.diagonal  # computed at every access
        if max_cycles is not None:
            check_count("max_cycles", max_cycles)
        self.max_cycles = self._last if max_cycles is None else max_cycles
        self.possible_agents = list(self.scenario.agents)
        self.agents: list[str] = []
        self.state_space = self.state_layout().make_space()
        self.monitor = Monitor(
            self.scenario.specification,
            self.scenario.control_period,
            self.scenario.areas,
            self.scenario.bodies,
            task.signal_bounds(),
        )
        rates, areas = find_rates(reward, self.scenario.domain), self.scenario.areas
        self.reward, self._forecast = reward, None
        if rates is not None:
            self._forecast = Forecast(self.monitor, areas, self.scenario.bodies, rates, task.signal_bounds())
        self._potential = 0.0  # of reward "progress" [m]
        self.curves: dict[str, np.ndarray] = {}  # polylines to draw under the bodies, for example a plan
        self.impacts: list[Impact] = []  # of the last control period
        self.lasting_contacts: list[LastingContact] = []  # of the last control period; free-flyers alone have them
        self.impulse = 0.0  # propulsion spent since reset
        self.failure: SimulationFailed | None = None  # that ended the episode
        self.infos: dict[str, Any] = {}  # what every agent was told last
        self._rng: np.random.Generator | None = None
        self._renderer: Any = None
        self.caption = ""  # over pictures; the scenario's name where nobody says more
        self.speed: float | None = None  # time shown in one second of a film, written into its pictures
        self._trailed: list[str] = []  # bodies whose path is drawn
        self._track = np.zeros((0, 0, 3))  # poses of every step, kept for rendering
        self._marks: list[tuple[Impact, list[tuple[float, float, float, float]]]] = []

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
        self._states = self.model.state()
        self.task.reset(physics, self._states, self._rng)
        self.signals = self.task.signals(self._states)
        self.monitor.reset()
        self.bounds = self._watch()
        self._potential = self._predict()
        self._marks = []
        self._remember()
        infos = self._infos()
        self.infos = next(iter(infos.values()))
        return self.task.observe(0.0, self.bounds), infos

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
        controls = self.task.controls(actions)
        before, signals, potential = self.bounds, self.signals, self._potential
        self._advance(controls)
        self.steps += 1
        self.impulse += self.task.impulse(controls)
        if self.failure is None:
            self.task.sense(self._states, self.impacts)
            self.signals = self.task.signals(self._states)
            self.bounds = self._watch()
        else:
            self.bounds = (-self._limit, -self._limit)
        self._remember(signals)
        failed = self.failure is not None
        over = failed or self.steps >= min(self.max_cycles, self._last)
        agents = self.agents
        if self._forecast is None:
            team = compute_team_reward(before, self.bounds, over)
        else:
            if over or self.impacts or self.steps % self._forecast.every == 0:
                self._potential = self._predict()
            team = compute_progress_reward(potential, self._potential, self.bounds[0], over)
        rewards = {agent: compute_reward(team, len(agents), self.task.effort(actions[agent])) for agent in agents}
        observations, infos = self.task.observe(self.time, self.bounds), self._infos(over)
        self.infos = infos[agents[0]]
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
        states = self.model.state() if self.failure is None else self._states
        state = join_states(states[None], np.array([self.time / self.scenario.horizon]))
        if secrets:
            physics = self.task.list_secrets(self._physics)
            state = add_secrets(state, physics[None], self.monitor.parts[None], self._limit)
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
            options: of `impact_envs.render.Renderer`, for example speed.
        """
        from impact_envs.picture.view import ARROW_SHARE, find_view
        from impact_envs.render import Renderer

        arrow = ARROW_SHARE * self.scenario.horizon
        return Renderer(*find_view(self.scenario), self.task.shapes(), mode, arrow=arrow, **options)

    def make_frame(self) -> Any:
        """Return what is to be drawn of the present step; paths and impacts only with a ``render_mode``.

        Raises:
            ResetNeeded: before the first reset.
        """
        from impact_envs.picture.unit import find_unit
        from impact_envs.render import Frame, Mark

        self._check_started("make_frame")
        bodies = self.scenario.bodies
        if not self._trailed:
            shapes = self.task.shapes()
            self._trailed = [shape.body for shape in shapes if shape.body is not None and shape.label]
        past = self._track[: self.steps + 1]
        return Frame(
            time=self.time,
            poses=dict(zip(bodies, self._list_poses(), strict=True)),
            chains=self.task.chains(self._states),
            trails={body: past[:, bodies.index(body), :2] for body in self._trailed} if len(past) else {},
            plans=self.curves,
            impacts=[Mark(*mark.point, self.time - mark.time, changes) for mark, changes in self._marks],
            robustness=self.bounds,
            unit=find_unit(self.scenario.specification),
            caption=self.caption or self.scenario.name,
            speed=self.speed,
        )

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
            check_finite(states, self.scenario.bodies)
        except InputError:
            raise
        except (SimulationFailed, ArithmeticError, ValueError) as error:
            self.failure = self._explain(error)
        else:
            self.impacts, self._states = impacts, states
            self.lasting_contacts = getattr(self.model, "lasting_contacts", [])

    def _explain(self, error: Exception) -> SimulationFailed:
        """Return why the model failed: arithmetic may stop at a state that is not finite before anybody looks at it."""
        try:
            check_finite(self.model.state(), self.scenario.bodies)
        except NotFinite as failure:
            return failure
        except (ArithmeticError, ValueError):
            return NotFinite("a body")
        if isinstance(error, SimulationFailed):
            return error
        raise error

    def _list_poses(self) -> list[tuple[float, float, float]]:
        s = self.signals
        return [(s[f"{body}.x"], s[f"{body}.y"], s[f"{body}.heading"]) for body in self.scenario.bodies]

    def _remember(self, before: Mapping[str, float] | None = None) -> None:
        """Keep what pictures show of the past.

        Args:
            before: signals of the step before; a body's change of velocity in an impact is that of the whole step.
        """
        if self.render_mode is None:
            return
        if before is None:
            self._track = np.empty((self._last + 1, len(self.scenario.bodies), 3))
        self._track[self.steps] = self._list_poses()
        s, bodies = self.signals, self.scenario.bodies
        before = before or s
        for impact in self.impacts:
            changes = []
            for body in (impact.a, impact.b):
                if body in bodies:
                    x, y, vx, vy = (f"{body}.{name}" for name in ("x", "y", "vx", "vy"))
                    changes.append((before[x], before[y], s[vx] - before[vx], s[vy] - before[vy]))
            self._marks.append((impact, changes))

    def _watch(self) -> tuple[float, float]:
        """Take the formula's sample; return the interval of robustness still possible, clipped."""
        low, high = self.monitor.update(self.signals)
        return max(-self._limit, min(self._limit, low)), max(-self._limit, min(self._limit, high))

    def _predict(self) -> float:
        """Return the potential of reward "progress"; 0 for the other one."""
        if self._forecast is None:
            return 0.0
        if self.failure is not None:
            return -self._limit
        found = self._forecast.predict(self.monitor, self.signals, self.steps)
        return max(-self._limit, min(self._limit, found))

    def _infos(self, over: bool = False) -> dict[str, dict[str, Any]]:
        info: dict[str, Any] = {"robustness_lower": self.bounds[0], "robustness_upper": self.bounds[1]}
        info["overflow"] = int(isinstance(self.failure, TooManyEvents))
        robustness, success = judge(compute_outcome(*self.monitor.ends, self._limit))
        info["is_success"] = bool(success) and self.failure is None
        if over:
            decided = self.failure is not None or self.steps >= self._last
            info |= {"robustness": robustness, "success": success, "decided": decided}
        if self.failure is not None:
            info |= {"robustness": -self._limit, "success": False, "failure": str(self.failure)}
        return {agent: dict(info) for agent in self.agents}


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

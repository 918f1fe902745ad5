"""What is asked of free-flyers: actions, observations, signals of the formula, effort."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from gymnasium.spaces import Box

from impact_envs.free_flyer.command import read_commands
from impact_envs.free_flyer.observation import Sensors, make_joint_layout, make_layout
from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.free_flyer.secrets import list_secrets_of_one, make_secrets_layout
from impact_envs.free_flyer.sensing import FELT_SPEED, write_observations
from impact_envs.free_flyer.truth import Physics
from impact_envs.interface.shape import Shape
from impact_envs.observation import MOTION, Layout
from impact_envs.physics.impact import Impact
from impact_envs.reward import compute_effort

SIGNALS = ("x", "y", "vx", "vy", "heading", "omega")


class FreeFlyerTask:
    """Intent of a free-flyer scenario.

    Observation of a robot, float64, SI units, as measured: itself, the other robots and the objects, its contact, the
    time and, for every conjunct of the formula, the interval of STL robustness still possible, clipped to the world's
    diagonal: which subgoals are reached shows there; every element is listed by ``layouts[robot].describe()``, and
    those of all robots together by ``joint_layout.describe()``.

    Action of a robot: ``[Fx, Fy, torque]`` in its body frame, in [-1, 1] of its limits.
    """

    def __init__(self, scenario: FreeFlyerScenario) -> None:
        self.scenario = scenario
        self._robots, self._period, self._horizon = scenario.robots, scenario.control_period, scenario.horizon
        limits = [(robot.force_limit, robot.force_limit, robot.torque_limit) for robot in scenario.robots.values()]
        self._limits, self._ones = np.array(limits, dtype=float), np.ones((len(limits), 3))
        self._sensors = Sensors(scenario)
        self._rows = {name: row for row, name in enumerate(scenario.agents)}
        self._signals = [f"{body}.{name}" for body in scenario.bodies for name in SIGNALS]
        self.joint_layout = make_joint_layout(scenario)
        self.layouts = {name: make_layout(scenario, name) for name in scenario.agents}
        own = self.layouts[scenario.agents[0]].size
        self._joint_shape, self._agents_shape = (1, self.joint_layout.size), (1, len(scenario.robots), own)
        self._nobody = np.empty((1, 0, own))
        self.action_spaces = {name: Box(-1.0, 1.0, (3,), np.float32) for name in scenario.agents}
        units = ("force along its own x axis [{:g} N]", "force along its own y axis [{:g} N]", "torque [{:g} N m]")
        self.action_elements = {
            name: tuple(text.format(limit) for text, limit in zip(units, row, strict=True))
            for name, row in zip(scenario.agents, limits, strict=True)
        }
        self.observation_spaces = {name: layout.make_space() for name, layout in self.layouts.items()}
        self.joint_observation_space = self.joint_layout.make_space()
        self.state_layout = Layout(*((body, MOTION) for body in scenario.bodies))
        self.secrets_layout = make_secrets_layout(scenario)

    def reset(self, physics: Physics, states: np.ndarray, rng: np.random.Generator) -> None:
        """Start an episode.

        Args:
            physics: the drawn true world.
            states: true start states, shape (bodies, 6).
            rng: the episode's generator.
        """
        self._sensors.reset(physics, rng)
        self.sense(states, [])

    def controls(self, actions: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Scale actions to body-frame force and torque [N, N, N m], shape (3,) each.

        Raises:
            InputError: a robot without action, an unknown robot, or an action that is not three finite numbers.
        """
        controls = read_commands(actions, self._robots, self._ones, "action") * self._limits
        return {name: controls[row] for name, row in self._rows.items()}

    def effort(self, action: np.ndarray) -> float:
        """Return a robot's effort in one control period (see `compute_effort`), in [0, 1]."""
        return compute_effort(np.asarray(action))

    def impulse(self, controls: Mapping[str, np.ndarray]) -> float:
        """Return the propulsion spent in one control period: sum of |F| dt over robots [N s]."""
        total = 0.0
        for u in controls.values():
            fx, fy, _ = u.tolist()
            total += math.hypot(fx, fy)
        return total * self._period

    def sense(self, states: np.ndarray, impacts: Sequence[Impact]) -> None:
        """Take the sensors' sample of this control step.

        Args:
            states: true states, shape (bodies, 6).
            impacts: impacts of the last control period.
        """
        contacts = np.zeros(len(self._rows))
        for impact in impacts:
            for name in (impact.a, impact.b):
                if impact.speed > FELT_SPEED and name in self._rows:
                    contacts[self._rows[name]] = 1.0
        self._measured, self._contacts = self._sensors.measure(states, contacts)

    def observe(self, time: float, robustness: Sequence[float]) -> dict[str, np.ndarray]:
        """Return each robot's observation.

        Args:
            time: [s].
            robustness: lower and upper end of each conjunct's interval still possible, finite [m].
        """
        agents = np.empty(self._agents_shape)
        self._write(time, robustness, agents)
        return {name: agents[0, row] for name, row in self._rows.items()}

    def observe_jointly(self, time: float, robustness: Sequence[float]) -> np.ndarray:
        """Return everything measured once: bodies in scenario order, contacts, time / horizon, robustness intervals."""
        return self._write(time, robustness, self._nobody)

    def signals(self, states: np.ndarray) -> dict[str, float]:
        """Return the named signals a formula speaks of, for example ``pop.x``."""
        return dict(zip(self._signals, states.ravel().tolist(), strict=True))

    def signal_bounds(self) -> dict[str, tuple[float, float]]:
        """Return what is known of signals beforehand: solid walls keep every body in the world box."""
        (x0, y0), (x1, y1) = self.scenario.world.lower, self.scenario.world.upper
        limits = {"x": (x0, x1), "y": (y0, y1)}
        return {f"{body}.{axis}": limit for body in self.scenario.bodies for axis, limit in limits.items()}

    def list_secrets(self, physics: Physics) -> np.ndarray:
        """Return a world's drawn physics as ``secrets_layout`` says, shape (size,)."""
        return list_secrets_of_one(physics)

    def shapes(self) -> tuple[Shape, ...]:
        """Return regions, obstacles and bodies as shapes, in drawing order."""
        scenario = self.scenario
        areas = [Shape(None, "region", vertices=a.corners, label=n) for n, a in scenario.regions.items()]
        areas += [Shape(None, "obstacle", vertices=a.corners, label=n) for n, a in scenario.obstacles.items()]
        robots = [Shape(n, "robot", radius=robot.radius, label=n) for n, robot in scenario.robots.items()]
        objects = [
            Shape(n, "object", None if body.vertices else body.radius, body.vertices, n)
            for n, body in scenario.objects.items()
        ]
        return (*areas, *objects, *robots)

    def chains(self, states: np.ndarray) -> dict[str, np.ndarray]:
        """Return nothing: a free-flyer is held by nobody."""
        return {}

    def _write(self, time: float, robustness: Sequence[float], agents: np.ndarray) -> np.ndarray:
        """Return the joint observation, and write those of the robots for which there is room."""
        joint = np.empty(self._joint_shape)
        measured, felt = self._measured[None], self._contacts[None]
        ends = np.array([robustness], dtype=float)
        write_observations(0, measured, felt, time / self._horizon, ends, joint, agents)
        return joint[0]

"""What is asked of free-flyers: actions, observations, signals of the formula, effort."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from gymnasium.spaces import Box

from impact_envs.free_flyer.observation import BODY_SIZE, TAIL_SIZE, Sensors
from impact_envs.free_flyer.schema import FreeFlyerScenario, Physics
from impact_envs.free_flyer.sensing import FELT_SPEED, write_agent_observation, write_joint_observation
from impact_envs.physics.impact import Impact
from impact_envs.shape import Shape

SIGNALS = ("x", "y", "vx", "vy", "heading", "omega")


class FreeFlyerTask:
    """Intent of a free-flyer scenario.

    Observation of a robot, float64, SI units, as measured: for itself, the other robots and the objects
    ``x, y, vx, vy, cos(heading), sin(heading), omega`` [m, m/s, -, rad/s]; then ``contact`` (1 if its inertial unit
    felt an impact in the last step), ``time / horizon``, ``robustness_lower``, ``robustness_upper`` (the interval of
    STL robustness still possible, clipped to the world's diagonal [m]).

    Action of a robot: ``[Fx, Fy, torque]`` in its body frame, in [-1, 1] of its limits.
    """

    def __init__(self, scenario: FreeFlyerScenario) -> None:
        self.scenario = scenario
        self._limits = {
            name: (robot.force_limit, robot.force_limit, robot.torque_limit) for name, robot in scenario.robots.items()
        }
        self._sensors = Sensors(scenario)
        self._names = scenario.agents
        self._signals = [f"{body}.{name}" for body in scenario.bodies for name in SIGNALS]
        self._contacts = np.zeros(len(scenario.robots))
        size = BODY_SIZE * len(scenario.bodies)
        n = len(scenario.robots)
        self.action_spaces = {name: Box(-1.0, 1.0, (3,), np.float32) for name in scenario.agents}
        self.observation_spaces = {name: _unbounded(size + TAIL_SIZE) for name in scenario.agents}
        self.joint_observation_space = _unbounded(size + n + TAIL_SIZE - 1)
        self.state_space = _unbounded(6 * len(scenario.bodies) + 1)

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
        """Scale actions to body-frame force and torque [N, N, N m], shape (3,) each."""
        # Plain numbers: arrays of three cost more than the whole step.
        return {
            name: np.array([min(max(float(u), -1.0), 1.0) * w for u, w in zip(action, self._limits[name], strict=True)])
            for name, action in actions.items()
        }

    def effort(self, action: np.ndarray) -> float:
        """Return a robot's effort in one control period: mean square of its action, in [0, 1]."""
        total = 0.0
        for u in action:
            clipped = min(max(float(u), -1.0), 1.0)
            total += clipped * clipped
        return total / len(action)

    def impulse(self, controls: Mapping[str, np.ndarray]) -> float:
        """Return the propulsion spent in one control period: sum of |F| dt over robots [N s]."""
        return sum(math.hypot(u[0], u[1]) for u in controls.values()) * self.scenario.control_period

    def sense(self, states: np.ndarray, impacts: Sequence[Impact]) -> None:
        """Take the sensors' sample of this control step.

        Args:
            states: true states, shape (bodies, 6).
            impacts: impacts of the last control period.
        """
        felt = {name for impact in impacts if impact.speed > FELT_SPEED for name in (impact.a, impact.b)}
        contacts = np.array([float(name in felt) for name in self._names])
        self._measured, self._contacts = self._sensors.measure(states, contacts)

    def observe(self, time: float, bounds: tuple[float, float]) -> dict[str, np.ndarray]:
        """Return each robot's observation.

        Args:
            time: [s].
            bounds: interval of robustness still possible, finite [m].
        """
        joint = self.observe_jointly(time, bounds)[None]
        agents = np.empty((1, len(self.scenario.robots), BODY_SIZE * len(self.scenario.bodies) + TAIL_SIZE))
        for i in range(len(self.scenario.robots)):
            write_agent_observation(0, i, joint, agents)
        return {agent: row.copy() for agent, row in zip(self._names, agents[0], strict=True)}

    def observe_jointly(self, time: float, bounds: tuple[float, float]) -> np.ndarray:
        """Return everything measured once: bodies in scenario order, contacts, time / horizon, robustness interval."""
        joint = np.empty((1, self.joint_observation_space.shape[0]))
        measured, felt = self._measured[None], self._contacts[None]
        write_joint_observation(0, measured, felt, time / self.scenario.horizon, *bounds, joint)
        return joint[0]

    def signals(self, states: np.ndarray) -> dict[str, float]:
        """Return the named signals a formula speaks of, for example ``pop.x``."""
        return dict(zip(self._signals, states.ravel().tolist(), strict=True))

    def signal_bounds(self) -> dict[str, tuple[float, float]]:
        """Return what is known of signals beforehand: solid walls keep every body in the world box."""
        (x0, y0), (x1, y1) = self.scenario.world.lower, self.scenario.world.upper
        limits = {"x": (x0, x1), "y": (y0, y1)}
        return {f"{body}.{axis}": limit for body in self.scenario.bodies for axis, limit in limits.items()}

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


def _unbounded(size: int) -> Box:
    return Box(-np.inf, np.inf, (size,), np.float64)

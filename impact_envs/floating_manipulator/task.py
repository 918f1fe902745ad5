"""The task of a floating manipulator: actions, observations, signals of the formula, effort."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.spaces import Box

from impact_envs.compiled import bind
from impact_envs.floating_manipulator.actuation import compute_forces, join_limits, make_actuators, scale_action
from impact_envs.floating_manipulator.observation import find_places, make_layout, select_felt, write_observation
from impact_envs.floating_manipulator.schema import FloatingManipulatorScenario, Physics
from impact_envs.floating_manipulator.secrets import list_secrets, make_secrets_layout
from impact_envs.floating_manipulator.signals import find_length, read_coordinates, write_signals
from impact_envs.interface.agent_vectors import read_vectors
from impact_envs.interface.failure import are_finite
from impact_envs.interface.shape import Shape
from impact_envs.normal import draw_normals
from impact_envs.observation import MOTION, Layout
from impact_envs.physics.impact import Impact
from impact_envs.reward import compute_effort
from impact_envs.stl import SIGNALS, Distance

LINK_WIDTH = 0.16  # of the arm as drawn [m]


class FloatingManipulatorTask:
    """Intent of a floating-manipulator scenario.

    Observation, float64, SI units, as measured (with the true world's noise, as old as its delay; time and robustness
    are exact), the same vector for both agents: base ``x, y, cos(psi), sin(psi)``
    [m, -]; joint angles ``q_1 ... q_n`` [rad]; base ``vx, vy, dpsi/dt`` [m/s, rad/s]; joint rates [rad/s]; tip
    relative to its goal ``x, y`` [m] and its velocity ``vx, vy`` [m/s]; box ``x, y, vx, vy, cos(heading),
    sin(heading), omega`` [m, m/s, -, rad/s]; ``contact`` (1 if the arm felt an impact in the last step),
    ``time / horizon``, and of each conjunct of the formula ``robustness_lower``, ``robustness_upper`` (the interval of
    STL robustness still possible, clipped to the world's diagonal).

    Action of ``arm``: joint torques in [-1, 1] of three times their stall torques, before the motors' limits. Action of
    ``base``: ``[Fx, Fy, torque]`` along the world's axes; the on/off thrusters fire where the command exceeds their
    dead zone, the wheel's torque is in [-1, 1] of three times its stall torque. Commands of actuators that the base
    lacks are ignored.

    Signals of the formula, in addition to position and velocity of every body: ``link.joint_velocity`` [rad/s] and
    ``link.torque`` [N m] of the joint that carries the link, held in the last control period;
    ``base.momentum_x, base.momentum_y`` [N s] and ``base.angular_momentum`` [N m s] about the world's origin, of base,
    arm and load together; the same of ``box``; ``tip.impulse``, the sum of impulses on the box in the last control
    period [N s]; ``tip.since_impact``, the time since the last impact felt, before the first one the horizon [s].

    Attributes:
        signal_names: in the order of `signals`.
    """

    def __init__(self, scenario: FloatingManipulatorScenario) -> None:
        self.scenario = scenario
        n = len(scenario.links)
        self._horizon, self._agents = float(scenario.horizon), scenario.agents
        self._period, self._thrusters = scenario.control_period, scenario.thrusters
        largest = scenario.largest_commands
        self._sizes = {name: len(limits) for name, limits in largest.items()}
        true = scenario.true
        self._noise = np.array(
            [true.position_noise] * 2 + [true.speed_noise] * 2 + [true.heading_noise, true.rate_noise]
        )
        self._is_noisy = bool(self._noise.any())
        states = [f"{body}.{name}" for body in scenario.bodies for name in SIGNALS]
        self.signal_names = (*states, *scenario.extra_signals)
        self._no_signals = dict.fromkeys(self.signal_names, 0.0)
        self._w, self._rates, self._values = np.zeros((n + 1, 2)), np.zeros(n + 1), np.zeros(len(self.signal_names))
        self._q, self._v, self._action, self._command, self._force = np.zeros((5, n + 3))
        parts = {"arm": slice(3, None), "base": slice(0, 3)}  # of all commands
        self._parts, self._all_limits = {agent: parts[agent] for agent in self._sizes}, join_limits(scenario)
        self.action_spaces = {agent: Box(-1.0, 1.0, limit.shape, np.float32) for agent, limit in largest.items()}
        joints, forces = [f"torque of {link}" for link in scenario.links], ("force along x", "force along y", "torque")
        self.action_elements = {
            "arm": tuple(f"{name} [{limit:g} N m]" for name, limit in zip(joints, largest["arm"], strict=True))
        }
        if "base" in largest:
            limits = zip(forces, largest["base"], ("N", "N", "N m"), strict=True)
            self.action_elements["base"] = tuple(f"{name} [{limit:g} {unit}]" for name, limit, unit in limits)
        self.joint_layout = make_layout(scenario)
        self.layouts = dict.fromkeys(scenario.agents, self.joint_layout)
        self._places = find_places(self.joint_layout)
        self.joint_observation_space = self.joint_layout.make_space()
        self.observation_spaces = dict.fromkeys(scenario.agents, self.joint_observation_space)
        self.state_layout = Layout(*((body, MOTION) for body in scenario.bodies))
        self.secrets_layout = make_secrets_layout(scenario)
        self._physics = scenario.as_believed().draw(np.random.default_rng(0))
        self._bind()

    def reset(self, physics: Physics, states: np.ndarray, rng: np.random.Generator) -> None:
        """Start an episode.

        Args:
            physics: the drawn true world.
            states: true start states, shape (bodies, 6).
            rng: the episode's generator.
        """
        self._physics, self._actuators = physics, make_actuators(self.scenario, physics)
        self._impulse, self._since, self._samples = 0.0, self._horizon, 0
        self._force[:] = 0.0
        self._hit: float | None = None
        self._rng = rng
        self._measured: deque[tuple[np.ndarray, bool]] = deque(maxlen=self.scenario.true.delay_steps + 1)
        self._store_sample(states, False)

    def controls(self, actions: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Scale actions to commanded torques and forces [N m], [N].

        Raises:
            InputError: an agent without action, an unknown agent, or an action that is not its finite numbers.
        """
        action, command = self._action, self._command
        read = read_vectors(actions, self._sizes, "action", finite=False)
        for agent, part in self._parts.items():
            action[part] = read[agent]
        if not are_finite(action):  # one look at all; who is to blame is asked only then
            read_vectors(actions, self._sizes, "action")
        self._scale_action(self._all_limits, action, command)
        self._compute_forces(self._actuators, self._v, command, self._force)
        return {agent: command[part].copy() for agent, part in self._parts.items()}

    def effort(self, action: np.ndarray) -> float:
        """Return an agent's effort in one control period (see `compute_effort`), in [0, 1]."""
        return compute_effort(np.asarray(action))

    def impulse(self, controls: Mapping[str, np.ndarray]) -> float:
        """Return the thrusters' propulsion in one control period: sum of |F| dt over the axes [N s]."""
        thrusters = self._thrusters
        if thrusters is None:
            return 0.0
        x, y, _ = controls["base"].tolist()
        firing = (abs(x) > thrusters.dead_zone) + (abs(y) > thrusters.dead_zone)
        return firing * self._physics.thruster_force * self._period

    def sense(self, states: np.ndarray, impacts: Sequence[Impact]) -> None:
        """Take the sensors' sample of this control step.

        Args:
            states: true states, shape (bodies, 6).
            impacts: impacts of the last control period.
        """
        felt = select_felt(impacts) if impacts else []
        self._store_sample(states, bool(felt))
        self._samples += 1
        self._impulse = sum((find_length(*impact.impulse) for impact in impacts), 0.0) if impacts else 0.0
        if felt:
            self._hit = felt[-1].time
        if self._hit is not None:
            self._since = self._samples * self._period - self._hit

    def observe(self, time: float, robustness: Sequence[float]) -> dict[str, np.ndarray]:
        """Return each agent's observation.

        Args:
            time: [s].
            robustness: lower and upper end of each conjunct's interval still possible, finite.
        """
        vector = self.observe_jointly(time, robustness)
        return {agent: vector.copy() for agent in self._agents}

    def observe_jointly(self, time: float, robustness: Sequence[float]) -> np.ndarray:
        """Return the observation, which is each agent's too."""
        vector = np.empty(self.joint_layout.size)
        states, contact = self._measured[0]
        ends = np.array(robustness, dtype=float)
        self._write_observation(states, contact, time / self._horizon, ends, self._places, vector)
        return vector

    def signals(self, states: np.ndarray) -> dict[str, float]:
        """Return the named signals a formula speaks of, for example ``tip.x``.

        Args:
            states: true states, those last sensed, shape (bodies, 6).
        """
        physics, felt = self._physics, (self._impulse, self._since)
        box, work = (physics.box_mass, physics.box_inertia), (self._w, self._rates)
        known = self._q, self._v, self._force[3:], felt, work, self._values
        self._write_signals(physics.chain, box, states, *known)
        signals = self._no_signals.copy()  # so large at once: it need not grow
        signals.update(zip(self.signal_names, self._values.tolist(), strict=True))
        return signals

    def signal_bounds(self) -> dict[str, tuple[float, float]]:
        """Return the bounds known beforehand: the goal is fixed, times and impulses are not negative."""
        x, y = self.scenario.arm.goal
        times = (0.0, self.scenario.horizon)
        return {
            "target.x": (x, x),
            "target.y": (y, y),
            "tip.since_impact": times,
            "tip.impulse": (0.0, math.inf),
        }

    def list_secrets(self, physics: Physics) -> np.ndarray:
        """Return a world's drawn physics as ``secrets_layout`` says, shape (size,)."""
        return list_secrets(physics)

    def shapes(self) -> tuple[Shape, ...]:
        """Return regions, goal, box, base and arm as shapes, in drawing order; links have no label and no trail."""
        scenario = self.scenario
        areas = [Shape(None, "region", vertices=a.corners, label=n) for n, a in scenario.regions.items()]
        box = Shape("box", "object", vertices=_make_rectangle(*scenario.box.size), label="box")
        base = Shape("base", "robot", vertices=_make_rectangle(*scenario.base.size), label="base")
        links = [
            Shape(name, "robot", vertices=_make_bar(link.center_of_mass, link.length))
            for name, link in scenario.links.items()
        ]
        tip = Shape("tip", "robot", vertices=_make_disc(0.0, 0.0, scenario.load.radius), label="tip")
        return (*areas, *self._goal_shapes(), box, base, *links, tip)

    def chains(self, states: np.ndarray) -> dict[str, np.ndarray]:
        """Return nothing: the links are shapes."""
        return {}

    def _bind(self) -> None:
        """Find the machine code of what runs in every control period."""
        chain, (bodies, size) = self._physics.chain, (len(self.scenario.bodies), self.joint_layout.size)
        motion = np.zeros((bodies, 6)), self._q.copy(), self._v.copy()
        actuators, force = make_actuators(self.scenario, self._physics), self._force.copy()
        self._compute_forces = bind(compute_forces, actuators, self._v, self._command, force)
        self._scale_action = bind(scale_action, self._all_limits, self._action, self._command.copy())
        self._read_coordinates = bind(read_coordinates, *motion)
        pair, work = (1.0, 1.0), (self._w, self._rates)
        self._write_signals = bind(write_signals, chain, pair, *motion, force[3:], pair, work, self._values)
        ends = np.zeros(len(self.joint_layout.fields["robustness"]))
        seen = motion[0], False, 0.0, ends, self._places, np.zeros(size)
        self._write_observation = bind(write_observation, *seen)

    def __getstate__(self) -> dict[str, Any]:
        bound = ("_scale_action", "_compute_forces", "_read_coordinates", "_write_signals", "_write_observation")
        return {name: value for name, value in self.__dict__.items() if name not in bound}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._bind()

    def _goal_shapes(self) -> list[Shape]:
        """Return the goal as discs whose radii are the formula's bounds on the distance of tip and target."""
        x, y = self.scenario.arm.goal
        asked = [p for p in self.scenario.specification.walk() if isinstance(p, Distance)]
        radii = sorted({p.bound for p in asked if set(p.bodies()) == {"tip", "target"}}, reverse=True)
        labels = ["goal"] + max(len(radii) - 1, 0) * [""]
        return [
            Shape(None, "region", vertices=_make_disc(x, y, radius), label=label)
            for radius, label in zip(radii, labels, strict=False)
        ]

    def _store_sample(self, states: np.ndarray, contact: bool) -> None:
        """Store the true coordinates of the manipulator, and the measurement that is observed after the delay."""
        self._read_coordinates(states, self._q, self._v)
        measured = states.copy()
        if self._is_noisy:
            drawn = draw_normals(self._rng, 6 * (len(states) - 1))
            measured[:-1] += self._noise * drawn.reshape(-1, 6)
        self._measured.append((measured, contact))


def _make_rectangle(length: float, width: float) -> tuple[tuple[float, float], ...]:
    a, b = length / 2, width / 2
    return ((-a, -b), (a, -b), (a, b), (-a, b))


def _make_bar(center: float, length: float) -> tuple[tuple[float, float], ...]:
    """Return a link as drawn, from its centre of mass: round at its joint, pointed at its end."""
    b, end = LINK_WIDTH / 2, length - center
    angles = np.linspace(math.pi / 2, 3 * math.pi / 2, 9).tolist()
    joint = [(b * math.cos(angle) - center, b * math.sin(angle)) for angle in angles]
    return (*joint, (end - b, -b), (end, 0.0), (end - b, b))


def _make_disc(x: float, y: float, radius: float) -> tuple[tuple[float, float], ...]:
    angles = 2 * math.pi * np.arange(32) / 32
    return tuple((x + radius * math.cos(angle), y + radius * math.sin(angle)) for angle in angles)

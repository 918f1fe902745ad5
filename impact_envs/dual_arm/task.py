"""The task of two arms that grasp: actions, observations, signals of the formula, effort."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from gymnasium.spaces import Box

from impact_envs.dual_arm.arm import compute_pose
from impact_envs.dual_arm.observation import TRUTH, make_joint_layout, make_layout
from impact_envs.dual_arm.schema import DualArmScenario, Physics
from impact_envs.dual_arm.secrets import list_secrets, make_secrets_layout
from impact_envs.dual_arm.world import FORCES, JOINTS, KEPT
from impact_envs.elementary import cos_sin
from impact_envs.interface.agent_vectors import read_vectors
from impact_envs.interface.shape import Shape
from impact_envs.observation import Layout
from impact_envs.physics.impact import Impact
from impact_envs.reward import compute_effort

MOTION = slice(0, 6)
MOVED = slice(JOINTS.start, FORCES.stop)  # angles, rates and forces: side by side in a state as in an observation
# Effort is counted per tenth of a second, however short the control period: the weight of effort then means the same.
EFFORT_PERIOD = 0.1  # [s]
PAD_DEPTH, TABLE_DEPTH = 0.03, 0.05  # as drawn [m]


class DualArmTask:
    """Intent of a dual-arm scenario.

    Observation of an arm, float64, SI units, exact: of itself and then of the other arm ``q1, q2, q3, q1', q2', q3'``
    [rad, rad/s], the normal forces at its pad's two corners [N], and of its pad ``x, y, cos(heading), sin(heading), vx,
    vy, omega`` [m, -, m/s, rad/s]; then ``time / horizon``. Neither the box nor the robustness is observed;
    the robustness would reveal the box's pose.

    Action of an arm: torques of its three joints in [-1, 1] of their limits, held over the control period.

    Effort: mean square of the action, times the control period over 0.1 s.
    """

    def __init__(self, scenario: DualArmScenario) -> None:
        self.scenario = scenario
        self._limits = scenario.links.torque_limits
        self._sizes = dict.fromkeys(scenario.agents, 3)
        self._arms = scenario.arm_numbers()
        self._signals = [f"{body}.{name}" for body in scenario.bodies for name in scenario.signals]
        self._measured: list[list[float]] = []  # of each arm, as ARM says
        self.joint_layout = make_joint_layout(scenario)
        self.layouts = dict.fromkeys(scenario.agents, make_layout())
        self.action_spaces = {name: Box(-1.0, 1.0, (3,), np.float32) for name in scenario.agents}
        elements = tuple(f"torque of joint {j} [{limit:g} N m]" for j, limit in enumerate(self._limits, 1))
        self.action_elements = dict.fromkeys(scenario.agents, elements)
        self.observation_spaces = {name: layout.make_space() for name, layout in self.layouts.items()}
        self.joint_observation_space = self.joint_layout.make_space()
        self.state_layout = Layout(*((body, TRUTH) for body in scenario.bodies))
        self.secrets_layout = make_secrets_layout(scenario)

    def reset(self, physics: Physics, states: np.ndarray, rng: np.random.Generator) -> None:
        """Start an episode.

        Args:
            physics: the drawn true world.
            states: true start states, shape (3, 22).
            rng: the episode's generator.
        """
        self.sense(states, [])

    def controls(self, actions: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Scale actions to joint torques [N m], shape (3,) each.

        Raises:
            InputError: an arm without action, an unknown arm, or an action that is not three finite numbers.
        """
        read = read_vectors(actions, self._sizes, "action")
        return {
            name: np.array(
                [min(max(u, -1.0), 1.0) * limit for u, limit in zip(read[name].tolist(), self._limits, strict=True)]
            )
            for name in actions
        }

    def effort(self, action: np.ndarray) -> float:
        """Return an arm's effort in one control period, in [0, 1] where that is at most 0.1 s."""
        return compute_effort(np.asarray(action)) * self.scenario.control_period / EFFORT_PERIOD

    def impulse(self, controls: Mapping[str, np.ndarray]) -> float:
        """Return the propulsion of all joints in one control period: sum of |tau| dt [N m s]."""
        return sum(abs(tau) for u in controls.values() for tau in u.tolist()) * self.scenario.control_period

    def sense(self, states: np.ndarray, impacts: Sequence[Impact]) -> None:
        """Take the sensors' sample of this control step.

        Args:
            states: true states, shape (3, 22).
            impacts: of the last control period.
        """
        self._measured = [_measure(state) for state in states[:2].tolist()]

    def observe(self, time: float, robustness: Sequence[float]) -> dict[str, np.ndarray]:
        """Return each arm's observation.

        Args:
            time: [s].
            robustness: intervals still possible, not observed.
        """
        share = time / self.scenario.horizon
        first, second = self._measured
        pairs = ((first, second), (second, first))
        return {
            name: np.array([*own, *other, share]) for name, (own, other) in zip(self.scenario.arms, pairs, strict=True)
        }

    def observe_jointly(self, time: float, robustness: Sequence[float]) -> np.ndarray:
        """Return everything measured once: both arms, then time / horizon."""
        first, second = self._measured
        return np.array([*first, *second, time / self.scenario.horizon])

    def signals(self, states: np.ndarray) -> dict[str, float]:
        """Return the named signals a formula speaks of, for example ``box.slip``."""
        values = [value for row in states.tolist() for value in (*row[MOTION], *row[KEPT])]
        return dict(zip(self._signals, values, strict=True))

    def signal_bounds(self) -> dict[str, tuple[float, float]]:
        """Return the bounds known beforehand: limits of torques and times; no signal of a grasp is negative."""
        torque = max(self._limits)
        upper = {"torque": torque, "torque_step": 2.0 * torque}
        upper |= dict.fromkeys(("lag", "interim", "limit_time"), self.scenario.horizon)
        upper |= dict.fromkeys(("force_min", "force_max", "slip"), math.inf)
        return {f"{body}.{name}": (0.0, limit) for body in self.scenario.bodies for name, limit in upper.items()}

    def list_secrets(self, physics: Physics) -> np.ndarray:
        """Return a world's drawn physics as ``secrets_layout`` says, shape (size,)."""
        return list_secrets(physics)

    def shapes(self) -> tuple[Shape, ...]:
        """Return regions, the table at its believed pose, the box and the pads, in drawing order."""
        scenario = self.scenario
        box, pad = scenario.box, scenario.links.pad_half_height
        regions = [Shape(None, "region", vertices=a.corners, label=n) for n, a in scenario.regions.items()]
        x, y, heading = box.start.array
        c, d = math.cos(heading), math.sin(heading)
        top = -box.half_height
        slab = _make_rectangle(-2.0 * box.half_width, top - TABLE_DEPTH, 2.0 * box.half_width, top)
        table = Shape(
            None, "obstacle", vertices=tuple((x + c * u - d * v, y + d * u + c * v) for u, v in slab), label="table"
        )
        sides = _make_rectangle(-box.half_width, -box.half_height, box.half_width, box.half_height)
        pads = [Shape(n, "robot", vertices=_make_rectangle(-PAD_DEPTH, -pad, 0.0, pad), label=n) for n in scenario.arms]
        return (*regions, table, Shape("box", "object", vertices=sides, label="box"), *pads)

    def chains(self, states: np.ndarray) -> dict[str, np.ndarray]:
        """Return the polyline of each arm: base, elbow, wrist and pad.

        Args:
            states: true states, shape (3, 22).

        Returns:
            Arm to shape (4, 2) [m].
        """
        chains = {}
        for name, arm, state in zip(self.scenario.arms, self._arms, states[:2], strict=True):
            q1, q2, q3 = state[JOINTS].tolist()
            base = arm[:2]
            elbow = base + arm[2] * np.array([math.cos(q1), math.sin(q1)])
            wrist = elbow + arm[3] * np.array([math.cos(q1 + q2), math.sin(q1 + q2)])
            pad = compute_pose(arm, q1, q2, q3)[:2]
            chains[name] = np.array([base, elbow, wrist, pad])
        return chains


def _measure(state: list[float]) -> list[float]:
    """Return what is measured of an arm, as ARM says, from the row of its pad's true state."""
    x, y, vx, vy, heading, omega = state[MOTION]
    return [*state[MOVED], x, y, *cos_sin(heading), vx, vy, omega]


def _make_rectangle(x0: float, y0: float, x1: float, y1: float) -> tuple[tuple[float, float], ...]:
    return ((x0, y0), (x1, y0), (x1, y1), (x0, y1))

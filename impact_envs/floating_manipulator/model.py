"""A floating manipulator and a free box: flight by Runge-Kutta 4, exact impacts of the tip, pushing without overlap.

Flight and impacts are compiled (``flow``, ``events``, ``collision``). Motors, wheel and thrusters compute forces
and torques from the commands and speeds at the start of a control period, and hold them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from impact_envs.compiled import bind
from impact_envs.errors import InputError, choices
from impact_envs.floating_manipulator.actuation import make_actuators
from impact_envs.floating_manipulator.collision import (
    ENDLESS,
    EVENTS,
    STRIKE,
    STRUCK,
    Progress,
    advance_to_impact,
    hold_controls,
)
from impact_envs.floating_manipulator.flow import (
    compute_rows,
    find_contact,
    make_scratch,
    make_system,
)
from impact_envs.floating_manipulator.schema import FloatingManipulatorScenario, Physics
from impact_envs.interface.agent_vectors import FLOAT
from impact_envs.interface.failure import TooManyEvents, are_finite
from impact_envs.physics.impact import Impact
from impact_envs.physics.multibody import (
    compute_directions,
    compute_kinetic_energy,
    compute_momenta,
)


@dataclass(frozen=True, eq=False)
class Collision:
    """One impact with all velocities before and after it.

    Attributes:
        impact: of tip and box.
        q: coordinates of the manipulator, shape (n + 3,) [m], [rad].
        v_minus, v_plus: their rates before and after, shape (n + 3,) [m/s], [rad/s].
        box: x, y, heading of the box, shape (3,) [m], [rad].
        box_minus, box_plus: velocity of the box before and after, shape (3,) [m/s], [rad/s].
    """

    impact: Impact
    q: np.ndarray
    v_minus: np.ndarray
    v_plus: np.ndarray
    box: np.ndarray
    box_minus: np.ndarray
    box_plus: np.ndarray


class FloatingManipulatorModel:
    """Physics of the floating-manipulator domain.

    Only tip and box touch; links and base pass through the box. The reaction wheel acts as an external torque on the
    base (as in the paper); ``wheel_momentum`` sums the angular momentum that it takes up.

    The state between control periods is plain numbers: a pickled model continues bit for bit.

    Args:
        scenario: who is where.

    Attributes:
        physics: of the current episode.
        collisions: of the last control period.
        torques: of the joints, held over the last control period, shape (n,) [N m].
        base_forces: Fx, Fy and torque on the base, held over the last control period, shape (3,) [N], [N m].
        wheel_momentum: angular momentum the wheel has taken up [N m s].
    """

    def __init__(self, scenario: FloatingManipulatorScenario) -> None:
        self.scenario = scenario
        self._n = len(scenario.links)
        self._period, self._goal = float(scenario.control_period), scenario.arm.goal
        self._sizes = {agent: len(limits) for agent, limits in scenario.largest_commands.items()}
        self._scratch, self._strike, self._command = make_scratch(self._n), np.zeros(1, STRIKE), np.zeros(self._n + 3)
        self._rows = np.zeros((self._n + 4, 6))  # what `state` returns, but for all that moves
        self._rows[-1, :2] = self._goal
        self.reset(scenario.as_believed().draw(np.random.default_rng(0)))
        self._bind()

    def reset(self, physics: Physics) -> None:
        """Put manipulator and box at rest at their start in a world with these physics.

        Args:
            physics: the drawn numbers of one episode.
        """
        scenario, n = self.scenario, self._n
        self.physics = physics
        self._system, self._actuators = make_system(scenario, physics), make_actuators(scenario, physics)
        self._q, self._v = np.concatenate([scenario.start, physics.box_start]), np.zeros(n + 6)
        self._force = np.zeros(n + 6)
        self._touching = False
        self._steps = 0
        self.collisions: list[Collision] = []
        self.wheel_momentum = 0.0

    @property
    def time(self) -> float:
        """Return the time since reset [s]."""
        return self._steps * self._period

    @property
    def torques(self) -> np.ndarray:
        """Return the torques of the joints held over the last control period, shape (n,) [N m]."""
        return self._force[3 : 3 + self._n].copy()

    @property
    def base_forces(self) -> np.ndarray:
        """Return force and torque on the base held over the last control period, shape (3,) [N], [N m]."""
        return self._force[:3].copy()

    @property
    def gap(self) -> float:
        """Return the distance between tip and box [m]."""
        return float(find_contact(self._system, self._q, self._v, self._scratch).gap)

    def coordinates(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the manipulator's coordinates (base x, y, psi, joints) and rates, shape (n + 3,) each."""
        return self._q[:-3].copy(), self._v[:-3].copy()

    def state(self) -> np.ndarray:
        """Return the state of all bodies.

        Returns:
            Rows x, y, vx, vy, heading, omega of base and links (centres of mass), tip, box and target,
            shape (n + 4, 6) [m], [m/s], [rad], [rad/s]. Headings are not wrapped.
        """
        rows = self._rows.copy()
        self._write_rows(self._system, self._q, self._v, self._scratch, rows[:-1])
        return rows

    def set_state(self, states: np.ndarray) -> None:
        """Set the state of manipulator and box; the time is kept.

        Args:
            states: as ``state`` returns them, shape (n + 4, 6); of links only heading and omega are used, of tip and
                target nothing.
        """
        n = self._n
        rows = np.asarray(states, dtype=float)
        self._q[:3], self._v[:3] = rows[0, [0, 1, 4]], rows[0, [2, 3, 5]]
        self._q[3 : 3 + n], self._v[3 : 3 + n] = np.diff(rows[: n + 1, 4]), np.diff(rows[: n + 1, 5])
        self._q[n + 3 :], self._v[n + 3 :] = rows[n + 2, [0, 1, 4]], rows[n + 2, [2, 3, 5]]
        self._touching = False

    def step(self, controls: Mapping[str, np.ndarray]) -> list[Impact]:
        """Advance one control period under held controls.

        Args:
            controls: ``arm``: commanded joint torques, shape (n,) [N m]; where there are thrusters or a wheel,
                ``base``: commanded forces along the world's axes and torque of the wheel, shape (3,) [N], [N m].

        Returns:
            The impacts in order of time; a touch that starts a push is not one.

        Raises:
            InputError: an agent without control, an unknown one, or a control of wrong shape or not finite.
            TooManyEvents: impacts do not end.
        """
        agents = self._sizes
        if controls.keys() != agents.keys():
            wrong = ", ".join(sorted(controls.keys() ^ agents.keys()))
            raise InputError(
                f"controls must name every agent once; wrong or missing: {wrong}; {choices(wrong, agents)}"
            )
        self._read_controls(controls)
        self._advance(self._period)
        if self.scenario.wheel:
            self.wheel_momentum -= self._force[2] * self._period
        self._steps += 1
        return [collision.impact for collision in self.collisions]

    def momenta(self) -> np.ndarray:
        """Return P_x, P_y and L about the world's origin of manipulator and box, shape (2, 3) [N s], [N m s]."""
        q, v = self._q, self._v
        w, rates = self._scratch.w, self._scratch.rates
        compute_directions(self._system.chain, q, v, w, rates)
        m = self._system.box_mass
        (x, y, _), (vx, vy, omega) = q[-3:], v[-3:]
        box = (m * vx, m * vy, self._system.box_inertia * omega + m * (x * vy - y * vx))
        return np.array([compute_momenta(self._system.chain, q[:-3], v[:-3], w, rates), box])

    def energies(self) -> np.ndarray:
        """Return the kinetic energies of manipulator and box, shape (2,) [J]."""
        w, rates = self._scratch.w, self._scratch.rates
        compute_directions(self._system.chain, self._q, self._v, w, rates)
        vx, vy, omega = self._v[-3:]
        box = (self._system.box_mass * (vx**2 + vy**2) + self._system.box_inertia * omega**2) / 2
        return np.array([compute_kinetic_energy(self._system.chain, self._v[:-3], w, rates), box])

    def _read_controls(self, controls: Mapping[str, np.ndarray]) -> None:
        """Write the commands held over the next control period."""
        command = self._command
        command[3:] = _read_control("arm", controls["arm"], self._n)
        if "base" in self._sizes:
            command[:3] = _read_control("base", controls["base"], 3)
        if not are_finite(command):
            for agent, size in self._sizes.items():
                _check_control(agent, controls[agent], size)

    def _advance(self, period: float) -> None:
        """Advance the state by one control period, impact by impact."""
        self.collisions = []
        progress = Progress(0.0, self._touching, 0)
        status, progress = self._hold(*self._collect(period, progress))
        while status == STRUCK:
            self.collisions.append(self._describe_collision())
            _, _, law, _, force, *rest = self._collect(period, progress)
            status, progress = advance_to_impact(self._system, law, force, *rest)
        self._touching = progress.touching
        if status == ENDLESS:
            raise TooManyEvents(EVENTS, "box")

    def _collect(self, period: float, progress: Progress) -> tuple[Any, ...]:
        """Return the arguments of `hold_controls`."""
        law, state = (self.physics.restitution, self.physics.restitution_speed), (self._force, self._q, self._v)
        work = self._scratch, self._strike
        return self._system, self._actuators, law, self._command, *state, period, progress, *work

    def _bind(self) -> None:
        """Find the machine code of what runs in every control period; no time passes."""
        self._hold = bind(hold_controls, *self._collect(0.0, Progress(0.0, False, 0)))
        rows = np.zeros((self._n + 4, 6))
        self._write_rows = bind(compute_rows, self._system, self._q, self._v, self._scratch, rows[:-1])

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name not in ("_hold", "_write_rows")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        force = self._force.copy()
        self._bind()
        self._force[:] = force

    def _describe_collision(self) -> Collision:
        """Return the impact that just happened."""
        strike, v_minus = self._strike[0], self._scratch.v_minus.copy()
        time, speed, normal = self.time + float(strike["time"]), float(strike["speed"]), strike["normal"]
        point, impulse = _as_pair(strike["point"]), _as_pair(strike["impulse"] * normal)
        q, v = self._q.copy(), self._v.copy()
        impact = Impact(time, "tip", "box", point, _as_pair(normal), impulse, speed)
        return Collision(impact, q[:-3], v_minus[:-3], v[:-3], q[-3:], v_minus[-3:], v[-3:])


def _read_control(agent: str, control: np.ndarray, size: int) -> np.ndarray:
    """Return a control as an array of a size, of which no more is known."""
    if type(control) is np.ndarray and control.dtype is FLOAT and control.shape == (size,):
        return control
    return _check_control(agent, control, size)


def _check_control(agent: str, control: np.ndarray, size: int) -> np.ndarray:
    """Return a control as an array of a size; raise if it is none."""
    values = np.asarray(control, dtype=float)
    if values.shape != (size,) or not are_finite(values):
        text = np.array2string(values, threshold=8).replace("\n", "")
        raise InputError(f"control of {agent} = {text}: {size} finite numbers are needed")
    return values


def _as_pair(vector: Sequence[float] | np.ndarray) -> tuple[float, float]:
    return float(vector[0]), float(vector[1])

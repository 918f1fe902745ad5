"""Two planar arms and a box on a table with compliant contact, stepped one tick of held torques at a time."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from impact_envs.dual_arm.arm import compute_dynamics, compute_kinematics
from impact_envs.dual_arm.grasp_record import add_tick, begin_period, make_grasp_record
from impact_envs.dual_arm.plant import ARM, BOX, CONTACTS, NORMAL, STATE, TANGENTIAL, advance_state, make_plant
from impact_envs.dual_arm.schema import DualArmScenario, Physics
from impact_envs.errors import InputError, choices
from impact_envs.physics.impact import Impact

# Columns of the state.
JOINTS, RATES, FORCES, KEPT, WIDTH = slice(6, 9), slice(9, 12), slice(12, 14), slice(14, 22), 22
SIDES = (1.0, -1.0)  # of the box's frame: arm 1 pushes along +x, arm 2 along -x


class DualArmModel:
    """Physics of the dual-arm domain.

    Joint torques are held over a tick and clipped to their limits. With flexible joints they are the commands of the
    low-level torque loop. The corners of the pads touch the box's two side faces; its other faces and the arms' links
    touch nothing. The table supports the box's lower corners.

    Args:
        scenario: who is where.
    """

    def __init__(self, scenario: DualArmScenario) -> None:
        self.scenario = scenario
        self._substeps = scenario.substeps
        self._step_length = scenario.tick / self._substeps
        self._work = np.zeros((6, STATE))
        self.reset(scenario.as_believed().draw(np.random.default_rng(0)))

    def reset(self, physics: Physics) -> None:
        """Put pads and box at their starts, at rest, with the joint springs bent by the arms' weight.

        Args:
            physics: the drawn numbers of one episode.
        """
        self.physics = physics
        self.plant = make_plant(self.scenario, physics)
        self._ticks = 0
        self._contacts = np.zeros((CONTACTS, 5))
        self._sums = np.zeros((4, 2))
        self._record = make_grasp_record()
        self._touched = np.zeros(2, dtype=bool)
        self._state = np.zeros(STATE)
        q = self.scenario.joint_angles(physics.starts)
        self.set_joints(q, np.zeros((2, 3)))
        self._state[BOX : BOX + 3] = physics.box

    @property
    def time(self) -> float:
        """Return the time since reset [s]."""
        return self._ticks * self.scenario.tick

    def set_joints(self, q: np.ndarray, v: np.ndarray) -> None:
        """Set the joints, with their springs bent by the arms' weight.

        Args:
            q: joint angles, shape (2, 3) [rad].
            v: joint rates, shape (2, 3) [rad/s].
        """
        M, load = np.zeros((3, 3)), np.zeros(3)
        for i in range(2):
            compute_dynamics(self.plant.arms[i], q[i], np.zeros(3), M, load)
            deflection = load / self.plant.joint_stiffness
            self._state[ARM * i : ARM * (i + 1)] = [*q[i], *v[i], *(q[i] + deflection), *v[i]]

    def joints(self) -> tuple[np.ndarray, np.ndarray]:
        """Return joint angles and rates on the link side, shapes (2, 3) [rad], [rad/s]."""
        arms = self._state[:BOX].reshape(2, 4, 3)
        return arms[:, 0].copy(), arms[:, 1].copy()

    def state(self) -> np.ndarray:
        """Return the state of all bodies.

        Returns:
            Rows of both pads and the box, shape (3, 22): x, y, vx, vy, heading, omega; then (zeros for the box) three
            joint angles, three joint rates, the normal forces at the pad's corners; then the grasp's record in the
            order of `schema.GRASP_SIGNALS` [m, m/s, rad, rad/s, N, N m, s].
        """
        rows = np.zeros((3, WIDTH))
        pose, J, drift = np.zeros(3), np.zeros((3, 3)), np.zeros(3)
        q, v = self.joints()
        for i in range(2):
            compute_kinematics(self.plant.arms[i], q[i], v[i], pose, J, drift)
            rows[i, :6] = _interleave(pose, J @ v[i])
        rows[:2, JOINTS], rows[:2, RATES] = q, v
        rows[:2, FORCES] = self._contacts[:4, NORMAL].reshape(2, 2)
        rows[:, KEPT] = self._record.values
        rows[2, :6] = _interleave(self._state[BOX : BOX + 3], self._state[BOX + 3 :])
        return rows

    def contacts(self) -> np.ndarray:
        """Return the contacts at the current state.

        Returns:
            Rows gap [m], gap rate, slip rate [m/s], normal and tangential force on the box [N] of the corners of pad
            1 (2), of pad 2 (2) and of the box on the table (2), shape (6, 5); zeros before the first tick.
        """
        return self._contacts.copy()

    def slips(self) -> np.ndarray:
        """Return the net slip of each pad corner while it touched, since reset, shape (4,) [m]."""
        return self._sums[:, 0].copy()

    def tick(self, torques: np.ndarray) -> None:
        """Advance one tick under held torques.

        Args:
            torques: of each arm's joints, clipped to their limits, shape (2, 3) [N m].
        """
        tau = np.clip(torques, -self.plant.limits, self.plant.limits)
        advance_state(
            self.plant, tau, self._state, self._substeps, self._step_length, self._work, self._contacts, self._sums
        )
        add_tick(self._record, self._contacts, self._sums, tau, self.plant.limits, self.scenario.tick)
        self._ticks += 1

    def step(self, controls: Mapping[str, np.ndarray]) -> list[Impact]:
        """Advance one control period.

        Args:
            controls: arm to its joint torques, held, shape (3,), or one row per tick, shape (ticks, 3) [N m].

        Returns:
            The first touch of each pad, with the impulse up to the end of its tick, in order of time.

        Raises:
            InputError: an arm without control, an unknown arm, or a control that is not finite torques.
        """
        arms = self.scenario.arms
        if controls.keys() != arms.keys():
            wrong = ", ".join(sorted(controls.keys() ^ arms.keys()))
            raise InputError(f"controls must name every arm once; wrong or missing: {wrong}; {choices(wrong, arms)}")
        ticks = self.scenario.ticks
        torques = np.zeros((ticks, 2, 3))
        for i, (name, control) in enumerate((name, controls[name]) for name in arms):
            values = np.asarray(control, dtype=float)
            if values.shape not in ((3,), (ticks, 3)) or not np.isfinite(values).all():
                text = np.array2string(values, threshold=8).replace("\n", "")
                raise InputError(
                    f"control of {name} = {text}: 3 finite joint torques are needed, or {ticks} rows of them"
                )
            torques[:, i] = values
        impacts: list[Impact] = []
        begin_period(self._record)
        for k in range(ticks):
            before = self._sums[:, 1].copy()
            self.tick(torques[k])
            impacts += self._find_touches(before)
        return impacts

    def _find_touches(self, before: np.ndarray) -> list[Impact]:
        """Return the pads' first touches in the last tick, as impacts on the box."""
        impacts = []
        normal = self._sums[:, 1] - before
        x, y, heading = self._state[BOX : BOX + 3]
        axis = np.array([np.cos(heading), np.sin(heading)])
        for i, name in enumerate(self.scenario.arms):
            pair = slice(2 * i, 2 * i + 2)
            if self._touched[i] or not normal[pair].sum() > 0.0:
                continue
            self._touched[i] = True
            n = SIDES[i] * axis
            rows = self._contacts[pair]
            ratio = rows[:, TANGENTIAL].sum() / max(rows[:, NORMAL].sum(), 1e-12)
            impulse = normal[pair].sum() * (n + ratio * np.array([-axis[1], axis[0]]))
            point = np.array([x, y]) - self.scenario.box.half_width * n
            speed = max(0.0, -float(rows[:, 1].min()))
            impacts.append(Impact(self.time, name, "box", tuple(point), tuple(n), tuple(impulse), speed))
        return impacts


def _interleave(pose: np.ndarray, twist: np.ndarray) -> np.ndarray:
    """Return x, y, vx, vy, heading, omega, shape (6,)."""
    return np.array([pose[0], pose[1], twist[0], twist[1], pose[2], twist[2]])

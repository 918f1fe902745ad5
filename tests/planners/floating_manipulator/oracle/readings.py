"""What the floating manipulator's expert believes of its readings; the believed model stands in for the others."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping

import numpy as np

from impact_envs.compiled import compiled
from impact_envs.floating_manipulator.actuation import compute_forces, join_controls, make_actuators
from impact_envs.floating_manipulator.contact import compute_contact
from impact_envs.floating_manipulator.flow import System, make_scratch, take_step
from impact_envs.floating_manipulator.observation import Measurement
from impact_envs.floating_manipulator.schema import FloatingManipulatorScenario
from planners.floating_manipulator.options import EXPERT, ReadingOptions
from planners.floating_manipulator.reading_reach import make_gates
from planners.reading_gate import BELIEVED, COUNTS, REJECTED, Q, V, judge_reading, open_gate, predict_reading
from tests.planners.floating_manipulator.oracle.correction import compute_tip


class Readings:
    """Replace readings that are missing, or that no motion explains, by what the believed model does meanwhile.

    The manipulator and the box are judged apart, each by a `reading_gate`. In its reach the margins are shares of the
    arm's length; the actuators push the base by (F + sum tau / l) / m and (tau_w + tau_1) / I, joint i by
    2 tau_i / I_i; and an impact changes the speed of a point by at most 2 v, where v = sum_i w_i L_i is the speed of
    the tip when every joint runs at its no-load speed w_i, L_i away from the tip.

    The clock goes forward by at most `clock_steps` periods; otherwise a period is added. A contact is believed if the
    tip is near the box.

    Args:
        scenario: as believed.
        options: margins, patience.

    Attributes:
        counts: how often readings were missing, rejected, taken up.
    """

    def __init__(self, scenario: FloatingManipulatorScenario, options: ReadingOptions = EXPERT.readings) -> None:
        self._scenario, self._options, self._period = scenario, options, scenario.control_period
        self._physics = scenario.draw(np.random.default_rng(0))  # as believed: nothing is drawn
        (length, width), physics = scenario.box.size, self._physics
        masses = physics.chain, physics.box_mass, physics.box_inertia
        self._system = System(*masses, length / 2, width / 2, scenario.load.radius)
        self._scratch, self._length = make_scratch(len(scenario.links)), sum(x.length for x in scenario.links.values())
        self._arm, self._box = make_gates(scenario, options)
        self.reset()

    def reset(self) -> None:
        """Expect the manipulator at its start, and the box anywhere."""
        self.counts: Counter[str] = Counter()
        self._time = -self._period
        open_gate(self._arm, self._scenario.start)
        box = self._scenario.box
        open_gate(self._box, np.array([*box.start, box.heading]), known=False)

    def check(self, measurement: Measurement, controls: Mapping[str, np.ndarray] | None) -> Measurement:
        """Return a measurement to act on: as it is, or with what is not believed of it replaced.

        Args:
            measurement: as read.
            controls: of the period before it, None at the start.
        """
        contact, limits = measurement.contact, (self._period, measurement.contact, self._options.patience)
        arm_use, box_use = judge_parts(self._arm, self._box, measurement.q, measurement.v, measurement.box, *limits)
        time = self._read_clock(measurement.time)
        if arm_use == BELIEVED and box_use == BELIEVED and time == measurement.time and not contact:
            return measurement
        self.counts.update(COUNTS[use] for use in (arm_use, box_use) if use != BELIEVED)
        if arm_use <= REJECTED or box_use <= REJECTED:
            a = self._accelerate(controls)
            if arm_use <= REJECTED:
                predict_reading(self._arm, a[:-3], self._period)
            if box_use <= REJECTED:
                predict_reading(self._box, a[-3:], self._period)
        box = self._box[[Q, V]].ravel()
        contact = contact and self._is_contact_possible(box)
        return Measurement(time, self._arm[Q].copy(), self._arm[V].copy(), contact, box)

    def _is_contact_possible(self, box: np.ndarray) -> bool:
        """Return whether the tip is so near the box that it may have touched it; otherwise count it as rejected."""
        tip, (length, width) = compute_tip(self._physics.chain, self._arm[Q], self._arm[V]), self._scenario.box.size
        place = compute_contact(tip, self._scenario.load.radius, tuple(box.tolist()), length / 2, width / 2)
        possible = bool(place.gap <= self._options.place * self._length + math.hypot(*tip[2:4]) * self._period)
        self.counts["rejected"] += not possible
        return possible

    def _accelerate(self, controls: Mapping[str, np.ndarray] | None) -> np.ndarray:
        """Return the mean acceleration of manipulator and box over a period, in free flight, shape (n + 6,)."""
        force = np.zeros(self._arm.shape[1] + 3)
        if controls is not None:
            command = join_controls(controls, len(self._scenario.links))
            compute_forces(make_actuators(self._scenario, self._physics), self._arm[V], command, force)
        q, v = (np.concatenate([self._arm[row], self._box[row]]) for row in (Q, V))
        take_step(self._system, force, q, v, self._period, False, self._scratch)
        return (self._scratch.v_next - v) / self._period

    def _read_clock(self, time: float) -> float:
        """Return the time of a measurement: as read, or a period after the last one where that is impossible [s]."""
        if not 0.0 < time - self._time <= self._options.clock_steps * self._period:
            self.counts["rejected"] += 1
            time = self._time + self._period
        self._time = time
        return time


@compiled
def judge_parts(
    arm_gate: np.ndarray,
    box_gate: np.ndarray,
    q: np.ndarray,
    v: np.ndarray,
    box: np.ndarray,
    period: float,
    touched: bool,
    patience: float,
) -> tuple[int, int]:
    """Return what is done with the readings of the manipulator and of the box, see `judge_reading`."""
    arm_use = judge_reading(arm_gate, q, v, period, touched, patience)
    return arm_use, judge_reading(box_gate, box[:3], box[3:], period, touched, patience)

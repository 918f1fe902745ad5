"""What the dual arm's expert believes of its readings; the last torques' predicted motion stands in for the others."""

from __future__ import annotations

import math
from collections import Counter

import numpy as np

from impact_envs.dual_arm.arm import compute_pose
from impact_envs.dual_arm.observation import ARM
from impact_envs.dual_arm.schema import DualArmScenario
from planners.dual_arm.options import EXPERT, ReadingOptions
from planners.reading_gate import BELIEVED, MISSING, REJECTED, Reach, ReadingGate

ANGLES, RATES, FORCES = ARM["angles"], ARM["rates"], ARM["forces"]


class Readings:
    """Replace readings of the arms that are missing, or that no motion explains.

    Each arm's angles and rates are judged by a `ReadingGate`, in whose reach the torque limits push joint i by
    tau_i / (I_i + m_i c_i^2), and an impact changes its rate by at most 2 v / l_i, v the pads' speed at the planned
    impact and l_i the length of link i. Normal forces at a pad's corners are believed from 0 to `force`, and above 0
    before the first contact only where the pad is near the believed box; after `patience` in any case. What replaces
    them are the last ones that were believed.

    Args:
        scenario: as believed.
        impact_speed: of the pads at the planned impact [m/s].
        options: margins, patience.

    Attributes:
        counts: how often readings were missing, rejected, taken up.
    """

    def __init__(
        self, scenario: DualArmScenario, impact_speed: float, options: ReadingOptions = EXPERT.readings
    ) -> None:
        self._options, self._numbers = options, scenario.arm_numbers()
        self._box, self._size = scenario.box.start.array, (scenario.box.half_width, scenario.box.half_height)
        self._pad = scenario.links.pad_half_height
        self._patience = math.ceil(options.patience / scenario.control_period)
        reach = _make_reach(scenario, impact_speed, options)
        self._gates = [ReadingGate(reach, scenario.control_period, options.patience) for _ in range(2)]
        self.reset()

    def reset(self) -> None:
        """Expect the arms anywhere, and no contact."""
        self.counts: Counter[str] = Counter()
        for gate in self._gates:
            gate.reset(np.zeros(3), known=False)
        self._forces, self._doubted = np.zeros((2, 2)), [0, 0]

    def check(self, rows: np.ndarray, accelerations: np.ndarray) -> None:
        """Replace in place what is not believed of a reading.

        Args:
            rows: of both arms as read, shape (2, ARM.size).
            accelerations: of the joints that the last torques should cause, shape (2, 3) [rad/s^2].
        """
        touching = bool(self._forces.any() or (rows[:, FORCES] > 0.0).any())
        for i, gate in enumerate(self._gates):
            row = rows[i]
            use = gate.judge(row[ANGLES], row[RATES], touching)
            if use != BELIEVED:
                self.counts["no_measurement" if use == MISSING else "rejected" if use == REJECTED else "taken_up"] += 1
                if use <= REJECTED:
                    gate.predict(accelerations[i])
                row[ANGLES], row[RATES] = gate.q, gate.v
            self._check_forces(i, row)

    def _check_forces(self, i: int, row: np.ndarray) -> None:
        """Replace the normal forces at pad i's corners in place if they are not believed."""
        first, second = row[FORCES].tolist()
        possible = min(first, second) >= 0.0 and max(first, second) <= self._options.force
        if (first == 0.0 and second == 0.0) or (possible and self._may_touch(i)):
            self._doubted[i] = 0
        else:
            finite = math.isfinite(first + second)
            self.counts["rejected" if finite else "no_measurement"] += 1
            self._doubted[i] = self._doubted[i] + 1 if finite else 0
            if self._doubted[i] <= self._patience:
                row[FORCES] = self._forces[i]
                return
        self._forces[i] = row[FORCES]

    def _may_touch(self, i: int) -> bool:
        """Return whether pad i is near the believed box, or has touched it."""
        if self._forces[i].any():
            return True
        x, y, _ = compute_pose(self._numbers[i], *self._gates[i].q)
        (box_x, box_y, heading), (width, height) = self._box, self._size
        c, d = math.cos(heading), math.sin(heading)
        along, across = c * (x - box_x) + d * (y - box_y), c * (y - box_y) - d * (x - box_x)
        near = self._options.near
        return abs(along) <= width + near and abs(across) <= height + self._pad + near


def _make_reach(scenario: DualArmScenario, impact_speed: float, options: ReadingOptions) -> Reach:
    links = scenario.links
    pairs = zip(links.torque_limits, links.inertias, links.masses, links.centers, strict=True)
    return Reach(
        place=np.full(3, options.angle),
        rate=np.full(3, options.rate),
        push=np.array([torque / (inertia + mass * center**2) for torque, inertia, mass, center in pairs]),
        jump=2.0 * impact_speed / np.array(links.lengths),
        turns=np.zeros(3, dtype=bool),
    )

"""What the dual arm's expert believes of its readings; the last torques' predicted motion stands in for the others.

Each arm's angles and rates are judged by a `reading_gate`, in whose reach the torque limits push joint i by
tau_i / (I_i + m_i c_i^2), and an impact changes its rate by at most 2 v / l_i, v the pads' speed at the planned impact
and l_i the length of link i. Normal forces at a pad's corners are believed from 0 to `force`, and above 0 before the
first contact only where the pad is near the believed box; after `patience` in any case. What replaces them are the last
ones that were believed.
"""

from __future__ import annotations

import math

import numpy as np

from impact_envs.compiled import compiled
from impact_envs.dual_arm.arm import compute_pose
from impact_envs.dual_arm.observation import ARM
from impact_envs.dual_arm.schema import DualArmScenario
from impact_envs.elementary import cos_sin
from planners.dual_arm.options import ReadingOptions
from planners.dual_arm.torque_qp import QDD
from planners.reading_gate import (
    BELIEVED,
    MISSING,
    REJECTED,
    Q,
    V,
    judge_reading,
    make_gate,
    open_gate,
    predict_reading,
)

ANGLES, RATES, FORCES = (ARM[name].start for name in ("angles", "rates", "forces"))


# Elements of the surroundings in `judge_rows`: place and direction of the believed box [m]; how far a pad's
# centre may be from the box's where they touch, along and across its direction [m]; greatest normal force [N]; control
# period and patience [s].
X, Y, COS, SIN, ALONG, ACROSS, FORCE, PERIOD, PATIENCE = range(9)


def make_surroundings(scenario: DualArmScenario, options: ReadingOptions) -> np.ndarray:
    """Return what forces are judged by, elements X to PATIENCE, shape (9,).

    Args:
        scenario: as believed.
        options: margins, patience.
    """
    box, near = scenario.box, options.near
    x, y, heading = box.start.array.tolist()
    across = box.half_height + scenario.links.pad_half_height + near
    place = (x, y, *cos_sin(heading), box.half_width + near, across)
    return np.array([*place, options.force, scenario.control_period, options.patience])


def make_gates(scenario: DualArmScenario, impact_speed: float, options: ReadingOptions) -> np.ndarray:
    """Return the gates of both arms, which expect them anywhere, shape (2, ROWS, 3).

    Args:
        scenario: as believed.
        impact_speed: of the pads at the planned impact [m/s].
        options: margins.
    """
    links = scenario.links
    pairs = zip(links.torque_limits, links.inertias, links.masses, links.centers, strict=True)
    gate = make_gate(
        place=np.full(3, options.angle),
        rate=np.full(3, options.rate),
        push=np.array([torque / (inertia + mass * center * center) for torque, inertia, mass, center in pairs]),
        jump=2.0 * impact_speed / np.array(links.lengths),
        turns=np.zeros(3),
    )
    open_gate(gate, np.zeros(3), known=False)
    return np.array([gate, gate])


@compiled
def judge_rows(
    gates: np.ndarray,
    rows: np.ndarray,
    solution: np.ndarray,
    numbers: np.ndarray,
    forces: np.ndarray,
    doubted: np.ndarray,
    counts: np.ndarray,
    near: np.ndarray,
) -> None:
    """Judge the readings of both arms, and replace what is not believed.

    Args:
        gates: shape (2, ROWS, 3).
        rows: as read, changed, shape (2, ARM.size).
        solution: joint accelerations begin at QDD.
        numbers: rows of `arm.make_arm`, shape (2, 14).
        forces: believed last, shape (2, 2) [N].
        doubted: periods for which forces are not believed, shape (2,).
        counts: of `COUNTS`, shape (3,).
        near: the surroundings, elements X to PATIENCE, shape (9,).
    """
    touching = False
    for i in range(2):
        for j in range(2):
            touching = touching or forces[i, j] > 0.0 or rows[i, FORCES + j] > 0.0
    for i in range(2):
        gate, angles, rates = gates[i], rows[i, ANGLES : ANGLES + 3], rows[i, RATES : RATES + 3]
        use = judge_reading(gate, angles, rates, near[PERIOD], touching, near[PATIENCE])
        if use != BELIEVED:
            counts[use] += 1
            if use in (MISSING, REJECTED):
                predict_reading(gate, solution[QDD + 3 * i : QDD + 3 * i + 3], near[PERIOD])
            for j in range(3):
                angles[j], rates[j] = gate[Q, j], gate[V, j]
        first, second = rows[i, FORCES], rows[i, FORCES + 1]
        least, most = min(first, second), max(first, second)
        touched = forces[i, 0] > 0.0 or forces[i, 1] > 0.0
        possible = least >= 0.0 and most <= near[FORCE] and math.isfinite(first + second)
        if possible and (most == 0.0 or touched or may_touch(numbers[i], gate, near)):
            doubted[i] = 0.0
        else:
            finite = math.isfinite(first + second)
            counts[REJECTED if finite else MISSING] += 1
            doubted[i] = doubted[i] + 1.0 if finite else 0.0
            if doubted[i] * near[PERIOD] <= near[PATIENCE]:
                rows[i, FORCES], rows[i, FORCES + 1] = forces[i, 0], forces[i, 1]
        forces[i, 0], forces[i, 1] = rows[i, FORCES], rows[i, FORCES + 1]


@compiled
def may_touch(arm: np.ndarray, gate: np.ndarray, near: np.ndarray) -> bool:
    """Return whether an arm's pad is near the believed box."""
    x, y, _ = compute_pose(arm, gate[Q, 0], gate[Q, 1], gate[Q, 2])
    along = near[COS] * (x - near[X]) + near[SIN] * (y - near[Y])
    across = near[COS] * (y - near[Y]) - near[SIN] * (x - near[X])
    return abs(along) <= near[ALONG] and abs(across) <= near[ACROSS]

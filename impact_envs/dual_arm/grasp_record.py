"""The quality of a grasp, recorded tick by tick: contact forces, torque steps, slip, time between the impacts.

A record has a row for each arm and one for the box, which holds the worst of both arms. Columns `force_min` to
`torque_step` describe the last control period, the others the time since reset.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from impact_envs.compiled import compiled
from impact_envs.dual_arm.plant import NORMAL

# Columns of the values, in the order of `schema.GRASP_SIGNALS`.
FORCE_MIN, FORCE_MAX, TORQUE, TORQUE_STEP, SLIP, LAG, INTERIM, LIMIT_TIME = range(8)
COUNT, FIRST, HELD, GRASP = 0, 1, 3, 4  # elements of the marks; FIRST has one for each arm
START_MARKS = (0, -1, -1, 0, -1)  # of an episode that has not begun; all else is 0
# The box is grasped when every pad corner has pressed harder than this [N] for this long [s].
GRASP_FORCE, GRASP_TIME = 1.0, 0.015
# Share of the limit: a clipped command equals the limit up to rounding.
AT_LIMIT = 1.0 - 1e-9


class GraspRecord(NamedTuple):
    """The record of an episode so far.

    Attributes:
        values: shape (3, 8), columns in the order of `schema.GRASP_SIGNALS`.
        marks: number of ticks, tick of each pad's first touch (-1 before), consecutive ticks of full contact, tick at
            which the box was grasped (-1 before), shape (5,).
        slips: of the pad corners when the box was grasped, shape (4,) [m].
        torques: of the last tick, shape (2, 3) [N m].
    """

    values: np.ndarray
    marks: np.ndarray
    slips: np.ndarray
    torques: np.ndarray


@compiled
def begin_period(record: GraspRecord) -> None:
    """Clear what describes the last control period; at least one tick must follow."""
    for i in range(3):
        record.values[i, FORCE_MIN] = np.inf
        for column in range(FORCE_MAX, TORQUE_STEP + 1):
            record.values[i, column] = 0.0


@compiled
def add_tick(
    record: GraspRecord, contacts: np.ndarray, sums: np.ndarray, tau: np.ndarray, limits: np.ndarray, tick: float
) -> None:
    """Add a tick to the record.

    Args:
        record: changed.
        contacts: at the end of the tick, see `plant`, shape (6, 5).
        sums: slip and normal impulse of the pad corners since reset, shape (4, 2) [m, N s].
        tau: commanded torques of the tick, shape (2, 3) [N m].
        limits: of the torques, shape (2, 3) [N m].
        tick: length of the tick [s].
    """
    values, marks, _, last = record
    box = values[2]
    box[FORCE_MAX] = box[TORQUE] = box[TORQUE_STEP] = 0.0
    box[FORCE_MIN] = np.inf
    at_limit = False
    for i in range(2):
        row = values[i]
        low, high = contacts[2 * i, NORMAL], contacts[2 * i + 1, NORMAL]
        row[FORCE_MIN] = min(row[FORCE_MIN], low, high)
        row[FORCE_MAX] = max(row[FORCE_MAX], low, high)
        saturated = False
        for j in range(3):
            row[TORQUE] = max(row[TORQUE], abs(tau[i, j]))
            if marks[COUNT] > 0:
                row[TORQUE_STEP] = max(row[TORQUE_STEP], abs(tau[i, j] - last[i, j]))
            saturated = saturated or abs(tau[i, j]) >= AT_LIMIT * limits[i, j]
            last[i, j] = tau[i, j]
        if marks[FIRST + i] < 0 and sums[2 * i, 1] + sums[2 * i + 1, 1] > 0.0:
            marks[FIRST + i] = marks[COUNT]
        if saturated and (marks[FIRST] >= 0 or marks[FIRST + 1] >= 0):
            row[LIMIT_TIME] += tick
            at_limit = True
        for column in (FORCE_MAX, TORQUE, TORQUE_STEP):
            box[column] = max(box[column], row[column])
        box[FORCE_MIN] = min(box[FORCE_MIN], row[FORCE_MIN])
    if at_limit:
        box[LIMIT_TIME] += tick
    update_grasp(record, contacts, sums, tick)
    marks[COUNT] += 1


@compiled
def update_grasp(record: GraspRecord, contacts: np.ndarray, sums: np.ndarray, tick: float) -> None:
    """Update the time between the impacts, the time until full contact, and the slip since then.

    Args:
        record: changed.
        contacts: at the end of the tick, shape (6, 5).
        sums: slip and normal impulse of the pad corners since reset, shape (4, 2) [m, N s].
        tick: length of the tick [s].
    """
    values, marks, slips, _ = record
    count = marks[COUNT]
    for i in range(2):
        mine, other = marks[FIRST + i], marks[FIRST + 1 - i]
        if other >= 0:
            values[i, LAG] = max(0.0, ((mine if mine >= 0 else count) - other) * tick)
    first = max(marks[FIRST], marks[FIRST + 1])
    if marks[FIRST] >= 0 and marks[FIRST + 1] >= 0:
        first = min(marks[FIRST], marks[FIRST + 1])
    full = min(contacts[0, NORMAL], contacts[1, NORMAL], contacts[2, NORMAL], contacts[3, NORMAL]) > GRASP_FORCE
    marks[HELD] = marks[HELD] + 1 if full else 0
    if first >= 0 and marks[GRASP] < 0:
        for i in range(3):
            values[i, INTERIM] = (count - first) * tick
        if marks[HELD] >= round(GRASP_TIME / tick):
            marks[GRASP] = count
            for i in range(4):
                slips[i] = sums[i, 0]
    if marks[GRASP] >= 0:
        for i in range(2):
            values[i, SLIP] = max(abs(sums[2 * i, 0] - slips[2 * i]), abs(sums[2 * i + 1, 0] - slips[2 * i + 1]))
    for column in (SLIP, LAG):
        values[2, column] = max(values[0, column], values[1, column])

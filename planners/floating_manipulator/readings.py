"""What the floating manipulator's expert believes of its readings; the believed model stands in for the others.

The manipulator and the box are judged apart, each by a `reading_gate` whose reach `reading_reach` says.
"""

from __future__ import annotations

import math

import numpy as np

from impact_envs.compiled import compiled
from impact_envs.elementary import atan2, hypot
from impact_envs.floating_manipulator.actuation import compute_forces
from impact_envs.floating_manipulator.contact import compute_contact
from impact_envs.floating_manipulator.flow import take_step
from impact_envs.physics.multibody import compute_directions, compute_point
from planners.floating_manipulator.options import Options, ReadingOptions
from planners.floating_manipulator.world_memory import ExpertMemory, ExpertScratch, ExpertTable
from planners.reading_gate import BELIEVED, MISSING, REJECTED, Q, V, judge_reading, predict_reading

UNIT_ERROR = 0.25  # from a length of 1, above which two numbers are no cosine and sine


@compiled
def is_start(table: ExpertTable, joint: np.ndarray, k: int) -> bool:
    """Return whether world k's observation is the first of an episode; one of zeros alone is none."""
    at, row = table.at, joint[k]
    return row[at.time] == 0.0 and (row[at.base + 2] != 0.0 or row[at.base + 3] != 0.0)


@compiled
def read_heading(cos: float, sin: float) -> float:
    """Return the angle of a direction; NaN if its length is not about 1 [rad]."""
    return atan2(sin, cos) if abs(hypot(cos, sin) - 1.0) <= UNIT_ERROR else math.nan


@compiled
def read_observation(table: ExpertTable, memory: ExpertMemory, k: int, joint: np.ndarray) -> None:
    """Read world k's measurement; headings lie in [-pi, pi], NaN if what was read is no direction.

    Args:
        joint: observations, shape (N, 2 n + 22).
    """
    at, row, state = table.at, joint[k], memory.state[k]
    q, v, box = memory.q[k], memory.v[k], memory.box[k]
    q[0], q[1], q[2] = row[at.base], row[at.base + 1], read_heading(row[at.base + 2], row[at.base + 3])
    for i in range(3):
        v[i] = row[at.base_rates + i]
    for j in range(len(q) - 3):
        q[3 + j], v[3 + j] = row[at.joints + j], row[at.joint_rates + j]
    box[0], box[1], box[2] = row[at.box], row[at.box + 1], read_heading(row[at.box + 4], row[at.box + 5])
    box[3], box[4], box[5] = row[at.box + 2], row[at.box + 3], row[at.box + 6]
    state.time = row[at.time] * table.horizon
    state.contact = 0.5 < row[at.contact] < 1.5


@compiled
def check_readings(table: ExpertTable, memory: ExpertMemory, options: Options, scratch: ExpertScratch, k: int) -> None:
    """Replace what is not believed of world k's measurement, and count it.

    The clock goes forward by at most `clock_steps` periods; otherwise a period is added. A contact is believed if the
    tip is near the box.
    """
    state, limits, period = memory.state[k], options.readings, table.period
    q, v, box = memory.q[k], memory.v[k], memory.box[k]
    arm_gate, box_gate = memory.arm_gate[k], memory.box_gate[k]
    touched = state.contact
    arm_use = judge_reading(arm_gate, q, v, period, touched, limits.patience)
    box_use = judge_reading(box_gate, box[:3], box[3:], period, touched, limits.patience)
    read_clock(table, memory, limits, k)
    if arm_use != BELIEVED or box_use != BELIEVED:
        count_use(memory, k, arm_use)
        count_use(memory, k, box_use)
        if arm_use <= REJECTED or box_use <= REJECTED:
            predict(table, memory, scratch, k, arm_use <= REJECTED, box_use <= REJECTED)
        for i in range(len(q)):
            q[i], v[i] = arm_gate[Q, i], arm_gate[V, i]
        for i in range(3):
            box[i], box[3 + i] = box_gate[Q, i], box_gate[V, i]
    if touched and not is_contact_possible(table, memory, limits, scratch, k):
        memory.counts[k].rejected += 1
        state.contact = False


@compiled
def read_clock(table: ExpertTable, memory: ExpertMemory, limits: ReadingOptions, k: int) -> None:
    """Believe world k's time, or a period after the last one where what was read is impossible."""
    state = memory.state[k]
    if not 0.0 < state.time - state.clock <= limits.clock_steps * table.period:
        memory.counts[k].rejected += 1
        state.time = state.clock + table.period
    state.clock = state.time


@compiled
def count_use(memory: ExpertMemory, k: int, use: int) -> None:
    """Count what was done with a reading of world k."""
    counts = memory.counts[k]
    if use == MISSING:
        counts.no_measurement += 1
    elif use == REJECTED:
        counts.rejected += 1
    elif use != BELIEVED:
        counts.taken_up += 1


@compiled
def predict(
    table: ExpertTable, memory: ExpertMemory, scratch: ExpertScratch, k: int, arm_missing: bool, box_missing: bool
) -> None:
    """Move what is believed of world k on by a period, in free flight under the last controls."""
    arm_gate, box_gate, period = memory.arm_gate[k], memory.box_gate[k], table.period
    force, q, v, m = scratch.force, scratch.q, scratch.v, memory.q.shape[1]
    for i in range(m):
        q[i], v[i] = arm_gate[Q, i], arm_gate[V, i]
    for i in range(3):
        q[m + i], v[m + i], force[m + i] = box_gate[Q, i], box_gate[V, i], 0.0
    compute_forces(table.actuators, v, memory.command[k], force)
    take_step(table.system, force, q, v, period, False, scratch.flow)
    for i in range(m + 3):
        force[i] = (scratch.flow.v_next[i] - v[i]) / period  # the mean acceleration
    if arm_missing:
        predict_reading(arm_gate, force[:m], period)
    if box_missing:
        predict_reading(box_gate, force[m:], period)


@compiled
def is_contact_possible(
    table: ExpertTable, memory: ExpertMemory, limits: ReadingOptions, scratch: ExpertScratch, k: int
) -> bool:
    """Return whether world k's tip is so near the box that it may have touched it."""
    x, y, vx, vy, ax, ay = locate_tip(table, memory, scratch, k)
    system, box = table.system, memory.box[k]
    pose = (box[0], box[1], box[2], box[3], box[4], box[5])
    tip = (x, y, vx, vy, ax, ay)
    contact = compute_contact(tip, system.radius, pose, system.half_length, system.half_width)
    return contact.gap <= limits.place * table.reach + hypot(vx, vy) * table.period


@compiled
def locate_tip(
    table: ExpertTable, memory: ExpertMemory, scratch: ExpertScratch, k: int
) -> tuple[float, float, float, float, float, float]:
    """Return x, y, vx, vy of world k's tip, and the ax, ay that come from its rates alone [m], [m/s], [m/s^2]."""
    chain, output = table.system.chain, scratch.output
    q, v = memory.q[k], memory.v[k]
    compute_directions(chain, q, v, output.w, output.rates)
    return compute_point(q, v, output.w, output.rates, chain.levers[len(chain.levers) - 1])

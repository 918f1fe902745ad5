"""What a learner observes of a floating manipulator on its way to the goal, and what it may change."""

from __future__ import annotations

import numpy as np

from impact_envs.compiled import compiled
from impact_envs.elementary import cos_sin, exp, hypot
from impact_envs.floating_manipulator.contact import compute_contact
from impact_envs.floating_manipulator.schema import FloatingManipulatorScenario
from planners.floating_manipulator.options import Options
from planners.floating_manipulator.readings import locate_tip
from planners.floating_manipulator.world_memory import PAUSE, PHASES, ExpertMemory, ExpertScratch, ExpertTable

ROUND_OFF = 1e-9  # of times [s]


def get_correction_size(scenario: FloatingManipulatorScenario) -> int:
    """Return the length of a correction, for n joints n + 2."""
    return len(scenario.links) + 2


def get_feature_size(scenario: FloatingManipulatorScenario) -> int:
    """Return the length of the features, for n joints 2 n + 27."""
    return 2 * len(scenario.links) + 27


@compiled
def await_correction(
    table: ExpertTable, memory: ExpertMemory, options: Options, scratch: ExpertScratch, k: int
) -> None:
    """Decide whether world k awaits a correction in this control step, and forget one that is over.

    None is awaited in a pause, nor near the goal; there the last one ends.
    """
    state, correction = memory.state[k], options.correction
    due, under_way = state.time >= state.due - ROUND_OFF, state.phase != PAUSE
    if under_way and (due or state.is_corrected):
        x, y, _, _, _, _ = locate_tip(table, memory, scratch, k)
        under_way = hypot(x - table.goal[0], y - table.goal[1]) > correction.goal_distance
    if not under_way:
        state.due = state.time
    state.is_awaited = under_way and due
    if state.is_awaited or not under_way:
        state.is_corrected = False


@compiled
def wait_for_next(memory: ExpertMemory, options: Options, k: int) -> None:
    """Let world k await its next correction a period later."""
    state = memory.state[k]
    state.is_awaited, state.due = False, state.time + options.correction.period


@compiled
def correct_world(table: ExpertTable, memory: ExpertMemory, options: Options, k: int, c: np.ndarray) -> None:
    """Set world k's correction until the next one is awaited.

    Args:
        c: in [-1, 1], shape (n + 2,): for n torques, the weight R, and the weights of the tip's velocity in Q.
    """
    state, limits, n = memory.state[k], options.correction, memory.torques.shape[1]
    for j in range(n):
        memory.torques[k, j] = limits.torque_share * table.actuators.stall_torque[j] * c[j]
    state.effort, state.speed_weight = exp(limits.log_range * float(c[n])), exp(limits.log_range * float(c[n + 1]))
    state.is_corrected = True
    wait_for_next(memory, options, k)


@compiled
def write_features(
    table: ExpertTable, memory: ExpertMemory, scratch: ExpertScratch, k: int, features: np.ndarray
) -> None:
    """Write what a learner may observe of world k.

    Args:
        features: takes it, shape (2 n + 27,): time / horizon; one-hot phase (3); tip relative to its goal (2) [m] and
            its velocity (2) [m/s]; cos(psi), sin(psi); joint angles (n) [rad]; base rates (3) [m/s], [rad/s]; joint
            rates (n) [rad/s]; momenta used by the OSDRE: P_x, P_y and L about the world's origin (3) [N s], [N m s];
            impacts felt so far; gap between tip and box [m], its rate [m/s], normal from box to tip (2), nearest point
            relative to the box's centre (2) [m], speed along the box [m/s]; velocity of the box (3) [m/s], [rad/s].
    """
    state, system, q, v, box = memory.state[k], table.system, memory.q[k], memory.v[k], memory.box[k]
    m = len(q)
    features[0] = state.time / table.horizon
    for phase in range(len(PHASES)):
        features[1 + phase] = 1.0 if state.phase == phase else 0.0
    x, y, vx, vy, ax, ay = locate_tip(table, memory, scratch, k)
    features[4], features[5], features[6], features[7] = x - table.goal[0], y - table.goal[1], vx, vy
    features[8], features[9] = cos_sin(q[2])
    for j in range(3, m):
        features[7 + j] = q[j]
    for i in range(m):
        features[7 + m + i] = v[i]
    at = 7 + 2 * m
    for i in range(3):
        features[at + i], features[at + 11 + i] = state.momenta[i], box[3 + i]
    features[at + 3] = state.impacts
    tip, pose = (x, y, vx, vy, ax, ay), (box[0], box[1], box[2], box[3], box[4], box[5])
    contact = compute_contact(tip, system.radius, pose, system.half_length, system.half_width)
    features[at + 4], features[at + 5] = contact.gap, contact.rate
    features[at + 6], features[at + 7] = contact.nx, contact.ny
    features[at + 8], features[at + 9] = contact.rx, contact.ry
    features[at + 10] = contact.slip

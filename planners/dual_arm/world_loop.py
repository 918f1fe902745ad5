"""One control period of the dual arm's expert in world k: judge the readings, await a correction, control; compiled."""

from __future__ import annotations

import numpy as np

from impact_envs.compiled import compiled, inlined
from impact_envs.dual_arm.observation import ARM
from impact_envs.elementary import exp
from planners.dual_arm.control_memory import POST
from planners.dual_arm.phase_machine import compute_reference_error, control_arms, count_grasp_ticks
from planners.dual_arm.readings import ANGLES, FORCES, RATES, judge_rows
from planners.dual_arm.reference import ImpactMap

ROW = ARM.size


@compiled
def observe_world(law: np.record, rules: np.record, memory: np.record, expert: np.record) -> None:
    """Judge a world's readings, and decide whether a correction is awaited.

    Args:
        law, rules: LAW and RULES.
        memory: a CONTROL; what is measured is written.
        expert: an EXPERT with `rows` as read.
    """
    gates, rows, counts, near = expert.gates, expert.rows, expert.counts, rules.surroundings
    judge_rows(gates, rows, memory.solution, law.arms, expert.forces, expert.doubted, counts, near)
    for i in range(2):
        for j in range(3):
            memory.q[i, j] = expert.rows[i, ANGLES + j]
            memory.v[i, j] = expert.rows[i, RATES + j]
        for j in range(2):
            memory.forces[2 * i + j] = expert.rows[i, FORCES + j]
    ticks = count_grasp_ticks(memory)
    due = ticks >= rules.first and (ticks - rules.first) % rules.every == 0
    expert.awaiting = due
    if due:
        expert.answer[0] = expert.answer[1] = 0.0
    if ticks > 0:
        x, y, turn = compute_reference_error(law, memory)
        expert.lag[0] += rules.lag_share * (x - expert.lag[0])
        expert.lag[1] += rules.lag_share * (y - expert.lag[1])
        expert.lag[2] += rules.lag_share * (turn - expert.lag[2])


@inlined
def read_world(law: np.record, rules: np.record, memory: np.record, expert: np.record, joint: np.ndarray) -> None:
    """Take a world's joint observation, and observe.

    Args:
        law, rules, memory, expert: see `observe_world`.
        joint: what is measured of both arms, shape (2 ROW or more,).
    """
    for i in range(2):
        for j in range(ROW):
            expert.rows[i, j] = joint[ROW * i + j]
    observe_world(law, rules, memory, expert)


@inlined
def control_world(
    law: np.record,
    rules: np.record,
    impact_map: ImpactMap,
    memory: np.record,
    expert: np.record,
    scratch: np.record,
    actions: np.ndarray,
) -> None:
    """Apply the correction and compute a world's actions.

    Args:
        law, rules, memory, expert: see `observe_world`.
        impact_map, scratch: see `control_arms`.
        actions: joint torques over their limits, written, shape (2, 3).
    """
    apply_correction(law, rules, memory, expert)
    control_arms(law, impact_map, memory, scratch)
    for i in range(2):
        for j in range(3):
            actions[i, j] = memory.torques[i, j] / law.limits[i, j]


@inlined
def apply_correction(law: np.record, rules: np.record, memory: np.record, expert: np.record) -> None:
    """Move grip and load towards the correction, at a limited rate.

    Args:
        law, rules, memory, expert: see `observe_world`.
    """
    expert.awaiting = 0
    if expert.applied[0] == expert.answer[0] and expert.applied[1] == expert.answer[1]:
        return
    for i in range(2):
        change = expert.answer[i] - expert.applied[i]
        expert.applied[i] += min(max(change, -rules.most_change), rules.most_change)
    weight = exp(rules.log_range * expert.applied[1])
    memory.grip = exp(rules.log_range * expert.applied[0]) * law.grip
    memory.mass, memory.inertia = weight * law.mass, weight * law.inertia


@compiled
def write_features(law: np.record, memory: np.record, expert: np.record, features: np.ndarray) -> None:
    """Write what a learner may see of the grasp, see `DualArmExpert.features`.

    Args:
        law, memory, expert: see `observe_world`.
        features: written, shape (22,).
    """
    for i in range(len(features)):
        features[i] = 0.0
    if memory.phase != POST:
        return
    features[0] = (memory.ticks - memory.grasped) * law.tick
    interim = memory.touched if law.interim_phase > 0.0 else memory.grasped
    features[1] = memory.grasped * law.tick - interim * law.tick
    x, y, turn = compute_reference_error(law, memory)
    features[14], features[15], features[16] = x, y, turn
    for i in range(2):
        features[2 + i] = memory.heights[i]
        for j in range(2):
            features[4 + 2 * i + j] = expert.rows[i, FORCES + j]
        features[20 + i] = expert.applied[i]
    for r in range(3):
        features[8 + r] = law.target[r] - memory.box[r]
        features[11 + r] = memory.box[3 + r]
        features[17 + r] = expert.lag[r]


# What `run_experts` does.
OBSERVE, CONTROL, CORRECT, FEATURES = range(4)


@compiled
def run_experts(
    law: np.ndarray,
    rules: np.ndarray,
    heights: np.ndarray,
    weights: np.ndarray,
    memory: np.ndarray,
    expert: np.ndarray,
    scratch: np.ndarray,
    joint: np.ndarray,
    output: np.ndarray,
    part: int,
    thread: int,
    first: int,
    end: int,
) -> None:
    """Do one part of a control period in the worlds from first to before end.

    Args:
        law, rules: LAW and RULES, shape (1,).
        heights, weights: of the impact map.
        memory, expert: CONTROL and EXPERT, shape (N,).
        scratch: SCRATCH, shape (T,).
        joint: what is measured of both arms, for OBSERVE, shape (N, 2 ROW or more).
        output: actions in [-1, 1] after CONTROL, shape (N, 2, 3); features after FEATURES, shape (N, 1, 22).
        part: OBSERVE; CONTROL; CORRECT, which applies corrections alone; or FEATURES.
        thread: whose scratch.
        first, end: worlds.
    """
    impact_map, laws, ruled = ImpactMap(heights, weights, law[0].rho), law[0], rules[0]
    for k in range(first, end):
        if part == OBSERVE:
            read_world(laws, ruled, memory[k], expert[k], joint[k])
        elif part == FEATURES:
            write_features(laws, memory[k], expert[k], output[k, 0])
        elif part == CONTROL:
            control_world(laws, ruled, impact_map, memory[k], expert[k], scratch[thread], output[k])
        else:
            apply_correction(laws, ruled, memory[k], expert[k])

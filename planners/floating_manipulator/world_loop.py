"""One control period of one world, compiled: read, decide on the phase, regulate the tip or recover from an impact."""

from __future__ import annotations

import math

import numpy as np

from impact_envs.compiled import compiled
from impact_envs.floating_manipulator.contact import compute_contact
from impact_envs.physics.multibody import compute_directions, compute_momenta
from planners.floating_manipulator.compensation import avoid_box, compensate_drift
from planners.floating_manipulator.correction import (
    ROUND_OFF,
    await_correction,
    correct_world,
    wait_for_next,
    write_features,
)
from planners.floating_manipulator.options import PRINTED, Options
from planners.floating_manipulator.osdre import OutputScratch, compute_torques
from planners.floating_manipulator.pulses import fire_axis, forget_pulses
from planners.floating_manipulator.readings import check_readings, is_start, read_observation
from planners.floating_manipulator.world_memory import (
    AFTER,
    BEFORE,
    PAUSE,
    ExpertMemory,
    ExpertScratch,
    ExpertTable,
    start_world,
)

# What run_experts does with worlds, in bits.
START, OBSERVE, UPDATE, CORRECT, FEATURES, CONTROL = (1 << part for part in range(6))
FOLLOW = 1 << 6  # start with the first observation of an episode


@compiled
def update_phase(table: ExpertTable, memory: ExpertMemory, options: Options, scratch: ExpertScratch, k: int) -> None:
    """Start a pause at an impact, average the momenta at its end, and end it."""
    state = memory.state[k]
    if state.contact:
        state.phase, state.samples = PAUSE, 0
        state.impacts += 1
        state.resume = state.time + table.pause
        for i in range(memory.q.shape[1]):
            memory.held[k, i] = memory.q[k, i]
        forget_pulses(memory, k)
    elif state.phase == PAUSE:
        left = state.resume - ROUND_OFF - state.time
        if left <= (options.recovery.momentum_time if table.is_compensated else 0.0):
            average_momenta(table, memory, scratch, k)
        if left <= 0.0:
            state.phase = AFTER


@compiled
def average_momenta(table: ExpertTable, memory: ExpertMemory, scratch: ExpertScratch, k: int) -> None:
    """Take the momenta of world k's measured rates into their mean."""
    state, chain, output = memory.state[k], table.system.chain, scratch.output
    q, v = memory.q[k], memory.v[k]
    compute_directions(chain, q, v, output.w, output.rates)
    px, py, spin = compute_momenta(chain, q, v, output.w, output.rates)
    state.samples += 1
    state.momenta[0] += (px - state.momenta[0]) / state.samples
    state.momenta[1] += (py - state.momenta[1]) / state.samples
    state.momenta[2] += (spin - state.momenta[2]) / state.samples


@compiled
def control_world(table: ExpertTable, memory: ExpertMemory, options: Options, scratch: ExpertScratch, k: int) -> None:
    """Compute world k's controls; a request for a correction that is left unanswered counts as zero."""
    state = memory.state[k]
    if state.is_awaited:
        wait_for_next(memory, options, k)
    if state.phase == PAUSE:
        recover_world(table, memory, options, k)
    else:
        regulate_world(table, memory, options, scratch, k)


@compiled
def regulate_world(table: ExpertTable, memory: ExpertMemory, options: Options, scratch: ExpertScratch, k: int) -> None:
    """Compute the corrected torques of the OSDRE, and no control of the base.

    Where the equation has no solution, the last gain is used; there is none at first, and so no torque.
    """
    state, law, n = memory.state[k], options.regulator, memory.torques.shape[1]
    t, u, rates = scratch.output, scratch.u, scratch.rates
    s = OutputScratch(t.w, t.rates, t.M, t.J, t.a, t.z, t.drift, t.B, t.A, t.S, t.Q, memory.K[k], t.riccati)
    effort, speed_weight = law.effort_before if state.phase == BEFORE else law.effort_after, 1.0
    if state.is_corrected:
        effort, speed_weight = effort * state.effort, state.speed_weight
    for i in range(4):
        s.Q[i, i] = law.state_weights[i] if i < 2 else speed_weight * law.state_weights[i]
    for i in range(n + 3):
        rates[i] = memory.v[k, i]
    printed, measured, chain = law.coefficients == PRINTED, law.measured_base, table.system.chain
    if compute_torques(chain, memory.q[k], rates, state.momenta, measured, table.goal, effort, printed, s, u):
        state.knows_gain = True
    elif state.knows_gain:
        memory.counts[k].last_gain += 1
    else:
        memory.counts[k].none += 1
    compensated = table.is_compensated and state.phase == AFTER
    if compensated:
        compensate_drift(options.compensation, s.drift, s.B, rates[3:], u)
    if state.is_corrected:
        for j in range(n):
            if memory.torques[k, j] != 0.0:
                u[j] += memory.torques[k, j]
    if compensated:
        box, system = memory.box[k], table.system
        tip = (s.z[0], s.z[1], s.z[2], s.z[3], s.drift[0], s.drift[1])
        pose = (box[0], box[1], box[2], box[3], box[4], box[5])
        contact = compute_contact(tip, system.radius, pose, system.half_length, system.half_width)
        avoid_box(options.compensation, contact, s.B, u)
    for i in range(3):
        memory.command[k, i] = 0.0
    for j in range(n):
        memory.command[k, 3 + j] = u[j]


@compiled
def recover_world(table: ExpertTable, memory: ExpertMemory, options: Options, k: int) -> None:
    """Compute the controls of the safety pause: none, or PD to the configuration at the impact."""
    command, recovery = memory.command[k], options.recovery
    for i in range(len(command)):
        command[i] = 0.0
        if table.drives_base:
            away = memory.q[k, i] - memory.held[k, i]
            if i == 2:  # psi is measured modulo whole turns
                away -= math.tau * math.floor(away / math.tau + 0.5)
            gain = recovery.thruster_gain if i < 2 else recovery.wheel_gain if i == 2 else recovery.joint_gain
            command[i] = -gain * (away + recovery.damping * memory.v[k, i])
    if table.fires_pulses:
        for axis in range(2):
            command[axis] = fire_axis(table, memory, options, k, axis, command[axis])
        if command[0] != 0.0 or command[1] != 0.0:
            memory.state[k].samples = 0


@compiled
def write_action(table: ExpertTable, memory: ExpertMemory, k: int, actions: np.ndarray) -> None:
    """Scale world k's controls to actions in [-1, 1]: of the arm, then of the base where it is actuated.

    An agent with a control that is no number does nothing, which is counted.

    Args:
        actions: written, shape (N, n) or (N, n + 3).
    """
    command, n = memory.command[k], memory.torques.shape[1]
    for agent in range(2 if table.drives_base else 1):
        source, size = (3, n) if agent == 0 else (0, 3)
        lost = False
        for i in range(size):
            lost = lost or math.isnan(command[source + i])
        memory.counts[k].no_action += 1 if lost else 0
        for i in range(size):
            share = 0.0 if lost else command[source + i] / table.limits[source + i]
            actions[k, agent * n + i] = min(max(share, -1.0), 1.0)


@compiled
def run_experts(
    table: ExpertTable,
    memory: ExpertMemory,
    options: np.ndarray,
    scratch: ExpertScratch,
    joint: np.ndarray,
    values: np.ndarray,
    actions: np.ndarray,
    parts: int,
    first: int,
    end: int,
) -> None:
    """Do parts of the control period of the worlds from first to before end.

    Args:
        options: see `options.make_record`.
        scratch: of this thread.
        joint: observations, shape (N, 2 n + 22).
        values: written by FEATURES, shape (N, 2 n + 27); CORRECT reads corrections from its first columns, NaN where
            there is none.
        actions: written by CONTROL, shape (N, n) or (N, n + 3).
        parts: sum of what is done in this order: START or FOLLOW; OBSERVE or UPDATE, what comes after a measurement
            that stands in the memory; CORRECT; FEATURES; CONTROL.
    """
    chosen = options[0]
    for k in range(first, end):
        if parts & START or (parts & FOLLOW and is_start(table, joint, k)):
            start_world(table, memory, k)
        if parts & OBSERVE:
            read_observation(table, memory, k, joint)
            check_readings(table, memory, chosen, scratch, k)
        if parts & (OBSERVE | UPDATE):
            update_phase(table, memory, chosen, scratch, k)
            await_correction(table, memory, chosen, scratch, k)
        if parts & CORRECT and not math.isnan(values[k, 0]):
            correct_world(table, memory, chosen, k, values[k])
        if parts & FEATURES:
            write_features(table, memory, scratch, k, values[k])
        if parts & CONTROL:
            control_world(table, memory, chosen, scratch, k)
            write_action(table, memory, k, actions)

"""One control period of the whole task in world k: actions, physics, sensors, robustness, reward, observation.

The same compiled functions as FloatingManipulatorModel and FloatingManipulatorTask, in the same order, so that a world
of many equals the single environment bit for bit.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from impact_envs.compiled import compiled
from impact_envs.floating_manipulator.actuation import compute_forces, scale_action
from impact_envs.floating_manipulator.collision import (
    DONE,
    ENDLESS,
    STRUCK,
    Progress,
    advance_to_impact,
    is_finite,
)
from impact_envs.floating_manipulator.flow import System, compute_rows
from impact_envs.floating_manipulator.observation import FELT_SPEED, write_observation
from impact_envs.floating_manipulator.signals import find_length, read_coordinates, write_signals
from impact_envs.floating_manipulator.worlds import (
    BLANK_PROGRESS,
    Arena,
    Memory,
    StepScratch,
    Worlds,
    view_actuators,
    view_system,
)
from impact_envs.normal import next_normal
from impact_envs.reward import compute_effort, compute_reward, compute_team_reward
from impact_envs.stl.compiled_formula import CompiledFormula
from impact_envs.stl.stepper import read_conjuncts, start_monitor, update_monitor
from impact_envs.stl.verdict import compute_outcome, settle_tie

LEAVE, STEP, START = range(3)  # what `run_range` does with a world


class Output(NamedTuple):
    """What a step returns of N worlds.

    Attributes:
        joint: everything measured once, shape (N, joint size).
        agents: each agent's observation, shape (N, agents, joint size), or no agents where nobody asks.
        rewards: of each agent, shape (N, agents) [m].
    """

    joint: np.ndarray
    agents: np.ndarray
    rewards: np.ndarray


@compiled
def step_task(
    arena: Arena,
    worlds: Worlds,
    memory: Memory,
    formula: CompiledFormula,
    scratch: StepScratch,
    output: Output,
    actions: np.ndarray,
    k: int,
) -> None:
    """Hold world k's actions, of the arm and then of the base, for one control period.

    Args:
        actions: in [-1, 1], shape (N, n) or (N, n + 3).
    """
    progress, system = worlds.progress[k], view_system(arena, worlds, k)
    command_actuators(arena, worlds, memory, scratch, actions, k)
    advance_world(arena, worlds, system, scratch, k)
    progress.steps += 1
    if not is_finite(worlds.q[k], worlds.v[k]):
        progress.lost, progress.overflow = 1, 0
    before = memory.bounds[k, 0], memory.bounds[k, 1]
    if progress.lost + progress.overflow > 0:
        memory.bounds[k, 0] = memory.bounds[k, 1] = memory.outcome[k] = -arena.diagonal
        for i in range(memory.conjuncts.shape[1]):
            memory.conjuncts[k, i] = -arena.diagonal
        progress.hits = 0
    else:
        sense_world(arena, worlds, memory, system, scratch, k)
        watch_world(arena, memory, formula, progress.steps, k)
    after = memory.bounds[k, 0], memory.bounds[k, 1]
    over = progress.steps >= arena.last or progress.lost + progress.overflow > 0
    team, agents, n = compute_team_reward(before, after, over), output.rewards.shape[1], memory.torques.shape[1]
    for agent in range(agents):
        part = actions[k, :n] if agent == 0 else actions[k, n:]
        output.rewards[k, agent] = compute_reward(team, agents, compute_effort(part))
    show_world(arena, worlds, memory, output, k)


@compiled
def command_actuators(
    arena: Arena, worlds: Worlds, memory: Memory, scratch: StepScratch, actions: np.ndarray, k: int
) -> None:
    """Write the forces that world k's actions bring, and the torques that the formula speaks of."""
    action, command, force, n = scratch.action, scratch.command, scratch.force, memory.torques.shape[1]
    for i in range(n + 3):
        place = i - 3 if i >= 3 else n + i
        action[i] = actions[k, place] if place < actions.shape[1] else 0.0
    scale_action(arena.limits, action, command)
    actuators = view_actuators(arena, worlds, k)
    compute_forces(actuators, memory.v[k], command, force)
    for j in range(n):
        memory.torques[k, j] = force[3 + j]
    compute_forces(actuators, worlds.v[k], command, force)


@compiled
def advance_world(arena: Arena, worlds: Worlds, system: System, scratch: StepScratch, k: int) -> None:
    """Advance world k by one control period, and sum up its impacts."""
    progress, physics = worlds.progress[k], worlds.physics[k]
    restitution = (physics.restitution, physics.restitution_speed)
    start, impulse, hits = progress.steps * arena.period, 0.0, 0
    done, status = Progress(0.0, progress.is_touching, 0), STRUCK
    felt, felt_at = False, 0.0
    while status == STRUCK:
        status, done = advance_to_impact(
            system,
            restitution,
            scratch.force,
            worlds.q[k],
            worlds.v[k],
            arena.period,
            done,
            scratch.flow,
            scratch.strike,
        )
        if status == STRUCK:
            strike = scratch.strike[0]
            hits += 1
            impulse += find_length(strike.impulse * strike.normal[0], strike.impulse * strike.normal[1])
            if strike.speed > FELT_SPEED:
                felt, felt_at = True, start + strike.time
    progress.hits, progress.impulse, progress.is_touching = hits, impulse, done.touching
    progress.overflow, progress.lost = (1 if status == ENDLESS else 0), (0 if status in (DONE, ENDLESS) else 1)
    progress.is_felt = felt
    if felt:
        progress.has_felt, progress.felt_at = True, felt_at


@compiled
def sense_world(arena: Arena, worlds: Worlds, memory: Memory, system: System, scratch: StepScratch, k: int) -> None:
    """Write world k's true states and signals, and take the sensors' sample."""
    states, progress, flow = memory.states[k], worlds.progress[k], scratch.flow
    bodies, q, v = len(states), memory.q[k], memory.v[k]
    compute_rows(system, worlds.q[k], worlds.v[k], flow, states[: bodies - 1])
    for column in range(6):
        states[bodies - 1, column] = arena.goal[column] if column < 2 else 0.0
    read_coordinates(states, q, v)
    place = progress.steps % memory.samples.shape[1]
    sample = memory.samples[k, place]
    for i in range(bodies):
        for column in range(6):
            sample[i, column] = states[i, column]
            if arena.is_noisy and i < bodies - 1:
                sample[i, column] += arena.noise[column] * next_normal(worlds.streams, k)
    memory.contacts[k, place] = progress.is_felt
    since = progress.steps * arena.period - progress.felt_at if progress.has_felt else arena.horizon
    box, felt = (system.box_mass, system.box_inertia), (progress.impulse, since)
    write_signals(system.chain, box, states, q, v, memory.torques[k], felt, (flow.w, flow.rates), memory.signals[k])


@compiled
def watch_world(arena: Arena, memory: Memory, formula: CompiledFormula, count: int, k: int) -> None:
    """Take the formula's sample of world k."""
    low, high = update_monitor(formula, memory.monitor, k, count, memory.signals)
    memory.outcome[k] = compute_outcome(low, high, arena.diagonal)
    memory.bounds[k, 0] = max(-arena.diagonal, min(arena.diagonal, settle_tie(low)))
    memory.bounds[k, 1] = max(-arena.diagonal, min(arena.diagonal, settle_tie(high)))
    read_conjuncts(formula, memory.monitor, k, memory.conjuncts)
    for i in range(memory.conjuncts.shape[1]):
        memory.conjuncts[k, i] = max(-arena.diagonal, min(arena.diagonal, memory.conjuncts[k, i]))


@compiled
def show_world(arena: Arena, worlds: Worlds, memory: Memory, output: Output, k: int) -> None:
    """Write the observations of world k from the sample that arrived last."""
    progress, places = worlds.progress[k], memory.samples.shape[1]
    newest = progress.steps - 1 if progress.lost + progress.overflow > 0 else progress.steps
    place = max(newest - (places - 1), 0) % places
    fraction = progress.steps * arena.period / arena.horizon
    sample, felt, ends = memory.samples[k, place], memory.contacts[k, place], memory.conjuncts[k]
    write_observation(sample, felt, fraction, ends, arena.at, output.joint[k])
    for agent in range(output.agents.shape[1]):
        for i in range(output.joint.shape[1]):
            output.agents[k, agent, i] = output.joint[k, i]


@compiled
def start_task(
    arena: Arena,
    worlds: Worlds,
    memory: Memory,
    formula: CompiledFormula,
    scratch: StepScratch,
    output: Output,
    k: int,
) -> None:
    """Start an episode in world k, whose physics are drawn: everything at rest."""
    m, q, v = len(arena.start), worlds.q[k], worlds.v[k]
    worlds.progress[k] = BLANK_PROGRESS
    for i in range(m + 3):
        q[i] = arena.start[i] if i < m else worlds.physics[k].box_start[i - m]
        v[i] = 0.0
    for j in range(m - 3):
        memory.torques[k, j] = 0.0
    sense_world(arena, worlds, memory, view_system(arena, worlds, k), scratch, k)
    start_monitor(formula, memory.monitor, k)
    watch_world(arena, memory, formula, 0, k)
    for agent in range(output.rewards.shape[1]):
        output.rewards[k, agent] = 0.0
    show_world(arena, worlds, memory, output, k)


@compiled
def run_range(
    arena: Arena,
    worlds: Worlds,
    memory: Memory,
    formula: CompiledFormula,
    scratch: StepScratch,
    output: Output,
    actions: np.ndarray,
    todo: np.ndarray,
    first: int,
    end: int,
) -> None:
    """Step or start the worlds from first to before end, as todo says, shape (N,)."""
    for k in range(first, end):
        if todo[k] == STEP:
            step_task(arena, worlds, memory, formula, scratch, output, actions, k)
        elif todo[k] == START:
            start_task(arena, worlds, memory, formula, scratch, output, k)

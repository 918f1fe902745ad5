"""One control period of the dual-arm task in world k: actions, physics, robustness, reward, observation; compiled.

The same arithmetic as ImpactEnv with DualArmTask, so that a world of many equals the single environment bit for bit.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from impact_envs.compiled import compiled, inlined
from impact_envs.dual_arm.observation import ARM
from impact_envs.dual_arm.plant import STATE
from impact_envs.dual_arm.world import WIDTH, advance_tick, begin_world_period, write_rows
from impact_envs.elementary import cos_sin
from impact_envs.reward import compute_effort, compute_reward, compute_team_reward
from impact_envs.stl.compiled_formula import CompiledFormula
from impact_envs.stl.stepper import start_monitor, update_monitor
from impact_envs.stl.verdict import compute_outcome, settle_tie

ROW = ARM.size
MOTION, RECORD = 6, 8  # signals of a body: how many of its motion, and of the grasp's record
SIGNALS = MOTION + RECORD

# What all worlds share of the task.
RULES = np.dtype(
    [
        ("period", float),  # of control [s]
        ("horizon", float),  # [s]
        ("last", np.int64),  # control periods after which an episode is truncated
        ("limit", float),  # diagonal of the world, to which bounds of robustness are clipped [m]
        ("effort_period", float),  # see `task.EFFORT_PERIOD` [s]
    ]
)
# What the task remembers of a world.
TASK = np.dtype(
    [
        ("steps", np.int64),  # control periods since reset
        ("lost", np.int64),  # the world cannot be followed any further
        ("impacts", np.int64),  # in the last control period
        ("states", float, (3, WIDTH)),  # true ones, the last that were finite
        ("measured", float, (2, ROW)),  # the sensors' last sample
    ]
)


class Memory(NamedTuple):
    """What the formula remembers of N worlds.

    Attributes:
        signals: of its last sample, shape (N, 42).
        monitor: of the formula, shape (N, ...).
        bounds: interval of robustness still possible, shape (N, 2) [m].
        outcome: the robustness if the episode ended now, ties marked (`verdict.py`), shape (N,) [m].
    """

    signals: np.ndarray
    monitor: np.ndarray
    bounds: np.ndarray
    outcome: np.ndarray


class Output(NamedTuple):
    """What a step returns of N worlds.

    Attributes:
        joint: everything measured once, shape (N, joint size).
        agents: each arm's observation, shape (N, 2, agent size), or no arms where nobody asks.
        rewards: of each arm, shape (N, 2) [m].
    """

    joint: np.ndarray
    agents: np.ndarray
    rewards: np.ndarray


class Scratch(NamedTuple):
    """Where threads compute.

    Attributes:
        work: of the integration, shape (T, 6, 30).
        torques: commanded ones, shape (T, 2, 3) [N m].
    """

    work: np.ndarray
    torques: np.ndarray


def make_scratch(threads: int) -> Scratch:
    """Make room for threads to compute in."""
    return Scratch(np.zeros((threads, 6, STATE)), np.zeros((threads, 2, 3)))


@inlined
def step_task(
    plants: np.ndarray,
    worlds: np.ndarray,
    clock: np.record,
    scratch: Scratch,
    formula: CompiledFormula,
    rules: np.record,
    tasks: np.ndarray,
    memory: Memory,
    output: Output,
    c: int,
    k: int,
    actions: np.ndarray,
) -> None:
    """Hold world k's actions, shape (N, 2, 3) in [-1, 1], for one control period."""
    plant, world, task, work, torques = plants[k], worlds[k], tasks[k], scratch.work[c], scratch.torques[c]
    for i in range(2):
        for j in range(3):
            torques[i, j] = min(max(float(actions[k, i, j]), -1.0), 1.0) * plant.limits[i, j]
    begin_world_period(world)
    for _ in range(clock.ticks):
        advance_tick(plant, world, clock, work, torques)
    write_rows(plant, world, work)
    task.steps += 1
    over = task.steps >= rules.last
    before = memory.bounds[k, 0], memory.bounds[k, 1]
    if is_finite(world):
        take_sample(world, task, memory, k)
        watch(formula, rules, memory, k, task.steps)
        task.impacts = world.hits[0] + world.hits[1]
    else:
        task.lost, over = 1, True
        memory.bounds[k, 0] = memory.bounds[k, 1] = memory.outcome[k] = -rules.limit
        task.impacts = 0
    team = compute_team_reward(before, (memory.bounds[k, 0], memory.bounds[k, 1]), over)
    for i in range(2):
        effort = compute_effort(actions[k, i]) * rules.period / rules.effort_period
        output.rewards[k, i] = compute_reward(team, 2, effort)
    show(rules, task, output, k)


@inlined
def is_finite(world: np.record) -> bool:
    """Return whether all true states of a world are finite numbers."""
    total = 0.0
    for i in range(3):
        for j in range(WIDTH):
            total += 0.0 * world.rows[i, j]
    return total == 0.0


@inlined
def start_task(
    plants: np.ndarray,
    worlds: np.ndarray,
    scratch: Scratch,
    formula: CompiledFormula,
    rules: np.record,
    tasks: np.ndarray,
    memory: Memory,
    output: Output,
    c: int,
    k: int,
) -> None:
    """Start an episode in world k, which is at its start."""
    task = tasks[k]
    task.steps = task.lost = task.impacts = 0
    write_rows(plants[k], worlds[k], scratch.work[c])
    take_sample(worlds[k], task, memory, k)
    start_monitor(formula, memory.monitor, k)
    watch(formula, rules, memory, k, 0)
    output.rewards[k, 0] = output.rewards[k, 1] = 0.0
    show(rules, task, output, k)


@inlined
def take_sample(world: np.record, task: np.record, memory: Memory, k: int) -> None:
    """Take the sensors' sample and the formula's of world k from its true states."""
    for i in range(3):
        row = world.rows[i]
        for j in range(WIDTH):
            task.states[i, j] = row[j]
        for j in range(MOTION):
            memory.signals[k, SIGNALS * i + j] = row[j]
        for j in range(RECORD):
            memory.signals[k, SIGNALS * i + MOTION + j] = row[WIDTH - RECORD + j]
    for i in range(2):
        row, seen = world.rows[i], task.measured[i]
        for j in range(RECORD):  # angles, rates, forces
            seen[j] = row[MOTION + j]
        seen[8], seen[9] = row[0], row[1]
        seen[10], seen[11] = cos_sin(row[4])
        seen[12], seen[13], seen[14] = row[2], row[3], row[5]


@inlined
def watch(formula: CompiledFormula, rules: np.record, memory: Memory, k: int, count: int) -> None:
    """Take the formula's sample of world k."""
    low, high = update_monitor(formula, memory.monitor, k, count, memory.signals)
    memory.outcome[k] = compute_outcome(low, high, rules.limit)
    memory.bounds[k, 0] = max(-rules.limit, min(rules.limit, settle_tie(low)))
    memory.bounds[k, 1] = max(-rules.limit, min(rules.limit, settle_tie(high)))


@inlined
def show(rules: np.record, task: np.record, output: Output, k: int) -> None:
    """Write the observations of world k from its last sample."""
    time = task.steps * rules.period / rules.horizon
    for i in range(2):
        for j in range(ROW):
            output.joint[k, ROW * i + j] = task.measured[i, j]
    output.joint[k, 2 * ROW] = time
    for i in range(output.agents.shape[1]):
        for j in range(ROW):
            output.agents[k, i, j] = task.measured[i, j]
            output.agents[k, i, ROW + j] = task.measured[1 - i, j]
        output.agents[k, i, 2 * ROW] = time


# What run does with a world.
LEAVE, STEP, START = range(3)


@compiled
def run_worlds(
    plants: np.ndarray,
    worlds: np.ndarray,
    clock: np.ndarray,
    rules: np.ndarray,
    tasks: np.ndarray,
    scratch: tuple,
    formula: tuple,
    memory: tuple,
    output: tuple,
    actions: np.ndarray,
    todo: np.ndarray,
    thread: int,
    first: int,
    end: int,
) -> None:
    """Step or start the worlds from first to before end, as todo says.

    Args:
        plants, worlds, tasks: PLANT, WORLD and TASK, shape (N,).
        clock, rules: CLOCK and RULES, shape (1,).
        scratch, formula, memory, output: Scratch, CompiledFormula, Memory and Output, as plain tuples, which Python
            hands over faster.
        actions: in [-1, 1], shape (N, 2, 3).
        todo: LEAVE, STEP or START, shape (N,).
        thread: whose scratch.
        first, end: worlds.
    """
    room, parsed, kept, shown = Scratch(*scratch), CompiledFormula(*formula), Memory(*memory), Output(*output)
    for k in range(first, end):
        if todo[k] == STEP:
            step_task(plants, worlds, clock[0], room, parsed, rules[0], tasks, kept, shown, thread, k, actions)
        elif todo[k] == START:
            start_task(plants, worlds, room, parsed, rules[0], tasks, kept, shown, thread, k)

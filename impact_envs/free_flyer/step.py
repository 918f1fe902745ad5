"""One control period of the whole task in world k: actions, physics, sensors, robustness, reward, observation.

Compiled scalar functions, the same arithmetic as ImpactEnv with FreeFlyerTask, so that a world of many equals the
single environment bit for bit.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from impact_envs.compiled import compiled, inlined
from impact_envs.flight import Flight, predict_robustness
from impact_envs.free_flyer.engine import step_world
from impact_envs.free_flyer.sensing import (
    FELT_SPEED,
    Sensing,
    take_sample,
    write_observations,
)
from impact_envs.free_flyer.worlds import (
    FELT,
    HELD,
    HITS,
    LIMIT,
    LOST,
    OVERFLOW,
    OWED,
    STEPS,
    Arena,
    Scratch,
    Worlds,
    read_states,
    shift_starts,
    write_states,
)
from impact_envs.reward import compute_effort, compute_progress_reward, compute_reward, compute_team_reward
from impact_envs.stl.compiled_formula import CompiledFormula
from impact_envs.stl.stepper import read_conjuncts, start_monitor, update_monitor
from impact_envs.stl.verdict import compute_outcome, settle_tie
from impact_envs.stream import next_double


class Rules(NamedTuple):
    """What all worlds share of the task.

    Attributes:
        horizon: number of control periods that observations count time in.
        last: control periods after which an episode is truncated.
        diagonal: of the world; bounds of robustness are clipped to it [m].
        start: x, y, vx, vy, heading, omega of the bodies at the start, shape (1, n, 6).
        flight: how signals go on by themselves, for reward "progress".
    """

    horizon: float
    last: int
    diagonal: float
    start: np.ndarray
    flight: Flight


class Memory(NamedTuple):
    """What the task remembers of N worlds.

    Attributes:
        states: true states of the bodies' centres, shape (N, n, 6).
        signals: the same numbers, shape (N, 6 n).
        contacts: which robots felt an impact, shape (N, r).
        streams: random streams, shape (N, 4) uint64.
        sensors: as ``Physics.sensor``, shape (N, 2).
        uniforms: drawn for the noise and loss of a sample, shape (N, ``count_uniforms``).
        samples: velocity window, delay line and what arrived last, shape (N, ...).
        measured, felt: states and contacts as measured; of ideal sensors ``states`` and ``contacts`` themselves.
        monitor: of the formula, shape (N, ...).
        bounds: interval of robustness still possible, shape (N, 2) [m].
        conjuncts: the same of every conjunct of the formula, shape (N, 2 conjuncts) [m].
        outcome: the robustness if the episode ended now, ties marked (``verdict.py``), shape (N,) [m].
        potential: of reward "progress", shape (N, 1), or no column without it [m].
        spare, flown: where it is predicted, of the shapes of ``monitor`` and ``signals``, or no columns.
    """

    states: np.ndarray
    signals: np.ndarray
    contacts: np.ndarray
    streams: np.ndarray
    sensors: np.ndarray
    uniforms: np.ndarray
    samples: np.ndarray
    measured: np.ndarray
    felt: np.ndarray
    monitor: np.ndarray
    bounds: np.ndarray
    conjuncts: np.ndarray
    outcome: np.ndarray
    potential: np.ndarray
    spare: np.ndarray
    flown: np.ndarray


class Output(NamedTuple):
    """What a step returns of N worlds.

    Attributes:
        joint: everything measured once, shape (N, joint size).
        agents: each robot's observation, shape (N, r, agent size), or no robots where nobody asks.
        rewards: of each robot, shape (N, r) [m].
    """

    joint: np.ndarray
    agents: np.ndarray
    rewards: np.ndarray


@inlined
def step_task(
    arena: Arena,
    worlds: Worlds,
    scratch: Scratch,
    log: np.ndarray,
    formula: CompiledFormula,
    sensing: Sensing,
    rules: Rules,
    memory: Memory,
    output: Output,
    c: int,
    k: int,
    actions: np.ndarray,
) -> None:
    """Hold world k's actions, shape (N, r, 3) in [-1, 1], for one control period."""
    for i in range(arena.robots):
        for channel in range(3):
            u = min(max(float(actions[k, i, channel]), -1.0), 1.0)
            scratch.motion[c, i, HELD + channel] = u * arena.discs[i, LIMIT + channel]
    step_world(arena, worlds, scratch, log, c, k)
    if not is_finite(worlds, k):
        worlds.counter[k, LOST], worlds.counter[k, OVERFLOW] = 1, 0
    if worlds.counter[k, OVERFLOW] + worlds.counter[k, LOST] > 0:
        fail_task(arena, worlds, sensing, rules, memory, output, k, actions)
        return
    read_states(worlds, k, memory.states)
    for i in range(arena.robots):
        memory.contacts[k, i] = 1.0 if worlds.state[k, i, FELT] > FELT_SPEED else 0.0
    before, steps = (memory.bounds[k, 0], memory.bounds[k, 1]), worlds.counter[k, STEPS]
    watch(formula, rules, memory, k, steps)
    after, over = (memory.bounds[k, 0], memory.bounds[k, 1]), steps >= rules.last
    if rules.flight.every == 0:
        team = compute_team_reward(before, after, over)
    else:
        potential = memory.potential[k, 0]
        if over or worlds.counter[k, HITS] > 0 or steps % rules.flight.every == 0:
            predict(formula, rules, memory, k, steps)
        team = compute_progress_reward(potential, memory.potential[k, 0], after[0], over)
    for i in range(arena.robots):
        output.rewards[k, i] = compute_reward(team, arena.robots, compute_effort(actions[k, i]))
    observe(worlds, sensing, rules, memory, output, k)


@inlined
def is_finite(worlds: Worlds, k: int) -> bool:
    """Return whether all states of world k are finite numbers."""
    total = 0.0
    for i in range(worlds.state.shape[1]):
        for column in range(6):
            total += 0.0 * worlds.state[k, i, column]
    return total == 0.0


@inlined
def fail_task(
    arena: Arena,
    worlds: Worlds,
    sensing: Sensing,
    rules: Rules,
    memory: Memory,
    output: Output,
    k: int,
    actions: np.ndarray,
) -> None:
    """End the episode of world k, whose motion cannot be followed: least robustness, the last sample observed."""
    before = memory.bounds[k, 0], memory.bounds[k, 1]
    memory.bounds[k, 0] = memory.bounds[k, 1] = memory.outcome[k] = -rules.diagonal
    for i in range(memory.conjuncts.shape[1]):
        memory.conjuncts[k, i] = -rules.diagonal
    if rules.flight.every == 0:
        team = compute_team_reward(before, (-rules.diagonal, -rules.diagonal), True)
    else:
        team = compute_progress_reward(memory.potential[k, 0], -rules.diagonal, -rules.diagonal, True)
        memory.potential[k, 0] = -rules.diagonal
    for i in range(arena.robots):
        output.rewards[k, i] = compute_reward(team, arena.robots, compute_effort(actions[k, i]))
    worlds.counter[k, HITS] = 0
    show(worlds, sensing, rules, memory, output, k)


@inlined
def start_task(
    worlds: Worlds,
    formula: CompiledFormula,
    sensing: Sensing,
    rules: Rules,
    memory: Memory,
    output: Output,
    k: int,
) -> None:
    """Start an episode in world k, whose physics are drawn."""
    for column in range(worlds.counter.shape[1]):
        worlds.counter[k, column] = 0
    for i in range(worlds.state.shape[1]):
        worlds.state[k, i, FELT] = 0.0
    for i in range(worlds.thruster.shape[1]):
        worlds.thruster[k, i, OWED] = worlds.thruster[k, i, OWED + 1] = 0.0
    write_states(worlds, k, rules.start, 0)
    shift_starts(worlds, k, rules.start, 0)
    read_states(worlds, k, memory.states)
    for i in range(memory.contacts.shape[1]):
        memory.contacts[k, i] = 0.0
        output.rewards[k, i] = 0.0
    start_monitor(formula, memory.monitor, k)
    watch(formula, rules, memory, k, 0)
    if rules.flight.every > 0:
        predict(formula, rules, memory, k, 0)
    observe(worlds, sensing, rules, memory, output, k)


@inlined
def watch(formula: CompiledFormula, rules: Rules, memory: Memory, k: int, count: int) -> None:
    """Take the formula's sample of world k."""
    low, high = update_monitor(formula, memory.monitor, k, count, memory.signals)
    memory.outcome[k] = compute_outcome(low, high, rules.diagonal)
    memory.bounds[k, 0] = max(-rules.diagonal, min(rules.diagonal, settle_tie(low)))
    memory.bounds[k, 1] = max(-rules.diagonal, min(rules.diagonal, settle_tie(high)))
    read_conjuncts(formula, memory.monitor, k, memory.conjuncts)
    for i in range(memory.conjuncts.shape[1]):
        memory.conjuncts[k, i] = max(-rules.diagonal, min(rules.diagonal, memory.conjuncts[k, i]))


@compiled
def predict(formula: CompiledFormula, rules: Rules, memory: Memory, k: int, count: int) -> None:
    """Renew the potential of world k, whose last sample has this number."""
    room = memory.monitor, memory.spare, memory.signals, memory.flown
    found = predict_robustness(formula, rules.flight, *room, k, count, memory.bounds[k, 0])
    memory.potential[k, 0] = max(-rules.diagonal, min(rules.diagonal, found))


@inlined
def observe(worlds: Worlds, sensing: Sensing, rules: Rules, memory: Memory, output: Output, k: int) -> None:
    """Take the sensors' sample of world k and write its observations."""
    for i in range(memory.uniforms.shape[1]):
        memory.uniforms[k, i] = next_double(memory.streams, k)
    if memory.uniforms.shape[1] + memory.samples.shape[1] > 0:
        take_sample(
            sensing,
            k,
            worlds.counter[k, STEPS],
            memory.states,
            memory.contacts,
            memory.sensors,
            memory.uniforms,
            memory.samples,
            memory.measured,
            memory.felt,
        )
    show(worlds, sensing, rules, memory, output, k)


@inlined
def show(worlds: Worlds, sensing: Sensing, rules: Rules, memory: Memory, output: Output, k: int) -> None:
    """Write the observations of world k from its last sample."""
    fraction = worlds.counter[k, STEPS] * sensing.period / rules.horizon
    write_observations(k, memory.measured, memory.felt, fraction, memory.conjuncts, output.joint, output.agents)


# What run does with a world.
LEAVE, STEP, START = range(3)


@compiled
def run_range(
    arena: Arena,
    worlds: Worlds,
    scratch: Scratch,
    log: np.ndarray,
    formula: CompiledFormula,
    sensing: Sensing,
    rules: Rules,
    memory: Memory,
    output: Output,
    actions: np.ndarray,
    todo: np.ndarray,
    c: int,
    first: int,
    end: int,
) -> None:
    """Step or start the worlds from first to before end, as todo says."""
    for k in range(first, end):
        if todo[k] == STEP:
            step_task(arena, worlds, scratch, log, formula, sensing, rules, memory, output, c, k, actions)
        elif todo[k] == START:
            start_task(worlds, formula, sensing, rules, memory, output, k)


@compiled
def run_tuples(
    arena: tuple,
    worlds: tuple,
    scratch: tuple,
    log: np.ndarray,
    formula: tuple,
    sensing: tuple,
    rules: tuple,
    memory: tuple,
    output: tuple,
    actions: np.ndarray,
    todo: np.ndarray,
    c: int,
    first: int,
    end: int,
) -> None:
    """``run_range`` for Python, which hands over plain tuples three times faster than NamedTuples."""
    run_range(
        Arena(*arena),
        Worlds(*worlds),
        Scratch(*scratch),
        log,
        CompiledFormula(*formula),
        Sensing(*sensing),
        Rules(*rules),
        Memory(*memory),
        Output(*output),
        actions,
        todo,
        c,
        first,
        end,
    )


@compiled
def find_not_finite(actions: np.ndarray) -> int:
    """Return the place of the first action that is no finite number, in a flat view, or -1."""
    for place in range(actions.size):
        if not np.isfinite(actions[place]):
            return place
    return -1

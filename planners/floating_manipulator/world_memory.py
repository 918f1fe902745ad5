"""What the compiled expert knows beforehand, and what it remembers of every world.

Compiled functions name their arguments alike: `table`: what all worlds share, `memory`: of all worlds, `k`: world,
`scratch`: of the thread.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from impact_envs.compiled import compiled
from impact_envs.floating_manipulator.actuation import Actuators, join_limits, make_actuators
from impact_envs.floating_manipulator.flow import Scratch, System, make_scratch, make_system
from impact_envs.floating_manipulator.observation import Places, find_places, make_layout
from impact_envs.floating_manipulator.schema import FloatingManipulatorScenario
from planners.floating_manipulator.options import Options
from planners.floating_manipulator.osdre import OutputScratch, make_output_scratch
from planners.floating_manipulator.reading_reach import make_gates
from planners.reading_gate import ROWS

BEFORE, PAUSE, AFTER = range(3)  # in STATE.phase
PHASES = ("before", "pause", "after")

# What is remembered of one world, apart from arrays.
STATE = np.dtype(
    [
        ("phase", int),  # BEFORE the first impact, in the safety PAUSE, or AFTER it
        ("impacts", int),  # number felt so far
        ("resume", float),  # when the pause ends [s]
        ("momenta", float, 3),  # P_x, P_y and L about the world's origin, used by the OSDRE [N s], [N m s]
        ("samples", int),  # of the momenta that were averaged
        ("knows_gain", bool),  # a Riccati equation was solved
        # The measurement of this control step.
        ("time", float),  # [s]
        ("clock", float),  # of the last reading, as believed [s]
        ("contact", bool),  # the arm felt an impact in the last control period
        # The correction.
        ("due", float),  # when the next one is due [s]
        ("is_awaited", bool),  # now
        ("is_corrected", bool),  # one is applied
        ("effort", float),  # its factor on R
        ("speed_weight", float),  # its factor on the weights of the tip's velocity in Q
    ],
    align=True,
)
# The pulses of one thruster axis, see `pulses`.
PULSE = np.dtype(
    [
        ("count", int),  # desired forces that are remembered
        ("on", int),  # control periods that are left of a pulse
        ("rest", int),  # control periods that are left of the rest after it
        ("sign", float),  # of the pulse
    ],
    align=True,
)
COUNTERS = ("last_gain", "none", "no_action", "no_measurement", "rejected", "taken_up")
COUNTS = np.dtype([(name, np.int64) for name in COUNTERS])
# Assigning one of these clears a record.
BLANK_STATE, BLANK_PULSE, BLANK_COUNTS = (np.zeros((), dtype)[()] for dtype in (STATE, PULSE, COUNTS))


class ExpertTable(NamedTuple):
    """What is believed of all worlds of a scenario.

    Attributes:
        system: masses and sizes.
        actuators: of arm and base.
        at: where the fields of an observation begin.
        start: coordinates of the manipulator at the start, shape (n + 3,) [m], [rad].
        goal: of the tip, shape (2,) [m].
        limits: commands of an action of 1: Fx, Fy and torque on the base, joint torques, shape (n + 3,) [N], [N m].
        arm_gate, box_gate: gates of manipulator and box at the start, see `reading_reach`.
        horizon, period, pause: of an episode, of control, after an impact [s].
        base_mass: of the base alone [kg].
        reach: length of the arm [m].
        drives_base: the base is actuated.
        is_compensated: the OSDRE after the pause is compensated.
        fires_pulses: thrusters fire in pulses.
    """

    system: System
    actuators: Actuators
    at: Places
    start: np.ndarray
    goal: np.ndarray
    limits: np.ndarray
    arm_gate: np.ndarray
    box_gate: np.ndarray
    horizon: float
    period: float
    pause: float
    base_mass: float
    reach: float
    drives_base: bool
    is_compensated: bool
    fires_pulses: bool


class ExpertMemory(NamedTuple):
    """What the expert remembers of N worlds.

    Attributes:
        state: a STATE, shape (N,).
        q, v: coordinates and rates of the manipulator in this control step, shape (N, n + 3) [m], [rad], [m/s],
            [rad/s].
        box: x, y, heading, vx, vy, omega of the box, shape (N, 6) [m], [rad], [m/s], [rad/s].
        held: coordinates at the last impact, shape (N, n + 3) [m], [rad].
        K: last solution of the Riccati equation, shape (N, 4, 4).
        torques: of the correction, shape (N, n) [N m].
        command: last controls: Fx, Fy and torque on the base, joint torques, shape (N, n + 3) [N], [N m].
        arm_gate, box_gate: gates of the readings, shapes (N, ROWS, n + 3) and (N, ROWS, 3).
        pulse: a PULSE of each axis, shape (N, 2).
        desired: last desired forces of each axis, oldest first, shape (N, 2, pulse_samples) [N].
        counts: how often what happened, a COUNTS, shape (N,).
    """

    state: np.ndarray
    q: np.ndarray
    v: np.ndarray
    box: np.ndarray
    held: np.ndarray
    K: np.ndarray
    torques: np.ndarray
    command: np.ndarray
    arm_gate: np.ndarray
    box_gate: np.ndarray
    pulse: np.ndarray
    desired: np.ndarray
    counts: np.ndarray


class ExpertScratch(NamedTuple):
    """Working arrays of one thread.

    Attributes:
        output: of the OSDRE; Q is written by `regulate_world`, K stays unused: every world has its own.
        flow: of the prediction of readings.
        force, q, v: of manipulator and box, shape (n + 6,).
        rates: of the manipulator, with the base's from its momenta, shape (n + 3,).
        u: torques of the OSDRE, shape (n,) [N m].
    """

    output: OutputScratch
    flow: Scratch
    force: np.ndarray
    q: np.ndarray
    v: np.ndarray
    rates: np.ndarray
    u: np.ndarray


def make_expert_table(scenario: FloatingManipulatorScenario, options: Options) -> ExpertTable:
    """Collect what is believed of all worlds of a scenario.

    Args:
        scenario: as believed.
        options: of the expert.
    """
    physics = scenario.draw(np.random.default_rng(0))  # as believed: nothing is drawn
    drives_base = "base" in scenario.agents
    compensated = options.compensated and drives_base
    arm_gate, box_gate = make_gates(scenario, options.readings)
    return ExpertTable(
        system=make_system(scenario, physics),
        actuators=make_actuators(scenario, physics),
        at=find_places(make_layout(scenario)),
        start=scenario.start,
        goal=np.array(scenario.arm.goal, dtype=float),
        limits=join_limits(scenario),
        arm_gate=arm_gate,
        box_gate=box_gate,
        horizon=float(scenario.horizon),
        period=float(scenario.control_period),
        pause=float(scenario.safety_pause),
        base_mass=float(scenario.base.mass),
        reach=float(sum(link.length for link in scenario.links.values())),
        drives_base=drives_base,
        is_compensated=compensated,
        fires_pulses=compensated and scenario.thrusters is not None,
    )


def make_expert_memory(table: ExpertTable, options: Options, count: int) -> ExpertMemory:
    """Make the memory of N worlds.

    Args:
        table: what they share.
        options: of the expert.
        count: N.
    """
    m = len(table.start)
    return ExpertMemory(
        state=np.zeros(count, STATE),
        q=np.zeros((count, m)),
        v=np.zeros((count, m)),
        box=np.zeros((count, 6)),
        held=np.zeros((count, m)),
        K=np.zeros((count, 4, 4)),
        torques=np.zeros((count, m - 3)),
        command=np.zeros((count, m)),
        arm_gate=np.zeros((count, ROWS, m)),
        box_gate=np.zeros((count, ROWS, 3)),
        pulse=np.zeros((count, 2), PULSE),
        desired=np.zeros((count, 2, options.recovery.pulse_samples)),
        counts=np.zeros(count, COUNTS),
    )


def make_expert_scratch(table: ExpertTable) -> ExpertScratch:
    """Allocate the working arrays of one thread."""
    m = len(table.start)
    vectors = (np.zeros(size) for size in (m + 3, m + 3, m + 3, m, m - 3))
    return ExpertScratch(make_output_scratch(m - 3), make_scratch(m - 3), *vectors)


@compiled
def start_world(table: ExpertTable, memory: ExpertMemory, k: int) -> None:
    """Forget the last episode of world k; until the first measurement, everything rests where it is believed to."""
    memory.state[k] = BLANK_STATE
    state = memory.state[k]
    state.clock = -table.period
    state.effort = state.speed_weight = 1.0
    memory.counts[k] = BLANK_COUNTS
    for axis in range(2):
        memory.pulse[k, axis] = BLANK_PULSE
    for i in range(len(table.start)):
        memory.q[k, i] = memory.held[k, i] = table.start[i]
        memory.v[k, i] = memory.command[k, i] = 0.0
        for row in range(ROWS):
            memory.arm_gate[k, row, i] = table.arm_gate[row, i]
    for i in range(3):
        memory.box[k, i], memory.box[k, 3 + i] = table.box_gate[0, i], 0.0
        for row in range(ROWS):
            memory.box_gate[k, row, i] = table.box_gate[row, i]
    for i in range(4):
        for j in range(4):
            memory.K[k, i, j] = 0.0
    for j in range(memory.torques.shape[1]):
        memory.torques[k, j] = 0.0

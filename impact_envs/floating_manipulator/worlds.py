"""The arrays of many floating manipulators: what all worlds share, and what each world has."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from impact_envs.compiled import compiled
from impact_envs.floating_manipulator.actuation import Actuators, join_limits, make_actuators
from impact_envs.floating_manipulator.collision import STRIKE
from impact_envs.floating_manipulator.flow import Scratch, System, make_scratch, make_system
from impact_envs.floating_manipulator.observation import Places, find_places, make_layout
from impact_envs.floating_manipulator.schema import FloatingManipulatorScenario, Physics
from impact_envs.physics.multibody import Chain

# The drawn physics of one world, apart from arrays.
PHYSICS = np.dtype(
    [
        ("mass", float),  # of base, links and load [kg]
        ("box_mass", float),  # [kg]
        ("box_inertia", float),  # [kg m^2]
        ("box_start", float, 3),  # x, y, heading [m], [rad]
        ("restitution", float),  # at zero speed
        ("restitution_speed", float),  # [m/s]
        ("thruster_force", float),  # [N]
    ],
    align=True,
)
# How far an episode is, and what its last control period brought.
PROGRESS = np.dtype(
    [
        ("steps", int),  # control periods since reset
        ("hits", int),  # impacts in the last one
        ("overflow", int),  # 1 where its events did not end
        ("lost", int),  # 1 where a state is no finite number any more
        ("is_touching", bool),  # the tip pushes the box
        ("impulse", float),  # sum of the impulses on the box in the last control period [N s]
        ("is_felt", bool),  # the arm felt an impact in it
        ("has_felt", bool),  # an impact was felt since reset
        ("felt_at", float),  # when the last one was [s]
    ],
    align=True,
)
BLANK_PROGRESS = np.zeros((), PROGRESS)[()]


class Arena(NamedTuple):
    """What all worlds share.

    Attributes:
        believed: system as believed; of its numbers those that are drawn are not looked at.
        actuators: the same.
        at: where the fields of an observation begin.
        start: coordinates of the manipulator at the start, shape (n + 3,) [m], [rad].
        goal: of the tip, shape (2,) [m].
        limits: commands of an action of 1: Fx, Fy and torque on the base, joint torques, shape (n + 3,) [N], [N m].
        noise: standard deviations of a measured row, shape (6,).
        is_noisy: any of them is above 0.
        drives_base: the base is an agent.
        period: of control [s].
        horizon: of an episode [s].
        last: control periods after which an episode is truncated.
        diagonal: of the world; bounds of robustness are clipped to it [m].
    """

    believed: System
    actuators: Actuators
    at: Places
    start: np.ndarray
    goal: np.ndarray
    limits: np.ndarray
    noise: np.ndarray
    is_noisy: bool
    drives_base: bool
    period: float
    horizon: float
    last: int
    diagonal: float


class Worlds(NamedTuple):
    """The true physics and the present motion of N worlds.

    Attributes:
        physics: a PHYSICS, shape (N,).
        first, second, inertia: of the chain, shapes (N, n + 1), (N, n + 1, n + 1), (N, n + 1).
        stall_torque, no_load_speed: of the joints' motors, shape (N, n) [N m], [rad/s].
        q, v: coordinates of manipulator and box, and their rates, shape (N, n + 6).
        progress: a PROGRESS, shape (N,).
        streams: random streams, shape (N, 4) uint64.
    """

    physics: np.ndarray
    first: np.ndarray
    second: np.ndarray
    inertia: np.ndarray
    stall_torque: np.ndarray
    no_load_speed: np.ndarray
    q: np.ndarray
    v: np.ndarray
    progress: np.ndarray
    streams: np.ndarray


class Memory(NamedTuple):
    """What the task remembers of N worlds.

    Attributes:
        states: true states of the bodies, shape (N, n + 4, 6).
        torques: of the joints in the last control period, as a signal, shape (N, n) [N m].
        q, v: coordinates and rates of the manipulator that the states say, shape (N, n + 3).
        signals: of the formula, shape (N, 6 (n + 4) + 2 n + 8).
        samples: measured states, the newest in place steps modulo delay + 1, shape (N, delay + 1, n + 4, 6).
        contacts: whether an impact was felt, of the same samples, shape (N, delay + 1).
        monitor: of the formula, shape (N, ...).
        bounds: interval of robustness still possible, shape (N, 2) [m].
        conjuncts: the same of every conjunct of the formula, shape (N, 2 c) [m].
        outcome: the robustness if the episode ended now, ties marked (``verdict.py``), shape (N,) [m].
    """

    states: np.ndarray
    torques: np.ndarray
    q: np.ndarray
    v: np.ndarray
    signals: np.ndarray
    samples: np.ndarray
    contacts: np.ndarray
    monitor: np.ndarray
    bounds: np.ndarray
    conjuncts: np.ndarray
    outcome: np.ndarray


class StepScratch(NamedTuple):
    """Working arrays of one thread.

    Attributes:
        flow: of the motion.
        strike: the last impact, a STRIKE, shape (1,).
        action, command: of Fx, Fy and torque on the base, and of joint torques, shape (n + 3,) [-], [N], [N m].
        force: on all coordinates, shape (n + 6,) [N], [N m].
    """

    flow: Scratch
    strike: np.ndarray
    action: np.ndarray
    command: np.ndarray
    force: np.ndarray


def make_arena(scenario: FloatingManipulatorScenario, last: int) -> Arena:
    """Collect what all worlds of a scenario share.

    Args:
        scenario: of the worlds.
        last: control periods after which an episode is truncated.
    """
    physics, true = scenario.as_believed().draw(np.random.default_rng(0)), scenario.true
    noise = [true.position_noise] * 2 + [true.speed_noise] * 2 + [true.heading_noise, true.rate_noise]
    return Arena(
        believed=make_system(scenario, physics),
        actuators=make_actuators(scenario, physics),
        at=find_places(make_layout(scenario)),
        start=scenario.start,
        goal=np.array(scenario.arm.goal, dtype=float),
        limits=join_limits(scenario),
        noise=np.array(noise, dtype=float),
        is_noisy=any(noise),
        drives_base="base" in scenario.agents,
        period=float(scenario.control_period),
        horizon=float(scenario.horizon),
        last=last,
        diagonal=float(scenario.world.diagonal),
    )


def make_worlds(arena: Arena, count: int) -> Worlds:
    """Return N worlds with all numbers zero."""
    n = len(arena.start) - 3
    return Worlds(
        physics=np.zeros(count, PHYSICS),
        first=np.zeros((count, n + 1)),
        second=np.zeros((count, n + 1, n + 1)),
        inertia=np.zeros((count, n + 1)),
        stall_torque=np.zeros((count, n)),
        no_load_speed=np.zeros((count, n)),
        q=np.zeros((count, n + 6)),
        v=np.zeros((count, n + 6)),
        progress=np.zeros(count, PROGRESS),
        streams=np.zeros((count, 4), np.uint64),
    )


def make_memory(arena: Arena, count: int, delay: int, monitor: int, conjuncts: int) -> Memory:
    """Return the task's memory of N worlds, all zero.

    Args:
        arena: what the worlds share.
        count: N.
        delay: of the measurements [control periods].
        monitor: numbers that the formula's monitor keeps of a world.
        conjuncts: of the formula.
    """
    n = len(arena.start) - 3
    return Memory(
        states=np.zeros((count, n + 4, 6)),
        torques=np.zeros((count, n)),
        q=np.zeros((count, n + 3)),
        v=np.zeros((count, n + 3)),
        signals=np.zeros((count, 6 * (n + 4) + 2 * n + 8)),
        samples=np.zeros((count, delay + 1, n + 4, 6)),
        contacts=np.zeros((count, delay + 1), bool),
        monitor=np.zeros((count, monitor)),
        bounds=np.zeros((count, 2)),
        conjuncts=np.zeros((count, 2 * conjuncts)),
        outcome=np.zeros(count),
    )


def make_step_scratch(arena: Arena) -> StepScratch:
    """Allocate the working arrays of one thread."""
    m = len(arena.start)
    return StepScratch(make_scratch(m - 3), np.zeros(1, STRIKE), np.zeros(m), np.zeros(m), np.zeros(m + 3))


class Drawn:
    """Numbers that are drawn already, in place of a generator.

    Args:
        numbers: uniform in [0, 1), in the order in which they are asked for.

    Attributes:
        count: how many were asked for.
    """

    def __init__(self, numbers: Any = ()) -> None:
        self._numbers, self.count = numbers, 0

    def uniform(self, low: float, high: float) -> float:
        """Return the next number between low and high, as numpy's generator does."""
        self.count += 1
        return low + (high - low) * (self._numbers[self.count - 1] if len(self._numbers) else 0.0)


def write_physics(worlds: Worlds, k: int, physics: Physics) -> None:
    """Put drawn physics into world k."""
    chain, row = physics.chain, worlds.physics[k]
    row["mass"], row["box_mass"], row["box_inertia"] = chain.mass, physics.box_mass, physics.box_inertia
    row["box_start"], row["thruster_force"] = physics.box_start, physics.thruster_force
    row["restitution"], row["restitution_speed"] = physics.restitution, physics.restitution_speed
    worlds.first[k], worlds.second[k], worlds.inertia[k] = chain.first, chain.second, chain.inertia
    worlds.stall_torque[k], worlds.no_load_speed[k] = physics.stall_torque, physics.no_load_speed


@compiled
def view_system(arena: Arena, worlds: Worlds, k: int) -> System:
    """Return the true system of world k, over its arrays."""
    shared, row = arena.believed, worlds.physics[k]
    mount, levers = shared.chain.mount, shared.chain.levers
    chain = Chain(row.mass, mount, worlds.first[k], worlds.second[k], worlds.inertia[k], levers)
    return System(chain, row.box_mass, row.box_inertia, shared.half_length, shared.half_width, shared.radius)


@compiled
def view_actuators(arena: Arena, worlds: Worlds, k: int) -> Actuators:
    """Return the true actuators of world k, over its arrays."""
    shared, force = arena.actuators, worlds.physics[k].thruster_force
    motors = worlds.stall_torque[k], worlds.no_load_speed[k]
    return Actuators(motors[0], motors[1], force, shared.dead_zone, shared.wheel_torque, shared.wheel_speed)

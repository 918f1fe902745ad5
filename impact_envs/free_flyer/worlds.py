"""The arrays of many disc worlds: what all worlds share, what each world has, and where a step computes.

Few arrays with named columns, because every array costs time in each call and in compilation. What no world of a
scenario needs has length 0, so that memory is paid for what is used. The drawn physics come first in their arrays, in
the columns that `schema.py` names.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from impact_envs.compiled import compiled
from impact_envs.elementary import cos_sin
from impact_envs.errors import InputError
from impact_envs.free_flyer.body import make_obstacle, make_walls
from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.free_flyer.truth import (
    BODY_COLUMNS,
    CONTACT_COLUMNS,
    OFFSET_X,
    OFFSET_Y,
    START_X,
    START_Y,
    THRUSTER_COLUMNS,
    Physics,
)

# Columns of Arena.discs: radius [m], limits of force and torque per channel [N], [N m].
RADIUS, LIMIT = 0, 1
# Column of Worlds.state after x, y, vx, vy, heading, omega: fastest impact in the last control period [m/s].
FELT, STATE_SIZE = 6, 7
# Columns of Worlds.body after those of Physics.body, of objects that keep their velocity: time since their last impact
# [s], and the line that they follow [m], [m/s].
SINCE, LINE_X, LINE_Y, LINE_VX, LINE_VY = range(BODY_COLUMNS, BODY_COLUMNS + 5)
# Columns of Worlds.thruster after those of Physics.thruster: what on/off thrusters owe in Fx, Fy, in full pulses.
OWED = THRUSTER_COLUMNS
# Columns of Worlds.counter.
STEPS, HITS, OVERFLOW, LOST, STRUCK = range(5)
# Columns of Scratch.motion: commands, then accelerations by thrusters and drift; the same with lasting contacts,
# changes of velocity by impulses and by their compression, how far from its centre of mass a body can come [m].
HELD, ACCELERATION, CHANGE, COMPRESSION, ROOM = range(0, 15, 3)
# Columns of Scratch.marks: numbers of the pairs that could touch; per pair 0 apart, 1 pressed, 2 resting unpressed.
NEAR, REST = range(2)
# Columns of a contact: bodies, normal from i to j, point [m], gap [m], speed of separation and slip before [m/s],
# speed of separation and slip that the impulses aim at [m/s], impulses along normal and tangent [N s], number of the
# pair; and, per entry of NEAR, the time of impact [s].
I, J, NX, NY, PX, PY, GAP, PARTING, SLIP, PARTING_GOAL, SLIP_GOAL, ALONG, ACROSS, PAIR, TIME, CONTACT_SIZE = range(16)

ROW = 10  # numbers that describe an impact: time, a, b, point, normal, impulse on b, speed


class Arena(NamedTuple):
    """What all worlds share; n movable bodies, of which the first are the robots, then the fixed ones.

    Attributes:
        period: control period [s].
        rest_speed: below it impacts of pressed bodies start lasting contacts [m/s].
        on_off: thrusters are off or full.
        robots: how many.
        discs: shape (n, 4), see the columns.
        pairs: bodies that can touch, the movable ones first, shape (pairs, 2).
        first_face: where the faces of each fixed body begin, shape (fixed + 1,).
        faces: start corner, outward normal and length of the fixed bodies' faces, shape (faces, 5) [m].
    """

    period: float
    rest_speed: float
    on_off: bool
    robots: int
    discs: np.ndarray
    pairs: np.ndarray
    first_face: np.ndarray
    faces: np.ndarray


class Worlds(NamedTuple):
    """The true physics and the present motion of N worlds.

    Attributes:
        state: x, y, vx, vy of the centres of mass, heading, omega, felt impact, shape (N, n, 7) [m], [m/s], [rad],
            [rad/s].
        body: as ``Physics.body``, shape (N, n, 12); mass and inertia only where that is all, 17 columns where objects
            keep their velocity.
        thruster: as ``Physics.thruster`` and two more, shape (N, robots, 14), or no robots where all thrusters do as
            they are told.
        contact: as ``Physics.contact``, shape (N, 3).
        held: impulse on the second body of each pair by lasting contacts in the last control period, shape
            (N, pairs, 2), or no pairs where nobody reads it [N s].
        counter: control periods since reset, impacts in the last one, whether its events did not end, whether a state
            is no finite number any more, body of the last impact in the last one plus one or 0, shape (N, 5).
    """

    state: np.ndarray
    body: np.ndarray
    thruster: np.ndarray
    contact: np.ndarray
    held: np.ndarray
    counter: np.ndarray


class Scratch(NamedTuple):
    """Room for the computation of one step, one per thread; the first axis is the thread.

    Attributes:
        motion: shape (threads, n, 13).
        marks: shape (threads, pairs, 2).
        contacts: shape (threads, pairs, 15).
    """

    motion: np.ndarray
    marks: np.ndarray
    contacts: np.ndarray


def make_arena(scenario: FreeFlyerScenario) -> tuple[Arena, tuple[str, ...]]:
    """Return what all worlds of a scenario share, and the names of all bodies, the fixed ones last.

    Raises:
        InputError: an object is no disc.
    """
    for name, body in scenario.objects.items():
        if body.vertices is not None:
            raise InputError(f'objects.{name} is a polygon; engine = "exact" takes discs, use engine = "pymunk"')
    fixed = make_walls(scenario.world.lower, scenario.world.upper)
    fixed += [make_obstacle(name, area.corners) for name, area in scenario.obstacles.items() if area.solid]
    n = len(scenario.bodies)
    discs = np.zeros((n, 4))
    discs[:, RADIUS] = [scenario.body(name).radius for name in scenario.bodies]
    discs[: len(scenario.robots), LIMIT:] = [
        (robot.force_limit, robot.force_limit, robot.torque_limit) for robot in scenario.robots.values()
    ]
    discs[len(scenario.robots) :, LIMIT] = [item.keep_force for item in scenario.objects.values()]
    pairs = [*itertools.combinations(range(n), 2), *itertools.product(range(n), range(n, n + len(fixed)))]
    arena = Arena(
        period=float(scenario.control_period),
        rest_speed=float(scenario.rest_speed),
        on_off=bool(scenario.true.thruster_on_off),
        robots=len(scenario.robots),
        discs=discs,
        pairs=np.array(pairs, dtype=np.int64),
        first_face=np.cumsum([0] + [len(body.faces) for body in fixed]),
        faces=np.array([face for body in fixed for face in body.faces]),
    )
    return arena, (*scenario.bodies, *(body.name for body in fixed))


def make_worlds(
    arena: Arena, count: int, shifts: bool, gains: bool, dtype: type = np.float64, held: bool = False
) -> Worlds:
    """Return worlds with all numbers zero.

    Args:
        arena: what they share.
        count: N.
        shifts: any centre of mass may be offset, or anything accelerate by itself.
        gains: any thruster may differ from its command.
        dtype: of all that is not counted.
        held: impulses of lasting contacts are read.
    """
    n, keeps = len(arena.discs), bool(arena.discs[arena.robots :, LIMIT].any())
    return Worlds(
        state=np.zeros((count, n, STATE_SIZE), dtype),
        body=np.zeros((count, n, LINE_VY + 1 if keeps else BODY_COLUMNS if shifts else OFFSET_X), dtype),
        thruster=np.zeros((count, arena.robots if gains or arena.on_off else 0, OWED + 2), dtype),
        contact=np.zeros((count, CONTACT_COLUMNS), dtype),
        held=np.zeros((count, len(arena.pairs) if held else 0, 2), dtype),
        counter=np.zeros((count, 5), np.int64),
    )


def write_physics(
    worlds: Any,
    chosen: Any,
    physics: Physics,
    sensors: Any = None,
    convert: Callable[[Any, Any], Any] | None = None,
) -> None:
    """Put drawn physics into some worlds; columns that no world of the scenario needs are left out.

    Args:
        worlds: `Worlds` of arrays or of tensors.
        chosen: the worlds' numbers, shape (m,).
        physics: of m worlds.
        sensors: takes what is drawn of the sensors, shape (N, 2); None where nobody measures.
        convert: turns what is drawn into what can be written to an array of the worlds, its second argument.
    """
    pairs = [
        (worlds.contact, physics.contact),
        (worlds.body, physics.body),
        (worlds.thruster, physics.thruster),
    ]
    if sensors is not None:
        pairs.append((sensors, physics.sensor))
    for kept, drawn in pairs:
        if kept.shape[1] > 0:
            width = min(kept.shape[-1], drawn.shape[-1])
            part = drawn[..., :width]
            kept[chosen, ..., :width] = convert(part, kept) if convert else part


def make_scratch(arena: Arena, threads: int) -> Scratch:
    """Return room for as many threads."""
    n, pairs = len(arena.discs), len(arena.pairs)
    return Scratch(
        motion=np.zeros((threads, n, 13)),
        marks=np.zeros((threads, pairs, 2), np.int64),
        contacts=np.zeros((threads, pairs, CONTACT_SIZE)),
    )


@compiled
def read_states(worlds: Worlds, k: int, states: np.ndarray) -> None:
    """Write x, y, vx, vy, heading, omega of the geometric centres of world k's bodies to states[k]."""
    for i in range(worlds.state.shape[1]):
        rx, ry = find_offset(worlds, k, i, worlds.state[k, i, 4])
        omega = worlds.state[k, i, 5]
        states[k, i, 0], states[k, i, 1] = worlds.state[k, i, 0] - rx, worlds.state[k, i, 1] - ry
        states[k, i, 2], states[k, i, 3] = worlds.state[k, i, 2] + omega * ry, worlds.state[k, i, 3] - omega * rx
        states[k, i, 4], states[k, i, 5] = worlds.state[k, i, 4], omega


@compiled
def write_states(worlds: Worlds, k: int, states: np.ndarray, row: int) -> None:
    """Put world k's bodies where states[row] says; the opposite of ``read_states``."""
    for i in range(worlds.state.shape[1]):
        rx, ry = find_offset(worlds, k, i, states[row, i, 4])
        omega = states[row, i, 5]
        worlds.state[k, i, 0], worlds.state[k, i, 1] = states[row, i, 0] + rx, states[row, i, 1] + ry
        worlds.state[k, i, 2], worlds.state[k, i, 3] = states[row, i, 2] - omega * ry, states[row, i, 3] + omega * rx
        worlds.state[k, i, 4], worlds.state[k, i, 5] = states[row, i, 4], omega


@compiled
def shift_starts(worlds: Worlds, k: int, states: np.ndarray, row: int) -> None:
    """Move world k's bodies from where states[row] says to where they start in this world."""
    if worlds.body.shape[2] <= START_Y:
        return
    for i in range(worlds.state.shape[1]):
        x, y = worlds.body[k, i, START_X], worlds.body[k, i, START_Y]
        if x != 0.0 or y != 0.0:
            rx, ry = find_offset(worlds, k, i, states[row, i, 4])
            worlds.state[k, i, 0], worlds.state[k, i, 1] = states[row, i, 0] + x + rx, states[row, i, 1] + y + ry


@compiled
def find_offset(worlds: Worlds, k: int, i: int, heading: float) -> tuple[float, float]:
    """Return the centre of mass of body i, seen from its geometric centre [m]."""
    if worlds.body.shape[2] <= OFFSET_X:
        return 0.0, 0.0
    ox, oy = worlds.body[k, i, OFFSET_X], worlds.body[k, i, OFFSET_Y]
    if ox == 0 and oy == 0:
        return 0.0, 0.0
    cos, sin = cos_sin(heading)
    return cos * ox - sin * oy, sin * ox + cos * oy

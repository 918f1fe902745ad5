"""How long the legs of robots take at least, and how much room they need, now that their velocities are known.

The event grid knows neither the velocity a robot needs at an impact, nor the room to reach it and to stop afterwards,
nor the way round an object it has just hit. A sequence whose motions prove too quick to be smoothed is planned again
with more time on its hasty legs, and with its impacts farther from the world's edges.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from impact_envs.free_flyer.schema import FreeFlyerScenario
from planners.free_flyer.nominal.event_grid import EventGrid
from planners.free_flyer.nominal.event_sequence import EventSequence
from planners.free_flyer.reserves import Reserves
from planners.plan import PlannedImpact


@dataclass(frozen=True)
class Wait:
    """Hold a least time between two events.

    Args:
        first: number of the earlier event; 0 is the start.
        second: number of the later event; K + 1 is the horizon.
        seconds: least time between them [s].
    """

    first: int
    second: int
    seconds: float

    @property
    def key(self) -> tuple[object, ...]:
        """Return what it is about; a later one with this key replaces it."""
        return self.first, self.second

    def add_to(self, grid: EventGrid) -> None:
        """Add its row to a grid."""
        events = grid.times[:: grid.pieces]
        grid.model.require(self.seconds - (events[self.second] - events[self.first]))


@dataclass(frozen=True)
class Room:
    """Hold how far a robot that hits has to be from an edge of the world.

    Args:
        robot: its name.
        event: number of the impact.
        axis: 0 or 1.
        sign: 1 for the upper edge, -1 for the lower one.
        bound: sign times the robot's place is at most this [m].
    """

    robot: str
    event: int
    axis: int
    sign: float
    bound: float

    @property
    def key(self) -> tuple[object, ...]:
        """Return what it is about; a later one with this key replaces it."""
        return self.robot, self.event, self.axis, self.sign

    def add_to(self, grid: EventGrid) -> None:
        """Add its row to a grid."""
        place = grid.knots[self.robot][self.event * grid.pieces][self.axis]
        grid.model.require(place * self.sign - self.bound)


@dataclass(frozen=True)
class HitPlace:
    """Hold where an object is hit, up to a box, in a sequence that hits it so many times.

    Args:
        name: of the object.
        number: of the hit among those of the object, from 0.
        count: of its hits.
        lower: corner of the box [m].
        upper: opposite corner [m].
    """

    name: str
    number: int
    count: int
    lower: tuple[float, ...]
    upper: tuple[float, ...]

    @property
    def key(self) -> tuple[object, ...]:
        """Return what it is about; a later one with this key replaces it."""
        return self.name, self.number

    def add_to(self, grid: EventGrid) -> None:
        """Add its rows to a grid, if it is of such a sequence, and what is hit at each of its events is given."""
        events = range(1, len(grid.hits) + 1)
        struck = [
            [name for name in grid.objects if grid.model.limits(grid.involved(event, name))[1] > 0.0]
            for event in events
        ]
        own = [event for event, names in zip(events, struck, strict=True) if self.name in names]
        if len(own) != self.count or any(len(names) > 1 for names in struck):
            return
        place = grid.path(self.name)[own[self.number]]
        for here, low, high in zip(place, self.lower, self.upper, strict=True):
            grid.model.require(low - here)
            grid.model.require(here - high)


Correction: TypeAlias = Wait | Room | HitPlace


@dataclass(frozen=True)
class _Stop:
    """Hold where a robot is at an event, and its velocity before and after; and what it hits there."""

    event: int
    place: np.ndarray
    before: np.ndarray
    after: np.ndarray
    impact: PlannedImpact | None = None


def find_waits(
    scenario: FreeFlyerScenario,
    sequence: EventSequence,
    impacts: Sequence[PlannedImpact],
    reserves: Reserves,
    factor: float,
    every: bool = False,
) -> tuple[Wait, ...]:
    """Return how long the legs of robots should take that take less than so many times the least time.

    Args:
        scenario: limits, starts and goals.
        sequence: events.
        impacts: from `compute_impacts`.
        reserves: thrust and clearance.
        factor: of the least time.
        every: whether legs that are not hasty are returned, too, for more time for one leg takes it from others.

    Returns:
        One wait per hasty leg; none: there is no such leg.
    """
    waits = []
    for name, robot in scenario.robots.items():
        strength = reserves.acceleration(robot)
        for here, there in itertools.pairwise(_list_stops(scenario, sequence, impacts, name)):
            least = max(
                compute_least_time(float(d), float(v), float(w), strength, robot.speed_limit)
                for d, v, w in zip(there.place - here.place, here.after, there.before, strict=True)
            )
            least = max(least, _measure_way_round(scenario, here, there, strength, reserves))
            taken = sequence.times[there.event] - sequence.times[here.event]
            if every or taken < factor * least:
                waits.append(Wait(here.event, there.event, factor * least))
    return tuple(waits)


def find_rooms(
    scenario: FreeFlyerScenario, impacts: Sequence[PlannedImpact], reserves: Reserves, factor: float
) -> tuple[Room, ...]:
    """Return how far from the world's edges robots should hit that have less room than they need.

    Reaching a velocity v from rest, or stopping from it, takes v^2 / (2 a) of way, on the side from which the robot
    comes before its impact and on the side to which it goes afterwards.

    Args:
        scenario: limits and world.
        impacts: from `compute_impacts`.
        reserves: thrust and distance from walls.
        factor: of the least way.

    Returns:
        One per robot, impact and edge that are too near; none: all have room.
    """
    rooms = []
    lower, upper = np.array(scenario.world.lower), np.array(scenario.world.upper)
    for event, impact in enumerate(impacts, start=1):
        robot = scenario.robots[impact.robot]
        inset, strength = robot.radius + reserves.wall, reserves.acceleration(robot)
        for axis, velocity in itertools.product(range(2), (-impact.robot_minus, impact.robot_plus)):
            sign = 1.0 if velocity[axis] > 0.0 else -1.0
            edge = upper[axis] if sign > 0.0 else -lower[axis]
            bound = float(edge - inset - factor * velocity[axis] ** 2 / (2.0 * strength))
            if sign * impact.contact[axis] > bound:
                rooms.append(Room(impact.robot, event, axis, sign, bound))
    return tuple(rooms)


def compute_least_time(distance: float, start: float, end: float, strength: float, fastest: float) -> float:
    """Return the least time between two states of a point on a line.

    Args:
        distance: from start to end [m].
        start: velocity at the start [m/s].
        end: velocity at the end [m/s].
        strength: greatest acceleration [m/s^2].
        fastest: greatest speed [m/s].
    """
    direct = (end**2 - start**2) / (2.0 * strength) * (1.0 if end >= start else -1.0)
    if distance < direct:
        distance, start, end = -distance, -start, -end
    peak = math.sqrt(max(strength * distance + 0.5 * (start**2 + end**2), 0.0))
    top = max(min(peak, fastest), start, end)
    moved = (2.0 * top**2 - start**2 - end**2) / (2.0 * strength)
    cruise = max(0.0, distance - moved) / top if top > 0.0 else 0.0
    return (2.0 * top - start - end) / strength + cruise


def _list_stops(
    scenario: FreeFlyerScenario, sequence: EventSequence, impacts: Sequence[PlannedImpact], name: str
) -> Iterator[_Stop]:
    robot, rest = scenario.robots[name], np.zeros(2)
    moving = np.array(robot.start_velocity)
    yield _Stop(0, np.array(robot.start), moving, moving)
    for event, impact in enumerate(impacts, start=1):
        if impact.robot == name:
            yield _Stop(event, impact.contact, impact.robot_minus, impact.robot_plus, impact)
    if robot.goal is not None:
        yield _Stop(len(sequence.times) - 1, np.array(robot.goal), rest, rest)


def _measure_way_round(
    scenario: FreeFlyerScenario, here: _Stop, there: _Stop, strength: float, reserves: Reserves
) -> float:
    """Return the time that the arc round an object takes which a robot hits twice running, from rest to its blow."""
    one, other = here.impact, there.impact
    if one is None or other is None or one.object != other.object:
        return 0.0
    angle = float(np.arccos(np.clip(one.normal @ other.normal, -1.0, 1.0)))
    reach = scenario.robots[one.robot].radius + scenario.objects[one.object].radius + reserves.clearance
    speed = float(np.linalg.norm(there.before - other.object_minus))
    return 2.0 * math.sqrt(angle * reach / strength) + speed / strength

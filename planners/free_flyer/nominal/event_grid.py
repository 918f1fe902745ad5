"""The event grid: K ordered impacts as a mixed-integer linear model without curves and without velocities.

Every motion is a polyline with its knots at the times of the impacts, which are common to all bodies. Robots are fully
actuated, so their velocity before an impact is free and follows from Eq. (5) once the object's polyline is known: the
impact law only caps the speed on the object's legs. With several objects, an object keeps its velocity while another
one is hit; this is bilinear and left out here. The path cost, which grows with every change of velocity, nearly brings
it about, and stage B makes it exact.

Bodies that move at the start: an object is on its ray p + v t up to its first impact; a robot's polyline begins where
it would come to a halt.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field

import numpy as np

from impact_envs.free_flyer.schema import FreeFlyerScenario, Robot
from planners.errors import Infeasible
from planners.free_flyer.nominal.event_sequence import (
    ANYBODY,
    Hitter,
    Word,
    compute_impact_caps,
    compute_speed_caps,
    find_own,
)
from planners.free_flyer.reserves import Reserves
from planners.free_flyer.specification.central_hit import find_central_impulses
from planners.free_flyer.specification.direction import AXES, DIRECTIONS
from planners.free_flyer.specification.grid import refine
from planners.mixed_integer import Affine, Model
from planners.path_cost import Displacement

# The greatest component of each of the four axes against a direction, or against one within 22.5 degrees of it.
BACKWARD = np.cos(np.maximum(0.0, np.arccos(np.clip(-DIRECTIONS @ AXES.T, -1.0, 1.0)) - np.deg2rad(22.5)))
# Half-angles of the cone around its direction in which an impulse lies, as tangents. One of the eight directions is
# always within 22.5 degrees of a throw from rest or a catch; a turn needs room for the legs before and after it.
CONE_AT_REST, CONE_TURNING = np.tan(np.deg2rad([30.0, 60.0]))
Point = np.ndarray  # shape (2,), of numbers or expressions [m]


@dataclass(frozen=True)
class EventGrid:
    """Hold the model and the meaning of its variables.

    Args:
        model: rows and bounds; the objective is set by the stage that solves it.
        rho: robustness [m].
        pieces: number of equally long pieces per leg; robots may turn between them.
        times: t_0 = 0, impact times, t_{K+1} = T, and the ends of pieces between them [s].
        knots: positions of every body at these times [m].
        hits: per impact, (robot, object) to the binary "the robot hits the object", or to 0 or 1 where that is given.
        sides: per impact, one binary per direction of `DIRECTIONS`.
        objects: names of the objects.
        caps: greatest speed per axis of every object on every piece, whoever hits it [m/s].
        speeds: greatest speed per axis of every robot [m/s].
        turns: time every robot loses by starting and stopping, per piece [s].
        moving: names of the objects that move at the start.
        first_turn: share of this time that counts on the first leg.
        apart: pairs of bodies with the pieces on which rows keep them apart.
        axes: directions along which rows may keep them apart, shape (n, 2).
        free: whether pieces of a leg on which the only object rests may be of different lengths.
    """

    model: Model
    rho: Affine
    pieces: int
    times: list[Affine | float]
    knots: dict[str, list[Point]]
    hits: list[dict[Hitter, Affine | float]]
    sides: list[list[Affine]]
    objects: tuple[str, ...]
    caps: dict[str, list[float]]
    speeds: dict[str, float]
    turns: dict[str, float]
    moving: tuple[str, ...] = ()
    first_turn: float = 1.0
    apart: set[tuple[str, str, int]] = field(default_factory=set)
    axes: np.ndarray = field(default_factory=lambda: AXES)
    free: bool = False

    @property
    def count(self) -> int:
        """Return the number of pieces of all legs."""
        return len(self.times) - 1

    def path(self, name: str) -> list[Point]:
        """Return an object's positions at t_0 .. t_{K+1} [m]."""
        return self.knots[name][:: self.pieces]

    def duration(self, piece: int) -> Affine | float:
        """Return the duration of a piece [s]."""
        return self.times[piece + 1] - self.times[piece]

    def fastest(self, body: str, piece: int) -> float:
        """Return the greatest speed per axis of a body on a piece [m/s]."""
        return self.caps[body][piece] if body in self.caps else self.speeds[body]

    def displacements(self) -> Iterator[Displacement]:
        """Yield the pieces of path of all bodies; an object's pieces share one velocity, so its legs count whole."""
        for name, knots in self.knots.items():
            stride = self.pieces if name in self.objects else 1
            for start in range(0, self.count, stride):
                end = start + stride
                move, duration = knots[end] - knots[start], self.times[end] - self.times[start]
                yield Displacement(name, move, duration, self.fastest(name, start))

    def involved(self, event: int, body: str) -> Affine | float:
        """Return 1 where a robot or object takes part in an event, else 0; the only object always does."""
        if self.objects == (body,):
            return 1.0
        return sum((hit for pair, hit in self.hits[event - 1].items() if body in pair), 0.0)

    def strikes(self, events: range, name: str) -> Affine | float:
        """Return how often an object is hit in a range of events."""
        return sum((self.involved(event, name) for event in events), 0.0)


def build_event_grid(
    scenario: FreeFlyerScenario,
    impacts: int,
    rho: tuple[float, float],
    reserves: Reserves,
    pieces: int = 1,
    word: Word | None = None,
    elastic: bool = False,
    sharp: bool = False,
    loose_speeds: bool = True,
    free: bool = False,
) -> EventGrid:
    """Build the model of all motions with a given number of impacts, without any formula or distances.

    Args:
        scenario: any numbers of robots and objects.
        impacts: number K of impacts.
        rho: least and greatest robustness allowed [m].
        reserves: what the plan keeps in hand.
        pieces: number of pieces per leg.
        word: who hits what at each impact; None: anybody anything.
        elastic: whether speeds, and rows that are added in parts, may be violated; see `Model`.
        sharp: whether speeds of several objects are capped by what the word says of their first and last impacts.
        loose_speeds: whether an elastic model may exceed speeds, too.
        free: whether pieces of a leg on which the only object rests may be of different lengths.

    Returns:
        The grid; `add_demands` adds the formula, the stages their objectives, `solve_apart` the distances.

    Raises:
        Infeasible: the variable bounds alone exclude every plan.

    Source: Verhagen & Tumova, Eqs. (5), (9b)-(9e), on a grid of events.
    """
    model = Model(f"event grid of {scenario.name} with {impacts} impacts", elastic)
    objects = tuple(scenario.objects)
    free = free and len(objects) == 1 and pieces > 1
    score, times = model.variable(*rho), _add_times(model, scenario, impacts, pieces, reserves, free)
    events = times[::pieces]
    grid = EventGrid(
        model=model,
        rho=score,
        pieces=pieces,
        times=times,
        knots={name: _add_knots(model, scenario, name, events, pieces, reserves, word) for name in scenario.bodies},
        hits=[_add_hits(model, scenario, None if word is None else word[k]) for k in range(impacts)],
        sides=[[model.binary() for _ in DIRECTIONS] for _ in range(impacts)],
        objects=objects,
        caps={
            name: [
                cap for cap in compute_speed_caps(scenario, name, impacts, reserves, word, sharp) for _ in range(pieces)
            ]
            for name in objects
        },
        speeds={name: reserves.cruise(robot) for name, robot in scenario.robots.items()},
        turns={name: reserves.turning(robot) / pieces for name, robot in scenario.robots.items()},
        moving=tuple(name for name, body in scenario.objects.items() if any(body.start_velocity)),
        first_turn=reserves.underway if scenario.starts_moving else 1.0,
        free=free,
    )
    for event in range(1, impacts + 1):
        _add_impact_rows(grid, scenario, event, reserves.run_up)
        for name in objects:
            _add_cone_rows(grid, event, name, reserves.push)
            _add_central_rows(grid, event, name, find_central_impulses(scenario.objects[name]))
    _add_gap_rows(grid, scenario, reserves)
    _require_hits(grid, scenario)
    if len(objects) > 1:
        _add_rest_rows(grid, scenario)
    _add_speed_rows(grid, loose_speeds)
    for name in objects:
        own = find_own(word, name) if sharp and word is not None else None
        _add_hitter_rows(grid, name, compute_impact_caps(scenario, name, impacts, reserves, own))
    return grid


def _add_times(
    model: Model, scenario: FreeFlyerScenario, impacts: int, pieces: int, reserves: Reserves, free: bool
) -> list[Affine | float]:
    """Return the times of all knots; free within legs on which the only object rests: elsewhere that is bilinear."""
    first, gap, last = reserves.times(scenario.horizon)
    if scenario.starts_moving:
        first = min(first, gap)
    latest = max(scenario.horizon - last, first)
    events = [model.variable(first, latest, rigid=True) for _ in range(impacts)]
    times = refine([0.0, *events, scenario.horizon], pieces)
    if not free:
        return times
    (body,) = scenario.objects.values()
    legs = [0] * (not any(body.start_velocity)) + [impacts] * (body.rest and impacts > 0)
    for k in (leg * pieces + piece for leg in legs for piece in range(1, pieces)):
        times[k] = model.variable(0.0, scenario.horizon, rigid=True)
    for leg in legs:
        for before, after in itertools.pairwise(times[leg * pieces : (leg + 1) * pieces + 1]):
            model.require(before - after)
    return times


def _add_hits(model: Model, scenario: FreeFlyerScenario, given: Hitter | None) -> dict[Hitter, Affine | float]:
    pairs = itertools.product(scenario.robots, scenario.objects)
    if given is not None and given[0] == ANYBODY:
        return {pair: model.binary() if pair[1] == given[1] else 0.0 for pair in pairs}
    return {pair: model.binary() if given is None else float(pair == given) for pair in pairs}


def _add_knots(
    model: Model,
    scenario: FreeFlyerScenario,
    name: str,
    events: Sequence[Affine | float],
    pieces: int,
    reserves: Reserves,
    word: Word | None,
) -> list[Point]:
    body, impacts = scenario.body(name), len(events) - 2
    inset = body.radius + reserves.wall
    lower, upper = np.array(scenario.world.lower) + inset, np.array(scenario.world.upper) - inset
    start = np.array(body.start)
    if isinstance(body, Robot):
        between = [model.vector(lower, upper) for _ in range((impacts + 1) * pieces - 1)]
        halt = find_halt(body, reserves)
        return [halt, *between, model.vector(lower, upper) if body.goal is None else np.array(body.goal)]
    # A body may start nearer to the world's edge than the reserve.
    lower, upper = np.minimum(lower, start), np.maximum(upper, start)
    struck = [True] * impacts if word is None else [hit[1] == name for hit in word]
    # An object that moves slowly may be left alone; it then flies on.
    slow = word is None and len(scenario.objects) > 1 and any(body.start_velocity) and not body.must_stop
    knots = [start]
    for k in range(impacts + 1):
        if not any(struck[:k]):
            knots.append(_find_free(scenario, name, events[k + 1]))
            for place, low, high in zip(knots[-1], lower - reserves.wall, upper + reserves.wall, strict=True):
                model.require(low - place)
                model.require(place - high)
        elif any(struck[k:]) or not body.rest or slow:
            knots.append(model.vector(lower, upper))
        else:
            knots.append(knots[-1])
    return refine(knots, pieces)


def find_halt(robot: Robot, reserves: Reserves) -> Point:
    """Return where a robot that brakes from the start comes to a halt, p + v |v| / (2 a) per axis [m]."""
    start, velocity = np.array(robot.start), np.array(robot.start_velocity)
    return start + velocity * np.abs(velocity) / (2.0 * reserves.braking * reserves.acceleration(robot))


def _find_free(scenario: FreeFlyerScenario, name: str, time: Affine | float) -> Point:
    """Return where an object is at a time before its first impact."""
    body = scenario.objects[name]
    if not any(body.start_velocity):
        return np.array(body.start)
    return np.array([time * v + p for p, v in zip(body.start, body.start_velocity, strict=True)])


def _add_impact_rows(grid: EventGrid, scenario: FreeFlyerScenario, event: int, run_up: float) -> None:
    """Say who hits what and from which side; for every direction of that side the robot is then inside the world."""
    model, hits, sides = grid.model, grid.hits[event - 1], grid.sides[event - 1]
    edges = [scenario.world.upper[0], -scenario.world.lower[0], scenario.world.upper[1], -scenario.world.lower[1]]
    someone = sum(hits.values(), 0.0)
    if isinstance(someone, Affine):
        model.require_equal(someone - 1.0)
    model.require_equal(sum(sides, Affine({})) - 1.0)
    toward, backward = (np.array(sides, dtype=object) @ directions for directions in (DIRECTIONS, BACKWARD))
    for (robot, name), hit in hits.items():
        reach, off = scenario.robots[robot].radius + scenario.objects[name].radius, 1.0 - hit
        miss = grid.knots[robot][event * grid.pieces] + toward * reach - grid.path(name)[event]
        for entry in miss:
            model.require(entry, unless=off)
            model.require(-entry, unless=off)
        farthest = AXES @ grid.path(name)[event] + backward * reach
        for place, edge in zip(farthest, edges, strict=True):
            model.require(place + scenario.robots[robot].radius + run_up - edge, unless=off)


def _add_cone_rows(grid: EventGrid, event: int, name: str, push: float) -> None:
    """Constrain the impulse on an object to a cone around its direction, and away from zero.

    The impulse is along D_k / T_k - D_{k-1} / T_{k-1}. Quotients are not linear, but a cone that contains D_k and
    -D_{k-1} contains their sum with any positive weights. If one of them is zero, a narrower cone is enough.
    """
    path, count = grid.path(name), len(grid.hits)
    missed = 1.0 - grid.involved(event, name)
    # 0 where the object rests before the event, whoever hits it there.
    before = 1.0 if name in grid.moving else grid.strikes(range(1, event), name)
    pushes = [
        (path[event + 1] - path[event], before),
        (path[event - 1] - path[event], grid.strikes(range(event + 1, count + 1), name)),
    ]
    moving = [one for one in pushes if any(grid.model.limits(entry) != (0.0, 0.0) for entry in one[0])]
    for side, direction in zip(grid.sides[event - 1], DIRECTIONS, strict=True):
        across, off = np.array([-direction[1], direction[0]]), 1.0 - side + missed
        grid.model.require(push - direction @ (pushes[0][0] + pushes[1][0]), unless=off)
        for (step, others), sign in itertools.product(moving, (1.0, -1.0)):
            widest = CONE_TURNING if len(moving) > 1 else CONE_AT_REST
            grid.model.require((sign * across - widest * direction) @ step, unless=off)
            if len(moving) > 1 and isinstance(others, Affine):
                grid.model.require((sign * across - CONE_AT_REST * direction) @ step, unless=off + others)


def _add_central_rows(grid: EventGrid, event: int, name: str, impulses: np.ndarray) -> None:
    """Let an object that is no disc be hit through its centre alone, so that it does not turn.

    As in the cones, both legs are along the impulse: a throw, a catch or a return.
    """
    if not len(impulses):
        return
    model, path = grid.model, grid.path(name)
    chosen = [model.binary() for _ in impulses]
    model.require_equal(sum(chosen, Affine({})) - grid.involved(event, name))
    steps = path[event + 1] - path[event], path[event - 1] - path[event]
    for choice, (x, y) in zip(chosen, impulses, strict=True):
        for step in steps:
            model.require(-(x * step[0] + y * step[1]), unless=1.0 - choice)
            for sign in (1.0, -1.0):
                model.require((x * step[1] - y * step[0]) * sign, unless=1.0 - choice)


def _add_gap_rows(grid: EventGrid, scenario: FreeFlyerScenario, reserves: Reserves) -> None:
    """Order the events, and leave every robot and object time between two impacts of its own."""
    gap, events = reserves.times(scenario.horizon)[1], grid.times[:: grid.pieces]
    for first, second in itertools.combinations(range(1, len(grid.hits) + 1), 2):
        wait = events[second] - events[first]
        if len(grid.objects) == 1:
            if second == first + 1:
                grid.model.require(gap - wait)
            continue
        if second == first + 1:
            grid.model.require(scenario.control_period - wait)
        for body in scenario.bodies:
            again = grid.involved(first, body) + grid.involved(second, body)
            grid.model.require(gap - wait, unless=2.0 - again)


def _require_hits(grid: EventGrid, scenario: FreeFlyerScenario) -> None:
    """Require at least one hit of every object that has to come to rest."""
    for name, body in scenario.objects.items():
        if not body.must_stop:
            continue
        hits = grid.strikes(range(1, len(grid.hits) + 1), name)
        if not isinstance(hits, Affine) and hits < 1.0:
            raise Infeasible(grid.model.name, f"{name} moves and is not hit", "allow more impacts")
        grid.model.require(1.0 - hits)


def _add_rest_rows(grid: EventGrid, scenario: FreeFlyerScenario) -> None:
    """Keep objects on their free motion before their first impact, and at rest after the last one where they must rest.

    An object that is never hit keeps its free motion: it rests or, where that is allowed, moves slowly.
    """
    count, events = len(grid.hits), grid.times[:: grid.pieces]
    for name, body in scenario.objects.items():
        path, moves = grid.path(name), name in grid.moving
        never: Affine | float = 0.0
        if moves and not body.must_stop:
            never = grid.model.binary()
            grid.model.require(grid.strikes(range(1, count + 1), name) + (never - 1.0) * count)
        for leg in range(1, count + 1):
            before = grid.strikes(range(1, leg + 1), name)
            after = grid.strikes(range(leg + 1, count + 1), name) + never
            steps = path[leg + 1] - path[leg]
            free = path[leg + 1] - _find_free(scenario, name, events[leg + 1]) if moves else steps
            for d, sign in itertools.product(range(2), (1.0, -1.0)):
                grid.model.require(free[d] * sign, unless=before)
                if body.rest:
                    grid.model.require(steps[d] * sign, unless=after)


def _add_speed_rows(grid: EventGrid, loose: bool) -> None:
    """Bound every piece by the way at the greatest speed, in its duration less the time for starting and stopping.

    |D| <= v (T - v / a) is what a leg from rest to rest needs at acceleration a and speed v at most.
    """
    for name, knots in grid.knots.items():
        with grid.model.part(f"speed of {name}", 1e3) if loose else nullcontext():
            for piece in range(grid.count):
                share = grid.first_turn if piece < grid.pieces else 1.0
                cruise = grid.duration(piece) - share * grid.turns.get(name, 0.0)
                farthest = grid.fastest(name, piece) * cruise
                for step in knots[piece + 1] - knots[piece]:
                    grid.model.require(step - farthest)
                    grid.model.require(-step - farthest)


def _add_hitter_rows(grid: EventGrid, name: str, each: Mapping[str, Sequence[float]]) -> None:
    """Bound an object's speed before and after an impact by what the robot that hits can do, if others can do more.

    Args:
        grid: gets the rows.
        name: of the object.
        each: robot to the greatest speed at each impact [m/s], from `compute_impact_caps`.
    """
    path, events = grid.path(name), grid.times[:: grid.pieces]
    # One of several objects may be left as fast as it starts.
    least = grid.caps[name][0] if len(grid.objects) > 1 else 0.0
    for (robot, caps), leg in itertools.product(each.items(), range(1, len(events) - 1)):
        for k in (leg, leg + 1)[: len(caps) - leg + 1]:
            cap = max(caps[k - 1], least)
            if cap >= grid.caps[name][leg * grid.pieces]:
                continue
            missed = 1.0 - grid.hits[k - 1][robot, name]
            for step, sign in itertools.product(path[leg + 1] - path[leg], (1.0, -1.0)):
                grid.model.require(step * sign - (events[leg + 1] - events[leg]) * cap, unless=missed)

"""The event grid: K ordered impacts as a mixed-integer linear model without curves and without velocities.

Every motion is a polyline whose knots are the impacts' times, common to all bodies. Robots are fully actuated,
so their velocity before an impact is free and follows from Eq. (5) once the object's polyline is known: the
impact law imposes nothing but a speed cap on the object's legs.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from impact_envs.free_flyer.schema import FreeFlyerScenario, Robot
from planners.free_flyer.events import compute_speed_caps
from planners.free_flyer.reserves import Reserves
from planners.mixed_integer import Affine, Model

AXES = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
# Directions an impulse is rounded to; the robot stands on the opposite side of the object.
DIRECTIONS = np.concatenate([AXES, np.sqrt(0.5) * np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]])])
# Half-angles of the cone round its direction that an impulse may fill: a throw from rest or a catch always
# has a direction within 22.5 degrees; a turn needs room for the legs before and after.
CONE_AT_REST, CONE_TURNING = np.tan(np.deg2rad([30.0, 60.0]))
COARSE = 1e-3  # diagonal contacts count as clear of both their axes in spite of rounding [m]
LEAST_PUSH = 0.1  # of the object's displacements after and before an impact along its direction [m]
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
        hits: per impact, robot name to the binary that it hits.
        sides: per impact, one binary per direction of `DIRECTIONS`.
        object: name of the object.
        caps: greatest speed per axis of the object on every piece [m/s].
        speeds: greatest speed per axis of every robot [m/s].
        turns: time every robot loses to starting and stopping, per piece [s].
    """

    model: Model
    rho: Affine
    pieces: int
    times: list[Affine | float]
    knots: dict[str, list[Point]]
    hits: list[dict[str, Affine]]
    sides: list[list[Affine]]
    object: str
    caps: list[float]
    speeds: dict[str, float]
    turns: dict[str, float]

    @property
    def count(self) -> int:
        """Return the number of pieces of all legs."""
        return len(self.times) - 1

    @property
    def path(self) -> list[Point]:
        """Return the object's positions at t_0 .. t_{K+1} [m]."""
        return self.knots[self.object][:: self.pieces]

    def duration(self, piece: int) -> Affine | float:
        """Return the duration of a piece [s]."""
        return self.times[piece + 1] - self.times[piece]

    def hits_at(self, knot: int) -> dict[str, Affine]:
        """Return who may hit at a knot; nobody between events."""
        event, rest = divmod(knot, self.pieces)
        return self.hits[event - 1] if rest == 0 and 1 <= event <= len(self.hits) else {}


def build_event_grid(
    scenario: FreeFlyerScenario, impacts: int, rho: tuple[float, float], reserves: Reserves, pieces: int = 1
) -> EventGrid:
    """Build the model of all motions with a given number of impacts, without any formula.

    Args:
        scenario: one object, any number of robots.
        impacts: number K of impacts.
        rho: least and greatest robustness allowed [m].
        reserves: what the plan keeps in hand.
        pieces: number of pieces per leg.

    Returns:
        The grid; `add_requirements` adds the formula, the stages their objectives.

    Raises:
        Infeasible: the variable bounds alone exclude every plan.

    Source: Verhagen & Tumova, Eqs. (5), (9b)-(9e), on a grid of events.
    """
    model = Model(f"event grid of {scenario.name} with {impacts} impacts")
    grid = EventGrid(
        model=model,
        rho=model.variable(*rho),
        pieces=pieces,
        times=_add_times(model, scenario, impacts, pieces, reserves),
        knots={name: _add_knots(model, scenario, name, impacts, pieces, reserves) for name in scenario.bodies},
        hits=[{robot: model.binary() for robot in scenario.robots} for _ in range(impacts)],
        sides=[[model.binary() for _ in DIRECTIONS] for _ in range(impacts)],
        object=next(iter(scenario.objects)),
        caps=[cap for cap in compute_speed_caps(scenario, impacts, reserves) for _ in range(pieces)],
        speeds={name: reserves.cruise(robot) for name, robot in scenario.robots.items()},
        turns={name: reserves.turning(robot) / pieces for name, robot in scenario.robots.items()},
    )
    _add_impact_rows(grid, scenario)
    _add_speed_rows(grid)
    _add_clearance_rows(grid, scenario, reserves)
    return grid


def _add_times(
    model: Model, scenario: FreeFlyerScenario, impacts: int, pieces: int, reserves: Reserves
) -> list[Affine | float]:
    first, gap, last = reserves.times(scenario.horizon)
    latest = max(scenario.horizon - last, first)
    events = [model.variable(first, latest) for _ in range(impacts)]
    for earlier, later in itertools.pairwise(events):
        model.require(gap - (later - earlier))
    return _refine([0.0, *events, scenario.horizon], pieces)


def _add_knots(
    model: Model, scenario: FreeFlyerScenario, name: str, impacts: int, pieces: int, reserves: Reserves
) -> list[Point]:
    body = scenario.body(name)
    inset = body.radius + reserves.wall
    lower, upper = np.array(scenario.world.lower) + inset, np.array(scenario.world.upper) - inset
    start = np.array(body.start)
    if isinstance(body, Robot):
        between = [model.vector(lower, upper) for _ in range((impacts + 1) * pieces - 1)]
        return [start, *between, model.vector(lower, upper) if body.goal is None else np.array(body.goal)]
    if impacts == 0:
        return _refine([start, start], pieces)
    knots = [start, start, *(model.vector(lower, upper) for _ in range(impacts - 1))]
    return _refine([*knots, knots[-1] if body.rest else model.vector(lower, upper)], pieces)


def _refine(values: Sequence[Any], pieces: int) -> list[Any]:
    """Return the values with linear interpolations between them."""
    fine = [values[0]]
    for a, b in itertools.pairwise(values):
        fine += [a + (b - a) * (i / pieces) for i in range(1, pieces)]
        fine.append(b)
    return fine


def _add_impact_rows(grid: EventGrid, scenario: FreeFlyerScenario) -> None:
    """Say who hits, from which side, where it stands, and that the impulse points away from it."""
    model, radius = grid.model, scenario.objects[grid.object].radius
    for k, (hits, sides) in enumerate(zip(grid.hits, grid.sides, strict=True), start=1):
        model.require_equal(sum(hits.values(), Affine({})) - 1.0)
        model.require_equal(sum(sides, Affine({})) - 1.0)
        toward = np.array(sides, dtype=object) @ DIRECTIONS
        for robot, hit in hits.items():
            reach = scenario.robots[robot].radius + radius
            miss = grid.knots[robot][k * grid.pieces] + toward * reach - grid.path[k]
            for entry in miss:
                model.require(entry, unless=1.0 - hit)
                model.require(-entry, unless=1.0 - hit)
        _add_cone_rows(grid, k)


def _add_cone_rows(grid: EventGrid, k: int) -> None:
    """Keep the impulse of event k near its direction, and not nil.

    The impulse is along D_k / T_k - D_{k-1} / T_{k-1}. Quotients are beyond linear rows, but a cone that holds
    D_k and -D_{k-1} holds their sum with any positive weights.
    """
    path = grid.path
    pushes = [path[k + 1] - path[k], path[k - 1] - path[k]]
    moving = [push for push in pushes if any(grid.model.limits(entry) != (0.0, 0.0) for entry in push)]
    widest = CONE_TURNING if len(moving) > 1 else CONE_AT_REST
    for side, direction in zip(grid.sides[k - 1], DIRECTIONS, strict=True):
        across = np.array([-direction[1], direction[0]])
        grid.model.require(LEAST_PUSH - direction @ (pushes[0] + pushes[1]), unless=1.0 - side)
        for push, sign in itertools.product(moving, (1.0, -1.0)):
            grid.model.require((sign * across - widest * direction) @ push, unless=1.0 - side)


def _add_speed_rows(grid: EventGrid) -> None:
    """Bound every piece by a cruise at the greatest speed, less the time that starting and stopping costs.

    |D| <= v (T - v / a) is what a leg from rest to rest needs at acceleration a and speed v at most.
    """
    for piece in range(grid.count):
        for name, knots in grid.knots.items():
            speed = grid.caps[piece] if name == grid.object else grid.speeds[name]
            cruise = grid.duration(piece) - grid.turns.get(name, 0.0)
            for step in knots[piece + 1] - knots[piece]:
                grid.model.require(step - speed * cruise)
                grid.model.require(-step - speed * cruise)


def _add_clearance_rows(grid: EventGrid, scenario: FreeFlyerScenario, reserves: Reserves) -> None:
    """Keep every robot on one side of the object and of every other robot during each piece.

    Two bodies on one piece move linearly against each other, so their separation along an axis at both ends is
    their separation in between. A robot that hits stands at contact distance at that end, where its side of the
    impact is the only one possible: it neither overtakes the object nor changes sides between two own impacts.
    """
    for first, second in itertools.combinations(scenario.bodies, 2):
        touching = scenario.body(first).radius + scenario.body(second).radius
        for piece in range(grid.count):
            alternatives = []
            for axis in AXES:
                rows = []
                for knot in (piece, piece + 1):
                    apart = axis @ (grid.knots[second][knot] - grid.knots[first][knot])
                    rows.append(_wanted(grid, (first, second), knot, apart, touching, reserves) - apart)
                alternatives.append(rows)
            grid.model.require_any(alternatives)


def _wanted(
    grid: EventGrid,
    pair: tuple[str, str],
    knot: int,
    apart: Affine | float,
    touching: float,
    reserves: Reserves,
) -> Affine | float:
    """Return the separation wanted along one axis: contact at own impacts, what is given at fixed ends."""
    first, second = pair
    # A diagonal contact counts as clear of both its axes.
    nearest, far = touching * np.sqrt(0.5) - COARSE, touching + reserves.clearance
    if not isinstance(apart, Affine):
        return min(max(float(apart), nearest), far)
    if knot == grid.count:
        return touching + reserves.wall
    hits = grid.hits_at(knot)
    return far - (far - nearest) * hits[first] if second == grid.object and hits else far

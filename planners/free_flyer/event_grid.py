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
from planners.free_flyer.requirement import Requirement
from planners.mixed_integer import Affine, Model

AXES = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
# Directions an impulse is rounded to; the robot stands on the opposite side of the object.
DIRECTIONS = np.concatenate([AXES, np.sqrt(0.5) * np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]])])
# Half-angles of the cone round its direction that an impulse may fill: a throw from rest or a catch always
# has a direction within 22.5 degrees; a turn needs room for the legs before and after.
CONE_AT_REST, CONE_TURNING = np.tan(np.deg2rad([30.0, 60.0]))
COARSE = 1e-3  # diagonal contacts count as clear of both their axes in spite of rounding [m]
LEAST_PUSH = 0.1  # of the object's displacements after and before an impact along its direction [m]
FRACTIONS = (0.25, 0.5, 0.75)  # where on a leg passing through an area is looked for
Point = np.ndarray | Sequence[Affine | float]


@dataclass(frozen=True)
class Reserves:
    """Hold what a plan keeps in hand for its execution.

    Times count in full from about 30 s of horizon on; below, they are shares of the horizon.

    Args:
        speed: share of the speed limits that legs between impacts may use.
        thrust: share of force_limit / mass that motions may use.
        turn: time to reach the speed of a leg from rest, or to stop from it, at this thrust [s].
        first: least time before the first impact [s].
        gap: least time between impacts [s].
        last: least time after the last impact [s].
        clearance: distance kept between bodies beyond touching [m].
        wall: distance kept from walls and solid obstacles beyond touching [m].
        avoid: distance kept from areas to avoid beyond the robustness, where the optimum allows it [m].

    Source: measured in closed loop with restitution, mass, sensing, drift and actuation perturbed.
    """

    speed: float = 0.7
    thrust: float = 0.6
    turn: float = 4.0
    first: float = 8.0
    gap: float = 5.0
    last: float = 15.0
    clearance: float = 0.2
    wall: float = 0.05
    avoid: float = 0.15

    def times(self, horizon: float) -> tuple[float, float, float]:
        """Return (first, gap, last) for a horizon [s]."""
        last = min(self.last, max(0.4 * self.last, 0.15 * horizon), 0.2 * horizon)
        return min(self.first, 0.27 * horizon), min(self.gap, 0.17 * horizon), last

    def acceleration(self, robot: Robot) -> float:
        """Return the greatest planned acceleration of a robot per axis [m/s^2]."""
        return self.thrust * robot.force_limit / robot.mass

    def cruise(self, robot: Robot) -> float:
        """Return the greatest planned speed of a robot between impacts per axis [m/s]."""
        return min(self.speed * robot.speed_limit, self.turn * self.acceleration(robot))

    def turning(self, robot: Robot) -> float:
        """Return the time a robot loses to starting and stopping on a leg [s]."""
        return self.cruise(robot) / self.acceleration(robot)


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
    scenario: FreeFlyerScenario,
    requirements: Sequence[Requirement],
    impacts: int,
    rho: tuple[float, float],
    reserves: Reserves,
    pieces: int = 1,
    passing: bool = True,
) -> EventGrid:
    """Build the model of all plans with a given number of impacts.

    Args:
        scenario: one object, any number of robots.
        requirements: what the formula demands, see `read_requirements`.
        impacts: number K of impacts.
        rho: least and greatest robustness allowed [m].
        reserves: what the plan keeps in hand.
        pieces: number of pieces per leg.
        passing: whether an area may be reached in passing, between events.

    Returns:
        The grid; its model has no objective yet.

    Raises:
        Infeasible: the variable bounds alone exclude every plan.

    Source: event-grid formulation of Eqs. (5), (9), (15), (21), (22).
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
    for requirement in requirements:
        if requirement.kind == "reach":
            _add_reach_rows(grid, requirement, passing)
        elif requirement.kind == "stay":
            _add_stay_rows(grid, requirement, scenario.control_period)
        else:
            _add_avoid_rows(grid, requirement, scenario.control_period)
    return grid


def compute_speed_caps(scenario: FreeFlyerScenario, impacts: int, reserves: Reserves) -> list[float]:
    r"""Return the greatest speed per axis of every leg of the object.

    A leg between impacts with |v^-|, |v^+| <= c per axis needs robot velocities v_R^- = (v^+ - m4 v^-) / m3
    and v_R^+ = m1 v_R^- + m2 v^-, which keep |v_R| <= v_max if
    c <= v_max / max((1 + |m4|) / m3, |m1| / m3 + |m2 - m1 m4 / m3|).
    The object is at rest before the first impact, and after the last one if it has to be.

    Args:
        scenario: masses, restitution and speed limits.
        impacts: number K of impacts.
        reserves: what the plan keeps in hand.

    Returns:
        K + 1 speeds [m/s]; zero where the object rests.

    Source: Verhagen & Tumova, Eq. (5), solved for the robot's velocities.
    """
    body = next(iter(scenario.objects.values()))
    free, first, last = [], [], []
    for robot in scenario.robots.values():
        m1, m2, m3, m4 = compute_mass_fractions(robot.mass, body.mass, scenario.believed.restitution)
        limit, through = reserves.cruise(robot), abs(m2 - m1 * m4 / m3)
        free.append(limit / max((1 + abs(m4)) / m3, abs(m1) / m3 + through))
        first.append(limit / max(1 / m3, abs(m1) / m3))
        last.append(limit / max(abs(m4) / m3, through, 1e-9))
    at_impact = [min(free)] * impacts
    if impacts:
        at_impact[0] = min(first)
    if impacts > 1 and body.rest:
        at_impact[-1] = min(last)
    moving = [min(body.speed_limit, *at_impact[k : k + 2]) for k in range(impacts)]
    return [0.0, *moving[:-1], 0.0 if body.rest else moving[-1]] if impacts else [0.0]


def compute_mass_fractions(
    robot_mass: float, object_mass: float, restitution: float
) -> tuple[float, float, float, float]:
    """Return m1..m4 with v_R^+ = m1 v_R^- + m2 v_O^- and v_O^+ = m3 v_R^- + m4 v_O^-.

    Args:
        robot_mass: m_R [kg].
        object_mass: m_O [kg].
        restitution: coefficient of restitution e.

    Returns:
        The four mass fractions.

    Source: Verhagen & Tumova, Eq. (5).
    """
    total = robot_mass + object_mass
    return (
        (robot_mass - restitution * object_mass) / total,
        (1 + restitution) * object_mass / total,
        (1 + restitution) * robot_mass / total,
        (object_mass - restitution * robot_mass) / total,
    )


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
        model.require_equal(np.sum(list(hits.values())) - 1.0)
        model.require_equal(np.sum(sides) - 1.0)
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


def _outside_window(grid: EventGrid, need: Requirement, piece: int, period: float) -> list[list[Affine | float]]:
    """Return the alternatives 'piece ends before the window' and 'piece starts after it'."""
    if need.start <= 0.0 and need.end >= grid.times[-1]:  # type: ignore[operator]
        return []
    return [[grid.times[piece + 1] + period - need.start], [need.end + period - grid.times[piece]]]


def _inside(grid: EventGrid, need: Requirement, point: Point) -> list[Affine | float]:
    return [face @ point + grid.rho - bound for face, bound in zip(need.faces, need.bounds, strict=True)]


def _add_stay_rows(grid: EventGrid, need: Requirement, period: float) -> None:
    knots = grid.knots[need.body]
    for piece in range(grid.count):
        inside = [*_inside(grid, need, knots[piece]), *_inside(grid, need, knots[piece + 1])]
        if need.start == need.end == grid.times[-1]:
            inside = _inside(grid, need, knots[-1])
        grid.model.require_any([inside, *_outside_window(grid, need, piece, period)])


def _add_avoid_rows(grid: EventGrid, need: Requirement, period: float) -> None:
    knots = grid.knots[need.body]
    for piece in range(grid.count):
        alternatives = _outside_window(grid, need, piece, period)
        for face, bound in zip(need.faces, need.bounds, strict=True):
            rows: list[Affine | float] = []
            for point in (knots[piece], knots[piece + 1]):
                beyond = face @ point - bound
                fixed = not isinstance(beyond, Affine)
                rows.append(need.clearance - beyond)
                if need.scored:
                    rows.append(grid.rho + (0.0 if fixed else need.reserve) - beyond)
            alternatives.append(rows)
        grid.model.require_any(alternatives)


def _add_reach_rows(grid: EventGrid, need: Requirement, passing: bool) -> None:
    """Look for the object at events, on a piece that overlaps the window, or at fixed fractions of pieces."""
    knots, times = grid.knots[need.body], grid.times
    moments = [(times[k], knots[k]) for k in range(0, grid.count + 1, 1 if passing else grid.pieces)]
    alternatives = []
    for piece in range(grid.count):
        inside = [*_inside(grid, need, knots[piece]), *_inside(grid, need, knots[piece + 1])]
        alternatives.append([times[piece] - need.end, need.start - times[piece + 1], *inside])
        for fraction in FRACTIONS if passing and grid.caps[piece] > 0.0 else ():
            moments.append(
                (
                    times[piece] + grid.duration(piece) * fraction,
                    knots[piece] + (knots[piece + 1] - knots[piece]) * fraction,
                )
            )
    for time, point in moments:
        alternatives.append([need.start - time, time - need.end, *_inside(grid, need, point)])
    grid.model.require_any(alternatives)

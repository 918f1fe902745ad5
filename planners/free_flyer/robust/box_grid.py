"""The box grid: boxes that contain the object at its impacts, whatever the deviation of its velocity after each.

Between impacts the object flies straight, so a box of positions and the deviation delta of the velocity after an
impact decide where it is at the next one. For a given delta, Eqs. (17)-(19) are linear in positions, displacements
and durations: times of impact stay continuous. The axes decouple, so the lower and the upper end of every interval
replace the vertices.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.physics.impact import compute_mass_fractions
from planners.errors import Infeasible
from planners.free_flyer.reserves import Reserves
from planners.free_flyer.robust.conditions import Conditions
from planners.free_flyer.specification.direction import AXES
from planners.free_flyer.specification.grid import refine
from planners.mixed_integer import Affine, Model
from planners.path_cost import Displacement

HALF_ANGLE = np.deg2rad(70.0)  # of the cone of impulses around the direction from the robot's side to the object
Point = np.ndarray  # shape (2,), of numbers or expressions [m]


@dataclass(frozen=True)
class PositionBox:
    """Hold an axis-aligned box of positions.

    Args:
        lower: shape (2,), of numbers or expressions [m].
        upper: shape (2,), of numbers or expressions [m].
    """

    lower: Point
    upper: Point

    @property
    def center(self) -> Point:
        """Return the centre of the box [m]."""
        return (self.lower + self.upper) * 0.5

    def support(self, normal: np.ndarray) -> Affine | float:
        """Return the greatest normal @ p over the box."""
        ends = [(self.upper if n > 0 else self.lower)[d] * n for d, n in enumerate(normal) if n != 0.0]
        return sum(ends[1:], ends[0])


@dataclass(frozen=True)
class ObjectLegs:
    """Hold the legs of the object between its impacts, shape (K+1,) each.

    Args:
        durations: numbers or expressions [s].
        caps: greatest speed per axis [m/s].
    """

    durations: Sequence[Affine | float]
    caps: Sequence[float]


@dataclass(frozen=True)
class BoxGrid:
    """Hold the model and the meaning of its variables.

    Args:
        model: rows and bounds.
        rho: robustness [m].
        pieces: number of equally long pieces per leg; robots may turn between them.
        legs: durations of legs 0 .. K [s].
        times: t_0 = 0, impact times, t_{K+1} = T, and the ends of pieces between them [s].
        knots: boxes that hold every body at these times.
        stands: robot to the boxes that its path is measured by: contact straight ahead, on its side of the object.
        moves: displacement on leg k = 1 .. K from the lower and the upper end of the object's box, per axis, shape
            (2, 2) [m].
        hits: per impact, robot name to the binary that it hits.
        sides: robot to one binary per axis of `AXES`, "the object is beyond the robot along this axis"; empty for
            points.
        object: name of the object.
        caps: greatest speed per axis of the object on every leg [m/s].
        speeds: greatest speed per axis of every robot [m/s].
        turns: time every robot loses by starting and stopping, per piece [s].
        delta: permissible deviation [m/s].
        velocities: boxes of the object's velocity on every leg, where the grid has them.
    """

    model: Model
    rho: Affine
    pieces: int
    legs: Sequence[Affine | float]
    times: list[Affine | float]
    knots: dict[str, list[PositionBox]]
    stands: dict[str, list[PositionBox]]
    moves: list[np.ndarray]
    hits: list[dict[str, Affine]]
    object: str
    caps: Sequence[float]
    speeds: dict[str, float]
    turns: dict[str, float]
    delta: Affine | float
    sides: dict[str, list[Affine]] = field(default_factory=dict)
    velocities: list[PositionBox] = field(default_factory=list)

    @property
    def count(self) -> int:
        """Return the number of pieces of all legs."""
        return len(self.times) - 1

    def displacements(self) -> Iterator[Displacement]:
        """Yield the pieces of path of the centres of boxes; the object's pieces share one velocity and count as one."""
        for name, boxes in {**self.stands, self.object: self.knots[self.object]}.items():
            stride = self.pieces if name == self.object else 1
            for start in range(0, self.count, stride):
                move = boxes[start + stride].center - boxes[start].center
                fastest = self.caps[start // self.pieces] if name == self.object else self.speeds[name]
                yield Displacement(name, move, self.duration(start) * float(stride), fastest)

    @property
    def boxes(self) -> list[PositionBox]:
        """Return the object's boxes at t_0 .. t_{K+1}."""
        return self.knots[self.object][:: self.pieces]

    def duration(self, piece: int) -> Affine | float:
        """Return the duration of a piece [s]."""
        return self.legs[piece // self.pieces] * (1.0 / self.pieces)

    def hits_at(self, knot: int) -> Mapping[str, Affine]:
        """Return who may hit at a knot; nobody between events."""
        event, rest = divmod(knot, self.pieces)
        return self.hits[event - 1] if rest == 0 and 1 <= event <= len(self.hits) else {}


def build_box_grid(
    scenario: FreeFlyerScenario,
    impacts: int,
    delta: float,
    conditions: Conditions,
    reserves: Reserves,
    pieces: int = 1,
) -> BoxGrid:
    r"""Build the model of all motions that bear a deviation delta after each of K impacts, without formula or sides.

    For both ends p_s of the object's interval at impact k and both axes, with T_k = t_{k+1} - t_k,
    p_s + D_s + delta T_k <= upper_{k+1}, p_s + D_s - delta T_k >= lower_{k+1}, |D_s| <= (cap_k - delta) T_k:
    the velocity wanted after the impact is an affine function of the position there. Boxes may be larger than
    what is reached, which is sound; a plan for delta is one for every smaller deviation.

    Args:
        scenario: one object, any number of robots.
        impacts: number K >= 1 of impacts.
        delta: permissible deviation of the object's velocity after an impact, per axis [m/s].
        conditions: what it refers to.
        reserves: what the plan keeps in hand.
        pieces: number of pieces per leg.

    Returns:
        The grid.

    Raises:
        Infeasible: the impacts do not fit into the horizon, or the variable bounds alone exclude every plan.

    Source: Verhagen & Tumova, Eqs. (16)-(20), with continuous times.
    """
    model = Model(f"box grid of {scenario.name} with {impacts} impacts")
    durations = _add_durations(model, scenario, impacts, conditions, reserves)
    caps = compute_leg_caps(scenario, impacts, conditions, reserves)
    grid = make_grid(model, scenario, ObjectLegs(durations, caps), delta, conditions, reserves, pieces)
    for k, hits in enumerate(grid.hits, start=1):
        model.require_equal(sum(hits.values(), Affine({})) - 1.0)
        _add_flight_rows(grid, k)
    return grid


def make_grid(
    model: Model,
    scenario: FreeFlyerScenario,
    legs: ObjectLegs,
    delta: Affine | float,
    conditions: Conditions,
    reserves: Reserves,
    pieces: int = 1,
    turning: bool = True,
) -> BoxGrid:
    """Make the variables of all boxes, and the rows for robots that hold however the object moves.

    Args:
        model: gets them.
        scenario: one object, any number of robots.
        legs: of the object.
        delta: permissible deviation [m/s].
        conditions: what it refers to.
        reserves: what the plan keeps in hand.
        pieces: number of pieces per leg.
        turning: whether robots lose time by starting and stopping.

    Returns:
        The grid, still without rows for who hits and where the object flies.
    """
    name, events = next(iter(scenario.objects)), len(legs.durations) - 1
    boxes, moves = _add_object(model, scenario, name, legs.caps, conditions, reserves)
    between = (events + 1) * pieces - 1
    stands = {robot: _add_robot(model, scenario, robot, between, reserves) for robot in scenario.robots}
    wide = stands
    if not conditions.points:
        wide = {robot: _add_robot(model, scenario, robot, between, reserves) for robot in scenario.robots}
    grid = BoxGrid(
        model=model,
        rho=model.variable(conditions.margin, conditions.margin),
        pieces=pieces,
        legs=legs.durations,
        times=refine([0.0, *itertools.accumulate(legs.durations[:-1]), scenario.horizon], pieces),
        knots={**wide, name: refine(boxes, pieces)},
        stands=stands,
        moves=moves,
        hits=[{robot: model.binary() for robot in scenario.robots} for _ in range(events)],
        object=name,
        caps=legs.caps,
        speeds={robot: reserves.cruise(body) for robot, body in scenario.robots.items()},
        turns={robot: reserves.turning(body) * turning / pieces for robot, body in scenario.robots.items()},
        delta=delta,
        sides={} if conditions.points else {robot: [model.binary() for _ in AXES] for robot in scenario.robots},
    )
    _add_contact_rows(grid, scenario, conditions.room)
    _add_speed_rows(grid, conditions.gather)
    return grid


def compute_leg_caps(
    scenario: FreeFlyerScenario, impacts: int, conditions: Conditions, reserves: Reserves
) -> list[float]:
    r"""Return the greatest speed per axis of the object on every leg, whoever hits.

    An impact from |v^-| <= b to |v^+| <= c needs |v_R^-| <= (c + |m4| b) / m3 and
    |v_R^+| <= |m1| / m3 c + |m2 - m1 m4 / m3| b. Here b = 0 at the first impact, c is the final velocity at the
    last one if the object has to rest, and b = c at the others.

    Args:
        scenario: masses, restitution and speed limits.
        impacts: number K of impacts.
        conditions: with the final velocity.
        reserves: what the plan keeps in hand.

    Returns:
        K + 1 speeds [m/s], zero before the first impact.

    Source: Verhagen & Tumova, Eq. (5), solved for the robot's velocities.
    """
    body = next(iter(scenario.objects.values()))
    final = min(conditions.final_velocity if body.rest else body.speed_limit, body.speed_limit)
    caps = [0.0, *[body.speed_limit] * (impacts - 1), final]
    for robot in scenario.robots.values():
        m1, m2, m3, m4 = compute_mass_fractions(robot.mass, body.mass, scenario.believed.restitution)
        limit = robot.speed_limit if conditions.points else reserves.cruise(robot)
        through = max(abs(m2 - m1 * m4 / m3), 1e-9)
        between = limit / max((1 + abs(m4)) / m3, abs(m1) / m3 + through)
        before, after = [between] * impacts, [between] * impacts
        after[0] = limit / max(1 / m3, abs(m1) / m3)
        if impacts > 1 and body.rest:
            before[-1] = min((m3 * limit - final) / max(abs(m4), 1e-9), (limit - abs(m1) / m3 * final) / through)
        for k in range(1, impacts + 1):
            caps[k] = min(caps[k], after[k - 1], *before[k : k + 1])
    return caps


def _add_durations(
    model: Model, scenario: FreeFlyerScenario, impacts: int, conditions: Conditions, reserves: Reserves
) -> list[Affine]:
    """Return the durations of the legs; their own bounds keep every big M small."""
    first = reserves.times(scenario.horizon)[0]
    spare = scenario.horizon - first - impacts * conditions.gap
    if spare < 0.0:
        status = f"{impacts} impacts {conditions.gap:g} s apart do not fit into {scenario.horizon:g} s"
        raise Infeasible(model.name, status, "allow a shorter gap or fewer impacts")
    least = [first, *[conditions.gap] * impacts]
    durations = [model.variable(low, low + spare) for low in least]
    model.require_equal(sum(durations, Affine({})) - scenario.horizon)
    return durations


def _room(scenario: FreeFlyerScenario, name: str, reserves: Reserves) -> tuple[np.ndarray, np.ndarray]:
    inset = scenario.body(name).radius + reserves.wall
    return np.array(scenario.world.lower) + inset, np.array(scenario.world.upper) - inset


def _add_object(
    model: Model,
    scenario: FreeFlyerScenario,
    name: str,
    caps: Sequence[float],
    conditions: Conditions,
    reserves: Reserves,
) -> tuple[list[PositionBox], list[np.ndarray]]:
    start, half = np.array(scenario.objects[name].start), np.array(conditions.initial)
    lower, upper = _room(scenario, name, reserves)
    boxes = [PositionBox(start - half, start + half)] * 2
    moves = []
    for k, cap in enumerate(caps[1:]):
        reach = np.minimum(cap * scenario.horizon, upper - lower)
        ends = np.array([model.vector(-reach, reach) for _ in range(2)])
        if k == 0:
            # An interval of no width is a single point, with one wanted velocity.
            ends[1] = np.where(half > 0.0, ends[1], ends[0])
        moves.append(ends)
        boxes.append(PositionBox(model.vector(lower, upper), model.vector(lower, upper)))
    return boxes, moves


def _add_robot(
    model: Model, scenario: FreeFlyerScenario, name: str, between: int, reserves: Reserves
) -> list[PositionBox]:
    robot, (lower, upper) = scenario.robots[name], _room(scenario, name, reserves)
    boxes = [PositionBox(model.vector(lower, upper), model.vector(lower, upper)) for _ in range(between)]
    start = np.array(robot.start)
    end = model.vector(lower, upper) if robot.goal is None else np.array(robot.goal)
    return [PositionBox(start, start), *boxes, PositionBox(end, end)]


def _add_flight_rows(grid: BoxGrid, k: int) -> None:
    """Require both ends of the interval at impact k to fly into the interval at the next event."""
    model, here, there, duration = grid.model, grid.boxes[k], grid.boxes[k + 1], grid.legs[k]
    spread = duration * grid.delta  # type: ignore[operator]
    for end, move in zip((here.lower, here.upper), grid.moves[k - 1], strict=True):
        for d in range(2):
            model.require(end[d] + move[d] + spread - there.upper[d])
            model.require(there.lower[d] - (end[d] + move[d] - spread))
            for sign in (1.0, -1.0):
                model.require(move[d] * sign + spread - duration * grid.caps[k])


def _add_contact_rows(grid: BoxGrid, scenario: FreeFlyerScenario, room: float) -> None:
    """Give a robot that hits a box as large as the object's, and every other robot a single point.

    A robot that hits is at contact distance on its side of the object, or anywhere within the cone of its impulses.
    """
    model, radius = grid.model, scenario.objects[grid.object].radius
    for name, robot in scenario.robots.items():
        low, high = ((robot.radius + radius) * part for part in _cone_limits())
        for knot, d in itertools.product(range(1, grid.count), range(2)):
            stand, wide, hit = grid.stands[name][knot], grid.knots[name][knot], grid.hits_at(knot).get(name, 0.0)
            model.require(stand.lower[d] - stand.upper[d])
            model.require(stand.upper[d] - stand.lower[d], unless=hit)
            if grid.sides:
                model.require(wide.lower[d] - stand.lower[d])
                model.require(stand.upper[d] - wide.upper[d])
            if not isinstance(hit, Affine):
                continue
            around, sides = grid.boxes[knot // grid.pieces], grid.sides.get(name, [])
            reach = (robot.radius + radius) * AXES[:, d]
            for box, least, most in ((stand, reach, reach), (wide, low[:, d] - room, high[:, d] + room)):
                nearest = sum((side * value for side, value in zip(sides, least, strict=False)), Affine({}))
                farthest = sum((side * value for side, value in zip(sides, most, strict=False)), Affine({}))
                model.require(box.lower[d] - around.lower[d] + farthest, unless=1.0 - hit)
                model.require(around.upper[d] - nearest - box.upper[d], unless=1.0 - hit)


def _cone_limits() -> tuple[np.ndarray, np.ndarray]:
    """Return the least and greatest components of unit vectors in the cones around the axes, each shape (4, 2)."""
    along, across = np.cos(HALF_ANGLE), np.sin(HALF_ANGLE)
    low = np.where(AXES > 0, along, np.where(AXES < 0, -1.0, -across))
    return low, -low[[1, 0, 3, 2]]


def _add_speed_rows(grid: BoxGrid, gather: bool) -> None:
    """Give every robot time to get from anywhere in its box to anywhere in the next, starting and stopping included."""
    for piece, (name, speed) in itertools.product(range(grid.count), grid.speeds.items()):
        here, there = grid.stands[name][piece : piece + 2]
        turn, hits = grid.turns[name], [grid.hits_at(knot).get(name) for knot in (piece, piece + 1)]
        steps = [*(there.upper - here.lower), *(here.upper - there.lower)]
        for step in steps:
            grid.model.require(step - (grid.duration(piece) - turn) * speed)
        if gather and all(hits):
            # All its motions meet in one point, where it stops once more.
            widths = [*(here.upper - here.lower), *(there.upper - there.lower)]
            for step in (*steps, *widths):
                row = step - (grid.duration(piece) - 2.0 * turn) * speed
                grid.model.require(row, unless=2.0 - hits[0] - hits[1])  # type: ignore[operator]

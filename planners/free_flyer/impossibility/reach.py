"""How soon bodies can be where: speeds, ways and waits that no plan can do better than.

Nothing but what every plan keeps counts: speed limits, the impact law, the world's edge and solid obstacles; robots
turn as they like and push with two axes at once, hits are where they like, other bodies are in nobody's way. A polygon
takes no more room than the disc inside it, and between samples an area that is to be avoided may be crossed.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from impact_envs.free_flyer.schema import Body, FreeFlyerScenario, Object, Robot
from impact_envs.physics.impact import compute_mass_fractions
from impact_envs.stl import In, Predicate
from planners.free_flyer.impossibility.convex_polygon import clip, list_faces, make_box
from planners.free_flyer.impossibility.least_way import ROUNDED, FreeSpace, grow
from planners.free_flyer.specification.requirement import Demands

# By which ways may be longer than what is told, of the world's largest side; less than the robustness that plans have.
FORGIVEN = 10.0 * ROUNDED

NEARLY = 0.99  # share of its speed limit from which an object counts as being as fast as that
SLANT = (1.0 + math.sqrt(2.0)) / 2.0  # max (cos + sin) cos: a hit at 22.5 degrees by a robot as fast along both axes
MOST_CLOSING = 8  # obstacles of which those are named that close a way


@dataclass(frozen=True)
class Kept:
    """Hold what a plan keeps in hand; nothing: what no plan of any kind can do without.

    Args:
        wall: distance from the world's edge and solid obstacles beyond touching [m].
        first: least time before an object at rest is hit [s].
    """

    wall: float = 0.0
    first: float = 0.0


@dataclass
class Reach:
    """Tell how soon bodies can be where.

    Args:
        scenario: bodies, limits, world.
        demands: of its formula.
        kept: in hand.
        max_impacts: greatest number of impacts.
        held: predicates that hold over the whole horizon, by body.
        spaces: of bodies and what holds of them, for more than one such table.
    """

    scenario: FreeFlyerScenario
    demands: Demands
    kept: Kept
    max_impacts: int
    held: dict[str, tuple[Predicate, ...]]
    spaces: dict[tuple[str, tuple[Predicate, ...]], FreeSpace] = field(default_factory=dict)
    _waits: dict[str, float] = field(default_factory=dict)

    @property
    def forgiven(self) -> float:
        """Return the length by which a place may be missed [m]."""
        world = self.scenario.world
        return FORGIVEN * float(np.subtract(world.upper, world.lower).max())

    def space(self, name: str) -> FreeSpace:
        """Return where a body's centre may be at any time."""
        key = name, self.held.get(name, ())
        if key not in self.spaces:
            self.spaces[key] = self.make_space(name, find_inner_radius(self.scenario.body(name)))
        return self.spaces[key]

    def make_space(self, name: str, radius: float) -> FreeSpace:
        """Return where a body's centre might be, were it of another radius [m]."""
        scenario, body, inset = self.scenario, self.scenario.body(name), radius + self.kept.wall
        fixed = [np.array(body.start)]
        if isinstance(body, Robot) and body.goal is not None:
            fixed.append(np.array(body.goal))
        lower = np.minimum(np.array(scenario.world.lower) + inset, np.min(fixed, axis=0))
        upper = np.maximum(np.array(scenario.world.upper) - inset, np.max(fixed, axis=0))
        box, obstacles = make_box(lower, upper), []
        for area, obstacle in scenario.obstacles.items():
            if obstacle.solid:
                corners = np.array(obstacle.corners)
                faces, bounds = list_faces(corners)
                # A body may start nearer than what plans keep.
                gap = min(float((faces @ place - bounds).max()) for place in fixed)
                obstacles.append((area, grow(corners, max(0.0, min(inset, gap)))))
        # Between samples a motion is no farther from one of them than half a step, along each axis.
        step = 0.5 * self.speed(name) * scenario.control_period
        for predicate in self.held.get(name, ()):
            need = self.demands.predicates[predicate]
            if need.kind == "stay" and not need.others:
                box = clip(box, need.faces, need.bounds + step * np.abs(need.faces).sum(axis=1))
            elif isinstance(predicate, In) and predicate.negated:
                corners = np.array(scenario.areas[predicate.area].corners)
                faces, bounds = list_faces(corners)
                inner = clip(corners, faces, bounds - step * np.abs(faces).sum(axis=1))
                if len(inner) > 2:
                    obstacles.append((predicate.area, inner))
        return FreeSpace(np.array(body.start), box, obstacles)

    def speed(self, name: str) -> float:
        """Return the greatest speed per axis [m/s].

        An object at speed v that is hit along its motion by a robot at w leaves at m3 w + (1 - m3) v; hit aside, by no
        more along an axis than 1.21 m3 w + (|1 - m3 / 2| + m3 / sqrt(2)) v, with w and v the greatest along an axis.
        """
        body = self.scenario.body(name)
        if isinstance(body, Robot):
            return max(body.speed_limit, *map(abs, body.start_velocity))
        start = given = max(map(abs, body.start_velocity))
        for _ in range(max(1, self.max_impacts)):  # that none may is told in other words
            after = given
            for robot in self.scenario.robots.values():
                _, _, m3, _ = compute_mass_fractions(robot.mass, body.mass, self.scenario.believed.restitution)
                fastest = max(robot.speed_limit, *map(abs, robot.start_velocity))
                after = max(after, SLANT * m3 * fastest + (abs(1.0 - 0.5 * m3) + m3 / math.sqrt(2.0)) * given)
            if after >= NEARLY * body.speed_limit:
                return max(body.speed_limit, start)
            given = after
        return max(given, start)

    def wait(self, name: str) -> float:
        """Return the time before which a body stays where it starts [s]: an object waits for its first impact."""
        if name in self.scenario.robots or any(self.scenario.objects[name].start_velocity):
            return 0.0
        if name not in self._waits:
            arrivals = [self._measure_arrival(robot, name) for robot in self.scenario.robots]
            self._waits[name] = max(self.kept.first, min(arrivals, default=math.inf))
        return self._waits[name]

    def _measure_arrival(self, name: str, struck: str) -> float:
        """Return the least time in which a robot comes to touch an object that rests at its start [s]."""
        robot, fastest = self.scenario.robots[name], self.speed(name)
        way = max(0.0, self.space(name).measure(self.find_touch(name, struck)) - self.forgiven)
        if not math.isfinite(way) or any(robot.start_velocity) or len(self.scenario.objects) > 1:
            return way / fastest  # what it hit before may have made it fast
        strength = math.sqrt(2.0) * robot.force_limit / robot.mass  # both axes of a robot that is turned by 45 degrees
        if way < fastest**2 / (2.0 * strength):
            return math.sqrt(2.0 * way / strength)
        return way / fastest + fastest / (2.0 * strength)

    def find_touch(self, name: str, struck: str, place: np.ndarray | None = None) -> np.ndarray:
        """Return a box that holds all places from which a robot touches an object, shape (n, 2) [m].

        Args:
            name: of the robot.
            struck: name of the object.
            place: convex polygon that the object is in; None: it is at its start.
        """
        place, box = np.array([self.scenario.body(struck).start]) if place is None else place, self.space(name).box
        reach = self.scenario.body(name).radius + self.scenario.body(struck).radius + self.forgiven
        faces, bounds = list_faces(box) if len(box) > 2 else (np.zeros((0, 2)), np.zeros(0))
        return clip(make_box(place.min(axis=0) - reach, place.max(axis=0) + reach), faces, bounds)

    def arrive(self, name: str, place: np.ndarray) -> tuple[float, float]:
        """Return the length of a body's least way into a place, and the time at which it can be there [m, s]."""
        way = max(0.0, self.space(name).measure(place) - self.forgiven)
        return (way, 0.0) if way == 0.0 else (way, self.wait(name) + way / self.speed(name))

    def find_closing(self, name: str, place: np.ndarray) -> tuple[list[str], float]:
        """Return which obstacles alone close all ways into a place, and the widest gap that they leave [m].

        Nothing is told of many obstacles.
        """
        names = list(dict.fromkeys(area for area, _ in self.space(name).obstacles))
        if len(names) > MOST_CLOSING:
            return [], 0.0
        closing = [area for area in names if math.isfinite(self.space(name).without(area).measure(place))]
        low, high = 0.0, find_inner_radius(self.scenario.body(name))
        for _ in range(10):
            middle = 0.5 * (low + high)
            if math.isfinite(self.make_space(name, middle).measure(place)):
                low = middle
            else:
                high = middle
        return closing, 2.0 * (low + self.kept.wall) if low > 0.0 else 0.0


def find_inner_radius(body: Body) -> float:
    """Return the radius of the greatest disc around a body's centre that lies in it [m]."""
    if not isinstance(body, Object) or body.vertices is None:
        return body.radius
    _, bounds = list_faces(np.array(body.vertices))
    return float(bounds.min())


def list_held(predicates: Iterable[Predicate]) -> dict[str, tuple[Predicate, ...]]:
    """Return predicates about one body by body."""
    own = sorted(((one.bodies()[0], one) for one in predicates if len(one.bodies()) == 1), key=lambda pair: pair[0])
    return {name: tuple(one for _, one in pairs) for name, pairs in itertools.groupby(own, key=lambda pair: pair[0])}

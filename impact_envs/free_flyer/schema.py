"""Tables of a free-flyer scenario: who is where, and what counts as a scenario; the physics are in `truth.py`."""

from __future__ import annotations

import math
import operator
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from impact_envs.free_flyer.truth import (
    BODY_COLUMNS,
    CONTACT_COLUMNS,
    CORNERS,
    DELAY,
    DEVIATION,
    DICE,
    DICE_MODULUS,
    DRIFT_X,
    DRIFT_Y,
    DROPOUT,
    FRICTION,
    INERTIA,
    MASS,
    OFFSET_X,
    OFFSET_Y,
    RESTITUTION,
    RESTITUTION_SPEED,
    SENSOR_COLUMNS,
    START_X,
    START_Y,
    TURN,
    Believed,
    Physics,
    Truth,
    draw_columns,
    draw_thrusters,
    largest,
    list_drawn,
    make_vectors,
    smallest,
)
from impact_envs.scenario import (
    Box,
    Finite,
    NonNegative,
    Positive,
    Quantity,
    Region,
    Scenario,
    Table,
    Uniform,
    Vector,
    check_convex,
)

Engine = Literal["exact", "pymunk"]
# Bodies may overlap by this share of their radii at the start: decimal numbers that make them touch are rounded.
TOUCHING = 1e-9
# The slowest speed limit over this, and at most this [m/s], is the default of World.rest_speed.
REST_FRACTION, MOST_REST_SPEED = 2000.0, 1e-4
# Of moments of inertia and torques, which take lengths twice: where lengths and masses are told in thousandths or in
# thousands they are 1e9 or 1e-9 times as large.
SMALLEST_MOMENT, LARGEST_MOMENT = 1e-18, 1e18


def _check_moment(number: float) -> float:
    if number < SMALLEST_MOMENT:
        raise ValueError(f"{number:g} is below {SMALLEST_MOMENT:g}, the smallest number above 0")
    return number


PositiveMoment = Annotated[float, Field(gt=0, le=LARGEST_MOMENT, allow_inf_nan=False), AfterValidator(_check_moment)]


class World(Box):
    """The box that bodies cannot leave, and what counts as rest in it."""

    # Bodies that meet more slowly than this come to rest on each other instead of rebounding, where anything presses
    # touching bodies together; where nothing does, at a thousandth of it. Unset: the slowest speed limit / 2000, at
    # most 1e-4 [m/s].
    rest_speed: Positive | None = None


class Obstacle(Region):
    """An area to avoid; ``solid`` ones stop bodies, the others exist only in the formula."""

    solid: bool = False  # it stops bodies


class Body(Table):
    """What robots and objects have in common; masses are the believed ones."""

    start: Vector  # position of the geometric centre [m]
    start_velocity: Vector = (0.0, 0.0)  # of the geometric centre at the start [m/s]
    heading: Finite = 0.0  # [rad]
    mass: Positive  # [kg]
    inertia: PositiveMoment  # about the centre of mass [kg m^2]
    radius: Positive  # of the disc, or of the circle round the polygon [m]
    speed_limit: Positive  # per axis [m/s]
    curves: Annotated[int, Field(ge=1, le=100)] | None = None  # of the published encoding; unset: its own numbers


class Robot(Body):
    """A free-flyer driven by a force and a torque in its body frame."""

    goal: Vector | None = None  # where it must rest at the horizon [m]
    force_limit: Positive  # per body axis [N]
    torque_limit: PositiveMoment  # [N m]

    @property
    def start_rate(self) -> float:
        """Return the angular velocity at the start: robots do not turn [rad/s]."""
        return 0.0


class Object(Body):
    """A passive body, moved only by impacts."""

    start_rate: Finite = 0.0  # angular velocity at the start [rad/s]
    vertices: tuple[Vector, ...] | None = None  # convex polygon in the body frame [m]; a disc without
    rest: bool = True  # must it be at rest at the horizon
    keep_force: NonNegative = 0.0  # of its own thrusters, by which it keeps its velocity between impacts; 0: none [N]
    start_uncertainty: tuple[NonNegative, NonNegative] = (0.0, 0.0)  # half widths of the box it may start in [m]
    final_speed: Positive = 0.05  # per axis at the horizon, where it has to rest but is uncertain or never hit [m/s]

    @property
    def must_stop(self) -> bool:
        """Return whether it starts too fast to count as at rest at the horizon if it is never hit."""
        return self.rest and max(map(abs, self.start_velocity)) > self.final_speed

    @model_validator(mode="after")
    def _shape(self) -> Self:
        if self.vertices is not None:
            check_convex(self.vertices)
            reach = max(math.hypot(*vertex) for vertex in self.vertices)
            if reach > self.radius * (1 + 1e-9):
                raise ValueError(f"radius {self.radius:g} is smaller than the farthest vertex at {reach:.3g}")
        return self


class FreeFlyerScenario(Scenario):
    """Free-flyers that move passive objects by impacts in a planar, weightless world box."""

    suite_file: ClassVar[Path | None] = Path(__file__).parent / "suites.toml"

    domain: Literal["free_flyer"]
    # Price of a metre of loosening, of each conjunct of the formula in their order, with `impact plan --relax`; 1 each
    # if unset.
    weights: Annotated[tuple[Positive, ...], Field(exclude_if=operator.not_)] = ()
    engine: Engine | None = None  # what computes the motion; unset: exact for discs, pymunk for polygons
    world: World
    robots: dict[str, Robot]
    objects: dict[str, Object]
    obstacles: dict[str, Obstacle] = {}
    impact_gap: Positive | None = None  # least time between uncertain impacts, and after the last one [s]
    believed: Believed
    true: Truth = Truth()

    @property
    def agents(self) -> tuple[str, ...]:
        """Return the robots' names, in file order."""
        return tuple(self.robots)

    @property
    def bodies(self) -> tuple[str, ...]:
        """Return robots, then objects, in file order: the canonical order of all arrays."""
        return (*self.robots, *self.objects)

    @property
    def areas(self) -> Mapping[str, Region]:
        """Return regions and obstacles by name."""
        return {**self.regions, **self.obstacles}

    def body(self, name: str) -> Robot | Object:
        """Return a robot or object by name."""
        return self.robots[name] if name in self.robots else self.objects[name]

    @property
    def starts(self) -> np.ndarray:
        """Return the states of all bodies at the start, as models return them, shape (bodies, 6)."""
        tables = [self.body(name) for name in self.bodies]
        return np.array([(*body.start, *body.start_velocity, body.heading, body.start_rate) for body in tables])

    @property
    def rest_speed(self) -> float:
        """Return the speed below which an impact of pressed bodies is the start of a lasting contact [m/s]."""
        if self.world.rest_speed is not None:
            return self.world.rest_speed
        return min(MOST_REST_SPEED, *(self.body(name).speed_limit / REST_FRACTION for name in self.bodies))

    def place_bodies(self, physics: Physics) -> np.ndarray:
        """Return ``starts`` in a true world."""
        states = self.starts
        states[:, :2] += physics.body[:, START_X : START_Y + 1]
        return states

    @property
    def starts_moving(self) -> bool:
        """Return whether any body has a velocity at the start."""
        return any(any(self.body(name).start_velocity) for name in self.bodies)

    def as_believed(self) -> Self:
        """Return the scenario as the expert sees it: the true world is the believed one, undisturbed."""
        return self.model_copy(update={"true": Truth()})

    @property
    def draw_count(self) -> int:
        """Return how many uniform numbers the draw of one true world takes."""
        return sum(isinstance(each, Uniform) for row in self.list_drawn().values() for each in row)

    def draw(self, rng: np.random.Generator) -> Physics:
        """Draw one true world.

        Args:
            rng: the episode's generator; the order of draws is fixed, so worlds of one seed share what they can.

        Returns:
            The numbers of one episode.
        """
        drawn = self.draw_many(rng.random((1, self.draw_count)))
        return Physics(drawn.contact[0], drawn.body[0], drawn.thruster[0], drawn.sensor[0], self.true)

    def draw_many(self, uniforms: np.ndarray) -> Physics:
        """Turn uniform numbers into true worlds, one per row; a world does not depend on the others.

        Args:
            uniforms: in [0, 1), shape (N, draw_count).

        Returns:
            The numbers of N episodes.
        """
        worlds, robots, n = len(uniforms), len(self.robots), len(self.bodies)
        drawn = draw_columns(self.list_drawn(), uniforms)
        contact = np.empty((worlds, CONTACT_COLUMNS))
        contact[:, RESTITUTION] = drawn["restitution"][:, 0]
        contact[:, RESTITUTION_SPEED] = drawn["restitution_speed"][:, 0]
        contact[:, FRICTION] = drawn["friction"][:, 0]
        body, tables = np.zeros((worlds, n, BODY_COLUMNS)), [self.body(name) for name in self.bodies]
        scale = np.hstack([drawn["robot_mass_scale"], drawn["object_mass_scale"]])
        body[:, :, MASS] = scale * [table.mass for table in tables]
        body[:, :, INERTIA] = scale * [table.inertia for table in tables]
        body[:, robots:, OFFSET_X : OFFSET_Y + 1] = make_vectors(drawn["center_of_mass_offset"])
        body[:, robots:, DRIFT_X : DRIFT_Y + 1] = make_vectors(drawn["drift"])
        if self.true.start_spread != 0.0:
            spread = drawn["start_spread"].reshape(worlds, n - robots, 3)
            halves = np.array([item.start_uncertainty for item in self.objects.values()]).reshape(-1, 2)
            body[:, robots:, START_X : START_Y + 1] = spread[:, :, :1] * spread[:, :, 1:] * halves
        if self.true.moves_starts:
            for column, axis in ((START_X, "x"), (START_Y, "y")):
                body[:, :, column] += np.hstack([drawn[f"robot_start_{axis}"], drawn[f"object_start_{axis}"]])
        if self.true.impact_deviation != 0.0:
            deviation = drawn["impact_deviation"].reshape(worlds, n - robots, 3)
            body[:, robots:, DEVIATION] = deviation[:, :, 0]
            body[:, robots:, CORNERS] = deviation[:, :, 1] < 0.5
            body[:, robots:, DICE] = np.floor(1.0 + deviation[:, :, 2] * (DICE_MODULUS - 2.0))
        body[:, robots:, TURN] = drawn["drift_turn"]
        sensor = np.empty((worlds, SENSOR_COLUMNS))
        sensor[:, DELAY] = np.minimum(np.floor(drawn["delay_steps"][:, 0]), largest(self.true.delay_steps))
        sensor[:, DROPOUT] = drawn["dropout_rate"][:, 0]
        return Physics(contact, body, draw_thrusters(drawn, self.horizon), sensor, self.true)

    def list_drawn(self) -> dict[str, tuple[Quantity, ...]]:
        """Return what a true world is made of, by field of `Truth` in the order of drawing."""
        return list_drawn(self.true, self.believed, len(self.robots), len(self.objects))

    @property
    def has_polygons(self) -> bool:
        """Return whether any object is no disc."""
        return any(body.vertices is not None for body in self.objects.values())

    @model_validator(mode="after")
    def _weights_fit(self) -> Self:
        conjuncts = self.specification.conjuncts()
        if self.weights and len(self.weights) != len(conjuncts):
            listed = "; ".join(map(str, conjuncts))
            raise ValueError(f"weights: {len(self.weights)} for {len(conjuncts)} conjuncts of the formula: {listed}")
        return self

    @model_validator(mode="after")
    def _engine_fits(self) -> Self:
        if self.engine == "exact" and self.has_polygons:
            name = next(name for name, body in self.objects.items() if body.vertices is not None)
            raise ValueError(f'engine = "exact" takes discs, and objects.{name} is a polygon; choose "pymunk"')
        for name, item in self.objects.items():
            if item.keep_force > 0 and (self.engine == "pymunk" or self.has_polygons):
                raise ValueError(f"objects.{name}.keep_force = {item.keep_force:g}: only the exact engine has it")
        return self

    @model_validator(mode="after")
    def _placed(self) -> Self:
        if not self.robots:
            raise ValueError("robots: at least one is needed")
        for one, other in (("robots", "objects"), ("regions", "obstacles")):
            for name in sorted(set(getattr(self, one)) & set(getattr(self, other))):
                raise ValueError(f"'{name}' names both {one}.{name} and {other}.{name}; give one of them another name")
        for name in self.bodies:
            self._check_inside(name)
        names = self.bodies
        for i, first in enumerate(names):
            for second in names[i + 1 :]:
                a, b = self.body(first), self.body(second)
                if math.dist(a.start, b.start) < (a.radius + b.radius) * (1 - TOUCHING):
                    raise ValueError(f"{first} and {second} overlap at the start")
        return self

    @model_validator(mode="after")
    def _spread_fits(self) -> Self:
        """Refuse boxes in which a body could start inside something else."""
        halves = {name: self._find_reach(name) for name in self.bodies}
        for name, half in halves.items():
            if not half.any():
                continue
            start, radius = np.array(self.body(name).start), self.body(name).radius
            where = f"{self._name_reach(name)}: {name} could start"
            room = np.minimum(start - self.world.lower, self.world.upper - start)
            if (room < half + radius).any():
                raise ValueError(f"{where} outside the world")
            for other in self.bodies:
                body = self.body(other)
                apart = np.abs(start - body.start) - half - halves[other]
                if other != name and np.hypot(*np.maximum(apart, 0.0)) < radius + body.radius:
                    raise ValueError(f"{where} in {other}")
            for area, obstacle in self.obstacles.items():
                H, b = obstacle.halfspaces()
                if obstacle.solid and np.max(H @ start - np.abs(H) @ half - b) < radius:
                    raise ValueError(f"{where} in the solid obstacle '{area}'")
        return self

    def _find_reach(self, name: str) -> np.ndarray:
        """Return how far from where the scenario says a body may start, along each axis, shape (2,) [m]."""
        kind = "robot" if name in self.robots else "object"
        moved = [getattr(self.true, f"{kind}_start_{axis}") for axis in "xy"]
        box = largest(self.true.start_spread) * np.array(getattr(self.body(name), "start_uncertainty", (0.0, 0.0)))
        reach: np.ndarray = box + [max(-smallest(quantity), largest(quantity)) for quantity in moved]
        return reach

    def _name_reach(self, name: str) -> str:
        """Return the keys that say how far from where the scenario says a body may start."""
        kind, keys = "robot" if name in self.robots else "object", []
        if kind == "object" and any(self.objects[name].start_uncertainty):
            keys.append(f"objects.{name}.start_uncertainty = {list(self.objects[name].start_uncertainty)}")
        if self.true.moves_starts:
            keys.append(f"true.{kind}_start_x, true.{kind}_start_y")
        return " with ".join(keys)

    def _check_inside(self, name: str) -> None:
        body = self.body(name)
        table = "robots" if name in self.robots else "objects"
        places = {"start": body.start, "goal": getattr(body, "goal", None)}
        (x0, y0), (x1, y1) = self.world.lower, self.world.upper
        for key, place in places.items():
            if place is None:
                continue
            x, y = place
            r = body.radius * (1 - TOUCHING)
            if not (x0 + r <= x <= x1 - r and y0 + r <= y <= y1 - r):
                raise ValueError(
                    f"{table}.{name}.{key} = {list(place)} with radius {body.radius:g} is not inside the world "
                    f"{list(self.world.lower)} to {list(self.world.upper)}"
                )
            for area, obstacle in self.obstacles.items():
                H, b = obstacle.halfspaces()
                if obstacle.solid and np.max(H @ np.array(place) - b) < r:
                    raise ValueError(f"{table}.{name}.{key} = {list(place)} touches the solid obstacle '{area}'")

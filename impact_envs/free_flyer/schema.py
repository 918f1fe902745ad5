"""Tables of a free-flyer scenario: who is where, what is believed, what is true, and the draw of one true world."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal, NamedTuple, Self

import numpy as np
from pydantic import Field, model_validator

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
Restitution = Annotated[float, Field(ge=0, le=1)]
# What directions and the choice of one of several things are drawn from.
ANGLE, SHARE = Uniform(uniform=(0.0, 2 * math.pi)), Uniform(uniform=(0.0, 1.0))


class Obstacle(Region):
    """An area to avoid; ``solid`` ones stop bodies, the others exist only in the formula."""

    solid: bool = False


class Body(Table):
    """What robots and objects have in common; masses are the believed ones."""

    start: Vector  # position of the geometric centre [m]
    start_velocity: Vector = (0.0, 0.0)  # of the geometric centre at the start [m/s]
    heading: Finite = 0.0  # [rad]
    mass: Positive  # [kg]
    inertia: Positive  # about the centre of mass [kg m^2]
    radius: Positive  # of the disc, or of the circle round the polygon [m]
    speed_limit: Positive  # per axis [m/s]
    curves: Annotated[int, Field(ge=1)] | None = None  # of the published encoding; unset: its own numbers


class Robot(Body):
    """A free-flyer driven by a force and a torque in its body frame."""

    goal: Vector | None = None  # where it must rest at the horizon [m]
    force_limit: Positive  # per body axis [N]
    torque_limit: Positive  # [N m]


class Object(Body):
    """A passive body, moved only by impacts."""

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


class Believed(Table):
    """The physics that planner and expert compute with."""

    restitution: Restitution
    friction: NonNegative = 0.0


class Truth(Table):
    """The physics of the simulated world, numbers or distributions; unset means as believed, undisturbed."""

    restitution: Restitution | Uniform | None = None
    restitution_speed: Quantity = 0.0  # e(v) = restitution * exp(-v / restitution_speed) [m/s]; 0 = constant
    friction: Quantity | None = None  # Coulomb coefficient at contacts
    robot_mass_scale: Quantity = 1.0  # true mass over believed mass
    object_mass_scale: Quantity = 1.0
    center_of_mass_offset: Quantity = 0.0  # of objects, in a random body direction [m]
    drift: Quantity = 0.0  # constant acceleration of each object, random direction [m/s^2]
    thruster_gain: Quantity = 1.0  # true over commanded force, drawn per robot
    weak_thruster: Quantity = 1.0  # further gain of one random thruster direction of one random robot
    thruster_on_off: bool = False  # thrusters are off or full at the control rate
    position_noise: NonNegative = 0.0  # standard deviation per axis [m]
    velocity_measured: bool = True  # otherwise velocity is a filtered difference of positions
    delay_steps: Annotated[int, Field(ge=0, le=50)] = 0  # control periods between event and observation

    @model_validator(mode="after")
    def _limits(self) -> Self:
        for name in ("robot_mass_scale", "object_mass_scale"):
            if smallest(getattr(self, name)) <= 0:
                raise ValueError(f"{name} must be above 0")
        for name in ("restitution", "restitution_speed", "friction", "center_of_mass_offset", "drift"):
            value = getattr(self, name)
            if value is not None and smallest(value) < 0:
                raise ValueError(f"{name} must not be negative")
        if isinstance(self.restitution, Uniform) and self.restitution.uniform[1] > 1:
            raise ValueError(f"restitution reaches {self.restitution.uniform[1]:g}, above 1")
        return self


def smallest(quantity: Quantity) -> float:
    """Return the smallest value a quantity can take."""
    return quantity.uniform[0] if isinstance(quantity, Uniform) else quantity


@dataclass(frozen=True)
class Physics:
    """One true world: the numbers drawn for one episode.

    Attributes:
        restitution: coefficient of restitution at zero speed.
        restitution_speed: e(v) = restitution * exp(-v / restitution_speed) [m/s]; 0 = constant.
        friction: Coulomb coefficient at contacts.
        masses, inertias: per body [kg], [kg m^2].
        center_of_mass: per body, offset from the geometric centre in the body frame, shape (2,) [m].
        drift: per object, constant world acceleration, shape (2,) [m/s^2].
        thruster_gain: per robot, shape (3, 2), gain of channels Fx, Fy, torque for positive and negative commands.
        thruster_on_off: thrusters are off or full.
        position_noise: standard deviation per axis [m].
        velocity_measured: False when velocity is a filtered difference of positions.
        delay_steps: control periods between event and observation.
    """

    restitution: float
    restitution_speed: float
    friction: float
    masses: Mapping[str, float]
    inertias: Mapping[str, float]
    center_of_mass: Mapping[str, np.ndarray]
    drift: Mapping[str, np.ndarray]
    thruster_gain: Mapping[str, np.ndarray]
    thruster_on_off: bool = False
    position_noise: float = 0.0
    velocity_measured: bool = True
    delay_steps: int = 0


class DrawnPhysics(NamedTuple):
    """The drawn numbers of N true worlds of one scenario, n bodies, of which the first are the r robots.

    Attributes:
        restitution, restitution_speed, friction: as in ``Physics``, shape (N,).
        masses, inertias: shape (N, n) [kg], [kg m^2].
        center_of_mass, drift: zero for robots, shape (N, n, 2) [m], [m/s^2].
        thruster_gain: shape (N, r, 3, 2).
    """

    restitution: np.ndarray
    restitution_speed: np.ndarray
    friction: np.ndarray
    masses: np.ndarray
    inertias: np.ndarray
    center_of_mass: np.ndarray
    drift: np.ndarray
    thruster_gain: np.ndarray


class FreeFlyerScenario(Scenario):
    """Free-flyers that move passive objects by impacts in a planar, weightless world box."""

    suite_file: ClassVar[Path | None] = Path(__file__).parent / "suites.toml"

    domain: Literal["free_flyer"]
    engine: Engine | None = None  # what computes the motion; unset: exact for discs, pymunk for polygons
    world: Box
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
        return np.array([(*table.start, *table.start_velocity, table.heading, 0.0) for table in tables])

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
        return sum(isinstance(quantity, Uniform) for quantity in self._quantities())

    def draw(self, rng: np.random.Generator) -> Physics:
        """Draw one true world.

        Args:
            rng: the episode's generator; the order of draws is fixed, so worlds of one seed share what they can.

        Returns:
            The numbers of one episode.
        """
        drawn = DrawnPhysics(*(rows[0] for rows in self.draw_many(rng.random((1, self.draw_count)))))
        place = {name: i for i, name in enumerate(self.bodies)}
        return Physics(
            restitution=float(drawn.restitution),
            restitution_speed=float(drawn.restitution_speed),
            friction=float(drawn.friction),
            masses={name: float(drawn.masses[i]) for name, i in place.items()},
            inertias={name: float(drawn.inertias[i]) for name, i in place.items()},
            center_of_mass={name: drawn.center_of_mass[i] for name, i in place.items()},
            drift={name: drawn.drift[place[name]] for name in self.objects},
            thruster_gain={name: drawn.thruster_gain[place[name]] for name in self.robots},
            thruster_on_off=self.true.thruster_on_off,
            position_noise=self.true.position_noise,
            velocity_measured=self.true.velocity_measured,
            delay_steps=self.true.delay_steps,
        )

    def draw_many(self, uniforms: np.ndarray) -> DrawnPhysics:
        """Turn uniform numbers into true worlds, one per row; a world does not depend on the others.

        Args:
            uniforms: in [0, 1), shape (N, draw_count).

        Returns:
            The numbers of N episodes.
        """
        robots, objects = len(self.robots), len(self.objects)
        sizes = (1, 1, robots + objects, 1, 2 * objects, 2 * objects, robots, 1)
        values = np.split(_draw_columns(self._quantities(), uniforms), np.cumsum(sizes), axis=1)
        restitution, friction, scale, speed, offset, drift, gain, weakest, which = values
        gains = np.empty((len(uniforms), robots, 3, 2))
        gains[:] = gain[:, :, None, None]
        robot, channel, sign = (which * (robots, 2, 2)).astype(int).T
        gains[np.arange(len(uniforms)), robot, channel, sign] *= weakest[:, 0]
        return DrawnPhysics(
            restitution=restitution[:, 0],
            restitution_speed=speed[:, 0],
            friction=friction[:, 0],
            masses=scale * [self.body(name).mass for name in self.bodies],
            inertias=scale * [self.body(name).inertia for name in self.bodies],
            center_of_mass=_make_vectors(offset, robots),
            drift=_make_vectors(drift, robots),
            thruster_gain=gains,
        )

    def _quantities(self) -> tuple[Quantity, ...]:
        """Return what a true world is made of, in the order of drawing."""
        true, robots, objects = self.true, len(self.robots), len(self.objects)
        return (
            self.believed.restitution if true.restitution is None else true.restitution,
            self.believed.friction if true.friction is None else true.friction,
            *(true.robot_mass_scale,) * robots,
            *(true.object_mass_scale,) * objects,
            true.restitution_speed,
            *(true.center_of_mass_offset, ANGLE) * objects,
            *(true.drift, ANGLE) * objects,
            *(true.thruster_gain,) * robots,
            true.weak_thruster,
            *(SHARE, SHARE, SHARE),  # which robot, force along x or y, positive or negative
        )

    @property
    def has_polygons(self) -> bool:
        """Return whether any object is no disc."""
        return any(body.vertices is not None for body in self.objects.values())

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
        shared = set(self.robots) & set(self.objects) | set(self.regions) & set(self.obstacles)
        if shared:
            raise ValueError(f"'{sorted(shared)[0]}' names two things")
        for name in self.bodies:
            self._check_inside(name)
        names = self.bodies
        for i, first in enumerate(names):
            for second in names[i + 1 :]:
                a, b = self.body(first), self.body(second)
                if math.dist(a.start, b.start) < a.radius + b.radius:
                    raise ValueError(f"{first} and {second} overlap at the start")
        return self

    def _check_inside(self, name: str) -> None:
        body = self.body(name)
        table = "robots" if name in self.robots else "objects"
        places = {"start": body.start, "goal": getattr(body, "goal", None)}
        (x0, y0), (x1, y1) = self.world.lower, self.world.upper
        for key, place in places.items():
            if place is None:
                continue
            x, y = place
            r = body.radius
            if not (x0 + r <= x <= x1 - r and y0 + r <= y <= y1 - r):
                raise ValueError(
                    f"{table}.{name}.{key} = {list(place)} with radius {r:g} is not inside the world "
                    f"{list(self.world.lower)} to {list(self.world.upper)}"
                )
            for area, obstacle in self.obstacles.items():
                H, b = obstacle.halfspaces()
                if obstacle.solid and np.max(H @ np.array(place) - b) < r:
                    raise ValueError(f"{table}.{name}.{key} = {list(place)} touches the solid obstacle '{area}'")


def _draw_columns(quantities: tuple[Quantity, ...], uniforms: np.ndarray) -> np.ndarray:
    """Return the numbers of each world, low + (high - low) u where they are drawn, shape (N, quantities)."""
    drawn = [isinstance(quantity, Uniform) for quantity in quantities]
    low = np.array([smallest(quantity) for quantity in quantities])
    high = np.array([quantity.uniform[1] if isinstance(quantity, Uniform) else quantity for quantity in quantities])
    shares = np.zeros((len(uniforms), len(quantities)))
    shares[:, drawn] = uniforms
    return low + (high - low) * shares


def _make_vectors(polar: np.ndarray, robots: int) -> np.ndarray:
    """Return the vectors of all bodies, zero for robots, of the objects' lengths and angles, shape (N, n, 2)."""
    from impact_envs.stream import write_directions  # reading a scenario does not wait for the compiler

    worlds, objects = len(polar), polar.shape[1] // 2
    directions = np.empty((worlds * objects, 2))
    write_directions(polar[:, 1::2].ravel(), directions)
    vectors = np.zeros((worlds, robots + objects, 2))
    vectors[:, robots:] = polar[:, 0::2, None] * directions.reshape(worlds, objects, 2)
    return vectors

"""What is believed of free-flyers' physics, what is true, and how true worlds are drawn.

A disturbance is a field of `Truth`, which says how it is drawn, and a column of `Physics`, which
`FreeFlyerScenario.draw_many` fills and the engine reads.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Literal, NamedTuple

import numpy as np
from pydantic import AfterValidator, Field

from impact_envs.scenario import SMALLEST, NonNegative, Positive, Quantity, Table, Uniform

Restitution = Annotated[float, Field(ge=0, le=1)]
# What directions and the choice of one of several things are drawn from.
ANGLE, SHARE = Uniform(uniform=(0.0, 2 * math.pi)), Uniform(uniform=(0.0, 1.0))
SIDE = Uniform(uniform=(-1.0, 1.0))
MOST_DELAY = 50  # [control periods]

# Columns of Physics.contact: coefficient of restitution at zero speed; v_e of e(v) = e exp(-v / v_e) [m/s], 0 for
# constant e; Coulomb coefficient.
RESTITUTION, RESTITUTION_SPEED, FRICTION, CONTACT_COLUMNS = range(4)
# Columns of Physics.body: mass [kg], inertia [kg m^2], centre of mass in the body frame from the geometric centre [m],
# acceleration at the start [m/s^2], start from where the scenario says [m], rate at which the acceleration turns
# [rad/s]; greatest deviation of its velocity after an impact per axis [m/s], 1 where only corners of that box occur,
# and the generator from which the next one is drawn.
MASS, INERTIA, OFFSET_X, OFFSET_Y, DRIFT_X, DRIFT_Y, START_X, START_Y, TURN = range(9)
DEVIATION, CORNERS, DICE, BODY_COLUMNS = range(9, 13)
DICE_MODULUS = 2147483647.0  # a state of that generator is a whole number from 1 to before this
# Columns of Physics.thruster, each positive and negative per channel Fx, Fy, torque: true over commanded force at the
# start; share of it that is lost per second [1/s].
GAIN, FADE, THRUSTER_COLUMNS = 0, 6, 12
# Columns of Physics.sensor: control periods between event and observation; how often readings are lost [1/s].
DELAY, DROPOUT, SENSOR_COLUMNS = range(3)


class Believed(Table):
    """The physics that planner and expert compute with."""

    restitution: Restitution  # coefficient of restitution
    friction: NonNegative = 0.0  # Coulomb coefficient at contacts


class Drawn(NamedTuple):
    """How a quantity of `Truth` is drawn.

    Attributes:
        per: drawn anew for every ``world``, ``robot`` or ``object``.
        beside: what else is drawn each time, after it, for example a direction.
        spare: nothing is drawn beside it where it is zero.
        whole: a whole number, each from the least to the greatest equally likely.
    """

    per: Literal["world", "robot", "object"] = "world"
    beside: tuple[Uniform, ...] = ()
    spare: bool = False
    whole: bool = False


def smallest(quantity: Quantity) -> float:
    """Return the smallest value a quantity can take."""
    return quantity.uniform[0] if isinstance(quantity, Uniform) else quantity


def largest(quantity: Quantity) -> float:
    """Return the largest value a quantity can take."""
    return quantity.uniform[1] if isinstance(quantity, Uniform) else quantity


def _at_least_zero(quantity: Quantity) -> Quantity:
    if smallest(quantity) < 0:
        raise ValueError("must not be negative")
    return quantity


def _above_zero(quantity: Quantity) -> Quantity:
    if smallest(quantity) < SMALLEST:
        raise ValueError(f"must be above 0, and not below {SMALLEST:g}")
    return quantity


def _at_most_one(quantity: Quantity) -> Quantity:
    if isinstance(quantity, Uniform) and quantity.uniform[1] > 1:
        raise ValueError(f"reaches {quantity.uniform[1]:g}, above 1")
    return quantity


def _whole_steps(quantity: int | Uniform) -> int | Uniform:
    ends = quantity.uniform if isinstance(quantity, Uniform) else (quantity,)
    if not all(end == int(end) and 0 <= end <= MOST_DELAY for end in ends):
        raise ValueError(f"must be whole numbers from 0 to {MOST_DELAY}")
    return quantity


Size = Annotated[Quantity, AfterValidator(_at_least_zero)]
Scale = Annotated[Quantity, AfterValidator(_above_zero)]
Share = Annotated[Restitution | Uniform, AfterValidator(_at_least_zero), AfterValidator(_at_most_one)]


class Truth(Table):
    """The physics of the simulated world, numbers or distributions; unset means as believed, undisturbed.

    What is drawn stands in the order of drawing, so that worlds of one seed share what they can: add at the end.
    """

    restitution: Annotated[Share | None, Drawn()] = None  # coefficient of restitution, at zero speed
    friction: Annotated[Size | None, Drawn()] = None  # Coulomb coefficient at contacts
    robot_mass_scale: Annotated[Scale, Drawn("robot")] = 1.0  # true mass over believed mass
    object_mass_scale: Annotated[Scale, Drawn("object")] = 1.0  # true mass over believed mass
    restitution_speed: Annotated[Size, Drawn()] = 0.0  # v_e of e(v) = restitution exp(-v / v_e) [m/s]; 0 = constant
    center_of_mass_offset: Annotated[Size, Drawn("object", (ANGLE,))] = 0.0  # in a random body direction [m]
    drift: Annotated[Size, Drawn("object", (ANGLE,))] = 0.0  # constant acceleration, random direction [m/s^2]
    thruster_gain: Annotated[Size, Drawn("robot")] = 1.0  # true over commanded force
    # Further gain of one thruster: of a random robot, along x or y, positive or negative.
    weak_thruster: Annotated[Size, Drawn("world", (SHARE, SHARE, SHARE))] = 1.0
    # An object starts anywhere in its box of start_uncertainty: 1 in all of it, 0 at its centre.
    start_spread: Annotated[Share, Drawn("object", (SIDE, SIDE), spare=True)] = 0.0
    drift_turn: Annotated[Quantity, Drawn("object")] = 0.0  # rate at which the drift's direction turns [rad/s]
    # Share of its force that one thruster of each robot, along x or y, positive or negative, loses evenly by the
    # horizon.
    thruster_fade: Annotated[Share, Drawn("robot", (SHARE, SHARE), spare=True)] = 0.0
    # Control periods between event and observation.
    delay_steps: Annotated[int | Uniform, AfterValidator(_whole_steps), Drawn(whole=True)] = 0
    # How often all readings of bodies are lost on their way, for `dropout_seconds`: the last ones that arrived are
    # repeated. Felt impacts are the robots' own and arrive [1/s].
    dropout_rate: Annotated[Size, Drawn()] = 0.0
    # Each impact of a robot adds up to so much per axis to the object's velocity, drawn anew, and takes the momentum
    # from the robot's; in half of the worlds anything up to it, in the others it or its opposite [m/s].
    impact_deviation: Annotated[Size, Drawn("object", (SHARE, SHARE), spare=True)] = 0.0
    robot_start_x: Annotated[Quantity, Drawn("robot")] = 0.0  # start of every robot, from where it is believed [m]
    robot_start_y: Annotated[Quantity, Drawn("robot")] = 0.0  # the same along y [m]
    object_start_x: Annotated[Quantity, Drawn("object")] = 0.0  # start of every object, from where it is believed [m]
    object_start_y: Annotated[Quantity, Drawn("object")] = 0.0  # the same along y [m]

    dropout_seconds: Positive = 1.0  # [s]
    thruster_on_off: bool = False  # thrusters are off or full at the control rate
    position_noise: NonNegative = 0.0  # standard deviation per axis [m]
    velocity_measured: bool = True  # otherwise velocity is a filtered difference of positions

    @property
    def moves_bodies(self) -> bool:
        """Return whether in any world a centre of mass is offset, or anything is moved but by what the law says."""
        moved = ("center_of_mass_offset", "drift", "start_spread", "impact_deviation")
        return self.moves_starts or any(getattr(self, name) != 0.0 for name in moved)

    @property
    def moves_starts(self) -> bool:
        """Return whether in any world a robot or an object starts beside where it is believed, but for its box."""
        return any(getattr(self, f"{kind}_start_{axis}") != 0.0 for kind in ("robot", "object") for axis in "xy")

    @property
    def changes_thrusters(self) -> bool:
        """Return whether in any world a thruster does not do as it is told."""
        return self.thruster_fade != 0.0 or any(
            getattr(self, name) != 1.0 for name in ("thruster_gain", "weak_thruster")
        )


class Physics(NamedTuple):
    """True worlds: the numbers drawn for one episode, or with a leading axis N for those of N worlds.

    Bodies are in the scenario's order, so the first are the robots; the columns are named at the top of this file.

    Attributes:
        contact: shape (3,).
        body: shape (n, 12); what is not mass, inertia or start is zero for robots.
        thruster: shape (robots, 12).
        sensor: shape (2,).
        true: what is not drawn.
    """

    contact: np.ndarray
    body: np.ndarray
    thruster: np.ndarray
    sensor: np.ndarray
    true: Truth


def list_drawn(true: Truth, believed: Believed, robots: int, objects: int) -> dict[str, tuple[Quantity, ...]]:
    """Return what true worlds are made of, by field of `Truth` in the order of drawing."""
    counts = {"world": 1, "robot": robots, "object": objects}
    drawn = {}
    for name, field in Truth.model_fields.items():
        for how in field.metadata:
            if isinstance(how, Drawn):
                value = getattr(true, name)
                quantity = getattr(believed, name) if value is None else value
                if how.whole and isinstance(quantity, Uniform):
                    low, high = quantity.uniform
                    quantity = Uniform(uniform=(low, high + 1))
                beside = () if how.spare and quantity == 0.0 else how.beside
                drawn[name] = (quantity, *beside) * counts[how.per]
    return drawn


def draw_thrusters(drawn: Mapping[str, np.ndarray], horizon: float) -> np.ndarray:
    """Return ``Physics.thruster`` of N worlds, in which what fades does so by the horizon [s]."""
    worlds, robots = drawn["thruster_gain"].shape
    gains, fades = np.empty((worlds, robots, 3, 2)), np.zeros((worlds, robots, 3, 2))
    gains[:] = drawn["thruster_gain"][:, :, None, None]
    weakest, which = np.split(drawn["weak_thruster"], (1,), axis=1)
    robot, channel, sign = (which * (robots, 2, 2)).astype(int).T
    gains[np.arange(worlds), robot, channel, sign] *= weakest[:, 0]
    fade = drawn["thruster_fade"]
    if fade.shape[1] > robots:  # directions are drawn beside it
        lost, *places = np.moveaxis(fade.reshape(worlds, robots, 3), 2, 0)
        channel, sign = (2 * np.array(places)).astype(int)
        fades[np.arange(worlds)[:, None], np.arange(robots), channel, sign] = lost / horizon
    return np.concatenate([part.reshape(worlds, robots, -1) for part in (gains, fades)], axis=2)


def draw_columns(drawn: Mapping[str, tuple[Quantity, ...]], uniforms: np.ndarray) -> dict[str, np.ndarray]:
    """Return the numbers of each world, low + (high - low) u where they are drawn, by name, shapes (N, quantities)."""
    quantities = [quantity for row in drawn.values() for quantity in row]
    low = np.array([smallest(quantity) for quantity in quantities])
    high = np.array([quantity.uniform[1] if isinstance(quantity, Uniform) else quantity for quantity in quantities])
    shares = np.zeros((len(uniforms), len(quantities)))
    shares[:, [isinstance(quantity, Uniform) for quantity in quantities]] = uniforms
    ends = np.cumsum([len(row) for row in drawn.values()])
    return dict(zip(drawn, np.split(low + (high - low) * shares, ends[:-1], axis=1), strict=True))


def make_vectors(polar: np.ndarray) -> np.ndarray:
    """Return the vectors of objects' lengths and angles, which alternate in each row, shape (N, objects, 2)."""
    from impact_envs.stream import write_directions  # reading a scenario does not wait for the compiler

    worlds, objects = len(polar), polar.shape[1] // 2
    directions = np.empty((worlds * objects, 2))
    write_directions(polar[:, 1::2].ravel(), directions)
    return polar[:, 0::2, None] * directions.reshape(worlds, objects, 2)

"""Tables of a floating-manipulator scenario: base, arm, box, motors, thrusters, and the draw of one true world."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from impact_envs.compiled import interpret
from impact_envs.elementary import atan2, cos_sin
from impact_envs.errors import InputError, choices
from impact_envs.floating_manipulator.contact import compute_contact
from impact_envs.floating_manipulator.stability import find_longest_period
from impact_envs.physics.multibody import Chain, compute_directions, compute_point, make_chain
from impact_envs.scenario import (
    SMALLEST,
    Box,
    Finite,
    Name,
    NonNegative,
    Positive,
    Quantity,
    Scenario,
    Table,
    Uniform,
    Vector,
    draw,
)
from impact_envs.stl import SIGNALS, Formula, parse

Restitution = Annotated[float, Field(ge=0, le=1)]
PARTS = ("tip", "box", "target", "base")


class Motor(Table):
    """Limits of a motor: |u + stall_torque / no_load_speed * speed| <= stall_torque (Nekoo et al., Eq. 34)."""

    stall_torque: Positive  # [N m]
    no_load_speed: Positive  # [rad/s]


class Base(Table):
    """The floating base that carries the arm."""

    start: Vector  # position of the centre of mass [m]
    heading: Finite = 0.0  # [rad]
    mass: Positive  # [kg]
    inertia: Positive  # about the centre of mass [kg m^2]
    mount: Vector = (0.0, 0.0)  # joint 1 in the base's frame, from its centre of mass [m]
    size: tuple[Positive, Positive] = (1.0, 1.0)  # as drawn; the base touches nothing [m]


class Link(Motor):
    """One link of the arm, and the motor of the joint that carries it."""

    mass: Positive  # [kg]
    inertia: Positive  # about the centre of mass [kg m^2]
    length: Positive  # [m]
    center_of_mass: NonNegative  # from the joint [m]


class Load(Table):
    """The load at the arm's tip: a disc that touches the box."""

    mass: NonNegative = 0.0  # [kg]
    inertia: NonNegative = 0.0  # [kg m^2]
    radius: Positive = 0.001  # positive, because a point has no normal at a corner of the box [m]


class Arm(Table):
    """Start of the arm, at rest, and goal of its tip."""

    goal: Vector  # of the tip [m]
    joints: tuple[Finite, ...] | None = None  # relative angles at the start [rad]
    tip: Vector | None = None  # or, with three links: the tip at the start [m]
    last_heading: Finite = 0.0  # absolute heading of the last link there [rad]
    elbow: Literal["positive", "negative"] = "positive"  # sign of the second joint angle there

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        if (self.joints is None) == (self.tip is None):
            raise ValueError("give either joints or tip")
        return self


class FloatingBox(Table):
    """The free box, at rest at the start."""

    start: Vector  # of the centre [m]
    heading: Finite = 0.0  # [rad]
    size: tuple[Positive, Positive]  # length and width along its own axes [m]
    mass: Positive  # [kg]
    inertia: Positive  # about the centre [kg m^2]


class Thrusters(Table):
    """On/off thrusters of the base, along the world's axes as in the paper."""

    force: Positive  # of each when on [N]
    dead_zone: NonNegative = 0.0  # smaller commands leave them off [N]


class Believed(Table):
    """The physics that the expert computes with, in addition to the masses of the tables above."""

    restitution: Restitution  # coefficient of restitution


class Truth(Table):
    """The physics of the simulated world, numbers or distributions; unset means as believed."""

    restitution: Restitution | Uniform | None = None  # coefficient of restitution, at zero speed
    restitution_speed: Quantity = 0.0  # e(v) = restitution * exp(-v / restitution_speed) [m/s]; 0 = constant
    box_mass_scale: Quantity = 1.0  # true mass and inertia over believed ones
    base_mass_scale: Quantity = 1.0  # true mass and inertia over believed ones
    load_mass_scale: Quantity = 1.0  # true mass and inertia over believed ones
    box_offset_x: Quantity = 0.0  # true start of the box minus the one in the file [m]
    box_offset_y: Quantity = 0.0  # the same along y [m]
    box_turn: Quantity = 0.0  # true heading of the box minus the one in the file [rad]
    stall_torque_scale: Quantity = 1.0  # of every joint's motor
    no_load_speed_scale: Quantity = 1.0  # of every joint's motor
    thruster_gain: Quantity = 1.0  # true over nominal force
    position_noise: NonNegative = 0.0  # standard deviation per axis, of every body's measurement [m]
    speed_noise: NonNegative = 0.0  # the same of velocities [m/s]
    heading_noise: NonNegative = 0.0  # of headings, so that joint angles have sqrt(2) times as much [rad]
    rate_noise: NonNegative = 0.0  # of their rates [rad/s]
    delay_steps: Annotated[int, Field(ge=0, le=50)] = 0  # control periods between event and observation

    @model_validator(mode="after")
    def _limits(self) -> Self:
        for name in type(self).model_fields:
            low = _range(getattr(self, name))[0]
            if name.endswith("_scale") and low < SMALLEST:
                raise ValueError(f"{name} must be above 0, and not below {SMALLEST:g}")
            if name in ("restitution", "restitution_speed", "thruster_gain") and low < 0:
                raise ValueError(f"{name} must not be negative")
        if isinstance(self.restitution, Uniform) and self.restitution.uniform[1] > 1:
            raise ValueError(f"restitution reaches {self.restitution.uniform[1]:g}, above 1")
        return self


def _range(quantity: Quantity | None) -> tuple[float, float]:
    if isinstance(quantity, Uniform):
        return quantity.uniform
    return (0.0, 0.0) if quantity is None else (quantity, quantity)


@dataclass(frozen=True)
class Physics:
    """One true world: the numbers drawn for one episode.

    Attributes:
        restitution: coefficient of restitution at zero speed.
        restitution_speed: e(v) = restitution * exp(-v / restitution_speed) [m/s]; 0 = constant.
        chain: base, links and load.
        box_mass, box_inertia: [kg], [kg m^2].
        box_start: x, y, heading of the box at the start, shape (3,) [m], [rad].
        stall_torque, no_load_speed: of the joints' motors, shape (n,) [N m], [rad/s].
        thruster_force: of each thruster when on [N].
    """

    restitution: float
    restitution_speed: float
    chain: Chain
    box_mass: float
    box_inertia: float
    box_start: np.ndarray
    stall_torque: np.ndarray
    no_load_speed: np.ndarray
    thruster_force: float = 0.0


class FloatingManipulatorScenario(Scenario):
    """An arm on a floating base that moves its tip to a goal and hits a free box on the way."""

    suite_file: ClassVar[Path | None] = Path(__file__).parent / "suites.toml"

    domain: Literal["floating_manipulator"]
    world: Box  # that is drawn; bodies may leave it
    base: Base
    links: dict[str, Link]
    load: Load = Load()
    arm: Arm
    box: FloatingBox
    thrusters: Thrusters | None = None
    wheel: Motor | None = None  # acts on the base as an external torque, as in the paper
    safety_pause: NonNegative = 0.0  # after an impact, without control of the tip [s]
    requirements: dict[Name, str] = {}  # additional formulas, by name, that are evaluated for every episode
    believed: Believed
    true: Truth = Truth()

    @property
    def agents(self) -> tuple[str, ...]:
        """Return ``arm`` and, where it is actuated, ``base``."""
        return ("arm",) if self.thrusters is None and self.wheel is None else ("arm", "base")

    @property
    def bodies(self) -> tuple[str, ...]:
        """Return base, links, tip, box, and the goal as ``target``: the canonical order of all arrays."""
        return ("base", *self.links, "tip", "box", "target")

    @property
    def signals(self) -> tuple[str, ...]:
        """Return the signals of bodies; not every body has every signal (see ``extra_signals``)."""
        return (*SIGNALS, *dict.fromkeys(name.partition(".")[2] for name in self.extra_signals))

    @cached_property
    def extra_signals(self) -> tuple[str, ...]:
        """Return the signals other than position and velocity of the bodies (see the task)."""
        return (
            *(f"{link}.{name}" for link in self.links for name in ("joint_velocity", "torque")),
            *(f"{body}.{name}" for body in ("base", "box") for name in ("momentum_x", "momentum_y")),
            *("base.angular_momentum", "box.angular_momentum", "tip.impulse", "tip.since_impact"),
        )

    @cached_property
    def required(self) -> dict[str, Formula]:
        """Return the parsed requirements."""
        return {name: parse(text) for name, text in self.requirements.items()}

    @property
    def largest_commands(self) -> dict[str, np.ndarray]:
        """Return the commands of an action of 1.

        Three times the stall torques: motors deliver them when they brake at twice their no-load speed.

        Returns:
            ``arm``: joint torques, shape (n,) [N m]; where the base is actuated, ``base``: forces along the world's
            axes and torque, shape (3,) [N], [N m].
        """
        arm = np.array([3.0 * link.stall_torque for link in self.links.values()])
        force = self.thrusters.force if self.thrusters else 1.0
        torque = 3.0 * self.wheel.stall_torque if self.wheel else 1.0
        limits = {"arm": arm, "base": np.array([force, force, torque])}
        return {agent: limits[agent] for agent in self.agents}

    @cached_property
    def start(self) -> np.ndarray:
        """Return the coordinates at the start: base x, y, psi, joints, shape (n + 3,) [m], [rad]."""
        joints = self.arm.joints if self.arm.joints is not None else self._solve_joints()
        return np.array([*self.base.start, self.base.heading, *joints])

    def chain(self, base_scale: float = 1.0, load_scale: float = 1.0) -> Chain:
        """Return base, links and load as believed, with masses and inertias scaled.

        Args:
            base_scale, load_scale: true over believed mass.
        """
        links = [(link.mass, link.inertia, link.length, link.center_of_mass) for link in self.links.values()]
        base = (self.base.mass * base_scale, self.base.inertia * base_scale)
        return make_chain(base, self.base.mount, links, (self.load.mass * load_scale, self.load.inertia * load_scale))

    def shorten(self, scale: float) -> Self:
        """Return the scenario with horizon and every time in formula and requirements scaled (see Scenario).

        Args:
            scale: factor in (0, 1] for tighter tasks.
        """
        bare = Scenario.shorten(self.override({"requirements": {}}), scale)
        required = {name: self._shorten_formula(formula, bare.horizon) for name, formula in self.required.items()}
        return bare.override({"requirements": required})

    def as_believed(self) -> Self:
        """Return the scenario as the expert sees it: the true physics are the believed ones."""
        return self.model_copy(update={"true": Truth()})

    def draw(self, rng: np.random.Generator) -> Physics:
        """Draw one true world.

        Args:
            rng: the episode's generator; the order of draws is fixed.

        Returns:
            The numbers of one episode.
        """
        true, links = self.true, self.links.values()
        restitution = self.believed.restitution if true.restitution is None else draw(true.restitution, rng)
        restitution_speed = draw(true.restitution_speed, rng)
        box_scale, base_scale, load_scale = (
            draw(scale, rng) for scale in (true.box_mass_scale, true.base_mass_scale, true.load_mass_scale)
        )
        offset = [draw(part, rng) for part in (true.box_offset_x, true.box_offset_y, true.box_turn)]
        stall_scale, speed_scale = draw(true.stall_torque_scale, rng), draw(true.no_load_speed_scale, rng)
        return Physics(
            restitution=restitution,
            restitution_speed=restitution_speed,
            chain=self.chain(base_scale, load_scale),
            box_mass=self.box.mass * box_scale,
            box_inertia=self.box.inertia * box_scale,
            box_start=np.array([*self.box.start, self.box.heading]) + offset,
            stall_torque=stall_scale * np.array([link.stall_torque for link in links]),
            no_load_speed=speed_scale * np.array([link.no_load_speed for link in links]),
            thruster_force=draw(true.thruster_gain, rng) * (self.thrusters.force if self.thrusters else 0.0),
        )

    def _solve_joints(self) -> tuple[float, float, float]:
        """Return the joint angles that bring the tip of three links to its start."""
        if len(self.links) != 3:
            raise ValueError(f"arm.tip: needs three links, there are {len(self.links)}; give arm.joints")
        assert self.arm.tip is not None
        a1, a2, a3 = (link.length for link in self.links.values())
        find_direction, find_angle = interpret(cos_sin), interpret(atan2)
        (dx, dy), (bx, by), last = self.base.mount, self.base.start, self.arm.last_heading
        (c, s), (c3, s3) = find_direction(self.base.heading), find_direction(last)
        x = self.arm.tip[0] - a3 * c3 - bx - c * dx + s * dy
        y = self.arm.tip[1] - a3 * s3 - by - s * dx - c * dy
        # tan(elbow / 2)^2 = (1 - cos(elbow)) / (1 + cos(elbow)), with the law of cosines.
        square = x * x + y * y
        far, near = (a1 + a2) * (a1 + a2) - square, square - (a1 - a2) * (a1 - a2)
        if min(far, near) < 0.0:
            raise ValueError(
                f"arm.tip = {list(self.arm.tip)} with last_heading {last:g} is out of reach: the last link would start "
                f"{math.hypot(x, y):.3g} m from joint 1, the links before it span {abs(a1 - a2):g} to {a1 + a2:g} m"
            )
        elbow = 2.0 * find_angle(math.sqrt(far), math.sqrt(near)) * (1.0 if self.arm.elbow == "positive" else -1.0)
        c, s = find_direction(elbow)
        first = find_angle(y, x) - find_angle(a2 * s, a1 + a2 * c)
        return first - self.base.heading, elbow, math.remainder(last - first - elbow, math.tau)

    @model_validator(mode="after")
    def _placed(self) -> Self:
        if not self.links:
            raise ValueError("links: at least one is needed")
        for name in self.links:
            if name in PARTS:
                raise ValueError(f"links: '{name}' names another part; those are {', '.join(PARTS)}")
        if self.arm.joints is not None and len(self.arm.joints) != len(self.links):
            raise ValueError(f"arm.joints has {len(self.arm.joints)} angles for {len(self.links)} links")
        self._check_motors()
        self._check_formulas()
        gap, room = self._start_gap(), self._box_room()
        if gap <= 0:
            raise ValueError(f"arm: the tip starts inside the box, by {-gap:.3g} m")
        if gap <= room:
            raise ValueError(f"true: offsets of the box reach {room:.3g} m, the tip starts {gap:.3g} m from it")
        return self

    def _check_motors(self) -> None:
        """Raise unless motors that hold their torque over a control period brake in every draw."""
        true, motors = self.true, [self.wheel, *self.links.values()]
        stall, speed = _range(true.stall_torque_scale)[1], _range(true.no_load_speed_scale)[0]
        damping = [motor.stall_torque / motor.no_load_speed if motor else 0.0 for motor in motors]
        damping[1:] = [stall / speed * drop for drop in damping[1:]]
        try:
            chain = self.chain(_range(true.base_mass_scale)[0], _range(true.load_mass_scale)[0])
            motor, longest = find_longest_period(chain, np.array(damping))
        except np.linalg.LinAlgError:
            raise ValueError("links: masses, inertias and lengths are too far apart to be simulated") from None
        if self.control_period > longest:
            name, worst = ["wheel", *(f"links.{name}" for name in self.links)][motor], motors[motor]
            assert worst is not None
            raise ValueError(
                f"control_period = {self.control_period:g}: {name}.stall_torque = {worst.stall_torque:g} with "
                f"{name}.no_load_speed = {worst.no_load_speed:g} is stable up to {longest:.2g}"
            )

    def _check_formulas(self) -> None:
        """Raise unless the formulas use known signals and times up to the horizon."""
        known = [f"{body}.{name}" for body in self.bodies for name in SIGNALS] + list(self.extra_signals)
        try:
            formulas = {"formula": self.specification}
            for name in self.requirements:
                formulas[f"requirements.{name}"] = self.required[name]
        except InputError as error:
            raise ValueError(f"requirements: {error}") from None
        for key, formula in formulas.items():
            try:
                formula.check_names(self.bodies, tuple(self.areas), self.signals)
                formula.reach(self.control_period)
            except InputError as error:
                raise ValueError(f"{key}: {error}") from None
            for signal in formula.expand(self.bodies).signals():
                if signal not in known:
                    raise ValueError(f"{key}: signal '{signal}' is unknown; {choices(signal, known)}")
            if formula.horizon > self.horizon * (1 + 1e-9):
                raise ValueError(f"{key}: looks {formula.horizon:g} s ahead, the horizon is {self.horizon:g} s")

    def _start_gap(self) -> float:
        """Return the distance between tip and box at the start, negative in overlap [m]."""
        chain, n, rest = self.chain(), len(self.links), np.zeros(len(self.start))
        w, rates = np.zeros((n + 1, 2)), np.zeros(n + 1)
        interpret(compute_directions)(chain, self.start, rest, w, rates)
        tip = interpret(compute_point)(self.start, rest, w, rates, chain.levers[-1])
        (length, width), (x, y) = self.box.size, self.box.start
        box = (x, y, self.box.heading, 0.0, 0.0, 0.0)
        return float(interpret(compute_contact)(tip, self.load.radius, box, length / 2, width / 2).gap)

    def _box_room(self) -> float:
        """Return the greatest distance between a point of the true box and of the box in the file [m]."""
        ranges: Mapping[str, tuple[float, float]] = {
            name: _range(getattr(self.true, name)) for name in ("box_offset_x", "box_offset_y", "box_turn")
        }
        x, y, turn = (max(map(abs, pair)) for pair in ranges.values())
        return math.hypot(x, y) + turn * math.hypot(*self.box.size) / 2

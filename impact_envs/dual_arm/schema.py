"""Tables of a dual-arm scenario: arms, pads, box, table, what is believed, what is true, and the draw of one world."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from impact_envs.compiled import interpret
from impact_envs.dual_arm.arm import make_arm, solve_inverse_kinematics
from impact_envs.dual_arm.stability import compute_inverse_masses, find_contact_step, find_stiffest_joint
from impact_envs.elementary import cos_sin
from impact_envs.errors import InputError
from impact_envs.scenario import (
    SMALLEST,
    Box,
    Finite,
    NonNegative,
    Positive,
    Quantity,
    Scenario,
    Table,
    Uniform,
    Vector,
    draw,
)
from impact_envs.stl import SIGNALS

MOST_STEPS = 10_000  # of the integration in a control period
# A pad corner deeper inside the box than this came in through another face [m].
DEEPEST = 0.05
Three = tuple[Positive, Positive, Positive]
# Signals of an arm, beside its pad's motion, and of the box, which has the worst of both arms. In the last control
# period: least and greatest normal force at the pads' corners [N], greatest joint torque, greatest change of a joint
# torque from tick to tick [N m]. Since reset: greatest net slip of a corner since the grasp [m], delay of the pad's
# first touch after the other's [s], time from the first touch to the grasp [s], time of a torque at its limit since the
# first touch [s].
GRASP_SIGNALS = ("force_min", "force_max", "torque", "torque_step", "slip", "lag", "interim", "limit_time")


class Pose(Table):
    """A place and an angle in the plane."""

    position: Vector  # x and y [m]
    heading: Finite = 0.0  # [rad]

    @property
    def array(self) -> np.ndarray:
        """Return x, y, heading, shape (3,) [m, rad]."""
        return np.array([*self.position, self.heading])


class Arm(Table):
    """Base and start of one arm; the first arm pushes the box's face at -x, the second the face at +x."""

    base: Vector  # of the first joint [m]
    elbow: Literal[-1, 1]  # sign of the second joint's angle
    start: Pose  # of the pad; x of the pad's frame points out of it


class Links(Table):
    """The links, joints and pad that both arms have."""

    lengths: Three  # [m]
    masses: Three  # [kg]
    centers: Three  # distance of each centre of mass from the link's joint [m]
    inertias: Three  # about the centres of mass [kg m^2]
    torque_limits: Three  # [N m]
    pad_half_height: Positive  # [m]


class Joints(Table):
    """Springs of the joints, and the motors behind them under their torque loop."""

    flexible: bool = True  # otherwise joints have no springs
    stiffness: Three  # [N m/rad]
    damping: tuple[NonNegative, NonNegative, NonNegative]  # [N m s/rad]
    motor_inertia: Three  # [kg m^2]
    shaped_inertia: Three  # apparent motor inertia under the torque loop [kg m^2]


class Surface(Table):
    """Compliant contact: exponentially extended Hunt-Crossley normal force, smoothed Coulomb friction."""

    stiffness: Positive  # k [N/m^c]
    damping: NonNegative  # d [N s/m^(c+1)]
    exponent: Annotated[float, Field(ge=1, le=3)] = 1.0  # c
    friction: NonNegative  # Coulomb coefficient, mu
    friction_slope: Positive = 1e3  # epsilon [s/m]


class GraspBox(Table):
    """The box as believed; the true box rests on the table, which is aligned with it."""

    start: Pose  # of the centre
    half_width: Positive  # along its own x axis [m]
    half_height: Positive  # along its own y axis [m]
    mass: Positive  # [kg]

    @property
    def inertia(self) -> float:
        """Return the inertia of the filled rectangle about its centre [kg m^2]."""
        return self.mass * (self.half_width * self.half_width + self.half_height * self.half_height) / 3.0


class Believed(Table):
    """Conservative values that the controller computes with."""

    friction: Positive  # of the pads; not above the true friction


class Truth(Table):
    """The physics of the simulated world, numbers or distributions; unset means as believed."""

    box_x: Quantity = 0.0  # true minus believed position of the box [m]
    box_y: Quantity = 0.0  # the same along y [m]
    box_heading: Quantity = 0.0  # the same of its heading [rad]
    mass_scale: Quantity = 1.0  # true mass of the box over the believed one
    friction: Quantity | None = None  # of the pads, Coulomb coefficient
    stiffness_scale: Quantity = 1.0  # of the pads, damping with it
    joint_stiffness_scale: Quantity = 1.0  # of both arms' joints
    start_x: Quantity = 0.0  # true minus planned start of each pad, drawn per arm [m]
    start_y: Quantity = 0.0  # the same along y [m]
    start_heading: Quantity = 0.0  # the same of its heading [rad]

    @model_validator(mode="after")
    def _limits(self) -> Self:
        for name in ("mass_scale", "stiffness_scale", "joint_stiffness_scale"):
            if find_smallest(getattr(self, name)) < SMALLEST:
                raise ValueError(f"{name} must be above 0, and not below {SMALLEST:g}")
        return self


def compute_corners(*quantities: Quantity) -> np.ndarray:
    """Return all combinations of the extreme values of quantities, shape (combinations, quantities)."""
    ends = [set(q.uniform) if isinstance(q, Uniform) else {q} for q in quantities]
    return np.array(list(itertools.product(*ends)))


def find_smallest(quantity: Quantity) -> float:
    """Return the smallest value a quantity can take."""
    return quantity.uniform[0] if isinstance(quantity, Uniform) else quantity


@dataclass(frozen=True)
class Physics:
    """One true world: the numbers drawn for one episode.

    Attributes:
        box: x, y, heading at the start, shape (3,) [m, rad].
        mass, inertia: of the box [kg], [kg m^2].
        friction: of the pads.
        stiffness, damping: of the pads [N/m^c], [N s/m^(c+1)].
        joint_stiffness: of both arms' joints, shape (3,) [N m/rad].
        starts: pose of each pad, shape (2, 3) [m, rad].
    """

    box: np.ndarray
    mass: float
    inertia: float
    friction: float
    stiffness: float
    damping: float
    joint_stiffness: np.ndarray
    starts: np.ndarray


class DualArmScenario(Scenario):
    """Two planar arms that grasp a box by hitting it from both sides, and carry it to a target."""

    suite_file: ClassVar[Path | None] = Path(__file__).parent / "suites.toml"

    domain: Literal["dual_arm"]
    tick: Positive = 1e-3  # over which joint torques are held [s]
    physics_step: Positive = 5e-5  # of the integration [s]
    gravity: NonNegative = 9.81  # along -y [m/s^2]
    world: Box
    arms: dict[str, Arm]
    links: Links
    joints: Joints
    box: GraspBox
    target: Pose  # of the box at the end
    pads: Surface
    table: Surface
    believed: Believed
    true: Truth = Truth()

    @property
    def agents(self) -> tuple[str, ...]:
        """Return the arms' names, in file order."""
        return tuple(self.arms)

    @property
    def bodies(self) -> tuple[str, ...]:
        """Return the arms (their pads), then the box: the canonical order of all arrays."""
        return (*self.arms, "box")

    @property
    def signals(self) -> tuple[str, ...]:
        """Return the signals of a body: its motion, and the record of the grasp."""
        return (*SIGNALS, *GRASP_SIGNALS)

    @property
    def ticks(self) -> int:
        """Return the number of ticks in a control period."""
        return round(self.control_period / self.tick)

    @property
    def substeps(self) -> int:
        """Return the number of integration steps in a tick."""
        return round(self.tick / self.physics_step)

    def arm_numbers(self) -> np.ndarray:
        """Return a row of `arm.make_arm` for each arm, shape (2, 14)."""
        links = self.links
        return np.array(
            [
                make_arm(arm.base, links.lengths, links.masses, links.centers, links.inertias, self.gravity)
                for arm in self.arms.values()
            ]
        )

    def joint_angles(self, poses: np.ndarray) -> np.ndarray:
        """Return the joint angles at which the pads have given poses.

        Args:
            poses: of each arm's pad, shape (2, 3) [m, rad].

        Returns:
            Shape (2, 3) [rad].

        Raises:
            InputError: out of reach.
        """
        arms = zip(self.arms.items(), self.arm_numbers(), poses, strict=True)
        angles = []
        for (name, arm), numbers, pose in arms:
            try:
                angles.append(solve_inverse_kinematics(numbers, pose, arm.elbow))
            except InputError as error:
                raise InputError(f"arms.{name}: {error}") from None
        return np.array(angles)

    def contact_poses(self, box: np.ndarray) -> np.ndarray:
        """Return the poses of pads that touch the middles of their faces of a box.

        Args:
            box: x, y, heading, shape (3,) [m, rad].

        Returns:
            Shape (2, 3) [m, rad].
        """
        axis = self.box.half_width * np.array(interpret(cos_sin)(float(box[2])))
        return np.array([[*(box[:2] - axis), box[2]], [*(box[:2] + axis), box[2] + math.pi]])

    def as_believed(self) -> Self:
        """Return the scenario as the expert sees it: the true physics are the believed ones."""
        return self.model_copy(update={"true": Truth()})

    def draw(self, rng: np.random.Generator) -> Physics:
        """Draw one true world.

        Args:
            rng: the episode's generator; the order of draws is fixed, so that suites share draws of one seed.

        """
        true = self.true
        offset = np.array([draw(true.box_x, rng), draw(true.box_y, rng), draw(true.box_heading, rng)])
        mass = draw(true.mass_scale, rng)
        friction = self.pads.friction if true.friction is None else draw(true.friction, rng)
        stiffness = draw(true.stiffness_scale, rng)
        joints = draw(true.joint_stiffness_scale, rng)
        shifts = [[draw(true.start_x, rng), draw(true.start_y, rng), draw(true.start_heading, rng)] for _ in self.arms]
        return Physics(
            box=self.box.start.array + offset,
            mass=self.box.mass * mass,
            inertia=self.box.inertia * mass,
            friction=friction,
            stiffness=self.pads.stiffness * stiffness,
            damping=self.pads.damping * stiffness,
            joint_stiffness=np.array(self.joints.stiffness) * joints,
            starts=np.array([arm.start.array for arm in self.arms.values()]) + np.array(shifts),
        )

    @model_validator(mode="after")
    def _possible(self) -> Self:
        if len(self.arms) != 2:
            raise ValueError(f"arms: {len(self.arms)} given, 2 are needed")
        for name, short, long in (
            ("tick", self.tick, self.control_period),
            ("physics_step", self.physics_step, self.tick),
        ):
            if not math.isclose(round(long / short) * short, long, rel_tol=1e-9):
                raise ValueError(f"{name} = {short:g} does not divide {long:g} into whole parts")
        if self.control_period > MOST_STEPS * self.physics_step * (1 + 1e-9):
            raise ValueError(
                f"physics_step = {self.physics_step:g}: a control period {self.control_period:g} has more than "
                f"{MOST_STEPS} of them"
            )
        true = self.pads.friction if self.true.friction is None else find_smallest(self.true.friction)
        if not self.believed.friction <= true:
            raise ValueError(
                f"believed.friction = {self.believed.friction:g} is above the pads' true friction {true:g}: "
                "forces inside the believed cone would slip"
            )
        self._check_step()
        self._check_places()
        return self

    def _check_step(self) -> None:
        """Raise unless the springs of joints and contacts are stable under the integration step, in every draw."""
        true, joints, box, pads, table = self.true, self.joints, self.box, self.pads, self.table
        found: list[tuple[float, str]] = []
        try:
            inverse, pad = compute_inverse_masses(self.arm_numbers()[0])
            if joints.flexible:
                stiffness, damping = np.array(joints.stiffness), np.array(joints.damping)
                for scale in compute_corners(true.joint_stiffness_scale).ravel():
                    j, step = find_stiffest_joint(inverse, scale * stiffness, damping, np.array(joints.shaped_inertia))
                    named = f"joints.stiffness[{j}] = {stiffness[j]:g} with joints.damping[{j}] = {damping[j]:g}"
                    found.append((step, named))
        except np.linalg.LinAlgError:
            raise ValueError("links: masses, inertias and lengths are too far apart to be simulated") from None
        # Two corners push together: they move what they touch twice as hard as one, or one alone also turns the box.
        press = max(self.links.torque_limits) / min(self.links.lengths)
        for mass, scale in compute_corners(true.mass_scale, true.stiffness_scale):
            move = 1.0 / (mass * box.mass)
            turn_pads, turn_table = (r**2 / (mass * box.inertia) for r in (box.half_height, box.half_width))
            k = scale * pads.stiffness
            depth = min(DEEPEST, (press / k) ** (1.0 / pads.exponent))
            step = find_contact_step(
                pad + move + max(pad + move, turn_pads), k, scale * pads.damping, pads.exponent, depth
            )
            found.append((step, f"pads.stiffness = {pads.stiffness:g} with pads.damping = {pads.damping:g}"))
            depth = (mass * box.mass * self.gravity / 2.0 / table.stiffness) ** (1.0 / table.exponent)
            step = find_contact_step(
                move + max(move, turn_table), table.stiffness, table.damping, table.exponent, depth
            )
            found.append((step, f"table.stiffness = {table.stiffness:g} with table.damping = {table.damping:g}"))
        longest, named = min(found)
        if self.tick / self.substeps > longest:
            raise ValueError(f"physics_step = {self.physics_step:g}: {named} is stable up to {longest:.2g}")

    def _check_places(self) -> None:
        """Raise unless all poses are in reach and the pads outside the box, also for the extreme draws."""
        true = self.true
        starts = np.array([arm.start.array for arm in self.arms.values()])
        shifted = starts + compute_corners(true.start_x, true.start_y, true.start_heading)[:, None]
        boxes = self.box.start.array + compute_corners(true.box_x, true.box_y, true.box_heading)
        places = [("start", starts), ("box.start", self.contact_poses(self.box.start.array))]
        places += [("target", self.contact_poses(self.target.array))]
        places += [("true start", poses) for poses in shifted]
        places += [("true box", self.contact_poses(box)) for box in boxes]
        for key, poses in places:
            try:
                self.joint_angles(poses)
            except InputError as error:
                raise ValueError(f"{key}: {error}") from None
        self._check_apart("start", starts, self.box.start.array)
        for poses, box in itertools.product(shifted, boxes):
            self._check_apart("true start", poses, box)

    def _check_apart(self, key: str, poses: np.ndarray, box: np.ndarray) -> None:
        """Raise unless each pad is in front of its face of the box."""
        for name, side, (x, y, heading) in zip(self.arms, (1.0, -1.0), poses, strict=True):
            for h in (self.links.pad_half_height, -self.links.pad_half_height):
                dx, dy = x - h * math.sin(heading) - box[0], y + h * math.cos(heading) - box[1]
                gap = -side * (math.cos(box[2]) * dx + math.sin(box[2]) * dy) - self.box.half_width
                if gap <= 0:
                    raise ValueError(f"arms.{name}: {key}: the pad is {-gap:.3g} m behind its face of the box")

"""Motion of two arms and a box on a table under held joint torques, in fixed steps.

State, shape (30,): per arm joint angles (3), joint rates (3), motor angles (3), motor rates (3); then the box's x, y,
angle and their rates. Motor angles are behind the joint springs; unused with rigid joints.
Contacts 0, 1 are the corners of arm 1's pad, 2, 3 those of arm 2's, 4, 5 the box's lower corners on the table.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from impact_envs.compiled import compiled, interpret
from impact_envs.dual_arm.arm import L1, L2, L3, X, Y, solve_arm
from impact_envs.dual_arm.schema import DEEPEST, DualArmScenario, Physics
from impact_envs.elementary import cos_sin, power
from impact_envs.physics.contact import compute_friction, compute_normal_force

STATE, ARM, BOX = 30, 12, 24  # size of the state, of an arm's part, and where the box begins
CONTACTS = 6
GAP, GAP_RATE, SLIP_RATE, NORMAL, TANGENTIAL = range(5)  # columns of a contact


class TrueSurface(NamedTuple):
    """Compliance and friction of a surface in the true world.

    Attributes:
        stiffness: k [N/m^c].
        damping: d [N s/m^(c+1)].
        exponent: c.
        friction: mu.
        friction_slope: epsilon [s/m].
    """

    stiffness: float
    damping: float
    exponent: float
    friction: float
    friction_slope: float


class Plant(NamedTuple):
    """The numbers of one true world.

    Attributes:
        arms: rows of `arm.make_arm`, shape (2, 14).
        limits: greatest joint torque, shape (2, 3) [N m].
        flexible: there are joint springs.
        joint_stiffness, joint_damping: of the joint springs, shape (3,) [N m/rad], [N m s/rad].
        motor_inertia, shaped_inertia: of the motors, and as it appears under the torque loop, shape (3,) [kg m^2].
        box_mass, box_inertia: [kg], [kg m^2].
        half_width, half_height: of the box [m].
        gravity: [m/s^2].
        pad_half_height: [m].
        pads: the pads' surface.
        table_pose: x, y of a point of the table's plane [m], cosine and sine of its angle, shape (4,).
        table: the table's surface.
    """

    arms: np.ndarray
    limits: np.ndarray
    flexible: bool
    joint_stiffness: np.ndarray
    joint_damping: np.ndarray
    motor_inertia: np.ndarray
    shaped_inertia: np.ndarray
    box_mass: float
    box_inertia: float
    half_width: float
    half_height: float
    gravity: float
    pad_half_height: float
    pads: TrueSurface
    table_pose: np.ndarray
    table: TrueSurface


def make_plant(scenario: DualArmScenario, physics: Physics) -> Plant:
    """Collect the numbers of a true world: the one place where the drawn physics are unpacked.

    The table lies under the resting box and has its heading.

    Args:
        scenario: who is where.
        physics: the drawn numbers.

    Returns:
        The plant.
    """
    links, joints, box, pads, table = scenario.links, scenario.joints, scenario.box, scenario.pads, scenario.table
    sink = interpret(power)(physics.mass * scenario.gravity / 2.0 / table.stiffness, 1.0 / table.exponent)
    x, y, heading = physics.box
    drop = box.half_height - sink
    c, s = cos_sin(float(heading))
    return Plant(
        arms=scenario.arm_numbers(),
        limits=np.array([links.torque_limits] * 2, dtype=float),
        flexible=joints.flexible,
        joint_stiffness=physics.joint_stiffness,
        joint_damping=np.array(joints.damping),
        motor_inertia=np.array(joints.motor_inertia),
        shaped_inertia=np.array(joints.shaped_inertia),
        box_mass=physics.mass,
        box_inertia=physics.inertia,
        half_width=box.half_width,
        half_height=box.half_height,
        gravity=scenario.gravity,
        pad_half_height=links.pad_half_height,
        pads=TrueSurface(physics.stiffness, physics.damping, pads.exponent, physics.friction, pads.friction_slope),
        table_pose=np.array([x + drop * s, y - drop * c, c, s]),
        table=TrueSurface(table.stiffness, table.damping, table.exponent, table.friction, table.friction_slope),
    )


@compiled
def compute_pad_contact(
    plant: Plant,
    s: np.ndarray,
    c: float,
    d: float,
    side: float,
    x: float,
    y: float,
    vx: float,
    vy: float,
    contact: np.ndarray,
) -> None:
    """Write gap, rates and forces of one pad corner against its face of the box.

    With r the corner in the box frame: gamma = -side r_x - half width, sigma = r_y. Faces end at the box's height.

    Args:
        plant: numbers of the world.
        s: state, shape (30,).
        c, d: cosine and sine of the box's angle.
        side: 1 for the face at -x, -1 for the one at +x.
        x, y: the corner [m].
        vx, vy: its velocity [m/s].
        contact: gap [m], gap rate, slip rate [m/s], normal and tangential force on the box [N], written, shape (5,).

    Source: van Steen et al., Eqs. 5 to 7.
    """
    dx, dy = x - s[BOX], y - s[BOX + 1]
    ux, uy = vx - s[BOX + 3], vy - s[BOX + 4]
    rx, ry = c * dx + d * dy, c * dy - d * dx
    rate_x, rate_y = c * ux + d * uy + s[BOX + 5] * ry, c * uy - d * ux - s[BOX + 5] * rx
    gap = -side * rx - plant.half_width
    normal, pads = 0.0, plant.pads
    if -DEEPEST < gap < 0.0 and abs(ry) <= plant.half_height:
        normal = compute_normal_force(gap, -side * rate_x, pads.stiffness, pads.damping, pads.exponent)
    contact[GAP], contact[GAP_RATE], contact[SLIP_RATE] = gap, -side * rate_x, rate_y
    contact[NORMAL] = normal
    contact[TANGENTIAL] = 0.0
    if normal > 0.0:
        contact[TANGENTIAL] = compute_friction(normal, rate_y, pads.friction, pads.friction_slope)


@compiled
def push_box(s: np.ndarray, force: np.ndarray, x: float, y: float, fx: float, fy: float) -> None:
    """Add a force at a point to the resultant force and torque on the box.

    Args:
        s: state, shape (30,).
        force: force and torque about the box's centre, added to, shape (3,) [N, N m].
        x, y: the point [m].
        fx, fy: the force [N].
    """
    force[0] += fx
    force[1] += fy
    force[2] += (x - s[BOX]) * fy - (y - s[BOX + 1]) * fx


@compiled
def move_arm(
    plant: Plant,
    i: int,
    tau: np.ndarray,
    s: np.ndarray,
    c: float,
    d: float,
    ds: np.ndarray,
    contacts: np.ndarray,
    force: np.ndarray,
) -> None:
    """Write the derivative of one arm's state, and add the forces of its pad on the box.

    Rigid joints feel the commanded torque. Flexible ones feel tau_a = K (theta - q) + D (theta' - q'), and their
    motors B theta'' + tau_a = tau_m under the loop tau_m = B Bt^-1 u + (1 - B Bt^-1) tau_a, so Bt theta'' + tau_a = u.

    Args:
        plant: numbers of the world.
        i: arm, 0 or 1.
        tau: commanded torques u, shape (2, 3) [N m].
        s: state, shape (30,).
        c, d: cosine and sine of the box's angle.
        ds: its derivative, written in the arm's part, shape (30,).
        contacts: written in the arm's rows, shape (6, 5).
        force: on the box, added to, shape (3,) [N, N m].

    Source: van Steen et al., Eq. 3; torque loop: Albu-Schäffer et al. (2007), Eq. 7.
    """
    n = i * ARM
    arm = plant.arms[i]
    a1 = s[n]
    a2 = a1 + s[n + 1]
    a3 = a2 + s[n + 2]
    w1 = s[n + 3]
    w2 = w1 + s[n + 4]
    w3 = w2 + s[n + 5]
    (c1, d1), (c2, d2), (c3, d3) = directions = cos_sin(a1), cos_sin(a2), cos_sin(a3)
    x1, y1 = arm[L1] * c1, arm[L1] * d1
    x2, y2 = arm[L2] * c2, arm[L2] * d2
    x3, y3 = arm[L3] * c3, arm[L3] * d3
    x, y = arm[X] + x1 + x2 + x3, arm[Y] + y1 + y2 + y3
    vx, vy = -y1 * w1 - y2 * w2 - y3 * w3, x1 * w1 + x2 * w2 + x3 * w3
    f1, f2, f3 = 0.0, 0.0, 0.0
    side = 1.0 - 2.0 * i
    for k in range(2):
        h = plant.pad_half_height * (1.0 - 2.0 * k)
        rx, ry = -h * d3, h * c3
        contact = contacts[2 * i + k]
        compute_pad_contact(plant, s, c, d, side, x + rx, y + ry, vx - w3 * ry, vy + w3 * rx, contact)
        if contact[NORMAL] > 0.0:
            normal, tangential = side * contact[NORMAL], contact[TANGENTIAL]
            fx, fy = c * normal - d * tangential, d * normal + c * tangential
            push_box(s, force, x + rx, y + ry, fx, fy)
            f1 += y1 * fx - x1 * fy
            f2 += y2 * fx - x2 * fy
            f3 += y3 * fx - x3 * fy - (rx * fy - ry * fx)
    t1, t2, t3 = tau[i, 0], tau[i, 1], tau[i, 2]
    for j in range(3):
        ds[n + j] = s[n + 3 + j]
        ds[n + 6 + j] = 0.0
        ds[n + 9 + j] = 0.0
    if plant.flexible:
        K, D, B, shaped = plant.joint_stiffness, plant.joint_damping, plant.motor_inertia, plant.shaped_inertia
        t1 = K[0] * (s[n + 6] - s[n]) + D[0] * (s[n + 9] - s[n + 3])
        t2 = K[1] * (s[n + 7] - s[n + 1]) + D[1] * (s[n + 10] - s[n + 4])
        t3 = K[2] * (s[n + 8] - s[n + 2]) + D[2] * (s[n + 11] - s[n + 5])
        for j in range(3):
            spring = t1 if j == 0 else (t2 if j == 1 else t3)
            ratio = B[j] / shaped[j]
            motor = ratio * tau[i, j] + (1.0 - ratio) * spring
            ds[n + 6 + j] = s[n + 9 + j]
            ds[n + 9 + j] = (motor - spring) / B[j]
    b1, b2, b3 = solve_arm(arm, directions, w1, w2, w3, f1 + t1 - t2, f2 + t2 - t3, f3 + t3)
    ds[n + 3], ds[n + 4], ds[n + 5] = b1, b2 - b1, b3 - b2


@compiled
def support_box(plant: Plant, s: np.ndarray, c: float, d: float, contacts: np.ndarray, force: np.ndarray) -> None:
    """Write the table's contacts with the box's lower corners, and add their forces on the box.

    Args:
        plant: numbers of the world.
        s: state, shape (30,).
        c, d: cosine and sine of the box's angle.
        contacts: rows 4 and 5 are written, shape (6, 5).
        force: on the box, added to, shape (3,) [N, N m].
    """
    table_x, table_y, tx, ty = plant.table_pose[0], plant.table_pose[1], plant.table_pose[2], plant.table_pose[3]
    table = plant.table
    for k in range(2):
        bx, by = (2.0 * k - 1.0) * plant.half_width, -plant.half_height
        rx, ry = c * bx - d * by, d * bx + c * by
        px, py = s[BOX] + rx, s[BOX + 1] + ry
        vx, vy = s[BOX + 3] - s[BOX + 5] * ry, s[BOX + 4] + s[BOX + 5] * rx
        gap = tx * (py - table_y) - ty * (px - table_x)
        rate, slip = tx * vy - ty * vx, tx * vx + ty * vy
        normal = compute_normal_force(gap, rate, table.stiffness, table.damping, table.exponent)
        contact = contacts[4 + k]
        contact[GAP], contact[GAP_RATE], contact[SLIP_RATE] = gap, rate, slip
        contact[NORMAL] = normal
        contact[TANGENTIAL] = 0.0
        if normal > 0.0:
            tangential = compute_friction(normal, slip, table.friction, table.friction_slope)
            contact[TANGENTIAL] = tangential
            push_box(s, force, px, py, -ty * normal - tx * tangential, tx * normal - ty * tangential)


@compiled
def compute_derivative(
    plant: Plant, tau: np.ndarray, s: np.ndarray, ds: np.ndarray, contacts: np.ndarray, force: np.ndarray
) -> None:
    """Write the derivative of the state and the contacts.

    Args:
        plant: numbers of the world.
        tau: commanded torques, shape (2, 3) [N m].
        s: state, shape (30,).
        ds: its derivative, written, shape (30,).
        contacts: rows gap, gap rate, slip rate, normal, tangential, written, shape (6, 5).
        force: written: force and torque on the box without gravity, shape (3,) [N, N m].

    Source: van Steen et al., Eqs. 3 and 4.
    """
    force[0] = force[1] = force[2] = 0.0
    c, d = cos_sin(s[BOX + 2])
    for i in range(2):
        move_arm(plant, i, tau, s, c, d, ds, contacts, force)
    support_box(plant, s, c, d, contacts, force)
    for j in range(3):
        ds[BOX + j] = s[BOX + 3 + j]
    ds[BOX + 3] = force[0] / plant.box_mass
    ds[BOX + 4] = force[1] / plant.box_mass - plant.gravity
    ds[BOX + 5] = force[2] / plant.box_inertia


@compiled
def advance_state(
    plant: Plant,
    tau: np.ndarray,
    s: np.ndarray,
    steps: int,
    h: float,
    work: np.ndarray,
    contacts: np.ndarray,
    sums: np.ndarray,
) -> None:
    """Move the state forward under held torques, by classical Runge-Kutta steps.

    Args:
        plant: numbers of the world.
        tau: commanded torques, shape (2, 3) [N m].
        s: state, then the new state, shape (30,).
        steps: number of steps.
        h: length of a step [s].
        work: scratch, shape (6, 30).
        contacts: at the new state, written, shape (6, 5).
        sums: slip and normal impulse of the pad corners, added to, shape (4, 2) [m, N s].
    """
    k1, k2, k3, k4, mid, force = work[0], work[1], work[2], work[3], work[4], work[5, :3]
    for _ in range(steps):
        compute_derivative(plant, tau, s, k1, contacts, force)
        for k in range(4):
            if contacts[k, NORMAL] > 0.0:
                sums[k, 0] += h * contacts[k, SLIP_RATE]
                sums[k, 1] += h * contacts[k, NORMAL]
        for j in range(STATE):
            mid[j] = s[j] + 0.5 * h * k1[j]
        compute_derivative(plant, tau, mid, k2, contacts, force)
        for j in range(STATE):
            mid[j] = s[j] + 0.5 * h * k2[j]
        compute_derivative(plant, tau, mid, k3, contacts, force)
        for j in range(STATE):
            mid[j] = s[j] + h * k3[j]
        compute_derivative(plant, tau, mid, k4, contacts, force)
        for j in range(STATE):
            s[j] += h / 6.0 * (k1[j] + 2.0 * k2[j] + 2.0 * k3[j] + k4[j])
    compute_derivative(plant, tau, s, k1, contacts, force)

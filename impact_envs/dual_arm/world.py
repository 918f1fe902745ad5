"""N worlds of two arms and a box as arrays of records, and one control period of them; compiled.

The single environment is N = 1.
"""

from __future__ import annotations

import numpy as np

from impact_envs.compiled import compiled, inlined
from impact_envs.dual_arm.arm import compute_dynamics, compute_kinematics
from impact_envs.dual_arm.grasp_record import COUNT, START_MARKS, GraspRecord, add_tick, begin_period
from impact_envs.dual_arm.plant import (
    ARM,
    BOX,
    CONTACTS,
    GAP_RATE,
    NORMAL,
    STATE,
    TANGENTIAL,
    Plant,
    TrueSurface,
    advance_state,
    make_plant,
)
from impact_envs.dual_arm.schema import DualArmScenario, Physics
from impact_envs.elementary import cos_sin

# Columns of the true state of a body.
JOINTS, RATES, FORCES, KEPT, WIDTH = slice(6, 9), slice(9, 12), slice(12, 14), slice(14, 22), 22
# Columns of a pad's first touch: time [s], point [m], normal, impulse on the box [N s], speed of approach [m/s].
TIME, POINT, ALONG, IMPULSE, SPEED, TOUCH = 0, 1, 3, 5, 7, 8

SURFACE = np.dtype([(name, float) for name in TrueSurface._fields])
# The numbers of a true world, see `plant.Plant`.
PLANT = np.dtype(
    [
        ("arms", float, (2, 14)),
        ("limits", float, (2, 3)),
        ("flexible", np.int64),
        ("joint_stiffness", float, 3),
        ("joint_damping", float, 3),
        ("motor_inertia", float, 3),
        ("shaped_inertia", float, 3),
        ("box_mass", float),
        ("box_inertia", float),
        ("half_width", float),
        ("half_height", float),
        ("gravity", float),
        ("pad_half_height", float),
        ("pads", SURFACE),
        ("table_pose", float, 4),
        ("table", SURFACE),
    ]
)
# What is true of a world now.
WORLD = np.dtype(
    [
        ("state", float, STATE),  # see `plant`
        ("contacts", float, (CONTACTS, 5)),  # at the last tick, see `plant`
        ("sums", float, (4, 2)),  # slip and normal impulse of the pad corners since reset [m, N s]
        ("values", float, (3, 8)),  # the grasp's record, see `grasp_record`
        ("marks", np.int64, 5),
        ("slips", float, 4),
        ("torques", float, (2, 3)),
        ("touched", np.int64, 2),  # whether each pad has touched the box
        ("touches", float, (2, TOUCH)),  # of the last control period, where `hits` has 1
        ("hits", np.int64, 2),
        ("rows", float, (3, WIDTH)),  # true state of both pads and the box, see `DualArmModel.state`
    ]
)
# How time is divided.
CLOCK = np.dtype([("ticks", np.int64), ("tick", float), ("substeps", np.int64), ("step", float)])


def make_clock(scenario: DualArmScenario) -> np.ndarray:
    """Return ticks in a control period, their length [s], steps in a tick, their length [s]: a CLOCK, shape (1,)."""
    clock = np.zeros(1, CLOCK)
    clock["ticks"], clock["tick"], clock["substeps"] = scenario.ticks, scenario.tick, scenario.substeps
    clock["step"] = scenario.tick / scenario.substeps
    return clock


def start_world(
    scenario: DualArmScenario, physics: Physics, plants: np.ndarray, worlds: np.ndarray, k: int = 0
) -> Plant:
    """Put pads and box of world k at their starts, at rest, with the joint springs bent by the arms' weight.

    Args:
        scenario: who is where.
        physics: the drawn numbers of the episode.
        plants, worlds: PLANT and WORLD, row k is written, shape (N,).
        k: the world.

    Returns:
        The plant.
    """
    made = make_plant(scenario, physics)
    for name, value in made._asdict().items():
        plants[k][name] = tuple(value) if isinstance(value, TrueSurface) else value
    worlds[k] = np.zeros((), WORLD)
    world = worlds[k]
    world["marks"] = START_MARKS
    set_joints(made, world, scenario.joint_angles(physics.starts), np.zeros((2, 3)))
    world["state"][BOX : BOX + 3] = physics.box
    return made


def set_joints(plant: Plant, world: np.void, q: np.ndarray, v: np.ndarray) -> None:
    """Set the joints of a world, with their springs bent by the arms' weight.

    Args:
        plant: its numbers.
        world: a WORLD, changed.
        q, v: joint angles and rates, shape (2, 3) [rad], [rad/s].
    """
    M, load = np.zeros((3, 3)), np.zeros(3)
    for i in range(2):
        compute_dynamics(plant.arms[i], q[i], np.zeros(3), M, load)
        deflection = load / plant.joint_stiffness
        world["state"][ARM * i : ARM * (i + 1)] = [*q[i], *v[i], *(q[i] + deflection), *v[i]]


@inlined
def get_plant(plant: np.record) -> Plant:
    """Return a PLANT as the physics take it."""
    pads, table = plant.pads, plant.table
    return Plant(
        plant.arms,
        plant.limits,
        plant.flexible > 0,
        plant.joint_stiffness,
        plant.joint_damping,
        plant.motor_inertia,
        plant.shaped_inertia,
        plant.box_mass,
        plant.box_inertia,
        plant.half_width,
        plant.half_height,
        plant.gravity,
        plant.pad_half_height,
        TrueSurface(pads.stiffness, pads.damping, pads.exponent, pads.friction, pads.friction_slope),
        plant.table_pose,
        TrueSurface(table.stiffness, table.damping, table.exponent, table.friction, table.friction_slope),
    )


@inlined
def get_record(world: np.record) -> GraspRecord:
    """Return the record of a world's grasp."""
    return GraspRecord(world.values, world.marks, world.slips, world.torques)


@compiled
def advance_tick(plant: np.record, world: np.record, clock: np.record, work: np.ndarray, tau: np.ndarray) -> None:
    """Advance a world by one tick of held torques.

    Args:
        plant, world, clock: PLANT, WORLD and CLOCK.
        work: scratch, shape (6, 30).
        tau: of each arm's joints, clipped to their limits in place, shape (2, 3) [N m].
    """
    numbers = get_plant(plant)
    sums = world.sums
    n0, n1, n2, n3 = sums[0, 1], sums[1, 1], sums[2, 1], sums[3, 1]
    for i in range(2):
        for j in range(3):
            tau[i, j] = min(max(tau[i, j], -plant.limits[i, j]), plant.limits[i, j])
    advance_state(numbers, tau, world.state, clock.substeps, clock.step, work, world.contacts, world.sums)
    add_tick(get_record(world), world.contacts, world.sums, tau, plant.limits, clock.tick)
    for i in range(2):
        normal = (sums[0, 1] - n0) + (sums[1, 1] - n1) if i == 0 else (sums[2, 1] - n2) + (sums[3, 1] - n3)
        if world.touched[i] == 0 and normal > 0.0:
            record_touch(plant, world, clock, i, normal)


@inlined
def record_touch(plant: np.record, world: np.record, clock: np.record, i: int, normal: float) -> None:
    """Write the first touch of pad i, with the impulse up to the end of its tick.

    Args:
        plant, world, clock: see `advance_tick`.
        i: arm, 0 or 1.
        normal: impulse along the normal in the tick [N s].
    """
    world.touched[i] = world.hits[i] = 1
    first, second, touch = world.contacts[2 * i], world.contacts[2 * i + 1], world.touches[i]
    side = 1.0 - 2.0 * i
    c, d = cos_sin(world.state[BOX + 2])
    nx, ny = side * c, side * d
    ratio = (first[TANGENTIAL] + second[TANGENTIAL]) / max(first[NORMAL] + second[NORMAL], 1e-12)
    touch[TIME] = world.marks[COUNT] * clock.tick
    touch[POINT] = world.state[BOX] - plant.half_width * nx
    touch[POINT + 1] = world.state[BOX + 1] - plant.half_width * ny
    touch[ALONG], touch[ALONG + 1] = nx, ny
    touch[IMPULSE], touch[IMPULSE + 1] = normal * (nx - ratio * d), normal * (ny + ratio * c)
    touch[SPEED] = max(0.0, -min(first[GAP_RATE], second[GAP_RATE]))


@inlined
def begin_world_period(world: np.record) -> None:
    """Clear what describes the last control period."""
    begin_period(get_record(world))
    world.hits[0] = world.hits[1] = 0


@compiled
def write_rows(plant: np.record, world: np.record, work: np.ndarray) -> None:
    """Write the true state of both pads and the box, see `DualArmModel.state`.

    Args:
        plant, world: PLANT and WORLD; `rows` are written.
        work: scratch, shape (6, 30).
    """
    s, rows = world.state, world.rows
    for i in range(2):
        n, pose, drift = ARM * i, work[0], work[1]
        J = work[2:5, :3]
        q, v = s[n : n + 3], s[n + 3 : n + 6]
        compute_kinematics(plant.arms[i], q, v, pose, J, drift)
        row = rows[i]
        row[0], row[1], row[4] = pose[0], pose[1], pose[2]
        row[2] = J[0, 0] * v[0] + J[0, 1] * v[1] + J[0, 2] * v[2]
        row[3] = J[1, 0] * v[0] + J[1, 1] * v[1] + J[1, 2] * v[2]
        row[5] = J[2, 0] * v[0] + J[2, 1] * v[1] + J[2, 2] * v[2]
        for j in range(3):
            row[6 + j], row[9 + j] = q[j], v[j]
        for k in range(2):
            row[12 + k] = world.contacts[2 * i + k, NORMAL]
    box = rows[2]
    box[0], box[1], box[4] = s[BOX], s[BOX + 1], s[BOX + 2]
    box[2], box[3], box[5] = s[BOX + 3], s[BOX + 4], s[BOX + 5]
    for i in range(3):
        for j in range(8):
            rows[i, 14 + j] = world.values[i, j]


# What `run_model` does.
TICK, PERIOD, ROWS = range(3)


@compiled
def run_model(
    plants: np.ndarray, worlds: np.ndarray, clock: np.ndarray, work: np.ndarray, torques: np.ndarray, part: int
) -> None:
    """Advance the first world, for Python.

    Args:
        plants, worlds, clock: PLANT, WORLD and CLOCK, shape (1,).
        work: scratch, shape (6, 30).
        torques: of each tick, clipped in place, shape (ticks, 2, 3) [N m].
        part: TICK, one tick; PERIOD, a control period; or ROWS, write the true state.
    """
    if part == PERIOD:
        begin_world_period(worlds[0])
        for k in range(clock[0].ticks):
            advance_tick(plants[0], worlds[0], clock[0], work, torques[k])
    elif part == TICK:
        advance_tick(plants[0], worlds[0], clock[0], work, torques[0])
    else:
        write_rows(plants[0], worlds[0], work)

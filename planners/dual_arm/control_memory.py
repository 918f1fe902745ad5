"""What the compiled control of two arms reads and writes: one law for all worlds, a memory for each, scratch a thread.

Arrays of records: a compiled call takes one array where it would take dozens, and fields have names.
"""

from __future__ import annotations

from dataclasses import fields

import numpy as np

from impact_envs.compiled import inlined
from impact_envs.dual_arm.schema import DualArmScenario
from impact_envs.elementary import cos_sin
from impact_envs.errors import InputError
from planners.dual_arm.grasp_qp import PostGains
from planners.dual_arm.options import ControllerOptions
from planners.dual_arm.reference import AnteField, ImpactMap, PostField
from planners.dual_arm.terms import TERMS, Terms
from planners.dual_arm.torque_qp import FREE, GRASP, QDD, AnteGains, InterimGains, TorqueQP, make_program_type
from planners.goldfarb_idnani import Workspace, make_workspace_type

ANTE, INTERIM, POST = range(3)
PHASES = ("ante", "interim", "post")
NEVER = -1  # tick of what has not happened

# What the control of all worlds shares: all of `options.ControllerOptions` but the impact's velocity, switches as 0 and
# 1, and what is believed of arms, box and pads; see `reference.AnteField` and `grasp_qp.PostGains`.
LAW = np.dtype(
    [
        *((field.name, float) for field in fields(ControllerOptions) if field.name != "impact_velocity"),
        ("tick", float),  # over which torques are held [s]
        ("dwell_ticks", np.int64),
        ("arms", float, (2, 14)),
        ("limits", float, (2, 3)),
        ("points", float, (2, 2)),
        ("velocities", float, (2, 2)),
        ("headings", float, 2),
        ("believed_box", float, 3),
        ("target", float, 3),
        ("friction", float),
        ("mass", float),
        ("inertia", float),
        ("gravity", float),
        ("half_height", float),
        ("rho", float),  # of the impact map
    ]
)

# What is remembered of one world.
CONTROL = np.dtype(
    [
        ("q", float, (2, 3)),  # measured: joint angles, rates, normal forces at the pads' corners
        ("v", float, (2, 3)),
        ("forces", float, 4),
        ("phase", np.int64),
        ("ticks", np.int64),  # controlled since the start
        ("touched", np.int64),  # tick of the first contact
        ("full", np.int64),  # ticks for which all corners have pressed
        ("grasped", np.int64),  # tick at which the phase after the impact began
        ("heights", float, 2),  # of both pads in the believed box's frame at the first contact [m]
        ("integrated", float, (2, 3)),  # poses along the reference since the first contact [m, rad]
        ("torques", float, (2, 3)),  # of the last tick [N m]
        ("step", float, (2, 3)),  # of the torques at full contact, which fades [N m]
        ("solution", float, FREE[0]),  # torques and joint accelerations of the last program; zeros where it has none
        ("box", float, 6),  # estimated state after the impact [m, rad, m/s, rad/s]
        ("predicted", float, 3),  # its twist just after the impact [m/s, rad/s]
        ("start", float, 3),  # its pose then [m, rad]
        ("grip", float),  # as corrected [N]
        ("mass", float),  # [kg]
        ("inertia", float),  # [kg m^2]
        ("built", np.int64),  # program of the last tick, see `phase_machine`
        ("slack", np.int64),  # how often the slack form was used
        ("held", np.int64),  # how often the last torques were held
    ]
)

SCRATCH = np.dtype(
    [
        ("free", make_program_type(FREE)),
        ("grasp", make_program_type(GRASP)),
        ("terms", TERMS),
        ("work", make_workspace_type(GRASP[0], QDD + GRASP[1])),
        ("x", float, GRASP[0]),  # solution
        ("solved", np.int64),  # whether it is one
    ]
)


def make_law(scenario: DualArmScenario, options: ControllerOptions, impact_map: ImpactMap | None) -> np.ndarray:
    """Collect the numbers of the control law.

    Args:
        scenario: as believed.
        options: of the controller.
        impact_map: predicted velocity of the box after the impact; None only if the options do without.

    Returns:
        A LAW, shape (1,).

    Raises:
        InputError: radii that do not enclose the impact points, or no impact map where one is needed.
    """
    if impact_map is None and options.impact_map:
        raise InputError("expert.controller.impact_map = True needs an impact map, none is given")
    law = np.zeros(1, LAW)
    row, field = law[0], make_ante_field(scenario, options)
    for name in LAW.names or ():
        if hasattr(options, name):
            row[name] = getattr(options, name)
    if not options.synchronisation:
        row["w_sync"] = 0.0
    row["tick"] = scenario.control_period
    row["dwell_ticks"] = round(options.dwell / scenario.control_period)
    row["arms"], row["limits"] = scenario.arm_numbers(), [scenario.links.torque_limits] * 2
    row["points"], row["velocities"], row["headings"] = field.points, field.velocities, field.headings
    row["believed_box"], row["target"] = field.box, scenario.target.array
    row["friction"], row["gravity"] = scenario.believed.friction, scenario.gravity
    row["mass"], row["inertia"] = scenario.box.mass, scenario.box.inertia
    row["half_height"] = scenario.links.pad_half_height
    row["rho"] = 0.0 if impact_map is None else impact_map.rho
    return law


def make_ante_field(scenario: DualArmScenario, options: ControllerOptions) -> AnteField:
    """Make the ante-impact reference towards the middles of the believed box's faces.

    Args:
        scenario: as believed.
        options: of the field.

    Raises:
        InputError: the radii do not enclose the impact points.
    """
    box = scenario.box.start.array
    poses = scenario.contact_poses(box)
    r_min, r_max = options.r_min, options.r_max
    if not scenario.box.half_width < r_min < r_max:
        raise InputError(
            f"expert.controller.r_min = {r_min:g} and r_max = {r_max:g}: "
            f"half width of the box {scenario.box.half_width:g} < r_min < r_max is needed"
        )
    c, d = cos_sin(float(box[2]))
    along, across = options.impact_velocity
    velocities = [(c * sign * along - d * across, d * sign * along + c * across) for sign in (1.0, -1.0)]
    return AnteField(
        points=poses[:, :2].copy(),
        velocities=np.array(velocities),
        headings=poses[:, 2].copy(),
        box=box,
        alpha=options.alpha,
        r_min=r_min,
        r_max=r_max,
        kappa_theta=options.kappa_theta,
    )


def make_control(law: np.ndarray, count: int) -> np.ndarray:
    """Return the memory of worlds in which nothing has happened, of type CONTROL, shape (count,)."""
    memory = np.zeros(count, CONTROL)
    memory["touched"] = memory["grasped"] = NEVER
    for name in ("grip", "mass", "inertia"):
        memory[name] = law[name]
    return memory


def make_scratch(law: np.ndarray, threads: int) -> np.ndarray:
    """Return room for threads to build and solve programs in, of type SCRATCH, shape (threads,)."""
    scratch, limits = np.zeros(threads, SCRATCH), law["limits"].ravel()
    for name in ("free", "grasp"):
        scratch[name]["lower"][:, :QDD], scratch[name]["upper"][:, :QDD] = -limits, limits
    scratch["grasp"]["upper"][:, QDD + 15 :] = np.inf  # the cones
    return scratch


def view_program(record: np.void) -> TorqueQP:
    """Return a program of SCRATCH as arrays that share its memory."""
    return TorqueQP(*(record[name] for name in TorqueQP._fields))


@inlined
def get_program(record: np.record) -> TorqueQP:
    """Return a program of SCRATCH, compiled."""
    return TorqueQP(record.H, record.f, record.A, record.lower, record.upper)


@inlined
def get_terms(record: np.record) -> Terms:
    """Return the terms of SCRATCH."""
    return Terms(record.M, record.h, record.pose, record.J, record.drift, record.twist, record.nominal)


@inlined
def get_workspace(record: np.record) -> Workspace:
    """Return the solver's workspace of SCRATCH."""
    return Workspace(
        record.reflectors,
        record.pivots,
        record.scale,
        record.basis,
        record.image,
        record.rows,
        record.factor,
        record.J,
        record.R,
        record.z,
        record.direction,
        record.d,
        record.r,
        record.active,
        record.sign,
        record.u,
    )


@inlined
def get_ante_field(law: np.record) -> AnteField:
    """Return the reference before the impact."""
    return AnteField(
        law.points,
        law.velocities,
        law.headings,
        law.believed_box,
        law.alpha,
        law.r_min,
        law.r_max,
        law.kappa_theta,
    )


@inlined
def get_ante_gains(law: np.record) -> AnteGains:
    """Return gains and weights before the impact."""
    return AnteGains(law.k_p, law.k_theta, law.sync_p, law.sync_d, law.w_p, law.w_theta, law.w_sync)


@inlined
def get_interim_gains(law: np.record) -> InterimGains:
    """Return gains and weights of the interim phase."""
    return InterimGains(law.k_int, law.k_theta_int, law.w_p_int, law.w_theta_int)


@inlined
def get_post_field(law: np.record, memory: np.record) -> PostField:
    """Return the reference after the impact, which begins at the estimated pose and the predicted velocity."""
    return PostField(
        memory.start,
        memory.predicted,
        law.target,
        law.kappa_post,
        law.kappa_theta_post,
        law.r_max_post,
        law.impact_map > 0.0,
    )


@inlined
def get_post_gains(law: np.record, memory: np.record) -> PostGains:
    """Return gains and weights after the impact, with grip and load as corrected."""
    return PostGains(
        law.k_p_post,
        law.k_theta_post,
        law.w_p_post,
        law.w_theta_post,
        law.w_share,
        law.w_normal,
        memory.grip,
        law.friction,
        memory.mass,
        memory.inertia,
        law.gravity,
        law.half_height,
    )

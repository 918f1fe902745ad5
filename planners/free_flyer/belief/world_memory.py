"""What the compiled expert remembers of every world: estimates, courses, coming impacts.

Compiled functions name their arguments alike: `plan`: the table that is followed, `memory`: of all worlds, `k`: world,
`i`, `j`: bodies, `r`: robot, `o`: object (body robots + o), `c`: thread, `z`: a FILTER, `now`: present time [s].
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from impact_envs.compiled import compiled
from impact_envs.free_flyer.sensing import BODY_SIZE
from planners.free_flyer.belief.plan_table import NO_IMPACT, PlanTable
from planners.free_flyer.tracking.course import COURSE
from planners.free_flyer.tracking.mpc import STAGES

NO_OBJECT, NO_ROBOT = -1, -1
NOBODY, UNKNOWN = -2, -1  # in WorldMemory.touch: touched nothing; touched something, but nothing is near

# The estimate of one body, a Kalman filter. Both axes share one covariance, over the complex numbers: real parts are of
# the same axis, imaginary ones of different axes; P_xy = E[x conj(y)]. See `offset`.
FILTER = np.dtype(
    [
        ("position", float, 2),  # of the geometric centre [m]
        ("velocity", float, 2),  # of the centre of mass [m/s]
        ("drift", float, 2),  # constant unknown acceleration [m/s^2]
        ("P_pp", float),  # covariance of position p, velocity v and acceleration a per axis
        ("P_pv", complex),
        ("P_pa", complex),
        ("P_vv", float),
        ("P_va", complex),
        ("P_aa", float),
        ("still", float),  # probability that there is no such acceleration, see `drift`
        ("offset", float, 2),  # of the geometric centre from the centre of mass, in the body's frame, d [m]
        ("P_pd", complex),
        ("P_vd", complex),
        ("P_ad", complex),
        ("P_dd", float),  # 0: the two are one
    ]
)
HEADING = np.dtype(
    [
        ("angle", float),  # [rad]
        ("rate", float),  # [rad/s]
    ]
)
# What is believed of the thrusters of one robot, see `thruster`: +x, -x, +y, -y of the body.
THRUST = np.dtype(
    [
        ("gain", float, 4),  # true over commanded force, as commands take it
        ("estimate", float, 4),  # and as it is estimated
        ("variance", float, 4),  # of the estimate
        ("command", float, 2),  # commanded since the last measurement, in the body's frame [m/s^2]
        ("last", float, 2),  # and before that
        ("push_once", float, 4),  # commands that went through the low pass once [m/s^2],
        ("push_twice", float, 4),  # and twice
        ("once", float, 2),  # the same of the position [m]
        ("twice", float, 2),
        ("ready", float),  # when the low passes begin [s]
    ]
)
# The last reading of one body, see `readings`.
TRACK = np.dtype(
    [
        ("reading", float, BODY_SIZE),  # as it stood in the observation
        ("time", float),  # when anything new was read last, before 0: never [s]
        ("since", float),  # since when readings are impossible but agree with each other; inf if they do not [s]
        ("angle", float),  # that it has, nearest to the heading at the start [rad]
        ("changes", bool),  # whether a reading was ever not the one before it; sensors with a delay repeat the first
        ("use", int),  # what is done with the last one: `readings.MISSING` ... `EXPECTED`
        ("doubted", float),  # until when `old` is kept, -inf if it is not [s]
        ("old", FILTER),  # the estimate as if there had been no surprise
    ],
    align=True,
)
# What is learned of the noise of measured positions.
SENSOR = np.dtype(
    [
        ("sigma", float),  # standard deviation [m]
        ("weight", float),  # of the samples so far
        ("square", float),  # weighted sum of their squares [m^2]
        ("samples", int),  # positions in a row in which nothing happened, at most 3
    ]
)
# The impact that an object waits for.
STRIKE = np.dtype(
    [
        ("index", int),  # of the impact in the plan, or NO_IMPACT
        ("robot", int),  # that hits, or NO_ROBOT
        ("time", float),  # when it is expected, inf if none is left [s]
        ("due", float),  # when it was expected before its robot postponed it [s]
        ("is_inserted", bool),  # it is not in the plan; the planned one, index, comes later
        ("insertions", int),  # impacts on this object that the plan does not have
        ("misses", int),  # how often it was tried in vain
        ("is_decided", bool),  # its correction was asked for
        ("scale", float),  # correction of the impulse's size, in [-1, 1]
        ("turn", float),  # correction of the impulse's direction, in [-1, 1]
        ("shift", float),  # correction of its time, in [-1, 1]
        ("reference_normal", float, 2),  # direction of the impulse as planned, a unit vector
        # The solution of its two-body problem.
        ("is_solved", bool),
        ("is_answered", bool),  # by the plan's response, with the believed physics, see `response.is_answered`
        ("outcome", int),  # a two_body.Outcome
        ("change", float),  # of the object's velocity, its size [m/s]
        ("lever", float),  # of the hit, see `offset.compute_lever`
        ("share", float),  # of the wished change that this is
        ("is_slowed", bool),  # its robot lost its course: it is hit as fast as there is room to run up, see `run_up`
        ("normal", float, 2),  # unit vector from robot to object
        ("contact", float, 2),  # centre of the robot [m]
        ("robot_minus", float, 2),  # velocity of the robot just before and after [m/s]
        ("robot_plus", float, 2),
        ("object_minus", float, 2),  # velocity of the object just before and after [m/s]
        ("object_plus", float, 2),  # of the centre of mass
        # Times [s] at which something happened last.
        ("last_contact", float),  # the object was touched
        ("looked_at", float),  # it was asked whether the impact should be moved, or one inserted
        ("optimised_at", float),  # the rest of the plan was optimised
        ("replanned_at", float),  # the robot's course was planned
        ("astray_since", float),  # the object misses its next knot and no robot can mend it; inf if all is well
    ],
    align=True,
)
# A contact that a robot felt, as the filters saw it.
CONTACT = np.dtype(
    [
        ("approach", float),  # speed of the robot towards the body [m/s]
        ("normal", float, 2),  # unit vector from robot to body
        ("free_velocity", float, 2),  # of the robot, had there been no contact [m/s]
        ("angle", float),  # heading of the body [rad]
        ("lever", float),  # of the hit, see `offset.compute_lever`
        ("object_variance", float),  # of the velocities of object and robot before it [m^2/s^2]
        ("robot_variance", float),
    ]
)
# The last impact of an object.
HIT = np.dtype(
    [
        ("contact", CONTACT),
        ("is_pending", bool),  # it is still observed
        ("is_answered", bool),  # it was a response of the plan
        ("is_beyond", bool),  # a response's deviation was beyond what the plan bears, so it promises nothing any more
        ("time", float),  # [s]
        ("robot", int),  # that hit
        ("before", float, 2),  # velocity of the object before it [m/s]
        ("latest", float, 2),  # velocity of the object a control period ago [m/s]
        ("aim", float, 2),  # velocity of the object after it that was asked for [m/s]
        ("commanded", float),  # change of the object's velocity that was asked for [m/s]
        ("direction", float, 2),  # of that change, a unit vector
        # Observed change along that and across it, to the left, over the commanded one's size: of this impact once it
        # is seen, and of the one before.
        ("observed", float, 2),
        ("earlier", float, 2),
        ("is_seen", bool),  # whether this impact's change was observed
        ("seen", int),  # number of impacts whose change was
        ("gained", float),  # change of the object's velocity along the normal [m/s]
        ("gained_variance", float),  # 0 before it is seen [m^2/s^2]
        ("learned_at", float),  # when it was seen [s]
        ("recoil", float),  # change of the robot's velocity against the normal [m/s]
        ("recoil_variance", float),  # [m^2/s^2]
        ("thrust", float),  # change of the robot's velocity by thrust since then, the way's length [m/s]
        ("watched_at", float),  # when the recoil was looked at last, inf if it is over [s]
        # Of the object's stay at its end, see `stay`.
        ("outside_at", float),  # when it was seen outside last [s]
        ("has_stayed", bool),  # it was inside for as long as it has to
    ],
    align=True,
)
# The inputs that are left of the last MPC that was solved.
SHIFTED = np.dtype(
    [
        ("inputs", float, (STAGES, 3)),  # [N, N, N m]
        ("count", int),  # of the stages that are left
    ]
)
COUNTERS = (
    "replans",
    "retry",
    "give_up",
    "lost",
    "unplanned_contact",
    "inserted",
    "retimed",
    "shifted_plan",
    "lqr",
    "no_measurement",
    "avoided",
    "off_centre",
    "reoptimised",
    "no_optimum",
    "stranded",
    "planned_anew",
    "no_plan",
    "late_plan",
    "lost_plan",
    "rejected",
    "taken_up",
    "no_action",
    "detours",
    "responded",
    "withdrawn",
    "filtered",
)
COUNTS = np.dtype([(name, np.int64) for name in COUNTERS])
# Assigning one of these clears a record.
BLANK_FILTER, BLANK_STRIKE, BLANK_HIT, BLANK_COURSE, BLANK_COUNTS = (
    np.zeros((), dtype)[()] for dtype in (FILTER, STRIKE, HIT, COURSE, COUNTS)
)
SPARE = 6  # impacts that a new plan may have beyond those of the first one
PAST_PERIOD = 0.5  # [s]


class WorldMemory(NamedTuple):
    """What the expert remembers of N worlds with n bodies, r robots, m objects and K planned impacts.

    Attributes:
        time: of the last measurement, shape (N,) [s].
        filter: FILTER of every body, shape (N, n).
        heading: HEADING of every body, shape (N, n).
        recent: the last three measured positions of the objects, oldest first, shape (N, m, 3, 2) [m].
        track: TRACK of every body, shape (N, n).
        sensor: SENSOR, shape (N,).
        push: acceleration of the robots that is expected of the commands since the last measurement, shape (N, r, 2)
            [m/s^2].
        thrust: THRUST of every robot, shape (N, r).
        spin: commanded angular acceleration of the robots since then, shape (N, r) [rad/s^2].
        touch: body that each robot touched, UNKNOWN or NOBODY, shape (N, r).
        course: COURSE of every robot, shape (N, r).
        strike: STRIKE of every object, shape (N, m).
        felt: last CONTACT of every robot, shape (N, r).
        hit: HIT of every object, shape (N, m).
        pair_mean: restitution and log mass ratio of each pair of robot and object; NOW: with the hits that are still
            observed, KNOWN: without them; shape (N, 2, 2 r m).
        pair_covariance: of these numbers, shape (N, 2, 2 r m, 2 r m).
        pair_share: scratch: their covariance with two observed changes, shape (N, 2, 2 r m, 2).
        velocity_error: learned variance of each body's velocity after a control period, beyond that of its filter,
            shape (N, n) [m^2/s^2].
        clock: expected times of the planned impacts, shape (N, K + 6) [s].
        place: wanted positions of the knots, shape (N, K + 6 + m, 2) [m].
        shifted: SHIFTED of every robot, shape (N, r).
        past: estimated positions every half second, shape (N, H, n, 2) [m].
        flown: coefficients of the robots' curves as `PlanTable.coefficients`, with their responses to where the objects
            are at impacts, shape (N, r, S, d + 1, 2) [m]; without responses (0, ...), and the plan's are flown.
        answered: to which place each response is: from its box's centre over the half widths, shape (N, K, 2).
        responded: when each robot's response was looked at last, shape (N, r) [s].
        wanted: when a new plan was first found to be needed, inf if it is not, shape (N,) [s].
        counts: how often what happened, a COUNTS, shape (N,).
    """

    time: np.ndarray
    filter: np.ndarray
    heading: np.ndarray
    recent: np.ndarray
    track: np.ndarray
    sensor: np.ndarray
    push: np.ndarray
    thrust: np.ndarray
    spin: np.ndarray
    touch: np.ndarray
    course: np.ndarray
    strike: np.ndarray
    felt: np.ndarray
    hit: np.ndarray
    pair_mean: np.ndarray
    pair_covariance: np.ndarray
    pair_share: np.ndarray
    velocity_error: np.ndarray
    clock: np.ndarray
    place: np.ndarray
    shifted: np.ndarray
    past: np.ndarray
    flown: np.ndarray
    answered: np.ndarray
    responded: np.ndarray
    wanted: np.ndarray
    counts: np.ndarray


def make_world_memory(plan: PlanTable, count: int) -> WorldMemory:
    """Make the memory of N worlds.

    Args:
        plan: what they follow.
        count: N.
    """
    n, r, planned = len(plan.body), plan.robots, len(plan.impact) + SPARE
    objects = n - r
    pairs = 2 * r * objects
    return WorldMemory(
        time=np.zeros(count),
        filter=np.zeros((count, n), FILTER),
        heading=np.zeros((count, n), HEADING),
        recent=np.zeros((count, objects, 3, 2)),
        track=np.zeros((count, n), TRACK),
        sensor=np.zeros(count, SENSOR),
        push=np.zeros((count, r, 2)),
        thrust=np.zeros((count, r), THRUST),
        spin=np.zeros((count, r)),
        touch=np.zeros((count, r), np.int64),
        course=np.zeros((count, r), COURSE),
        strike=np.zeros((count, objects), STRIKE),
        felt=np.zeros((count, r), CONTACT),
        hit=np.zeros((count, objects), HIT),
        pair_mean=np.zeros((count, 2, pairs)),
        pair_covariance=np.zeros((count, 2, pairs, pairs)),
        pair_share=np.zeros((count, 2, pairs, 2)),
        velocity_error=np.zeros((count, n)),
        clock=np.zeros((count, planned)),
        place=np.zeros((count, planned + objects, 2)),
        shifted=np.zeros((count, r), SHIFTED),
        past=np.zeros((count, math.ceil(plan.horizon / PAST_PERIOD) + 1, n, 2)),
        flown=np.zeros((count if len(plan.response) else 0, *plan.coefficients.shape)),
        answered=np.zeros((count, len(plan.response), 2)),
        responded=np.zeros((count, r)),
        wanted=np.full(count, math.inf),
        counts=np.zeros(count, COUNTS),
    )


@compiled
def find_next_event(plan: PlanTable, memory: WorldMemory, k: int, r: int) -> tuple[float, float, int]:
    """Return when robot r has to be somewhere next: its next impact, or the end of the plan.

    Returns:
        Expected time [s], the plan's time [s], and the number of the impact or NO_IMPACT.
    """
    time, planned, index = plan.horizon, plan.horizon, NO_IMPACT
    for o in range(memory.strike.shape[1]):
        at = memory.strike[k, o].index
        while at != NO_IMPACT:
            if plan.impact[at].robot == r and memory.clock[k, at] < time:
                time, planned, index = memory.clock[k, at], plan.impact[at].time, at
            at = plan.impact[at].next
    return time, planned, index


@compiled
def find_strike(memory: WorldMemory, k: int, r: int) -> int:
    """Return the object that robot r is to hit next, if its turn has come; NO_OBJECT otherwise."""
    best, found = math.inf, NO_OBJECT
    for o in range(memory.strike.shape[1]):
        strike = memory.strike[k, o]
        coming = strike.index != NO_IMPACT or strike.is_inserted
        if coming and strike.robot == r and strike.time < best:
            best, found = strike.time, o
    return found

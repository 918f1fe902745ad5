"""What the compiled expert remembers of every world: estimates, courses, coming impacts."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from impact_envs.compiled import compiled
from planners.free_flyer.belief.plan_table import AT, END, NEXT, ROBOT, PlanTable
from planners.free_flyer.tracking.course import COURSE_SIZE, IMPACT
from planners.free_flyer.tracking.mpc import STAGES

FILTER_SIZE, SENSOR_SIZE = 12, 4
# Columns of strike, the coming impact of an object. IMPACT_INDEX: in the plan, or END if none is left;
# INSERTED: 1 if it is none of the plan; AGENT: robot that hits; SCALE, TURN: correction of the impulse; SOLVED: 1 if
# the two-body problem was solved; LAST: time of the object's last contact; LOOKED, OPTIMISED: times of
# the last retiming and re-optimisation; ASTRAY: since when it misses its next knot with nobody to mend it, or inf.
(
    IMPACT_INDEX,
    INSERTED,
    AGENT,
    TIME,
    MISSES,
    REPLANNED,
    SCALE,
    TURN,
    DECIDED,
    SOLVED,
    LAST,
    LOOKED,
    EXTRA,
    OUTCOME,
    CHANGE,
    N_X,
    N_Y,
    CONTACT_X,
    CONTACT_Y,
    MINUS_X,
    MINUS_Y,
    PLUS_X,
    PLUS_Y,
    OBJECT_X,
    OBJECT_Y,
    REFERENCE_X,
    REFERENCE_Y,
    OPTIMISED,
    ASTRAY,
    STRIKE_SIZE,
) = range(30)
# Columns of felt, the last contact of a robot: estimated approach speed, normal, velocity of the robot without
# it, variances of the velocities of object and robot before it.
APPROACH, HIT_X, HIT_Y, FREE_X, FREE_Y, OBJECT_ERROR, ROBOT_ERROR, FELT_SIZE = range(8)
# Columns of hit, the last impact of an object, after those of WorldMemory.felt. PENDING: 1 while it is observed;
# HIT_BY: robot; BEFORE: velocity before it; LATEST: velocity a step ago; RATIO: observed over commanded change at the
# last impact, 0 before any; SEEN: number of observations; GAINED: change of the object's velocity along the normal,
# GAINED_VARIANCE 0 before it is seen; LEARNED: when it was; RECOIL: change of the robot's against the normal; SPENT:
# change of its velocity by thrust since then; WATCHED: until when.
(
    PENDING,
    HIT_AT,
    HIT_BY,
    BEFORE_X,
    BEFORE_Y,
    LATEST_X,
    LATEST_Y,
    COMMANDED,
    RATIO,
    SEEN,
    GAINED,
    GAINED_VARIANCE,
    LEARNED,
    RECOIL,
    RECOIL_VARIANCE,
    SPENT,
    WATCHED,
    HIT_SIZE,
) = range(FELT_SIZE, FELT_SIZE + 18)
# Columns of sensor.
SIGMA, WEIGHT, SQUARE, SAMPLES = range(SENSOR_SIZE)
# Columns of counts.
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
)
(
    REPLANS,
    RETRY,
    GIVE_UP,
    LOST,
    UNPLANNED,
    INSERTS,
    RETIMED,
    SHIFTED_PLAN,
    LQR,
    NO_MEASUREMENT,
    AVOIDED,
    OFF_CENTRE,
    REOPTIMISED,
    NO_OPTIMUM,
    STRANDED,
    PLANNED_ANEW,
    NO_PLAN,
) = range(len(COUNTERS))
SPARE = 6  # impacts that a new plan may have beyond those of the first one
PAST_PERIOD = 0.5  # [s]
NOBODY, UNKNOWN = -2, -1  # in WorldMemory.touch


class WorldMemory(NamedTuple):
    """What the expert remembers of N worlds with n bodies, r robots, m objects and K planned impacts.

    Attributes:
        time: of the last measurement, shape (N,) [s].
        filter: of every body, see ``estimator``, shape (N, n, 12).
        heading: angle and angular velocity, shape (N, n, 2) [rad, rad/s].
        recent: the last three measured positions of the objects, shape (N, m, 6) [m].
        sensor: what is learned of the noise, shape (N, 4).
        push: commanded acceleration of the robots since the last measurement, shape (N, r, 2) [m/s^2].
        touch: body that each robot touched, UNKNOWN or NOBODY, shape (N, r).
        course: of the robots, shape (N, r, 19).
        strike: coming impact of each object, shape (N, m, 29).
        felt: last contact of each robot, shape (N, r, 7).
        hit: last impact of each object, shape (N, m, 24).
        pair: restitution and log mass ratio of each pair of robot and object, now and without the hits that are still
            observed: mean, covariance, and two columns for computing, shape (N, 2, 2 r m, 2 r m + 3).
        velocity_error: learned variance of each body's velocity after a control period, beyond that of its filter,
            shape (N, n) [m^2/s^2].
        clock: expected times of the planned impacts, shape (N, K + 6) [s].
        place: wanted positions of the knots, shape (N, K + 6 + m, 2) [m].
        shifted: inputs left of the last successful MPC, and how many, shape (N, r, 31).
        past: estimated positions every half second, shape (N, H, n, 2) [m].
        wanted: when a new plan was first found to be needed, inf if it is not, shape (N,) [s].
        counts: of what happened, see COUNTERS, shape (N, 17).
    """

    time: np.ndarray
    filter: np.ndarray
    heading: np.ndarray
    recent: np.ndarray
    sensor: np.ndarray
    push: np.ndarray
    touch: np.ndarray
    course: np.ndarray
    strike: np.ndarray
    felt: np.ndarray
    hit: np.ndarray
    pair: np.ndarray
    velocity_error: np.ndarray
    clock: np.ndarray
    place: np.ndarray
    shifted: np.ndarray
    past: np.ndarray
    wanted: np.ndarray
    counts: np.ndarray


def make_world_memory(plan: PlanTable, count: int) -> WorldMemory:
    """Make the memory of N worlds.

    Args:
        plan: what they follow.
        count: N.
    """
    n, r, planned = len(plan.body), plan.robots, len(plan.impact) + SPARE
    return WorldMemory(
        time=np.zeros(count),
        filter=np.zeros((count, n, FILTER_SIZE)),
        heading=np.zeros((count, n, 2)),
        recent=np.zeros((count, n - r, 6)),
        sensor=np.zeros((count, SENSOR_SIZE)),
        push=np.zeros((count, r, 2)),
        touch=np.zeros((count, r), np.int64),
        course=np.zeros((count, r, COURSE_SIZE)),
        strike=np.zeros((count, n - r, STRIKE_SIZE)),
        felt=np.zeros((count, r, FELT_SIZE)),
        hit=np.zeros((count, n - r, HIT_SIZE)),
        pair=np.zeros((count, 2, 2 * r * (n - r), 2 * r * (n - r) + 3)),
        velocity_error=np.zeros((count, n)),
        clock=np.zeros((count, planned)),
        place=np.zeros((count, planned + n - r, 2)),
        shifted=np.zeros((count, r, 3 * STAGES + 1)),
        past=np.zeros((count, math.ceil(plan.horizon / PAST_PERIOD) + 1, n, 2)),
        wanted=np.full(count, math.inf),
        counts=np.zeros((count, len(COUNTERS)), np.int64),
    )


@compiled
def find_next_event(plan: PlanTable, memory: WorldMemory, k: int, r: int) -> tuple[float, float, int]:
    """Return when robot r has to be somewhere next: expected time, plan's time and number of its next impact, or END.

    Args:
        plan: what is followed.
        memory: of all worlds.
        k: world.
        r: robot.
    """
    time, planned, index = plan.horizon, plan.horizon, END
    for o in range(memory.strike.shape[1]):
        at = int(memory.strike[k, o, IMPACT_INDEX])
        while at != END:
            if plan.impact[at, ROBOT] == r and memory.clock[k, at] < time:
                time, planned, index = memory.clock[k, at], plan.impact[at, AT], at
            at = int(plan.impact[at, NEXT])
    return time, planned, index


@compiled
def find_strike(memory: WorldMemory, k: int, r: int) -> int:
    """Return the object that robot r is to hit next, if its turn has come; END otherwise."""
    best, found = math.inf, END
    for o in range(memory.strike.shape[1]):
        coming = memory.strike[k, o, IMPACT_INDEX] != END or memory.strike[k, o, INSERTED] > 0.0
        if coming and memory.strike[k, o, AGENT] == r and memory.strike[k, o, TIME] < best:
            best, found = memory.strike[k, o, TIME], o
    return found


@compiled
def is_approaching(memory: WorldMemory, k: int, r: int) -> bool:
    """Return whether robot r is on a course to an impact."""
    return memory.course[k, r, IMPACT] > 0.0

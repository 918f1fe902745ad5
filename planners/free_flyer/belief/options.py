"""Options of the closed loop: which parts are on, and every number that somebody chose.

The numbers were chosen in closed loop, on tuning seeds of the shipped scenarios' suites (from 1,000,000); what comes
from elsewhere says so. `make_expert(..., options={"insertion.wall": 0.2})` and `--set expert.insertion.wall=0.2` change
one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from impact_envs.errors import InputError, choices
from planners.free_flyer.tracking.problem import PUBLISHED_WEIGHTS, Weights
from planners.options import Cosine, Count, CountOrNone, Positive, Share, Spread

# Options.tracker in compiled code: by the compiled MPC, by LQR, by an object that Python calls.
BY_MPC, BY_LQR, BY_OBJECT = range(3)


@dataclass(frozen=True)
class Estimation:
    """Numbers of the bodies' Kalman filters."""

    near: float = 0.1  # a felt impact is blamed on a body closer than this gap [m]
    untrusted_jump: float = 0.5  # standard deviation of a modelled velocity jump, relative to its size
    unknown_jump: float = 0.002  # the same, at least [m/s]
    unseen_jump: float = 0.05  # the same, of a robot that felt an impact with nothing near [m/s]
    start_position: float = 1e-3  # standard deviation of a start position from the scenario's [m]
    start_velocity: float = 1e-4  # of a start velocity [m/s]; that it is small makes a small drift visible early
    # Beyond so many standard deviations, and so far, a position tells of an unseen event, such as a bounce off a wall.
    surprise: float = 6.0
    surprise_floor: float = 2e-3  # [m]
    # Readings that no motion explains, but that agree with each other for so long, are taken up: longer than a sensor
    # is usually wrong, and short beside the time between impacts [s].
    patience: Positive = 3.0
    clock_steps: Positive = 10.5  # control periods by which the clock may go on from one reading to the next
    position_prior: Positive = 5e-3  # standard deviation of measured positions until it is estimated [m]
    position_floor: float = 1e-7  # of measured positions, at least [m]
    # Of measured velocities over that of positions per control period; a velocity that comes from differences of noisy
    # positions then hardly counts, an exact one counts fully.
    velocity_ratio: Positive = 100.0
    noise_memory: Positive = 50.0  # samples over which the position noise is estimated
    thrust: float = 4e-3  # unmodelled acceleration of robots [m/s^2],
    thrust_share: float = 0.15  # and this share of what they are pushed with
    flight: float = 1e-5  # unmodelled acceleration of objects [m/s^2]
    kept: float = 3e-4  # the same, of objects that keep their velocity [m/s^2]
    drift: float = 5e-4  # standard deviation of the constant acceleration of an object [m/s^2]
    drift_change: float = 1e-5  # of the drift of a turning object, a random walk [m/s^2 per square root of s]
    still: Share = 0.15  # share of objects that have none
    offset: Positive = 0.02  # of an object's centre of mass from its geometric centre, per axis [m]
    least_turn: float = 1e-4  # slower bodies do not turn: rounding in hits makes them, and no offset shows [rad/s]


@dataclass(frozen=True)
class Thruster:
    """Numbers of the estimate of how strong a robot's thrusters are."""

    spread: Spread = 0.2  # standard deviation of a gain about 1, true over commanded force
    wander: float = 0.02  # of a gain while it pushes, a random walk [per square root of s]
    # Time constant of the low pass: long beside delays of the readings, short beside the time between impacts [s].
    low_pass: Positive = 1.5
    least: float = 5e-3  # filtered acceleration by thrust that tells anything [m/s^2]
    unknown: Share = 0.05  # share of it that is not explained by gains, such as by a delay
    position_floor: Positive = 2e-3  # added to the noise of positions [m]
    settle: float = 2.0  # after a contact, until the velocity of the robot is known [s]
    sure: float = 1.5  # standard deviations by which a gain differs from 1 before anything is made of it
    weakest: Positive = 0.4  # gain that is believed, so that no command grows beyond bounds,
    strongest: Positive = 1.3  # and the greatest


@dataclass(frozen=True)
class ImpactParameters:
    """Numbers of the estimate of restitution and mass ratio of every pair of robot and object."""

    restitution_spread: Spread = 0.18  # standard deviation of a pair's restitution about the believed one
    mass_spread: Spread = 0.17  # of the logarithm of an object's mass; both together give the gain a spread of 13 %
    same_material: Share = 0.9  # correlation of the restitutions of pairs with different objects,
    same_object: Share = 0.97  # and with the same object
    wander: float = 0.05  # standard deviation of a pair's restitution from hit to hit, e.g. by their speed
    thrust_error: float = 2e-3  # of a robot's velocity over one control period, until it is learned [m/s]
    thrust_share: float = 0.1  # share of the velocity change by thrust that is unknown until then
    error_memory: Positive = 20.0  # samples over which such errors are learned
    model_error: float = 0.01  # of the changes of object and robot, independent, relative to the approach speed
    object_floor: float = 5e-5  # of an observed change, at least [m/s]
    recoil_seconds: float = 1.5  # after a hit in which the robot's change is looked for [s]
    slowest: float = 1e-3  # approach that tells anything [m/s]
    iterations: Count = 8  # of Gauss-Newton
    farthest: float = 1.5  # that one hit may move the logarithm of a mass ratio
    # A change that is so many standard deviations from what was seen of it before is not the hit's alone: something
    # else touched the object since, such as another object, and what was seen before counts.
    sure: Positive = 4.0


@dataclass(frozen=True)
class Timing:
    """When impacts are expected, decided, missed and tried again."""

    settle: float = 1.5  # after a contact, until the object's velocity is known well enough to plan with [s]
    decision_lead: float = 8.0  # before an impact its correction is decided [s],
    decision_settle: float = 2.5  # after the previous contact, at least [s]
    replan_window: float = 20.0  # before an impact, in which the course to it is planned anew [s];
    replan_last: float = 1.0  # but no later than this; later changes only shake the robot [s]
    replan_period: Positive = 0.5  # [s]; Verhagen & Tumova, Sec. VI
    earliest: float = 2.0  # before the expected impact a contact is taken for it [s]
    patience: float = 1.5  # after the expected impact it counts as missed [s]
    retry_in: float = 5.0  # a missed impact is tried again after [s]
    retries: CountOrNone = 3
    observable: float = 1.0  # after a contact the object's velocity change can be observed [s]
    learn_period: Positive = 0.5  # between looks at what a hit did [s]
    return_seconds: float = 12.0  # longest quintic back to the plan [s]
    haste: Share = 0.8  # share of the time until a window closes that a flight into it takes
    fast: Positive = 0.225  # speed of such a flight, at most [m/s]
    # Where that is too slow an object may leave where it rests before the window of its stay opens: as it does, the
    # object is still inside after so large a share of the way to the edge. A throw stronger by 1.3 takes it all.
    inside: Share = 0.7
    fastest_clock: Positive = 1.5  # plan seconds per second; more would force the end pose within the few seconds left


@dataclass(frozen=True)
class Aim:
    """The velocity that an object should get."""

    shortest_leg: float = 5.0  # a delayed impact makes the object no faster than for a leg of this duration [s]
    # The last impact brings the object to its end if as much time is left, otherwise only deep enough into its goal.
    full_correction: float = 15.0  # [s]
    deep_enough: Share = 0.65  # share of the plan's margin
    # The first impact on an object that drifts is to push it as planned, with a cosine of at least this, or its robot
    # would have to go round it: otherwise it flies faster to its next place,
    kept_side: Cosine = 0.7
    sooner: Share = 0.85  # by this share of its flight's time at a time,
    hastenings: CountOrNone = 12  # so often at most: down to a seventh of the flight's time
    via: Share = 0.4  # share of the depth by which a place that a flight has to pass may be missed
    bend: float = 0.25  # from the straight way that a drifting object may fly, at most half the next knot's depth [m]
    cruise: float = 0.15  # speed at which any leg can be flown [m/s],
    hurry: float = 1.15  # or so many times the plan's, where the plan itself is faster,
    fastest: Share = 0.95  # up to this share of the object's limit
    shares: Count = 20  # of the way to the plan's end that are tried,
    smallest: float = 1e-3  # and the preference for a short way [m]
    same_side: Cosine = 0.3  # cosine by which an impulse may turn from the planned normal without its robot going round
    other_side: float = 1.0  # how much less a way to the plan's end is worth where it has to [m]


@dataclass(frozen=True)
class Correction:
    """What a learner's correction of 1 changes, and how much of a correction is taken."""

    scale: float = 0.5  # of the logarithm of the impulse
    turn: float = 0.3  # of the impulse [rad]
    shift: float = 2.0  # of the impact's time [s]
    notice: float = 4.0  # from the decision to an impact that was moved, at least [s]
    margin: float = 0.1  # by which a correction may promise less than the expert's own aim [m]
    shares: Count = 8  # of a correction that promises less: the greatest that does not is taken


@dataclass(frozen=True)
class Reach:
    """What a robot is taken to be able to do."""

    ease: Share = 0.75  # share of the thrust that a course to an impact may need
    run_up: Share = 0.6  # share of the thrust with which a robot that lost its course runs up to what it hits
    steps: Count = 8  # in which the room behind an impact is looked through


@dataclass(frozen=True)
class Published:
    """Numbers of the parts of Verhagen & Tumova that the expert replaces, from the published code."""

    robot_weight: Positive = 1e-4  # Q_2 / Q_1 of Eq. 32: the robot's velocity before an impact over the object's after
    miss_weight: Positive = 1e4  # of the squares of Eqs. 29c and 29d, over that of the acceleration
    clearance: float = 0.1  # kept by the barrier between the edges of a robot and an object [m]
    damping: float = 2.0  # gamma_1 of the barrier h'' + gamma_1 h' + gamma_0 h >= 0 [1/s]
    stiffness: float = 1.0  # gamma_0 [1/s^2]
    open: float = 5.0  # before its impact a robot has no barrier to what it hits [s]


@dataclass(frozen=True)
class Response:
    """A plan's responses to where objects are at their impacts."""

    edge: float = 5e-3  # so far outside its box an object is still answered: room for errors of tracking [m]
    least: float = 1e-3  # change of where the object will be that changes a robot's curve; less is met at contact [m]
    # Deviations greater than the plan's by this share, and by so many standard deviations, are no chance: the world is
    # not as believed, and the plan promises nothing any more.
    excess: float = 0.1
    sure: float = 3.0
    known: float = 0.01  # standard deviation of where the object will be from which on it is answered at once [m]
    rejoin: Positive = 4.0  # in which a course goes over to a changed curve, at least [s]


@dataclass(frozen=True)
class Replanning:
    """The course of a robot to an impact."""

    central: Share = 0.966  # cosine by which an impulse may turn to go through the centre of an object that is no disc
    postponements: CountOrNone = 10  # of a second each
    steady_way: float = 0.03  # towards the object, that a robot goes at constant speed before it hits it [m],
    steady: float = 1.5  # for no longer than this,
    quick: float = 0.3  # and not if that is done as quickly [s]
    off_course: float = 0.1  # tracking error above which a course starts from the estimated state [m]


@dataclass(frozen=True)
class Retiming:
    """When the coming impact is moved to."""

    frozen: float = 4.0  # before an impact its time is kept [s],
    last: float = 2.0  # where the object would not yet be what its knot demands, only so long: then it is put off [s]
    candidates: Count = 121  # times that are tried,
    refined: CountOrNone = 20  # then so many on either side of the best
    crowding: float = 0.1  # the object should be hit so deep inside what its knot demands [m]
    outside: float = 20.0  # weight of missing that, squared, over missing the planned place, squared
    pull: float = 1e-5  # weight of changing the time, squared [m^2/s^2]
    reserve: float = 4.0  # after the last impact [s], or
    reserve_share: Share = 0.1  # of the horizon
    # An object that waits for its first impact and will have drifted so far from its place by then is hit sooner [m]:
    # farther away it may be behind an obstacle or at a wall, and its robot's planned way past others tells nothing;
    stray: float = 0.5
    stray_deviations: float = 2.0  # and so many standard deviations more:
    stray_share: Share = 0.6  # when it has drifted so large a share of that, or later,
    careful: Positive = 1.0  # because its robot is given so many times as long as it needs
    fine: Positive = 0.5  # changes of time that are not worth it [s]


@dataclass(frozen=True)
class Stay:
    """Staying for a while where the last impact brings an object that drifts: thrown up against its drift."""

    longer: float = 1.1  # times as long as it has to,
    later: float = 2.0  # and so much longer [s]
    shallow: Share = 0.3  # share of the plan's margin below which another velocity is looked for
    samples: Count = 16  # of a stay that are looked at
    # Shares of the time that is left after which a throw is back at the straight way; without drift the first is best.
    throws: tuple[Share, ...] = (1.0, 0.7, 0.5, 0.35, 0.25, 0.18, 0.12, 0.08)
    shortest_throw: Positive = 2.0  # but no sooner: near the end of the horizon these shares are but an instant [s]
    targets: Count = 4  # of the way to the plan's place that are tried, and the place where it is


@dataclass(frozen=True)
class Insertion:
    """Impacts that the plan does not have."""

    safe: float = 0.02  # an impact is inserted where a knot's demands would be met by less than this [m]
    safe_deviations: float = 0.5  # and so many standard deviations less,
    deviations: float = 1.0  # or, after the last impact, so many,
    shallow: float = 0.3  # for ending less deep than this share of the plan's margin
    most: CountOrNone = 4  # per object
    long_astray: float = 5.0  # without a robot that could mend it, until a new plan is wanted [s],
    soon: float = 2.0  # or this if what is left of the plan has no optimum [s]
    leads: tuple[Positive, ...] = (6.0, 7.0, 9.0, 5.0, 4.0, 12.0, 15.0, 20.0)  # from now to an inserted impact [s]
    hastes: tuple[Positive, ...] = (1.0, 0.7, 0.5)  # shares of the next flight's duration; a short one turns it less
    least_leg: float = 3.0  # after an inserted impact [s]
    rest: float = 5.0  # of its robot before the next one [s]
    delay: float = 3.0  # by which a robot that lost its course may put it off, else it is withdrawn [s]
    least_share: Share = 0.5  # of the wished change of velocity, below which it is withdrawn
    least_change: float = 4e-3  # of the object's velocity that is worth an impact [m/s]
    side: Cosine = 0.6  # cosine between the way from robot to object and the change of velocity, at least
    # By so much an object misses the place of its first impact for which another one is inserted before it [m]: more
    # than what hitting it sooner mends;
    stray: float = 1.0
    wait: float = 30.0  # if that is so far off [s]
    edge: float = 0.2  # an impact is inserted, too, if its robot would come so near to areas it may not leave [m]
    wall: float = 0.1  # kept by the robot from the edge of areas it may not leave [m]


@dataclass(frozen=True)
class Reoptimisation:
    """Times and places of the impacts that are left, after each one."""

    scale_rho: Positive = 0.1  # deviation from the plan's robustness that costs 1 [m]
    scale_place: Positive = 0.3  # of a place [m]
    scale_time: Positive = 10.0  # of a time [s]
    notice: float = 4.0  # from now to the next impact [s]
    gap: float = 4.0  # between impacts of one object [s]
    share: Share = 0.6  # of an object's greatest speed that legs may need
    widest: float = math.sqrt(3.0)  # tangent of the half-angle of the cone round the normal that legs fill
    shortest_way: float = 0.05  # of a robot, for the linearisation of its time [m]
    shortest_leg: float = 0.05  # of an object, that has a direction [m]
    inset: float = 0.25  # from both ends of a window [s]


@dataclass(frozen=True)
class Avoidance:
    """Keeping off bodies that are not to be hit."""

    clearance: float = 0.1  # kept between the edges of two bodies [m]
    braking: Share = 0.7  # share of the thrust, for each of two robots
    sweeps: CountOrNone = 3  # over all neighbours
    # A robot keeps off the object that it is to hit, too, while the way to it is turned from the impulse by an angle of
    # a cosine below this, beside it or beyond: it would push the object aside,
    target_side: Cosine = 0.3
    target_clearance: float = 0.02  # by so much [m],
    # or if it comes sooner than this before the expected impact, and too fast to brake [s]: a contact is taken for the
    # expected one from Timing.earliest before it, and half a second is left for a late reading.
    target_early: float = 2.5


@dataclass(frozen=True)
class Surroundings:
    """Keeping off walls and solid obstacles, and going round them and round objects."""

    clearance: float = 0.03  # kept between a robot and a wall, less than the 0.05 of plans [m]
    late: float = 0.2  # after the expected impact, until which it is trusted to come before the wall does [s]
    near: float = 0.02  # a course that comes nearer, and nearer than its ends are, is replaced by a detour [m]
    margin: float = 0.08  # of the via points of detours [m]
    through: float = (
        0.02  # overlap of a course with the object that it is to hit, before that, from which it passes by [m]
    )
    aside: float = 0.05  # clearance of courses to objects that they do not end at: the barrier slows robots there [m],
    beside: float = 0.2  # and of the via points beside them [m]
    samples: Count = 24  # of a course that are looked at, at most
    intrusion: float = 10.0  # cost of a course that is too near all the time, and of twice the thrust that there is
    waits: tuple[Share, ...] = (0.3, 0.6)  # shares of a course after which its robot may first set out
    stretch: Count = 3  # times the duration of a way back to the plan that a detour may take
    earlier: Positive = 0.5  # steps in which an impact is moved to before its place is in a wall [s]
    turn: Positive = 0.1  # steps in which an impulse is turned until its robot is in no wall [rad],
    turns: CountOrNone = 5  # and how many


@dataclass(frozen=True)
class Background:
    """New plans, made in processes beside the loop."""

    delay: float = 2.0  # from asking for a plan to taking it over [s]
    most: CountOrNone = 2  # asked for in an episode
    apart: float = 8.0  # from the answer to the next question [s]
    least_left: float = 15.0  # of the horizon [s]
    calm: float = 1.0  # before the next impact, when a plan is taken over [s]
    work: Positive = 6500.0  # that a plan may take, see `budget.Work`; about 1 s of one core [simplex iterations]
    nodes: Count = 300  # of branch and bound, in each of its mixed-integer programs
    processes: CountOrNone = 0  # that plan at a time, at most; 0: one per core; makes no difference to an episode
    patience: Positive = 300.0  # wall time without an answer after which a process is given up and another asked [s]


@dataclass(frozen=True)
class Options:
    """Parts of the closed loop and their numbers; what has none of the numbers' groups is a switch, off in the paper.

    Attributes:
        once: plan each impact once, as the published code does; otherwise every 0.5 s, as the paper says.
        exact: a quintic to an impact that gives the object the desired velocity; otherwise the published replanner: the
            course of least acceleration of Eq. 29 to the compromise of Eq. 32.
        avoid: keep off all bodies that are not to be hit, as far as braking takes; otherwise the published barrier,
            which is one of robots to objects.
        learn: estimate restitution and mass from what impacts did.
        retime: move an impact to when the object is where it should be hit, and try a missed one again.
        drift: a constant unknown acceleration of every object in its filter.
        offset: of every object's centre of mass from its geometric centre in its filter.
        insert: add an unplanned impact when the object would miss its next target; slow it gently at the goal.
        reoptimise: choose times and places of the impacts that are left anew after each one.
        walls: keep off walls and solid obstacles as off bodies, hit objects before they are at one, and go round them.
        plan_anew: plan the rest in the background, with who hits what open, where that fails.
        respond: fly the responses of a plan that has any, while objects are in the boxes it promises.
        thrusters: learn how strong every thruster of a robot is, and command what gives the wanted force.
        filter: take only so much of a learner's correction as promises hardly less than the expert's own aim.
        tracker: what follows the courses, a name of `tracking.trackers.TRACKERS`.
        weights: of the tracking cost; in the paper those of App. B.
    """

    once: bool = False
    exact: bool = True
    avoid: bool = True
    learn: bool = True
    retime: bool = True
    drift: bool = True
    offset: bool = True
    insert: bool = True
    reoptimise: bool = True
    walls: bool = True
    plan_anew: bool = True
    respond: bool = True
    thrusters: bool = True
    filter: bool = True
    tracker: str = "mpc"
    weights: Weights = Weights()  # noqa: RUF009 - frozen
    estimation: Estimation = Estimation()
    thruster: Thruster = Thruster()
    impact_parameters: ImpactParameters = ImpactParameters()
    timing: Timing = Timing()
    aim: Aim = Aim()
    correction: Correction = Correction()
    reach: Reach = Reach()
    published: Published = Published()
    response: Response = Response()
    replanning: Replanning = Replanning()
    retiming: Retiming = Retiming()
    stay: Stay = Stay()
    insertion: Insertion = Insertion()
    reoptimisation: Reoptimisation = Reoptimisation()
    avoidance: Avoidance = Avoidance()
    surroundings: Surroundings = Surroundings()
    background: Background = Background()


EXPERT = Options()
_PAPER = Options(
    exact=False,
    avoid=False,
    learn=False,
    retime=False,
    drift=False,
    offset=False,
    insert=False,
    reoptimise=False,
    walls=False,
    plan_anew=False,
    respond=False,
    thrusters=False,
    weights=PUBLISHED_WEIGHTS,
)
# What the paper has is replaced, or what it lacks is added, one part a rung: each has all parts of the rung before.
_LADDER: tuple[tuple[str, dict[str, Any]], ...] = (
    ("paper_expert", {}),
    ("with_weights", {"weights": EXPERT.weights}),
    ("with_exact_impacts", {"exact": True}),
    ("with_avoidance", {"avoid": True}),
    ("with_learning", {"learn": True}),
    ("with_retiming", {"retime": True}),
    ("with_drift", {"drift": True}),
    ("with_insertion", {"insert": True}),
    ("with_reoptimisation", {"reoptimise": True}),
    ("with_offset", {"offset": True}),
    ("with_walls", {"walls": True}),
    ("with_responses", {"respond": True}),
    ("with_thrusters", {"thrusters": True}),
)


def _build_variants() -> dict[str, Options]:
    found, options = {"one_replan": replace(_PAPER, once=True)}, _PAPER
    for name, part in _LADDER:
        found[name] = options = replace(options, **part)
    return found


VARIANTS = _build_variants()


def get_options(variant: str | None) -> Options:
    """Return the parts of the closed loop that a variant has; default: all of them.

    Raises:
        InputError: unknown variant.
    """
    if variant is None:
        return EXPERT
    if variant not in VARIANTS:
        raise InputError(f"variant '{variant}' is unknown; {choices(variant, VARIANTS)}")
    return VARIANTS[variant]


@cache
def make_record(options: Options) -> np.ndarray:
    """Return options as compiled code takes them: one record with fields of the same names, the tracker as its number.

    Returns:
        Shape (1,); options.insertion.wall is record[0]["insertion"]["wall"].
    """
    number = {"mpc": BY_MPC, "lqr": BY_LQR}.get(options.tracker, BY_OBJECT)
    encoded = replace(options, tracker=number)  # type: ignore[arg-type]
    record = np.zeros(1, _make_dtype(encoded))
    _fill_record(record[0], encoded)
    return record


def _make_dtype(options: Any) -> np.dtype:
    columns: list[Any] = [(item.name, *_describe(getattr(options, item.name))) for item in fields(options)]
    return np.dtype(columns, align=True)


def _describe(value: Any) -> tuple[Any, ...]:
    if is_dataclass(value):
        return (_make_dtype(value),)
    return (type(value[0]), len(value)) if isinstance(value, tuple) else (type(value),)


def _fill_record(record: Any, options: Any) -> None:
    for item in fields(options):
        value = getattr(options, item.name)
        if is_dataclass(value):
            _fill_record(record[item.name], value)
        else:
            record[item.name] = value

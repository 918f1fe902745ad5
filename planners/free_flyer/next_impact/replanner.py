"""Online replanning: the course of one robot to its coming impact, from the object as it is seen now; compiled."""

from __future__ import annotations

import math

from impact_envs.compiled import compiled
from planners.free_flyer.belief.estimator import extrapolate
from planners.free_flyer.belief.impact_parameters import get_pair
from planners.free_flyer.belief.options import Options
from planners.free_flyer.belief.plan_table import (
    AT,
    MASS,
    RADIUS,
    SPEED,
    PlanTable,
)
from planners.free_flyer.belief.world_memory import (
    CHANGE,
    CONTACT_X,
    CONTACT_Y,
    IMPACT_INDEX,
    INSERTED,
    LOST,
    MINUS_X,
    MINUS_Y,
    N_X,
    N_Y,
    OBJECT_X,
    OBJECT_Y,
    OFF_CENTRE,
    OUTCOME,
    PLUS_X,
    PLUS_Y,
    REFERENCE_X,
    REFERENCE_Y,
    REPLANNED,
    REPLANS,
    SCALE,
    SOLVED,
    TIME,
    TURN,
    WorldMemory,
)
from planners.free_flyer.next_impact.bookkeeping import set_time
from planners.free_flyer.next_impact.desired_velocity import ROUND_OFF, aim, hasten
from planners.free_flyer.next_impact.reachability import is_reachable
from planners.free_flyer.next_impact.two_body import solve_two_body_impact
from planners.free_flyer.tracking.course import approach, evaluate_course

CENTRAL = 0.966  # cosine by which an impulse may turn to go through the centre of an object that is no disc
POSTPONEMENTS = 10  # of a second each
STEADY_WAY = 0.03  # of a robot towards the object, that it goes at constant speed before it hits it [m],
STEADY, QUICK = 1.5, 0.3  # for no longer than this, and not if that is done as quickly [s]
OFF_COURSE = 0.1  # tracking error above which a course starts from the estimated state [m]
SCALE_RANGE = 0.5  # of the logarithm of the impulse, at correction 1
ROTATION_RANGE = 0.3  # of the impulse, at correction 1 [rad]


@compiled
def solve_strike(plan: PlanTable, memory: WorldMemory, options: Options, k: int, r: int, o: int, now: float) -> None:
    """Solve the two-body problem of robot r's impact on object o, from the object as it is seen now."""
    strike, body = memory.strike[k, o], plan.robots + o
    time = strike[TIME]
    x, y, vx, vy = extrapolate(memory, k, body, time)
    if options.drift:
        hasten(plan, memory, k, o)
    wish = aim(plan, memory, options, k, o)
    scale, angle = math.exp(SCALE_RANGE * strike[SCALE]), ROTATION_RANGE * strike[TURN]
    cos, sin, dx, dy = math.cos(angle), math.sin(angle), wish[0] - vx, wish[1] - vy
    dx, dy = scale * (cos * dx - sin * dy), scale * (sin * dx + cos * dy)
    dx, dy, distance = turn_to_centre(plan, memory, k, o, time - now, dx, dy)
    desired = (vx + dx, vy + dy)
    normal = (strike[REFERENCE_X], strike[REFERENCE_Y])
    restitution, ratio = get_pair(memory, k, r, o)
    solution = solve_two_body_impact(
        (x, y),
        (vx, vy),
        desired,
        (vx, vy),
        normal,
        plan.body[r, MASS],
        ratio * plan.body[r, MASS],
        restitution,
        plan.body[r, RADIUS] + distance,
        plan.body[r, SPEED],
    )
    strike[OUTCOME], strike[SOLVED] = solution.outcome.value, 1.0
    strike[N_X], strike[N_Y] = solution.normal
    strike[CONTACT_X], strike[CONTACT_Y] = solution.contact
    strike[MINUS_X], strike[MINUS_Y] = solution.robot_minus
    strike[PLUS_X], strike[PLUS_Y] = solution.robot_plus
    strike[OBJECT_X], strike[OBJECT_Y] = solution.object_minus
    strike[CHANGE] = math.hypot(solution.object_plus[0] - vx, solution.object_plus[1] - vy)


@compiled
def replan(plan: PlanTable, memory: WorldMemory, options: Options, k: int, r: int, o: int, now: float) -> None:
    """Plan the course of robot r to its impact on object o; a robot that lost its course may put the impact off."""
    strike = memory.strike[k, o]
    solve_strike(plan, memory, options, k, r, o, now)
    begin = evaluate_course(memory.course, plan.breaks, plan.coefficients, k, r, now)
    z = memory.filter[k, r]
    if math.hypot(begin[0] - z[0], begin[1] - z[1]) > OFF_COURSE:
        memory.counts[k, LOST] += 1
        begin = (z[0], z[1], z[2], z[3], begin[4], begin[5])
        if options.retime:
            postpone(plan, memory, options, k, r, o, now)
    index = int(strike[IMPACT_INDEX])
    planned = -1.0 if strike[INSERTED] > 0.0 else plan.impact[index, AT]
    vx, vy = strike[MINUS_X], strike[MINUS_Y]
    # The slower robot and object meet, the earlier or later a small error of position lets them: steadily, then.
    slow = max(math.hypot(vx - strike[OBJECT_X], vy - strike[OBJECT_Y]), ROUND_OFF)
    steady = min(max(STEADY_WAY / slow - QUICK, 0.0), STEADY, (strike[TIME] - now) / 4)
    approach(
        memory.course,
        plan.breaks,
        plan.coefficients,
        k,
        r,
        now,
        begin,
        (strike[CONTACT_X] - steady * vx, strike[CONTACT_Y] - steady * vy),
        (vx, vy),
        strike[TIME] - steady,
        planned,
    )
    strike[REPLANNED] = now
    memory.counts[k, REPLANS] += 1


@compiled
def postpone(plan: PlanTable, memory: WorldMemory, options: Options, k: int, r: int, o: int, now: float) -> None:
    """Put the impact of robot r on object o off until the robot can be there, by at most 10 s."""
    strike = memory.strike[k, o]
    for _ in range(POSTPONEMENTS):
        x, y, vx, vy = strike[CONTACT_X], strike[CONTACT_Y], strike[MINUS_X], strike[MINUS_Y]
        later = strike[TIME] + 1.0
        if later >= plan.horizon or is_reachable(plan, memory, k, r, x, y, vx, vy, strike[TIME] - now):
            return
        if strike[INSERTED] > 0.0:
            strike[TIME] = later
        else:
            set_time(plan, memory, k, o, int(strike[IMPACT_INDEX]), later)
        solve_strike(plan, memory, options, k, r, o, now)


@compiled
def turn_to_centre(
    plan: PlanTable, memory: WorldMemory, k: int, o: int, ahead: float, dx: float, dy: float
) -> tuple[float, float, float]:
    """Return the part of a change of velocity that a hit through object o's centre can give, and how far that hit is.

    A disc takes any. Of an object that is none the nearest side or corner is hit that is there at the time; where it
    is turned away by more than 15 degrees it is counted.

    Args:
        plan: what is believed.
        memory: of all worlds.
        k: world.
        o: object.
        ahead: time until the impact [s].
        dx, dy: wished change [m/s].

    Returns:
        Change [m/s], and the distance of the place of contact from the centre [m].
    """
    body = plan.robots + o
    size, best, distance = math.hypot(dx, dy), -1.0, plan.body[body, RADIUS]
    heading = memory.heading[k, body, 0] + ahead * memory.heading[k, body, 1]
    cos, sin, nx, ny = math.cos(heading), math.sin(heading), 0.0, 0.0
    for i in range(plan.side.shape[1]):
        ux, uy, far = plan.side[o, i, 0], plan.side[o, i, 1], plan.side[o, i, 2]
        px, py = -(cos * ux - sin * uy), -(sin * ux + cos * uy)
        cosine = (px * dx + py * dy) / max(size, 1e-12)
        if far > 0.0 and cosine > best:
            best, nx, ny, distance = cosine, px, py, far
    if best == -1.0:
        return dx, dy, distance
    if best < CENTRAL and size > 1e-9:
        memory.counts[k, OFF_CENTRE] += 1
    along = max(best, 0.0) * size
    return along * nx, along * ny, distance

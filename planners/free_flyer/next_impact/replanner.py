"""Replan the course of one robot to its coming impact from the present estimate of the object; compiled."""

from __future__ import annotations

import math

from impact_envs.compiled import compiled
from impact_envs.elementary import cos_sin
from planners.free_flyer.belief.estimator import extrapolate_flight
from planners.free_flyer.belief.impact_parameters import get_pair
from planners.free_flyer.belief.offset import compute_lever, extrapolate_swing
from planners.free_flyer.belief.options import Options
from planners.free_flyer.belief.plan_table import NO_IMPACT, PlanTable
from planners.free_flyer.belief.surroundings import measure_gap
from planners.free_flyer.belief.world_memory import NO_OBJECT, WorldMemory
from planners.free_flyer.next_impact.aim import choose_desired_velocity, keep_side
from planners.free_flyer.next_impact.bookkeeping import set_clocks, set_time, withdraw_impact
from planners.free_flyer.next_impact.correction import correct_change
from planners.free_flyer.next_impact.desired_velocity import (
    ROUND_OFF,
    compute_margin,
    hasten_next_knot,
    is_answered,
)
from planners.free_flyer.next_impact.detour import go_round, move_clear
from planners.free_flyer.next_impact.reachability import is_reachable
from planners.free_flyer.next_impact.run_up import find_run_up_share
from planners.free_flyer.next_impact.two_body import (
    NO_CHANGE,
    compute_lever_gain,
    solve_soft_two_body_impact,
    solve_two_body_impact,
)
from planners.free_flyer.tracking.course import (
    evaluate_course,
    evaluate_curve,
    plan_approach,
    read_clock,
)
from planners.free_flyer.tracking.least_acceleration import plan_least_acceleration


@compiled
def solve_strike(plan: PlanTable, memory: WorldMemory, options: Options, k: int, r: int, o: int, now: float) -> None:
    """Solve the two-body problem of robot r's impact on object o from the present estimate of the object."""
    strike, body = memory.strike[k, o], plan.robots + o
    time = strike.time
    x, y, vx, vy = extrapolate_flight(memory, k, body, time)
    strike.is_answered = strike.index != NO_IMPACT and is_answered(plan, memory, options, k, o)
    if options.drift and not strike.is_answered:
        hasten_next_knot(plan, memory, options, k, o)
        keep_side(plan, memory, options, k, o)
    wish = choose_desired_velocity(plan, memory, options, k, o)
    dx, dy = correct_change(options, strike.scale, strike.turn, wish[0] - vx, wish[1] - vy)
    dx, dy, distance = turn_to_centre(plan, memory, options, k, o, time - now, dx, dy)
    if options.walls and distance == plan.body[body].radius:
        dx, dy = turn_off_walls(plan, options, r, body, x, y, dx, dy)
    normal = (strike.reference_normal[0], strike.reference_normal[1])
    centre_vx, centre_vy = vx, vy
    vx, vy = place_hit(plan, memory, k, o, (vx, vy), (dx, dy))
    desired = (vx + dx, vy + dy)
    restitution, ratio = find_law(plan, memory, k, r, o)
    mass, reach, limit = plan.body[r].mass, plan.body[r].radius + distance, plan.body[r].speed_limit
    wished = math.hypot(dx, dy)
    if strike.is_slowed:
        gain = compute_lever_gain(restitution, mass, ratio * mass, strike.lever)
        part = find_run_up_share(plan, memory, options, k, r, o, (x, y), (vx, vy), (dx, dy), reach, gain)
        desired = (vx + part * dx, vy + part * dy)
    if options.exact:
        solution = solve_two_body_impact(
            (x, y),
            (vx, vy),
            desired,
            (vx, vy),
            normal,
            mass,
            ratio * mass,
            restitution,
            reach,
            limit,
            strike.lever,
        )
    else:
        robot_wish = (vx, vy)
        if strike.index != NO_IMPACT and not strike.is_inserted:
            curves = memory.flown[k] if len(plan.response) > 0 else plan.coefficients
            planned = evaluate_curve(plan.breaks, curves, r, plan.impact[strike.index].time, True)
            robot_wish = (planned[2], planned[3])
        solution = solve_soft_two_body_impact(
            (x, y),
            (vx, vy),
            desired,
            robot_wish,
            normal,
            mass,
            ratio * mass,
            restitution,
            reach,
            limit,
            1.0,
            options.published.robot_weight,
            strike.lever,
        )
    strike.outcome, strike.is_solved = solution.outcome.value, True
    strike.normal[0], strike.normal[1] = solution.normal
    strike.contact[0], strike.contact[1] = solution.contact
    strike.robot_minus[0], strike.robot_minus[1] = solution.robot_minus
    strike.robot_plus[0], strike.robot_plus[1] = solution.robot_plus
    strike.object_minus[0], strike.object_minus[1] = solution.object_minus
    strike.object_plus[0] = centre_vx + solution.object_plus[0] - vx
    strike.object_plus[1] = centre_vy + solution.object_plus[1] - vy
    strike.change = math.hypot(solution.object_plus[0] - vx, solution.object_plus[1] - vy)
    strike.share = strike.change / wished if wished > NO_CHANGE else 1.0


@compiled
def find_law(plan: PlanTable, memory: WorldMemory, k: int, r: int, o: int) -> tuple[float, float]:
    """Return restitution and mass ratio that robot r's impact on object o is planned with.

    What the plan answers it has planned with the believed ones: what its impacts deviate tells nothing of the next.
    """
    if memory.strike[k, o].is_answered:
        return plan.restitution, plan.body[plan.robots + o].mass / plan.body[r].mass
    return get_pair(memory, k, r, o)


@compiled
def place_hit(
    plan: PlanTable, memory: WorldMemory, k: int, o: int, velocity: tuple[float, float], change: tuple[float, float]
) -> tuple[float, float]:
    """Set the lever of the coming hit on object o; return the velocity of the place that is hit, but for its slip.

    The normal goes through the geometric centre: along it the place is as fast as that. The slip of a turning object's
    rim is left alone: robots that matched it to leave friction nothing to act on did worse in closed loop.

    Args:
        velocity: of the centre of mass before it [m/s].
        change: wished [m/s].
    """
    strike, body = memory.strike[k, o], plan.robots + o
    z, heading, size = memory.filter[k, body], memory.heading[k, body], math.hypot(change[0], change[1])
    strike.lever = 0.0
    if z.P_dd == 0.0:
        return velocity
    if size > 0.0:
        angle = heading.angle + (strike.time - memory.time[k]) * heading.rate
        strike.lever = compute_lever(z, plan.body[body].gyration, angle, change[0] / size, change[1] / size)
    _, _, sx, sy = extrapolate_swing(memory, k, body, strike.time)
    return velocity[0] + sx, velocity[1] + sy


@compiled
def replan_course(plan: PlanTable, memory: WorldMemory, options: Options, k: int, r: int, o: int, now: float) -> None:
    """Plan the course of robot r to its impact on object o; a robot that lost its course may postpone the impact.

    An inserted impact that gives too little, or that would have to wait too long, is withdrawn.
    """
    strike = memory.strike[k, o]
    solve_strike(plan, memory, options, k, r, o, now)
    if strike.is_inserted and strike.share < options.insertion.least_share:
        withdraw_impact(plan, memory, options, k, o, now)
        return
    if options.walls and options.retime and not is_place_clear(plan, memory, k, r, o, strike.time):
        advance_impact(plan, memory, options, k, r, o, now)
    curves = memory.flown[k] if len(plan.response) > 0 else plan.coefficients
    begin = evaluate_course(memory.course[k, r], plan.breaks, curves, r, now)
    z = memory.filter[k, r]
    if math.hypot(begin[0] - z.position[0], begin[1] - z.position[1]) > options.replanning.off_course:
        memory.counts[k].lost += 1
        if options.walls and not strike.is_answered:
            strike.is_slowed = True
            solve_strike(plan, memory, options, k, r, o, now)
        begin = (z.position[0], z.position[1], z.velocity[0], z.velocity[1], begin[4], begin[5])
        if options.retime and not postpone_impact(plan, memory, options, k, r, o, now):
            withdraw_impact(plan, memory, options, k, o, now)
            return
    strike.replanned_at = now
    memory.counts[k].replans += 1
    index = strike.index
    planned = -1.0 if strike.is_inserted else plan.impact[index].time
    vx, vy = strike.robot_minus[0], strike.robot_minus[1]
    px, py = strike.contact[0], strike.contact[1]
    if not options.exact:
        course, contact = memory.course[k, r], (strike.contact[0], strike.contact[1])
        tau = min(read_clock(course, now), course.stop)
        base = evaluate_curve(plan.breaks, curves, r, tau, True)
        limit, miss = plan.body[r].speed_limit, options.published.miss_weight
        plan_least_acceleration(course, now, begin, (base[0], base[1]), contact, (vx, vy), strike.time, limit, miss)
        return
    if options.walls and measure_gap(plan, r, px, py) < 0.0:
        # From inside a wall nothing can be hit: wait beside it.
        px, py = move_clear(plan, r, px, py, options.surroundings.margin)
        vx, vy, o = 0.0, 0.0, NO_OBJECT
    # The slower robot and object meet, the more a small error of position shifts the time: then come at constant speed.
    slow = max(math.hypot(vx - strike.object_minus[0], vy - strike.object_minus[1]), ROUND_OFF)
    steady = min(
        max(options.replanning.steady_way / slow - options.replanning.quick, 0.0),
        options.replanning.steady,
        (strike.time - now) / 4,
    )
    plan_approach(
        memory.course[k, r],
        plan.breaks,
        curves,
        r,
        now,
        begin,
        (px - steady * vx, py - steady * vy),
        (vx, vy),
        strike.time - steady,
        planned,
    )
    if options.walls:
        go_round(plan, memory, options, k, r, o, now, strike.time)


@compiled
def postpone_impact(plan: PlanTable, memory: WorldMemory, options: Options, k: int, r: int, o: int, now: float) -> bool:
    """Postpone the impact of robot r on object o until the robot can be there, as far as that makes sense.

    Returns:
        Whether it stands: an inserted one that its robot cannot come to does not.
    """
    strike = memory.strike[k, o]
    for _ in range(options.replanning.postponements):
        x, y, vx, vy = strike.contact[0], strike.contact[1], strike.robot_minus[0], strike.robot_minus[1]
        later, due = strike.time + 1.0, strike.due
        if is_reachable(plan, memory, options, k, r, x, y, vx, vy, strike.time - now):
            return True
        if not may_wait(plan, memory, options, k, o, later):
            break
        if options.walls and not is_place_clear(plan, memory, k, r, o, later):
            break
        if strike.is_inserted:
            strike.time = later
        else:
            set_time(plan, memory, k, o, strike.index, later)
            strike.due = due
        solve_strike(plan, memory, options, k, r, o, now)
    return not strike.is_inserted


@compiled
def may_wait(plan: PlanTable, memory: WorldMemory, options: Options, k: int, o: int, later: float) -> bool:
    """Return whether the coming impact of object o may be as late as that.

    An inserted one soon is another one. In a planned one the object has to be where its knot demands it, if it would be
    there at present.
    """
    strike = memory.strike[k, o]
    index = strike.index
    if later >= plan.horizon:
        return False
    if strike.is_inserted:
        soon = later <= strike.due + options.insertion.delay + ROUND_OFF
        return soon and (index == NO_IMPACT or later + options.insertion.least_leg <= memory.clock[k, index])
    x, y, _, _ = extrapolate_flight(memory, k, plan.robots + o, strike.time)
    margin = compute_margin(plan, index, x, y)
    x, y, _, _ = extrapolate_flight(memory, k, plan.robots + o, later)
    return later <= plan.knot[index].closes and compute_margin(plan, index, x, y) >= min(margin, 0.0)


@compiled
def is_place_clear(plan: PlanTable, memory: WorldMemory, k: int, r: int, o: int, time: float) -> bool:
    """Return whether object o, and robot r that hits it along the present normal, are in no wall or obstacle then."""
    body, normal = plan.robots + o, memory.strike[k, o].normal
    x, y, _, _ = extrapolate_flight(memory, k, body, time)
    reach = plan.body[r].radius + plan.body[body].radius
    return (
        measure_gap(plan, r, x - reach * normal[0], y - reach * normal[1]) >= 0.0
        and measure_gap(plan, body, x, y) >= 0.0
    )


@compiled
def advance_impact(plan: PlanTable, memory: WorldMemory, options: Options, k: int, r: int, o: int, now: float) -> None:
    """Move the impact of robot r on object o to the latest time before at which its place is in no wall or obstacle.

    The robot has to be there in time; otherwise the impact stays when it is.
    """
    strike = memory.strike[k, o]
    old, earliest = strike.time, now + options.retiming.frozen
    if not strike.is_inserted:
        earliest = max(earliest, plan.knot[strike.index].opens)
    time = old - options.surroundings.earlier
    while time >= earliest:
        if is_place_clear(plan, memory, k, r, o, time):
            strike.time = time
            solve_strike(plan, memory, options, k, r, o, now)
            x, y, vx, vy = strike.contact[0], strike.contact[1], strike.robot_minus[0], strike.robot_minus[1]
            if measure_gap(plan, r, x, y) >= 0.0 and is_reachable(
                plan, memory, options, k, r, x, y, vx, vy, time - now
            ):
                memory.counts[k].retimed += 1
                if not strike.is_inserted:
                    set_time(plan, memory, k, o, strike.index, time)
                set_clocks(plan, memory, options, k, now)
                return
        time -= options.surroundings.earlier
    strike.time = old
    solve_strike(plan, memory, options, k, r, o, now)


@compiled
def turn_to_centre(
    plan: PlanTable, memory: WorldMemory, options: Options, k: int, o: int, ahead: float, dx: float, dy: float
) -> tuple[float, float, float]:
    """Return the part of a change of velocity that a hit through object o's centre can give, and how far that hit is.

    A disc takes any. Of an object that is none the nearest side or corner is hit that is there at the time; where it
    is turned away by more than 15 degrees it is counted.

    Args:
        ahead: time until the impact [s].
        dx, dy: wished change [m/s].

    Returns:
        Change [m/s], and the distance of the place of contact from the centre [m].
    """
    body = plan.robots + o
    size, best, distance = math.hypot(dx, dy), -1.0, plan.body[body].radius
    heading = memory.heading[k, body].angle + ahead * memory.heading[k, body].rate
    (cos, sin), nx, ny = cos_sin(heading), 0.0, 0.0
    for i in range(plan.side.shape[1]):
        side = plan.side[o, i]
        ux, uy, far = side.direction[0], side.direction[1], side.distance
        px, py = -(cos * ux - sin * uy), -(sin * ux + cos * uy)
        cosine = (px * dx + py * dy) / max(size, 1e-12)
        if far > 0.0 and cosine > best:
            best, nx, ny, distance = cosine, px, py, far
    if best == -1.0:
        return dx, dy, distance
    if best < options.replanning.central and size > 1e-9:
        memory.counts[k].off_centre += 1
    along = max(best, 0.0) * size
    return along * nx, along * ny, distance


@compiled
def turn_off_walls(
    plan: PlanTable, options: Options, r: int, body: int, x: float, y: float, dx: float, dy: float
) -> tuple[float, float]:
    """Return the part of a change of velocity that a disc at (x, y) can be given by a robot that is in no wall [m/s].

    It is turned as little as that takes; where that is too far, or the disc is in a wall itself, it stays as it is.

    Args:
        body: that is hit.
        dx, dy: wished change [m/s].
    """
    size, reach = math.hypot(dx, dy), plan.body[r].radius + plan.body[body].radius
    if size < NO_CHANGE:
        return dx, dy
    ux, uy = reach * dx / size, reach * dy / size
    if measure_gap(plan, r, x - ux, y - uy) >= 0.0 or measure_gap(plan, body, x, y) < 0.0:
        return dx, dy
    for i in range(options.surroundings.turns):
        cos, across = cos_sin((i + 1) * options.surroundings.turn)
        for side in range(2):
            sin = (1.0 - 2.0 * side) * across
            wx, wy = cos * ux - sin * uy, sin * ux + cos * uy
            if measure_gap(plan, r, x - wx, y - wy) >= 0.0:
                return cos * size / reach * wx, cos * size / reach * wy
    return dx, dy

"""Go round walls, obstacles and objects: replace a course that comes too near by one through a via point; compiled.

Robots stand near walls and run up to what they hit: a quintic that has much time for a short way swings out behind its
start, and one to the other side of an obstacle goes through it. Before an object in the way the barrier would stop the
robot for good. Via points are corners of obstacles, the worst place of the course moved clear, or to either side of the
object that is nearest there, its start, and the place where the run-up to its end begins.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from impact_envs.compiled import compiled, inlined
from planners.free_flyer.belief.estimator import extrapolate_flight
from planners.free_flyer.belief.options import Options
from planners.free_flyer.belief.plan_table import PlanTable
from planners.free_flyer.belief.surroundings import WALLS, get_inset, measure_distance, measure_gap
from planners.free_flyer.belief.world_memory import NO_OBJECT, WorldMemory
from planners.free_flyer.tracking.course import Motion, evaluate_course, evaluate_quintic, fit_detour, fit_quintic
from planners.free_flyer.tracking.mpc import GAIN, INPUT_LIMIT

SHORTEST = 1.0  # course that has room for a via point [s]
TINY = 1e-9  # round-off of lengths and times [m], [s]
ENDS = 0.15  # share of a course at either end that is no time for a via point


class Way(NamedTuple):
    """What a course has to keep off.

    Attributes:
        r: robot.
        o: object that it hits at the end, or NO_OBJECT.
        now: when it begins [s].
        least: gap to walls and solid obstacles, where its ends are no nearer [m].
        aside: gap to other objects, where its ends are no nearer [m].
        reach: distance from the centre of the object at which it is hit, 0 without one [m].
    """

    r: int
    o: int
    now: float
    least: float
    aside: float
    reach: float


@compiled
def go_round(
    plan: PlanTable, memory: WorldMemory, options: Options, k: int, r: int, o: int, now: float, latest: float
) -> None:
    """Replace robot r's course, which begins now, by a detour if it comes too near to a wall, obstacle or object.

    Nor may it lead through the object that it is to hit. Of all candidates, the course itself among them, the one of
    least cost is taken: see `weigh_course`. A course back to the plan may take up to `stretch` times as long.

    Args:
        o: object that the robot is on course to hit, or NO_OBJECT.
        latest: until when a course back to the plan may last [s].
    """
    course, surroundings = memory.course[k, r], options.surroundings
    curves = memory.flown[k] if len(plan.response) > 0 else plan.coefficients
    T = course.until - now
    if T < SHORTEST:
        return
    here = evaluate_course(course, plan.breaks, curves, r, now)
    there = evaluate_course(course, plan.breaks, curves, r, course.until)
    least = min(measure_gap(plan, r, here[0], here[1]), measure_gap(plan, r, there[0], there[1]))
    reach = 0.0
    if o != NO_OBJECT:
        strike = memory.strike[k, o]
        x, y, _, _ = extrapolate_flight(memory, k, plan.robots + o, strike.time)
        reach = math.hypot(strike.contact[0] - x, strike.contact[1] - y)
    aside = min(
        measure_aside(plan, memory, k, r, o, here, now), measure_aside(plan, memory, k, r, o, there, course.until)
    )
    way = Way(r, o, now, min(least, surroundings.near), min(aside, surroundings.aside), reach)
    if is_clear(plan, memory, options, k, way):
        return
    begin, end = evaluate_quintic(course, now), evaluate_quintic(course, course.until)
    most = options.reach.ease * plan.pilot[r, GAIN] * plan.pilot[r, INPUT_LIMIT]
    best, chosen, via_x, via_y, time = math.inf, course.until, 0.0, 0.0, now
    worst, found = now, here
    for stretch in range(1 if course.ends_in_impact else surroundings.stretch):
        until = now + (stretch + 1) * T
        if stretch > 0 and until > latest:
            break
        fit_course(course, begin, end, now, until)
        there = evaluate_course(course, plan.breaks, curves, r, until)
        cost, nearest = weigh_course(plan, memory, options, k, way, most)
        if cost < best:
            best, chosen, time = cost, until, now
        if stretch == 0:
            worst, found = nearest, evaluate_course(course, plan.breaks, curves, r, nearest)
        for i in range(5 + len(surroundings.waits) + plan.solid.shape[0] * plan.solid.shape[1]):
            if i < 3:
                x, y = pass_by(plan, memory, options, k, way, i, worst, found)
                at = now + (stretch + 1) * (worst - now)
            else:
                x, y, at = choose_via(plan, options, r, i - 3, now, until, here, there, most)
            x, y = move_clear(plan, r, x, y, surroundings.margin)
            at = min(max(at, now + ENDS * (until - now)), until - ENDS * (until - now))
            course.until = until
            fit_via(plan, curves, course, r, begin, end, now, at, x, y)
            cost, _ = weigh_course(plan, memory, options, k, way, most)
            if cost < best:
                best, chosen, via_x, via_y, time = cost, until, x, y, at
    if time > now:
        course.until = chosen
        fit_via(plan, curves, course, r, begin, end, now, time, via_x, via_y)
        memory.counts[k].detours += 1
    else:
        fit_course(course, begin, end, now, chosen)


@inlined
def pass_by(
    plan: PlanTable, memory: WorldMemory, options: Options, k: int, way: Way, side: int, time: float, found: Motion
) -> tuple[float, float]:
    """Return the worst place of a course, or the places to the left and right of the object that is nearest then.

    Args:
        side: 0: the place, 1, 2: left, right of the object.
        time: when the course is worst [s].
        found: motion there.
    """
    o = find_nearest_object(plan, memory, k, way, found, time)
    if side == 0 or o == NO_OBJECT:
        return found[0], found[1]
    x, y, vx, vy = predict_object(plan, memory, k, o, time)
    if o == way.o:
        apart = way.reach + options.surroundings.margin
    else:
        apart = plan.body[way.r].radius + plan.body[plan.robots + o].radius + options.surroundings.beside
    wx, wy = found[2] - vx, found[3] - vy
    scale = (3.0 - 2.0 * side) * apart / max(math.hypot(wx, wy), 1e-9)
    return x - scale * wy, y + scale * wx


@compiled
def find_nearest_object(plan: PlanTable, memory: WorldMemory, k: int, way: Way, motion: Motion, t: float) -> int:
    """Return the object that a place is nearest to, by the distances that are kept to each, or NO_OBJECT."""
    nearest, found = math.inf, NO_OBJECT
    for j in range(len(plan.first)):
        x, y, _, _ = predict_object(plan, memory, k, j, t)
        reach = way.reach if j == way.o else plan.body[way.r].radius + plan.body[plan.robots + j].radius + way.aside
        gap = math.hypot(motion[0] - x, motion[1] - y) - reach
        if gap < nearest:
            nearest, found = gap, j
    return found


@inlined
def predict_object(plan: PlanTable, memory: WorldMemory, k: int, o: int, t: float) -> tuple[float, float, float, float]:
    """Return where object o will be, and its velocity, with what its coming impact is to do [m], [m/s]."""
    strike = memory.strike[k, o]
    if t <= strike.time or not strike.is_solved:
        return extrapolate_flight(memory, k, plan.robots + o, min(t, strike.time))
    x, y, _, _ = extrapolate_flight(memory, k, plan.robots + o, strike.time)
    vx, vy = strike.object_plus[0], strike.object_plus[1]
    return x + (t - strike.time) * vx, y + (t - strike.time) * vy, vx, vy


@inlined
def measure_aside(plan: PlanTable, memory: WorldMemory, k: int, r: int, o: int, motion: Motion, t: float) -> float:
    """Return the gap between robot r at a place and the nearest object but o, negative where they overlap [m]."""
    gap = math.inf
    for j in range(len(plan.first)):
        if j != o:
            x, y, _, _ = predict_object(plan, memory, k, j, t)
            apart = math.hypot(motion[0] - x, motion[1] - y)
            gap = min(gap, apart - plan.body[r].radius - plan.body[plan.robots + j].radius)
    return gap


@compiled
def fit_course(course: np.record, begin: Motion, end: Motion, now: float, until: float) -> None:
    """Write one quintic into a COURSE."""
    course.since, course.until = now, until
    fit_quintic(course, begin, end)


@compiled
def fit_via(
    plan: PlanTable,
    curves: np.ndarray,
    course: np.record,
    r: int,
    begin: Motion,
    end: Motion,
    now: float,
    time: float,
    x: float,
    y: float,
) -> None:
    """Write two quintics through a place into a COURSE."""
    for j in range(6):
        course.quintic[j, 0] = course.quintic[j, 1] = course.first[j, 0] = course.first[j, 1] = 0.0
    base = evaluate_course(course, plan.breaks, curves, r, time)
    fit_detour(course, begin, end, (x - base[0], y - base[1]), now, time)


@compiled
def choose_via(
    plan: PlanTable,
    options: Options,
    r: int,
    i: int,
    now: float,
    until: float,
    here: Motion,
    there: Motion,
    most: float,
) -> tuple[float, float, float]:
    """Return place and time of via point i: after a wait at the start, where a run-up begins, round a corner."""
    waits = len(options.surroundings.waits)
    if i < waits:
        return here[0], here[1], now + options.surroundings.waits[i] * (until - now)
    if i < waits + 2:
        # From rest to the velocity at the end, at all of the thrust or half of it.
        run_up = (i - waits + 1) * math.hypot(there[2], there[3]) / most
        return there[0] - run_up / 2 * there[2], there[1] - run_up / 2 * there[3], until - run_up
    x, y = find_corner(plan, r, i - waits - 2, options.surroundings.margin)
    before, after = math.hypot(x - here[0], y - here[1]), math.hypot(there[0] - x, there[1] - y)
    return x, y, now + (until - now) * before / max(before + after, 1e-9)


@compiled
def find_corner(plan: PlanTable, r: int, at: int, margin: float) -> tuple[float, float]:
    """Return the place at a corner of a solid obstacle that is robot r's radius and a margin off both faces.

    Args:
        at: number of the corner.
    """
    count = plan.solid.shape[1]
    corners, b = plan.solid[at // count], at % count
    x, y = corners[b, 0], corners[b, 1]
    ux, uy, wx, wy = 0.0, 0.0, 0.0, 0.0
    for i in range(1, count):  # past corners that only fill up
        ex, ey = x - corners[(b - i) % count, 0], y - corners[(b - i) % count, 1]
        if ux == 0.0 and uy == 0.0 and (ex != 0.0 or ey != 0.0):
            length = math.hypot(ex, ey)
            ux, uy = ey / length, -ex / length
        ex, ey = corners[(b + i) % count, 0] - x, corners[(b + i) % count, 1] - y
        if wx == 0.0 and wy == 0.0 and (ex != 0.0 or ey != 0.0):
            length = math.hypot(ex, ey)
            wx, wy = ey / length, -ex / length
    scale = (max(get_inset(plan, WALLS + at // count, r), 0.0) + margin) / max(1.0 + ux * wx + uy * wy, 0.5)
    return x + scale * (ux + wx), y + scale * (uy + wy)


@compiled
def move_clear(plan: PlanTable, r: int, x: float, y: float, margin: float) -> tuple[float, float]:
    """Return the place moved off walls and solid obstacles until robot r has a margin to them there."""
    for _ in range(2):
        for i in range(WALLS + len(plan.solid)):
            distance, nx, ny = measure_distance(plan, i, x, y)
            short = margin + get_inset(plan, i, r) - distance
            if short > 0.0:
                x, y = x - short * nx, y - short * ny
    return x, y


@inlined
def measure_intrusion(
    plan: PlanTable, memory: WorldMemory, options: Options, k: int, way: Way, motion: Motion, t: float
) -> float:
    """Return by how much a place is too near to a wall, a solid obstacle or an object, negative: room [m]."""
    intrusion = way.least - measure_gap(plan, way.r, motion[0], motion[1])
    intrusion = max(intrusion, way.aside - measure_aside(plan, memory, k, way.r, way.o, motion, t))
    if way.o != NO_OBJECT:
        x, y, _, _ = extrapolate_flight(memory, k, plan.robots + way.o, t)
        apart = math.hypot(motion[0] - x, motion[1] - y)
        intrusion = max(intrusion, way.reach - options.surroundings.through - apart)
    return intrusion


@compiled
def is_clear(plan: PlanTable, memory: WorldMemory, options: Options, k: int, way: Way) -> bool:
    """Return whether a course is too near to nothing; where there is room, look less often."""
    curves = memory.flown[k] if len(plan.response) > 0 else plan.coefficients
    course = memory.course[k, way.r]
    step, t = (course.until - way.now) / options.surroundings.samples, way.now + TINY
    while t < course.until:
        motion = evaluate_course(course, plan.breaks, curves, way.r, t)
        intrusion = measure_intrusion(plan, memory, options, k, way, motion, t)
        if intrusion > TINY:
            return False
        t += max(step, -intrusion / (2.0 * max(math.hypot(motion[2], motion[3]), plan.body[way.r].speed_limit)))
    return True


@compiled
def weigh_course(
    plan: PlanTable, memory: WorldMemory, options: Options, k: int, way: Way, most: float
) -> tuple[float, float]:
    """Return the cost of a course, and when it is nearest to what it should keep off.

    intrusion (share of the time too near + max(0, a / a_most - 1)) + a / a_most

    Args:
        most: acceleration that is asked for [m/s^2].
    """
    curves = memory.flown[k] if len(plan.response) > 0 else plan.coefficients
    course, count = memory.course[k, way.r], options.surroundings.samples
    inside, peak, deepest, worst = 0, 0.0, -math.inf, way.now
    for i in range(1, count):
        t = way.now + i * (course.until - way.now) / count
        motion = evaluate_course(course, plan.breaks, curves, way.r, t)
        intrusion = measure_intrusion(plan, memory, options, k, way, motion, t)
        if intrusion > TINY:
            inside += 1
        if intrusion > deepest:
            deepest, worst = intrusion, t
        peak = max(peak, math.hypot(motion[4], motion[5]) / most)
    dear = options.surroundings.intrusion
    return dear * (inside / count + max(peak - 1.0, 0.0)) + peak, worst

"""Go round walls and solid obstacles: replace a course that comes too near by one through a via point; compiled.

Robots stand near walls and run up to what they hit: a quintic that has much time for a short way swings out behind its
start, and one to the other side of an obstacle goes through it. Via points are corners of obstacles, the worst place of
the course moved clear, its start, and the place where the run-up to its end begins.
"""

from __future__ import annotations

import math

import numpy as np

from impact_envs.compiled import compiled
from planners.free_flyer.belief.options import Options
from planners.free_flyer.belief.plan_table import PlanTable
from planners.free_flyer.belief.surroundings import WALLS, measure_distance, measure_gap
from planners.free_flyer.belief.world_memory import WorldMemory
from planners.free_flyer.tracking.course import Motion, evaluate_course, evaluate_quintic, fit_detour, fit_quintic
from planners.free_flyer.tracking.mpc import GAIN, INPUT_LIMIT

SHORTEST = 1.0  # course that has room for a via point [s]
ENDS = 0.15  # share of a course at either end that is no time for a via point


@compiled
def go_round(plan: PlanTable, memory: WorldMemory, options: Options, k: int, r: int, now: float, latest: float) -> None:
    """Replace robot r's course, which begins now, by a detour if it comes too near to a wall or solid obstacle.

    Of all candidates, the course itself among them, the one of least cost is taken: see `weigh_course`. A course back
    to the plan may take up to `stretch` times as long.

    Args:
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
    least = min(least, surroundings.near)
    if is_clear(plan, curves, options, course, r, now, least):
        return
    begin, end = evaluate_quintic(course, now), evaluate_quintic(course, course.until)
    most = options.reach.ease * plan.pilot[r, GAIN] * plan.pilot[r, INPUT_LIMIT]
    best, chosen, via_x, via_y, time = math.inf, course.until, 0.0, 0.0, now
    worst, worst_x, worst_y = now, 0.0, 0.0
    for stretch in range(1 if course.ends_in_impact else surroundings.stretch):
        until = now + (stretch + 1) * T
        if stretch > 0 and until > latest:
            break
        fit_course(course, begin, end, now, until)
        there = evaluate_course(course, plan.breaks, curves, r, until)
        cost, nearest = weigh_course(plan, curves, options, course, r, now, least, most)
        if cost < best:
            best, chosen, time = cost, until, now
        if stretch == 0:
            motion = evaluate_course(course, plan.breaks, curves, r, nearest)
            worst, worst_x, worst_y = nearest, motion[0], motion[1]
        for i in range(3 + len(surroundings.waits) + plan.solid.shape[0] * plan.solid.shape[1]):
            if i == 0:
                x, y, at = worst_x, worst_y, now + (stretch + 1) * (worst - now)
            else:
                x, y, at = choose_via(plan, options, r, i - 1, now, until, here, there, most)
            x, y = move_clear(plan, r, x, y, surroundings.margin)
            at = min(max(at, now + ENDS * (until - now)), until - ENDS * (until - now))
            course.until = until
            fit_via(plan, curves, course, r, begin, end, now, at, x, y)
            cost, _ = weigh_course(plan, curves, options, course, r, now, least, most)
            if cost < best:
                best, chosen, via_x, via_y, time = cost, until, x, y, at
    if time > now:
        course.until = chosen
        fit_via(plan, curves, course, r, begin, end, now, time, via_x, via_y)
        memory.counts[k].detours += 1
    else:
        fit_course(course, begin, end, now, chosen)


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
    scale = (plan.body[r].radius + margin) / max(1.0 + ux * wx + uy * wy, 0.5)
    return x + scale * (ux + wx), y + scale * (uy + wy)


@compiled
def move_clear(plan: PlanTable, r: int, x: float, y: float, margin: float) -> tuple[float, float]:
    """Return the place moved off walls and solid obstacles until robot r has a margin to them there."""
    for _ in range(2):
        for i in range(WALLS + len(plan.solid)):
            distance, nx, ny = measure_distance(plan, i, x, y)
            short = margin + plan.body[r].radius - distance
            if short > 0.0:
                x, y = x - short * nx, y - short * ny
    return x, y


@compiled
def is_clear(
    plan: PlanTable, curves: np.ndarray, options: Options, course: np.record, r: int, now: float, least: float
) -> bool:
    """Return whether robot r's course keeps a gap to walls and obstacles; where there is room, look less often."""
    step, t = (course.until - now) / options.surroundings.samples, now
    while t < course.until:
        motion = evaluate_course(course, plan.breaks, curves, r, t)
        gap = measure_gap(plan, r, motion[0], motion[1])
        if gap < least - 1e-9:
            return False
        t += max(step, gap / (2.0 * max(math.hypot(motion[2], motion[3]), plan.body[r].speed_limit)))
    return True


@compiled
def weigh_course(
    plan: PlanTable,
    curves: np.ndarray,
    options: Options,
    course: np.record,
    r: int,
    now: float,
    least: float,
    most: float,
) -> tuple[float, float]:
    """Return the cost of robot r's course, and when it is nearest to a wall or solid obstacle.

    intrusion (share of the time with less than the least gap + max(0, a / a_most - 1)) + a / a_most

    Args:
        curves: of the robots' plans, as flown.
        least: gap that is asked for [m].
        most: acceleration that is asked for [m/s^2].
    """
    count = options.surroundings.samples
    inside, peak, nearest, worst = 0, 0.0, math.inf, now
    for i in range(1, count):
        t = now + i * (course.until - now) / count
        motion = evaluate_course(course, plan.breaks, curves, r, t)
        gap = measure_gap(plan, r, motion[0], motion[1])
        if gap < least - 1e-9:
            inside += 1
        if gap < nearest:
            nearest, worst = gap, t
        peak = max(peak, math.hypot(motion[4], motion[5]) / most)
    intrusion = options.surroundings.intrusion
    return intrusion * (inside / count + max(peak - 1.0, 0.0)) + peak, worst

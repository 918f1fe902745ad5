"""The paper's course of a robot to an impact: a cubic of least acceleration within speed limits; compiled."""

from __future__ import annotations

import math

import numpy as np

from impact_envs.compiled import compiled
from planners.free_flyer.tracking.course import Motion, read_clock, set_clock


@compiled
def plan_least_acceleration(
    course: np.record,
    now: float,
    begin: Motion,
    base: tuple[float, float],
    contact: tuple[float, float],
    velocity: tuple[float, float],
    time: float,
    limit: float,
    miss: float,
) -> None:
    """Plan the course to an impact as the paper does: one cubic, of least acceleration.

    min integral |a|^2 dt + miss (|p(T) - contact|^2 + |v(T) - velocity|^2)  with the control points of v within limits

    The plan stands still meanwhile. After the impact the robot returns to it from what it then measures, which takes
    the place of the second cubic of Eq. 29.

    Args:
        course: a COURSE, written.
        now: present time [s].
        begin: motion to start from.
        base: where the plan of the robot is now [m].
        contact: where to be [m].
        velocity: how fast to be there [m/s].
        time: of the impact, after now [s].
        limit: greatest speed per axis [m/s].
        miss: weight of misses.

    Source: Verhagen & Tumova, Eq. 29 with h(s) linear.
    """
    tau = min(read_clock(course, now), course.stop)
    set_clock(course, now, tau, time, tau, math.inf)
    course.rate = 0.0
    course.ends_in_impact, course.since, course.until = True, now, time
    course.quintic[:] = 0.0
    T = time - now
    for axis in range(2):
        v_0 = begin[2 + axis]
        middle, v_1 = minimise_acceleration(T, contact[axis] - begin[axis], v_0, velocity[axis], limit, miss)
        course.quintic[0, axis], course.quintic[1, axis] = begin[axis] - base[axis], v_0
        course.quintic[2, axis] = (middle - v_0) / T
        course.quintic[3, axis] = (v_1 - 2.0 * middle + v_0) / (3.0 * T * T)


@compiled
def minimise_acceleration(
    T: float, way: float, v_0: float, v_end: float, limit: float, miss: float
) -> tuple[float, float]:
    """Return the second and the last control point of one axis' velocity; see `plan_least_acceleration`.

    p(T) - p_0 = T (v_0 + m + v_1) / 3 and integral a^2 dt = 4 (m^2 + v_1^2 - m v_1 - v_0 (m + v_1) + v_0^2) / (3 T):
    a convex quadratic in (m, v_1). Where its minimum is beyond the limits, it is the least one on their edges.

    Args:
        T: duration [s].
        way: to go [m].
        v_0, v_end: velocity at the start, and wished at the end [m/s].
        limit: of both [m/s].
        miss: weight of misses.
    """
    k, share = 4.0 / (3.0 * T), T / 3.0
    off = share * v_0 - way
    here, shared = 2.0 * k + 2.0 * miss * share * share, -k + 2.0 * miss * share * share
    there = here + 2.0 * miss
    slope = -k * v_0 + 2.0 * miss * share * off
    last = slope - 2.0 * miss * v_end
    determinant = here * there - shared * shared
    m, v = (shared * last - there * slope) / determinant, (shared * slope - here * last) / determinant
    if max(abs(m), abs(v)) <= limit:
        return m, v
    best, found_m, found_v = math.inf, 0.0, 0.0
    for edge in range(4):
        bound = limit if edge % 2 == 0 else -limit
        if edge < 2:
            x, y = bound, min(max(-(last + shared * bound) / there, -limit), limit)
        else:
            x, y = min(max(-(slope + shared * bound) / here, -limit), limit), bound
        cost = (here * x * x + there * y * y) / 2.0 + shared * x * y + slope * x + last * y
        if cost < best:
            best, found_m, found_v = cost, x, y
    return found_m, found_v

"""A course read at the nodes of the tracking horizon, compiled: what `course.evaluate_course` gives, for less."""

from __future__ import annotations

import math

import numpy as np

from impact_envs.compiled import compiled, inlined
from planners.free_flyer.tracking.course import TIME_ROUND_OFF, read_clock


@compiled
def sample_course(
    course: np.record,
    breaks: np.ndarray,
    coefficients: np.ndarray,
    r: int,
    now: float,
    durations: np.ndarray,
    count: int,
    states: np.ndarray,
) -> None:
    """Write positions and velocities of robot r's course at the first nodes of a horizon.

    The same bits as of `evaluate_course`, for half its price: no accelerations, the segment is sought from the one
    before on, and where the plan stands still it is read once.

    Args:
        course: a COURSE; its clock does not run backwards.
        breaks, coefficients: of all robots, see `PlanTable`.
        now: time of the first node [s].
        durations: between the nodes, shape (N,) [s].
        count: of nodes, at most N + 1.
        states: x, y, heading, vx, vy, omega at the nodes, written but for heading and omega, shape (N + 1, 6).
    """
    impact, until, stop, t = course.ends_in_impact, course.until, course.stop, now
    end = breaks.shape[1]
    while breaks[r, end - 1] == np.inf:
        end -= 1
    low, read_at, was_left = 0, math.nan, False
    px, py, vx, vy = 0.0, 0.0, 0.0, 0.0
    for j in range(count):
        here = min(t, until) if impact else t
        tau = read_clock(course, here)
        at, left = min(tau, stop), tau >= stop - TIME_ROUND_OFF
        if at != read_at or left != was_left:
            read_at, was_left = at, left
            while low < end - 2 and (breaks[r, low + 1] < at or (breaks[r, low + 1] == at and not left)):
                low += 1
            px, py, vx, vy = _read_segment(breaks, coefficients, r, low, at)
            if at < breaks[r, 0] or at > breaks[r, end - 1]:
                vx, vy = 0.0, 0.0
        rate = 0.0 if tau > stop + TIME_ROUND_OFF and not impact else course.rate
        x, y, u, w = px, py, vx * rate, vy * rate
        if here <= until:
            qx, qy, ux, uy = _read_quintic(course, here)
            x, y, u, w = x + qx, y + qy, u + ux, w + uy
        if t > here:
            x, y = x + (t - here) * u, y + (t - here) * w
        states[j, 0], states[j, 1], states[j, 3], states[j, 4] = x, y, u, w
        if j < len(durations):
            t += durations[j]


@inlined
def _read_segment(
    breaks: np.ndarray, coefficients: np.ndarray, r: int, k: int, t: float
) -> tuple[float, float, float, float]:
    """Return position and velocity of robot r's plan in segment k."""
    h = breaks[r, k + 1] - breaks[r, k]
    s = min(max((t - breaks[r, k]) / h, 0.0), 1.0)
    px, py, vx, vy = 0.0, 0.0, 0.0, 0.0
    for j in range(coefficients.shape[2] - 1, -1, -1):
        vx, vy = vx * s + px, vy * s + py
        px, py = px * s + coefficients[r, k, j, 0], py * s + coefficients[r, k, j, 1]
    return px, py, vx / h, vy / h


@inlined
def _read_quintic(course: np.record, t: float) -> tuple[float, float, float, float]:
    """Return position and velocity of `evaluate_quintic`."""
    early = t < course.since
    s = t - (course.set_out if early else course.since)
    px, py, vx, vy = 0.0, 0.0, 0.0, 0.0
    for j in range(5, -1, -1):
        cx, cy = course.quintic[j, 0], course.quintic[j, 1]
        if early:
            cx, cy = course.first[j, 0], course.first[j, 1]
        vx, vy = vx * s + px, vy * s + py
        px, py = px * s + cx, py * s + cy
    return px, py, vx, vy

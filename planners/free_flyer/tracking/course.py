"""Courses: where one robot goes, as its plan read with its own clock plus a quintic; compiled.

course(t) = plan(tau(t)) + sum_j c_j (t - since)^j until `until`; before `since` c_j and `set_out` of the first quintic,
tau = clock_tau + rate (t - clock_start), at most `stop`
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from impact_envs.compiled import compiled, inlined
from planners.bezier import Curve

COURSE = np.dtype(
    [
        # The clock by which the plan is read.
        ("clock_start", float),  # when it was set [s]
        ("clock_tau", float),  # the plan's time then [s]
        ("rate", float),  # plan seconds per second
        ("stop", float),  # the plan's time at which it stops [s]
        # The quintic that is added; on a detour another one comes before it.
        ("set_out", float),  # that begins [s]
        ("first", float, (6, 2)),  # its coefficients c_j [m/s^j]
        ("since", float),  # the last one begins [s]
        ("until", float),  # it ends [s]
        ("quintic", float, (6, 2)),  # its coefficients c_j [m/s^j]
        ("ends_in_impact", bool),  # after the quintic the robot goes straight on, otherwise by its plan
    ],
    align=True,
)
SHORTEST_RETURN = 1.0  # [s]
TIME_ROUND_OFF = 1e-9  # [s]
# Position, velocity and acceleration [m, m/s, m/s^2].
Motion = tuple[float, float, float, float, float, float]


class PowerCurve(NamedTuple):
    """A piecewise polynomial p(t) = sum_j coefficients[k, j] s^j, s = (t - times[k]) / (times[k+1] - times[k]).

    Args:
        times: breakpoints, shape (S+1,) [s].
        coefficients: shape (S, d+1, 2) [m].
    """

    times: np.ndarray
    coefficients: np.ndarray


def convert_curve(curve: Curve) -> PowerCurve:
    """Return a Bezier curve in power basis, which compiled code evaluates by Horner's rule.

    c_j = binom(d, j) sum_{i <= j} (-1)^(j - i) binom(j, i) b_i, the j-th forward difference times binom(d, j)

    Args:
        curve: the Bezier curve.

    Returns:
        The same curve.

    Source: Farin, Curves and Surfaces for CAGD, 5.3.
    """
    coefficients = np.array(curve.points)
    binomial = 1.0
    difference = np.array(curve.points)
    for j in range(1, coefficients.shape[1]):
        difference = np.diff(difference, axis=1)
        binomial *= (curve.degree - j + 1) / j
        coefficients[:, j] = binomial * difference[:, 0]
    return PowerCurve(np.array(curve.times), coefficients)


@compiled
def evaluate_curve(breaks: np.ndarray, coefficients: np.ndarray, r: int, t: float, left: bool) -> Motion:
    """Return the motion of robot r's plan; outside its span it rests at its ends.

    Args:
        breaks, coefficients: of all robots, see `PlanTable`.
        t: time [s].
        left: at a breakpoint take the segment before it.
    """
    count = breaks.shape[1]
    while breaks[r, count - 1] == np.inf:
        count -= 1
    low, high = 0, count - 1  # the segment's number is in [low, high)
    while high - low > 1:
        middle = (low + high) // 2
        if breaks[r, middle] < t or (breaks[r, middle] == t and not left):
            low = middle
        else:
            high = middle
    h = breaks[r, low + 1] - breaks[r, low]
    s = min(max((t - breaks[r, low]) / h, 0.0), 1.0)
    px, py, vx, vy, ax, ay = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for j in range(coefficients.shape[2] - 1, -1, -1):
        ax, ay = ax * s + 2.0 * vx, ay * s + 2.0 * vy
        vx, vy = vx * s + px, vy * s + py
        px, py = px * s + coefficients[r, low, j, 0], py * s + coefficients[r, low, j, 1]
    if t < breaks[r, 0] or t > breaks[r, count - 1]:
        return px, py, 0.0, 0.0, 0.0, 0.0
    return px, py, vx / h, vy / h, ax / (h * h), ay / (h * h)


@compiled
def read_clock(course: np.record, t: float) -> float:
    """Return the plan's time at time t on a COURSE."""
    return course.clock_tau + course.rate * (t - course.clock_start)


@compiled
def evaluate_course(course: np.record, breaks: np.ndarray, coefficients: np.ndarray, r: int, t: float) -> Motion:
    """Return the motion of robot r's course; after an impact that did not come it goes straight on.

    Args:
        course: a COURSE.
        breaks, coefficients: of all robots, see `PlanTable`.
        t: time, not before the course's start [s].
    """
    impact, until = course.ends_in_impact, course.until
    now = min(t, until) if impact else t
    tau, stop, rate = read_clock(course, now), course.stop, course.rate
    stopped = tau > stop + TIME_ROUND_OFF and not impact
    px, py, vx, vy, ax, ay = evaluate_curve(breaks, coefficients, r, min(tau, stop), tau >= stop - TIME_ROUND_OFF)
    if stopped:
        rate = 0.0
    vx, vy, ax, ay = vx * rate, vy * rate, ax * rate * rate, ay * rate * rate
    if now <= until:
        qx, qy, ux, uy, wx, wy = evaluate_quintic(course, now)
        px, py, vx, vy, ax, ay = px + qx, py + qy, vx + ux, vy + uy, ax + wx, ay + wy
    if t > now:
        return px + (t - now) * vx, py + (t - now) * vy, vx, vy, 0.0, 0.0
    return px, py, vx, vy, ax, ay


@inlined
def evaluate_quintic(course: np.record, t: float) -> Motion:
    """Return what a COURSE adds to its plan at a time until its `until`."""
    early = t < course.since
    s = t - (course.set_out if early else course.since)
    px, py, vx, vy, ax, ay = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for j in range(5, -1, -1):
        cx, cy = course.quintic[j, 0], course.quintic[j, 1]
        if early:
            cx, cy = course.first[j, 0], course.first[j, 1]
        ax, ay = ax * s + 2.0 * vx, ay * s + 2.0 * vy
        vx, vy = vx * s + px, vy * s + py
        px, py = px * s + cx, py * s + cy
    return px, py, vx, vy, ax, ay


@compiled
def fit_quintic(course: np.record, begin: Motion, end: Motion) -> None:
    """Write the polynomial of degree five between two motions into a COURSE, from its `since` to its `until`.

    Args:
        course: a COURSE.
        begin, end: motions at `since` and `until`.
    """
    T = course.until - course.since
    for axis in range(2):
        c0, c1, c2 = begin[axis], begin[2 + axis], begin[4 + axis] / 2
        p = (end[axis] - (c0 + T * (c1 + T * c2))) / T**3
        v = (end[2 + axis] - (c1 + 2 * T * c2)) / T**2
        a = (end[4 + axis] - 2 * c2) / T
        course.quintic[0, axis], course.quintic[1, axis], course.quintic[2, axis] = c0, c1, c2
        course.quintic[3, axis] = 10 * p - 4 * v + a / 2
        course.quintic[4, axis] = (-15 * p + 7 * v - a) / T
        course.quintic[5, axis] = (6 * p - 3 * v + a / 2) / T**2


@compiled
def fit_detour(
    course: np.record, begin: Motion, end: Motion, via: tuple[float, float], start: float, time: float
) -> None:
    """Write two quintics through a via point into a COURSE, of least jerk: jerk and snap are continuous there.

    In each axis velocity v and acceleration a at the via point solve, with q = 1 / duration of the pieces 1 and 2 and d
    the ways from the via point to both ends,
        6 (q_1^2 - q_2^2) v - 1.5 (q_1 + q_2) a = -10 (d_1 q_1^3 + d_2 q_2^3) - 4 (v_0 q_1^2 - v_1 q_2^2)
                                                  - 0.5 (a_0 q_1 + a_1 q_2)
        8 (q_1^3 + q_2^3) v - 1.5 (q_1^2 - q_2^2) a = 15 (d_2 q_2^4 - d_1 q_1^4) - 7 (v_0 q_1^3 + v_1 q_2^3)
                                                  - a_0 q_1^2 + a_1 q_2^2

    Args:
        course: a COURSE.
        begin, end: motions that are added to the plan at the start and at `until`.
        via: position that is added to the plan there [m].
        start, time: of the course and at the via point, start < time < until [s].
    """
    p, q = 1.0 / (time - start), 1.0 / (course.until - time)
    vx, ax = _find_middle(p, q, begin[0] - via[0], end[0] - via[0], begin[2], end[2], begin[4], end[4])
    vy, ay = _find_middle(p, q, begin[1] - via[1], end[1] - via[1], begin[3], end[3], begin[5], end[5])
    middle, until = (via[0], via[1], vx, vy, ax, ay), course.until
    course.since, course.until = start, time
    fit_quintic(course, begin, middle)
    for j in range(6):
        course.first[j, 0], course.first[j, 1] = course.quintic[j, 0], course.quintic[j, 1]
    course.set_out, course.since, course.until = start, time, until
    fit_quintic(course, middle, end)


@inlined
def _find_middle(
    p: float, q: float, d_0: float, d_1: float, v_0: float, v_1: float, a_0: float, a_1: float
) -> tuple[float, float]:
    """Return velocity and acceleration of one axis at the via point of `fit_detour`."""
    right = -10.0 * (d_0 * p**3 + d_1 * q**3) - 4.0 * (v_0 * p * p - v_1 * q * q) - 0.5 * (a_0 * p + a_1 * q)
    below = 15.0 * (d_1 * q**4 - d_0 * p**4) - 7.0 * (v_0 * p**3 + v_1 * q**3) - a_0 * p * p + a_1 * q * q
    a, b, c, d = 6.0 * (p * p - q * q), -1.5 * (p + q), 8.0 * (p**3 + q**3), -1.5 * (p * p - q * q)
    determinant = a * d - b * c
    return (right * d - b * below) / determinant, (a * below - c * right) / determinant


@compiled
def subtract_motion(a: Motion, b: Motion) -> Motion:
    """Return the difference of two motions."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2], a[3] - b[3], a[4] - b[4], a[5] - b[5]


@compiled
def set_clock(course: np.record, now: float, tau: float, time: float, planned: float, fastest: float) -> None:
    """Set the clock of a course so that the plan stands at an event when the event is expected, and stops there.

    rate = (planned - tau) / (time - now), at most `fastest`

    Args:
        course: a COURSE.
        now: present time [s].
        tau: plan's time now [s].
        time: of the event, expected [s].
        planned: of the event in the plan [s].
        fastest: plan seconds per second; more would force the end pose within the few seconds left.
    """
    tau = min(tau, planned)
    rate = 1.0
    if time > now and planned > tau:
        rate = min((planned - tau) / (time - now), fastest)
    course.clock_start, course.clock_tau, course.rate, course.stop = now, tau, rate, planned


@compiled
def plan_approach(
    course: np.record,
    breaks: np.ndarray,
    coefficients: np.ndarray,
    r: int,
    now: float,
    begin: Motion,
    contact: tuple[float, float],
    velocity: tuple[float, float],
    time: float,
    planned: float,
) -> None:
    """Plan the course to an impact: plan + quintic from a motion to contact and velocity at the time of impact.

    Args:
        course: a COURSE, written.
        breaks, coefficients: of all robots, see `PlanTable`.
        now: present time [s].
        begin: motion to start from.
        contact: where to be [m].
        velocity: how fast to be there [m/s].
        time: of the impact, after now [s].
        planned: plan's time of the impact; at or before the plan's present time the plan stands still [s].

    Source: Verhagen & Tumova, Eq. 29, with a quintic correction in place of the QP of
        `least_acceleration.plan_least_acceleration`.
    """
    tau = min(read_clock(course, now), course.stop)
    still = planned <= tau
    set_clock(course, now, tau, time, tau if still else planned, math.inf)
    course.rate = 0.0 if still else course.rate
    course.ends_in_impact, course.since, course.until = True, now, time
    course.quintic[:] = 0.0
    base = evaluate_course(course, breaks, coefficients, r, now)
    end = evaluate_course(course, breaks, coefficients, r, time)
    target = (contact[0], contact[1], velocity[0], velocity[1], end[4], end[5])
    fit_quintic(course, subtract_motion(begin, base), subtract_motion(target, end))


@compiled
def return_to_plan(
    course: np.record,
    breaks: np.ndarray,
    coefficients: np.ndarray,
    r: int,
    now: float,
    begin: tuple[float, float, float, float],
    tau: float,
    time: float,
    planned: float,
    longest: float,
    fastest: float,
) -> None:
    """Plan the course back to the plan, in half the time to the next event or less.

    Args:
        course: a COURSE, written.
        breaks, coefficients: of all robots, see `PlanTable`.
        now: present time [s].
        begin: position and velocity to start from, with the plan's acceleration [m, m/s].
        tau: plan's time that belongs to the present [s].
        time, planned: of the robot's next impact or of the horizon, expected and in the plan [s].
        longest: duration of the quintic at most [s].
        fastest: plan seconds per second at most.
    """
    set_clock(course, now, tau, time, planned, fastest)
    course.ends_in_impact, course.since = False, now
    course.until = now + max(min(longest, (time - now) / 2), SHORTEST_RETURN)
    course.quintic[:] = 0.0
    base = evaluate_course(course, breaks, coefficients, r, now)
    offset = (begin[0] - base[0], begin[1] - base[1], begin[2] - base[2], begin[3] - base[3], 0.0, 0.0)
    fit_quintic(course, offset, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0))


@compiled
def rejoin_plan(
    course: np.record,
    breaks: np.ndarray,
    coefficients: np.ndarray,
    r: int,
    now: float,
    begin: Motion,
    shortest: float,
) -> None:
    """Plan the course from a motion to a plan that has changed; its clock goes on, and so does a return under way.

    Args:
        course: a COURSE, written.
        breaks, coefficients: of all robots, see `PlanTable`.
        now: present time [s].
        begin: motion to start from.
        shortest: duration of the quintic at least [s].
    """
    course.since, course.until = now, max(course.until, now + shortest)
    course.quintic[:] = 0.0
    base = evaluate_course(course, breaks, coefficients, r, now)
    fit_quintic(course, subtract_motion(begin, base), (0.0, 0.0, 0.0, 0.0, 0.0, 0.0))

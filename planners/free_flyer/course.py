"""Courses: where one robot goes, as its plan read with its own clock plus a quintic; evaluated by compiled code."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from planners.bezier import Curve


class PowerCurve(NamedTuple):
    """A piecewise polynomial p(t) = sum_j coefficients[k, j] s^j, s = (t - times[k]) / (times[k+1] - times[k]).

    Args:
        times: breakpoints, shape (S+1,) [s].
        coefficients: shape (S, d+1, 2) [m].
    """

    times: np.ndarray
    coefficients: np.ndarray


class Course(NamedTuple):
    """Where one robot goes: plan(tau(t)) + quintic(t), tau = plan_start + rate (t - start), at most plan_stop.

    Args:
        plan: the robot's planned curve.
        start: time at which this course starts [s].
        plan_start: plan time at the start [s].
        rate: plan seconds per second.
        plan_stop: plan time at which the clock stops, the robot's next planned impact [s].
        quintic: coefficients of (t - start)^j, shape (6, 2) [m/s^j].
        end: time at which the quintic ends [s].
        impact: True if the course ends at an impact: it then goes straight on. Otherwise the plan goes on.
    """

    plan: PowerCurve
    start: float
    plan_start: float
    rate: float
    plan_stop: float
    quintic: np.ndarray
    end: float
    impact: bool


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


@njit(cache=True)
def evaluate_curve(curve: PowerCurve, t: float, left: bool, out: np.ndarray) -> None:
    """Evaluate a piecewise polynomial; outside its span it rests at its ends.

    Args:
        curve: the curve.
        t: time [s].
        left: at a breakpoint take the segment before it.
        out: position, velocity, acceleration, written, shape (3, 2) [m, m/s, m/s^2].
    """
    times, coefficients = curve.times, curve.coefficients
    last = len(times) - 2
    k = 0
    while k < last and (times[k + 1] < t or (times[k + 1] == t and not left)):
        k += 1
    h = times[k + 1] - times[k]
    s = min(max((t - times[k]) / h, 0.0), 1.0)
    outside = t < times[0] or t > times[-1]
    for axis in range(2):
        p, v, a = 0.0, 0.0, 0.0
        for j in range(coefficients.shape[1] - 1, -1, -1):
            a = a * s + 2.0 * v
            v = v * s + p
            p = p * s + coefficients[k, j, axis]
        out[0, axis] = p
        out[1, axis] = 0.0 if outside else v / h
        out[2, axis] = 0.0 if outside else a / (h * h)


@njit(cache=True)
def evaluate_course(course: Course, t: float, out: np.ndarray) -> None:
    """Evaluate a course; after an impact that did not come it goes straight on.

    Args:
        course: the course.
        t: time, not before its start [s].
        out: position, velocity, acceleration, written, shape (3, 2) [m, m/s, m/s^2].
    """
    now = min(t, course.end) if course.impact else t
    late = t - now
    tau = course.plan_start + course.rate * (now - course.start)
    stopped = tau > course.plan_stop + 1e-9 and not course.impact
    evaluate_curve(course.plan, min(tau, course.plan_stop), tau >= course.plan_stop - 1e-9, out)
    rate = 0.0 if stopped else course.rate
    s = now - course.start
    for axis in range(2):
        out[1, axis] *= rate
        out[2, axis] *= rate * rate
        if now <= course.end:
            p, v, a = 0.0, 0.0, 0.0
            for j in range(5, -1, -1):
                a = a * s + 2.0 * v
                v = v * s + p
                p = p * s + course.quintic[j, axis]
            out[0, axis] += p
            out[1, axis] += v
            out[2, axis] += a
        if late > 0.0:
            out[0, axis] += late * out[1, axis]
            out[2, axis] = 0.0


def fit_quintic(duration: float, begin: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return the polynomial of degree five between two states.

    Args:
        duration: T [s].
        begin, end: position, velocity, acceleration at 0 and T, shape (3, 2) [m, m/s, m/s^2].

    Returns:
        Coefficients of t^j, shape (6, 2).
    """
    T = duration
    c = np.zeros((6, 2))
    c[0], c[1], c[2] = begin[0], begin[1], begin[2] / 2
    p = (end[0] - (c[0] + T * (c[1] + T * c[2]))) / T**3
    v = (end[1] - (c[1] + 2 * T * c[2])) / T**2
    a = (end[2] - 2 * c[2]) / T
    c[3] = 10 * p - 4 * v + a / 2
    c[4] = (-15 * p + 7 * v - a) / T
    c[5] = (6 * p - 3 * v + a / 2) / T**2
    return c

"""Online replanning: the course of one robot to its next impact, and back to its plan afterwards.

A course is the plan, read with its own clock, plus a quintic that vanishes smoothly at both ends or ends at the impact.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from planners.bezier import Curve
from planners.free_flyer.tracking import NO_JUMP, STAGES, Reference, TrackingProblem
from planners.free_flyer.two_body import TwoBodyImpact

RETURN_SECONDS = 12.0  # longest quintic back to the plan
SHORTEST_RETURN = 1.0
FASTEST_CLOCK = 1.5  # plan seconds per second; more would force the end pose within the few seconds left


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


def follow_plan(plan: PowerCurve, plan_stop: float) -> Course:
    """Return the course that is the plan itself.

    Args:
        plan: the robot's planned curve.
        plan_stop: the robot's first planned impact, or the horizon [s].

    Returns:
        The course, from time 0.
    """
    return Course(plan, 0.0, 0.0, 1.0, plan_stop, np.zeros((6, 2)), 0.0, False)


def plan_approach(
    course: Course, now: float, state: np.ndarray, impact: TwoBodyImpact, time: float, plan_time: float
) -> Course:
    """Return the course to an impact.

    plan + quintic from the present reference (or from a state) to (p_c, v_R^-) at the time of impact, with the
    plan's acceleration there.

    Args:
        course: the present course.
        now: present time [s].
        state: position, velocity, acceleration to start from, shape (3, 2) [m, m/s, m/s^2].
        impact: where and how fast to be.
        time: of the impact, after now [s].
        plan_time: of the impact in the plan [s].

    Returns:
        The course, which goes straight on after the time of impact.

    Source: Verhagen & Tumova, Eq. 29, with a quintic correction in place of the QP.
    """
    tau = min(course.plan_start + course.rate * (now - course.start), plan_time)
    rate = (plan_time - tau) / (time - now)
    base = Course(course.plan, now, tau, rate, plan_time, np.zeros((6, 2)), time, True)
    begin, end = np.empty((3, 2)), np.empty((3, 2))
    evaluate_course(base, now, begin)
    evaluate_course(base, time, end)
    target = np.array([impact.contact, impact.robot_minus, end[2]])
    return base._replace(quintic=fit_quintic(time - now, state - begin, target - end))


def plan_return(
    plan: PowerCurve, now: float, state: np.ndarray, plan_now: float, next_time: float, plan_next: float
) -> Course:
    """Return the course back to the plan, in 12 s or half the time that is left.

    Args:
        plan: the robot's planned curve.
        now: present time [s].
        state: position and velocity to start from, with the plan's acceleration, shape (2, 2) [m, m/s].
        plan_now: plan time that belongs to the present [s].
        next_time: of the robot's next impact, or of the horizon [s].
        plan_next: the same in the plan [s].

    Returns:
        The course, whose clock arrives at the next impact in time.
    """
    left = next_time - now
    rate = min((plan_next - plan_now) / left, FASTEST_CLOCK) if left > 0 and plan_next > plan_now else 1.0
    duration = max(min(RETURN_SECONDS, left / 2), SHORTEST_RETURN)
    base = Course(plan, now, plan_now, rate, plan_next, np.zeros((6, 2)), now + duration, False)
    begin = np.empty((3, 2))
    evaluate_course(base, now, begin)
    begin[:2], begin[2] = state - begin[:2], 0.0
    return base._replace(quintic=fit_quintic(duration, begin, np.zeros((3, 2))))


def compute_desired_velocity(
    position: np.ndarray, target: np.ndarray, duration: float, drift: np.ndarray, limit: float
) -> np.ndarray:
    """Return the velocity that takes an object from its impact to its next knot.

    v_des = (P_{k+1} - x_O(t_I)) / L - a L / 2,  L = t_{k+1} - t_I, shortened to the speed limit

    Args:
        position: of the object at the impact, shape (2,) [m].
        target: where it should be next, shape (2,) [m].
        duration: of its flight there, L [s].
        drift: constant acceleration of the object, shape (2,) [m/s^2].
        limit: greatest speed per axis [m/s].

    Returns:
        Velocity, shape (2,) [m/s].

    Source: Verhagen & Tumova, Sec. VI, with the estimated drift added.
    """
    velocity = (target - position) / duration - drift * duration / 2
    return velocity * min(1.0, limit / max(float(np.abs(velocity).max()), 1e-12))


@njit(cache=True)
def fill_reference(
    course: Course,
    now: float,
    durations: np.ndarray,
    jump_node: int,
    after: tuple[float, float],
    mass: float,
    heading: float,
    states: np.ndarray,
    inputs: np.ndarray,
) -> None:
    """Sample a course at the nodes of the horizon, with the feed-forward forces that reproduce its velocities.

    Args:
        course: where to go.
        now: present time [s].
        durations: of the stages, shape (10,) [s].
        jump_node: node of a predicted impact, or NO_JUMP.
        after: velocity of the robot after the predicted impact [m/s].
        mass: of the robot [kg].
        heading: measured heading, which turns forces into the body frame [rad].
        states: columns x, y, vx, vy are written, shape (11, 6).
        inputs: columns Fx, Fy are written, shape (10, 3) [N].
    """
    c, s = np.cos(heading), np.sin(heading)
    sample = np.empty((3, 2))
    t = now
    for k in range(len(durations) + 1):
        if jump_node == NO_JUMP or k <= jump_node:
            evaluate_course(course, t, sample)
            for axis in range(2):
                states[k, axis], states[k, 3 + axis] = sample[0, axis], sample[1, axis]
        else:
            for axis in range(2):
                states[k, axis] = states[k - 1, axis] + durations[k - 1] * after[axis]
                states[k, 3 + axis] = after[axis]
        if k > 0:
            bounced = jump_node != NO_JUMP and k > jump_node
            fx = 0.0 if bounced else mass * (states[k, 3] - states[k - 1, 3]) / max(durations[k - 1], 1e-9)
            fy = 0.0 if bounced else mass * (states[k, 4] - states[k - 1, 4]) / max(durations[k - 1], 1e-9)
            inputs[k - 1, 0] = c * fx + s * fy
            inputs[k - 1, 1] = c * fy - s * fx
        if k < len(durations):
            t += durations[k]


def sample_reference(
    course: Course,
    now: float,
    problem: TrackingProblem,
    heading: float,
    home: float,
    impact: TwoBodyImpact | None,
    jump_gain: float,
) -> Reference:
    """Return what tracking should do over its horizon; a stage border is moved onto an impact within it.

    Args:
        course: where to go.
        now: present time [s].
        problem: of the tracking.
        heading: measured [rad].
        home: heading to keep [rad].
        impact: the one the course ends at, if it does.
        jump_gain: c = (1 + e) m_O / (m_R + m_O).

    Returns:
        The reference.

    Source: Verhagen & Tumova, Sec. VII: Eq. 7 in the prediction at t_m = t_impact.
    """
    h = problem.period
    states, inputs, durations = np.zeros((STAGES + 1, 6)), np.zeros((STAGES, 3)), np.full(STAGES, h)
    states[:, 2] = home
    ahead = course.end - now
    jumps = impact is not None and course.impact and 0.0 <= ahead < (STAGES - 0.5) * h
    if not jumps or impact is None:
        fill_reference(course, now, durations, NO_JUMP, (0.0, 0.0), 1.0 / problem.gains[0], heading, states, inputs)
        return Reference(states, inputs, durations)
    node = min(max(round(ahead / h), 1), STAGES - 1)
    durations[node - 1] = ahead - (node - 1) * h
    durations[node] = (node + 1) * h - ahead
    after = impact.robot_plus
    fill_reference(course, now, durations, node, after, 1.0 / problem.gains[0], heading, states, inputs)
    n, v = impact.normal, impact.object_minus
    return Reference(states, inputs, durations, node, n, jump_gain, n[0] * v[0] + n[1] * v[1])

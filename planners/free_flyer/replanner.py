"""Online replanning: the course of one robot to its next impact, and back to its plan afterwards."""

from __future__ import annotations

import numpy as np
from numba import njit

from planners.free_flyer.course import Course, PowerCurve, evaluate_course, fit_quintic
from planners.free_flyer.tracking import NO_JUMP, STAGES, Reference, TrackingProblem
from planners.free_flyer.two_body import TwoBodyImpact

RETURN_SECONDS = 12.0  # longest quintic back to the plan
SHORTEST_RETURN = 1.0
FASTEST_CLOCK = 1.5  # plan seconds per second; more would force the end pose within the few seconds left


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
    sample: np.ndarray,
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
        sample: scratch, shape (3, 2).
        states: columns x, y, vx, vy are written, shape (11, 6).
        inputs: columns Fx, Fy are written, shape (10, 3) [N].
    """
    c, s = np.cos(heading), np.sin(heading)
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
    h, mass, sample = problem.period, 1.0 / problem.gains[0], np.empty((3, 2))
    states, inputs, durations = np.zeros((STAGES + 1, 6)), np.zeros((STAGES, 3)), np.full(STAGES, h)
    states[:, 2] = home
    ahead = course.end - now
    if impact is None or not course.impact or not 0.0 <= ahead < (STAGES - 0.5) * h:
        fill_reference(course, now, durations, NO_JUMP, (0.0, 0.0), mass, heading, sample, states, inputs)
        return Reference(states, inputs, durations)
    node = min(max(round(ahead / h), 1), STAGES - 1)
    durations[node - 1] = ahead - (node - 1) * h
    durations[node] = (node + 1) * h - ahead
    fill_reference(course, now, durations, node, impact.robot_plus, mass, heading, sample, states, inputs)
    n, v = impact.normal, impact.object_minus
    return Reference(states, inputs, durations, node, n, jump_gain, n[0] * v[0] + n[1] * v[1])

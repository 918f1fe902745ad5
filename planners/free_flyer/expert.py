"""The free-flyers' expert: plan, estimate, replan the course to every impact, track it by MPC."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping

import numpy as np

from impact_envs.errors import InputError
from impact_envs.free_flyer.observation import Measurement, read_observations
from impact_envs.free_flyer.schema import Body, FreeFlyerScenario
from impact_envs.rollout import Diagnostics
from planners.free_flyer.course import Course, convert_curve, evaluate_course
from planners.free_flyer.estimator import Estimator
from planners.free_flyer.replanner import (
    compute_desired_velocity,
    follow_plan,
    plan_approach,
    plan_return,
    sample_reference,
)
from planners.free_flyer.schedule import Schedule, Strike
from planners.free_flyer.tracking import Tracker, build_tracking_problem
from planners.free_flyer.two_body import compute_velocity_gain, solve_two_body_impact
from planners.plan import Plan

LOST = 0.1  # tracking error above which a course starts from the estimated state [m]
SCALE_RANGE = 0.5  # of the logarithm of the impulse, at correction 1
ROTATION_RANGE = 0.3  # of the impulse, at correction 1 [rad]
SHORTEST_LEG = 5.0  # a delayed impact does not make the object faster than for a leg of this duration [s]
# An unknown restitution errs the same way at the first and the last impact, so its effects on position and velocity
# partly cancel: the last impact corrects the whole deviation only if as much time is left [s],
FULL_CORRECTION = 15.0
SAME_SIDE = 0.5  # and nothing of it if the impulse had to turn from the planned normal by more than this cosine
ONE_HOT = 6


def check_plan(scenario: FreeFlyerScenario, plan: Plan) -> None:
    """Raise if a plan cannot be executed in a scenario.

    Args:
        scenario: to act in.
        plan: to execute.

    Raises:
        InputError: the plan is for other bodies or another horizon.
    """
    planned = {*plan.robots, *plan.objects}
    if planned != set(scenario.bodies):
        raise InputError(
            f"the plan is for {plan.scenario} with {', '.join(sorted(planned))}; "
            f"scenario {scenario.name} has {', '.join(sorted(scenario.bodies))}"
        )
    if not math.isclose(plan.horizon, scenario.horizon):
        raise InputError(f"the plan lasts {plan.horizon:g} s, scenario {scenario.name} lasts {scenario.horizon:g} s")


class FreeFlyerExpert:
    """Execute a plan in closed loop: a Policy that also takes a correction of every impulse.

    Per control step: estimate; on a contact return to the plan; in the last 20 s before an impact replan the
    course to it from the predicted object; track by MPC. Everything is computed from the believed physics, the plan
    and observations.

    Args:
        scenario: its true physics are not looked at.
        plan: to execute.

    Attributes:
        name: of the policy.
        correction_size, feature_size: of what `correct` takes and `features` returns.
        plan: that is executed.

    Raises:
        InputError: the plan is for other bodies or another horizon.

    Source: Verhagen & Tumova, Secs. VI and VII.
    """

    name = "expert"
    correction_size = 2
    feature_size = ONE_HOT + 17

    def __init__(self, scenario: FreeFlyerScenario, plan: Plan) -> None:
        check_plan(scenario, plan)
        self.plan = plan
        self._scenario = scenario.as_believed()
        self._estimator = Estimator(self._scenario)
        self._schedule = Schedule(plan)
        self._trackers = {
            name: Tracker(build_tracking_problem(robot, scenario.control_period))
            for name, robot in scenario.robots.items()
        }
        self._curves = {name: convert_curve(plan.robots[name]) for name in scenario.robots}
        self.reset(0)
        self._warm_up()
        self.reset(0)

    def reset(self, seed: int) -> None:
        """Forget the last episode.

        Args:
            seed: unused, the expert is deterministic.
        """
        self._now = self._seconds = 0.0
        self._diagnostics = Diagnostics()
        self._estimator.reset()
        self._schedule.reset()
        self._accelerations: dict[str, tuple[float, float]] = {}
        self._awaiting: Strike | None = None
        self._courses: dict[str, Course] = {}
        for name, tracker in self._trackers.items():
            tracker.reset()
            self._courses[name] = follow_plan(self._curves[name], self._schedule.next_impact(name)[1])

    def act(self, observations: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Return each robot's action in [-1, 1], shape (3,), from its observation."""
        self.observe(observations)
        return self.control()

    def diagnostics(self) -> Diagnostics:
        """Return computing times, fallbacks and replans since reset."""
        return self._diagnostics

    def observe(self, observations: Mapping[str, np.ndarray]) -> None:
        """Update the estimates, take note of contacts and missed impacts, and see whether a correction is due.

        Args:
            observations: robot to its observation.
        """
        begin = time.perf_counter()
        measurement = read_observations(self._scenario, observations)
        before = {name: self._estimator.velocity(name) for name in self._scenario.objects}
        touched = self._estimator.update(measurement, self._accelerations)
        self._now = measurement.time
        for robot, other in touched.items():
            self._take_contact(robot, other, before)
        for strike, again in self._schedule.take_misses(self._now):
            self._diagnostics.fallbacks["retry" if again else "give_up"] += 1
            if not again:
                self._return(strike.planned.robot, strike.planned.time)
        self._schedule.observe_hits({name: self._estimator.velocity(name) for name in before}, self._now)
        self._awaiting = self._schedule.find_due(self._now)
        self._seconds = time.perf_counter() - begin

    @property
    def awaiting_correction(self) -> bool:
        """Return whether the next `control` will use up a new correction; once per planned impact."""
        return self._awaiting is not None

    def correct(self, correction: np.ndarray) -> None:
        """Set the correction of the coming impact.

        The desired velocity change of the object is multiplied by exp(0.5 c_0) and turned by 0.3 c_1 rad.

        Args:
            correction: c in [-1, 1], shape (2,); zero changes nothing, bit for bit.

        Raises:
            InputError: wrong shape, or no correction is awaited.
        """
        values = np.asarray(correction, dtype=float)
        if values.shape != (2,) or not np.isfinite(values).all():
            raise InputError(f"correction must be 2 finite numbers, got {np.array2string(values, threshold=8)}")
        if self._awaiting is None:
            raise InputError("no correction is awaited now; see awaiting_correction")
        scale, rotation = np.clip(values, -1.0, 1.0)
        self._awaiting.correction = float(scale), float(rotation)

    def features(self) -> np.ndarray:
        """Return what a learner may see of the coming impact (of the one a correction is awaited for, if any).

        Returns:
            Shape (23,): one-hot number of the impact in the plan (6); time / horizon; time to the impact [s]; duration
            of the leg after it [s]; predicted position of the object at the impact minus planned (2) [m]; velocity of
            the object (2), desired velocity (2), desired change (2) [m/s]; change over commanded change at the last
            impact of this object, 1 before any; number of such observations; position (2) [m] and velocity (2) [m/s]
            of the robot relative to the object. Zeros when no impact is to come.
        """
        coming = self._schedule.strikes.values()
        strike = self._awaiting or min(coming, key=lambda strike: strike.time, default=None)
        if strike is None:
            return np.zeros(self.feature_size)
        planned = strike.planned
        position, velocity = self._estimator.extrapolate(planned.object, strike.time)
        desired = self._desired_velocity(strike, position, velocity)
        one_hot = np.zeros(ONE_HOT)
        one_hot[min(strike.index, ONE_HOT - 1)] = 1.0
        leg = self._schedule.target(strike)[1] - strike.time
        ratios = self._schedule.ratios(planned.object)
        robot, item = self._estimator.state(planned.robot), self._estimator.state(planned.object)
        relative = robot - item
        return np.concatenate(
            [
                one_hot,
                [self._now / self._scenario.horizon, strike.time - self._now, leg],
                position - planned.position,
                self._estimator.velocity(planned.object),
                desired,
                desired - velocity,
                [ratios[-1] if ratios else 1.0, float(len(ratios))],
                relative[[0, 1, 3, 4]],
            ]
        )

    def control(self) -> dict[str, np.ndarray]:
        """Replan where it is time to, and return each robot's action.

        Returns:
            Robot to action in [-1, 1], shape (3,): body-frame forces and torque over their limits.
        """
        begin = time.perf_counter()
        if self._awaiting is not None:
            self._awaiting.decided, self._awaiting.replanned, self._awaiting = True, -math.inf, None
        actions = {}
        for name in self._scenario.robots:
            strike = self._schedule.strike_of(name)
            if strike is not None and self._schedule.should_replan(strike, self._now):
                self._replan(strike)
            actions[name] = self._track(name, strike)
        self._diagnostics.solve_seconds.append(self._seconds + time.perf_counter() - begin)
        return actions

    def _warm_up(self) -> None:
        """Run every compiled function once, so that no control step has to wait for the compiler."""

        def at_rest(bodies: Mapping[str, Body]) -> dict[str, np.ndarray]:
            return {name: np.array([*body.start, 0.0, 0.0, body.heading, 0.0]) for name, body in bodies.items()}

        robots, objects = self._scenario.robots, self._scenario.objects
        felt = dict.fromkeys(robots, True)
        self._estimator.update(Measurement(0.0, at_rest(robots), at_rest(objects), felt), {})
        for robot in robots:
            self._return(robot, 0.0)
        for strike in self._schedule.strikes.values():
            self._replan(strike)
        self.control()

    def _take_contact(self, robot: str, other: str, before: Mapping[str, np.ndarray]) -> None:
        """Return to the plan after a contact, planned or not."""
        strike = self._schedule.take_contact(robot, other, self._now, before.get(other, np.zeros(2)))
        if strike is None:
            self._diagnostics.fallbacks["unplanned_contact"] += 1
            course = self._courses[robot]
            self._return(robot, course.plan_start + course.rate * (self._now - course.start))
            return
        since = min(max(self._now - strike.time, 0.0), self._scenario.control_period)
        self._return(robot, strike.planned.time + since)

    def _return(self, robot: str, plan_now: float) -> None:
        """Plan the course back to the plan, which stands at a given time."""
        expected, planned = self._schedule.next_impact(robot)
        curve, start = self._curves[robot], self._present_state(robot)
        self._courses[robot] = plan_return(curve, self._now, start, min(plan_now, planned), expected, planned)
        self._diagnostics.replans += 1

    def _replan(self, strike: Strike) -> None:
        """Plan the course to an impact, from the object as it is seen now."""
        planned = strike.planned
        position, velocity = self._estimator.extrapolate(planned.object, strike.time)
        change = self._desired_velocity(strike, position, velocity) - velocity
        scale = math.exp(SCALE_RANGE * strike.correction[0])
        angle = ROTATION_RANGE * strike.correction[1]
        c, s = math.cos(angle), math.sin(angle)
        desired = velocity + scale * np.array([c * change[0] - s * change[1], s * change[0] + c * change[1]])
        robot, item = self._scenario.robots[planned.robot], self._scenario.objects[planned.object]
        strike.solution = solve_two_body_impact(
            tuple(position),
            tuple(velocity),
            tuple(desired),
            tuple(velocity),
            tuple(planned.normal),
            robot.mass,
            item.mass,
            self._scenario.believed.restitution,
            robot.radius + item.radius,
            robot.speed_limit,
        )
        course = self._courses[planned.robot]
        start = np.empty((3, 2))
        evaluate_course(course, self._now, start)
        present = self._present_state(planned.robot)
        if math.dist(present[0], start[0]) > LOST:
            self._diagnostics.fallbacks["lost"] += 1
            start[:2] = present
        self._courses[planned.robot] = plan_approach(
            course, self._now, start, strike.solution, strike.time, planned.time
        )
        strike.replanned = self._now
        self._diagnostics.replans += 1

    def _desired_velocity(self, strike: Strike, position: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """Return the velocity the object should have after the impact, given its state before, shape (2,) [m/s]."""
        name, planned = strike.planned.object, strike.planned
        limit, drift = self._scenario.objects[name].speed_limit, self._estimator.drift(name)
        target, due = self._schedule.target(strike)
        duration = max(due - strike.time, min(SHORTEST_LEG, due - planned.time))
        if not self._schedule.is_last(strike):
            return compute_desired_velocity(position, target, duration, drift, limit)
        deviation = position - planned.position
        share = min(1.0, duration / FULL_CORRECTION)
        desired = compute_desired_velocity(position, target + (1.0 - share) * deviation, duration, drift, limit)
        change = desired - velocity
        if change @ planned.normal >= SAME_SIDE * float(np.hypot(*change)):
            return desired
        return compute_desired_velocity(position, target + deviation, duration, drift, limit)

    def _track(self, name: str, strike: Strike | None) -> np.ndarray:
        """Return one robot's action, and remember the acceleration it should cause."""
        robot, tracker = self._scenario.robots[name], self._trackers[name]
        state = self._estimator.state(name)
        # the measured angle is only known up to whole turns
        state[2] = robot.heading + math.remainder(state[2] - robot.heading, math.tau)
        impact = None if strike is None else strike.solution
        gain = 0.0
        if strike is not None:
            item = self._scenario.objects[strike.planned.object]
            gain = compute_velocity_gain(self._scenario.believed.restitution, item.mass, robot.mass)
        course, problem = self._courses[name], tracker.problem
        reference = sample_reference(course, self._now, problem, state[2], robot.heading, impact, gain)
        u, source = tracker.control(state, reference)
        if source != "mpc":
            self._diagnostics.fallbacks[source] += 1
        middle = state[2] + state[5] * problem.period / 2
        c, s = math.cos(middle), math.sin(middle)
        self._accelerations[name] = ((c * u[0] - s * u[1]) / robot.mass, (s * u[0] + c * u[1]) / robot.mass)
        return u / problem.limits

    def _present_state(self, name: str) -> np.ndarray:
        """Return estimated position and velocity of a body, shape (2, 2) [m, m/s]."""
        return np.array([self._estimator.position(name), self._estimator.velocity(name)])

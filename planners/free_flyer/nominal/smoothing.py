"""Turn knots into smooth motions of bodies with radii: a convex QP in acceleration, repeated with better sides."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import clarabel
import numpy as np
from scipy import sparse

from impact_envs.free_flyer.schema import FreeFlyerScenario, Robot
from planners.bezier import Curve
from planners.budget import Work
from planners.cones import solve_clarabel
from planners.errors import Infeasible
from planners.free_flyer.nominal.event_grid import find_halt
from planners.free_flyer.nominal.event_sequence import EventSequence, make_object_curve
from planners.free_flyer.nominal.requirement_rows import add_requirement_rows
from planners.free_flyer.reserves import Reserves
from planners.free_flyer.specification.requirement import Requirement
from planners.plan import PlannedImpact
from planners.quintic_spline import DEGREE, Breakpoint, QuinticSpline, build_quintic_spline
from planners.spline_rows import SmoothingOptions, SplineRows, find_sides

AREA_TOLERANCE = 1e-6  # by which areas may be left [m]
FEWEST, MOST = 12.0, 42.0  # legs that are shorter or longer have as many segments as one of this length [s]
SHORTEST = 0.099  # segment between a breakpoint and the end of a window [s]
COST_SCALE = 100.0  # accelerations are some 0.01 m/s^2


@dataclass(frozen=True)
class _Problem:
    scenario: FreeFlyerScenario
    sequence: EventSequence
    impacts: tuple[PlannedImpact, ...]
    needs: tuple[Requirement, ...]
    rho: float
    reserves: Reserves
    options: SmoothingOptions
    times: np.ndarray
    splines: dict[str, QuinticSpline]
    object_points: dict[str, np.ndarray]  # of every object on every segment, shape (S, 6, 2)
    work: Work | None


def smooth_motions(
    scenario: FreeFlyerScenario,
    sequence: EventSequence,
    impacts: tuple[PlannedImpact, ...],
    needs: Sequence[Requirement],
    rho: float,
    reserves: Reserves,
    options: SmoothingOptions,
    work: Work | None = None,
) -> dict[str, Curve]:
    r"""Return the robots' curves: int |a|^2 + w |j|^2 dt is least.

    Every segment's duration is a number, so velocities, accelerations and differences between bodies are
    linear in the control points, and half-spaces on control points hold at all times. What is not convex
    (on which side to pass a body) is taken from the previous round, in the first one from the event grid. A robot
    passes a corner where two segments meet, so shorter segments leave it more choice of when.

    Args:
        scenario: limits, radii, starts and goals.
        sequence: events.
        impacts: from `compute_impacts`.
        needs: requirements of the formula and of solid obstacles.
        rho: robustness to keep [m].
        reserves: clearances.
        options: weights and number of rounds.
        work: counts the rows of every round, if any is counted.

    Returns:
        Robot name to its curve.

    Raises:
        Infeasible: some distance, area or limit cannot be kept.
        OutOfWork: no more work is allowed.
    """
    failure: Infeasible | None = None
    for longest in options.segments:
        problem = _build_problem(scenario, sequence, impacts, tuple(needs), rho, reserves, longest, options, work)
        try:
            return _solve_rounds(problem)
        except Infeasible as error:
            failure = failure or error
    assert failure is not None
    raise failure


def _solve_rounds(problem: _Problem) -> dict[str, Curve]:
    """Return the curves of the last of some rounds.

    Raises:
        Infeasible: some distance, area or limit cannot be kept.
    """
    scenario, reserves, options = problem.scenario, problem.reserves, problem.options
    points = {name: _interpolate_knots(problem, name) for name in scenario.robots}
    # Clearance is a reserve of which half may be spent here; the check of the plan knows what bodies really need.
    allowed = {"area": AREA_TOLERANCE, "clearance": 0.5 * reserves.clearance}
    good = False
    for price in options.slack_weights:
        for _ in range(0 if good else options.rounds):
            before = good
            points, worst = _solve_round(problem, points, price)
            good = all(worst[kind] <= limit for kind, limit in allowed.items())
            if before and good:
                break
    for kind, limit in allowed.items():
        if worst[kind] > limit:
            status = f"{kind} rows are {worst[kind]:.3g} m short"
            raise Infeasible("smoothing", status, "allow more impacts or a longer horizon")
    return {name: Curve(problem.times, points[name]) for name in points}


def _build_problem(
    scenario: FreeFlyerScenario,
    sequence: EventSequence,
    impacts: tuple[PlannedImpact, ...],
    needs: tuple[Requirement, ...],
    rho: float,
    reserves: Reserves,
    longest: float,
    options: SmoothingOptions,
    work: Work | None,
) -> _Problem:
    windows = [t for need in needs if scenario.robots.keys() & need.bodies for t in (need.start, need.end)]
    times = _make_breakpoints(sequence.times, windows, longest)
    splines = {name: _make_spline(scenario, times, impacts, name) for name in scenario.robots}
    moments = next(iter(splines.values())).greville()
    object_points = {
        name: make_object_curve(sequence, name).position(moments).reshape(-1, DEGREE + 1, 2)
        for name in scenario.objects
    }
    return _Problem(scenario, sequence, impacts, needs, rho, reserves, options, times, splines, object_points, work)


def _make_breakpoints(events: np.ndarray, windows: Sequence[float], longest: float) -> np.ndarray:
    """Return breakpoints, dense near events, where velocities change; ends of windows replace breakpoints near them.

    Args:
        events: times of impacts, and both ends [s].
        windows: ends of windows of the formula [s].
        longest: mean length of segments on legs that are neither short nor long [s].
    """
    times = [0.0]
    for start, end in itertools.pairwise(events):
        # The numbers of a short and of a long leg grow as the others do.
        count = int(np.clip(np.ceil((end - start) / longest), round(FEWEST / longest), round(MOST / longest)))
        times += [*(start + (end - start) * (1 - np.cos(np.pi * np.arange(1, count) / count)) / 2), end]
    fixed = list(events)
    for time in sorted(set(windows)):
        if np.abs(np.array(fixed) - time).min() > SHORTEST:
            fixed.append(time)
    free = [t for t in times if np.abs(np.array(fixed) - t).min() > SHORTEST]
    return np.unique([*fixed, *free])


def _make_spline(
    scenario: FreeFlyerScenario, times: np.ndarray, impacts: Sequence[PlannedImpact], name: str
) -> QuinticSpline:
    robot, rest = scenario.robots[name], (np.zeros(2), np.zeros(2))
    moving = np.array(robot.start_velocity)
    known = {
        0: Breakpoint(np.array(robot.start), (moving, moving)),
        len(times) - 1: Breakpoint(None if robot.goal is None else np.array(robot.goal), rest),
    }
    for impact in impacts:
        if impact.robot == name:
            j = int(np.flatnonzero(times == impact.time)[0])
            known[j] = Breakpoint(impact.contact, (impact.robot_minus, impact.robot_plus))
    return build_quintic_spline(times, known)


def _interpolate_knots(problem: _Problem, name: str) -> np.ndarray:
    moments = problem.splines[name].greville()
    knots = problem.sequence.knots[name]
    times = problem.sequence.knot_times(len(knots))
    points = np.stack([np.interp(moments, times, knots[:, d]) for d in range(2)], axis=1)
    return points.reshape(-1, DEGREE + 1, 2)


def _solve_round(
    problem: _Problem, points: dict[str, np.ndarray], price: float
) -> tuple[dict[str, np.ndarray], dict[str, float]]:
    """Solve the QP with the sides of the previous points; returns new points and violations by kind."""
    splines = problem.splines
    rows = SplineRows(splines)
    for name in splines:
        _add_limits(rows, problem, name)
        _add_world(rows, problem, name, points[name])
        _add_requirements(rows, problem, points, name)
        for struck in problem.scenario.objects:
            _add_object_clearance(rows, problem, name, struck, points[name])
    for first, second in itertools.combinations(splines, 2):
        _add_robot_clearance(rows, problem, first, second, points)
    _add_requirements(rows, problem, points)
    A, b = rows.stack()
    if problem.work is not None:
        problem.work.spend(len(b))
    P, q = rows.make_cost(problem.options.jerk_weight, COST_SCALE, price)
    x = solve_clarabel("smoothing", sparse.triu(P, format="csc"), q, A, b, [clarabel.NonnegativeConeT(len(b))])
    found = {name: rows.read_points(x, name) for name in splines}
    return found, {kind: rows.measure_violation(x, kind) for kind in ("area", "clearance")}


def _add_limits(rows: SplineRows, problem: _Problem, name: str) -> None:
    robot, spline = problem.scenario.robots[name], problem.splines[name]
    fastest, strongest = robot.speed_limit, problem.reserves.acceleration(robot)
    for part, limit in ((spline.velocity, fastest), (spline.acceleration, strongest)):
        for axis, sign in itertools.product(range(2), (1.0, -1.0)):
            normals = np.zeros((part.matrix.shape[0], 2))
            normals[:, axis] = sign
            rows.add([(name, part, normals)], np.full(len(normals), limit))
    if problem.reserves.thrust <= np.sqrt(0.5):
        return
    # The corners of the box would need more thrust than there is.
    share = min(problem.reserves.thrust, 1.0)
    diagonal = np.sqrt(0.5) * (share + np.sqrt(1.0 - share**2)) * robot.force_limit / robot.mass
    for x, y in itertools.product((1.0, -1.0), repeat=2):
        normals = np.full((spline.acceleration.matrix.shape[0], 2), np.sqrt(0.5)) * [x, y]
        rows.add([(name, spline.acceleration, normals)], np.full(len(normals), diagonal))


def _add_world(rows: SplineRows, problem: _Problem, name: str, points: np.ndarray) -> None:
    """Keep the robot inside the world."""
    scenario = problem.scenario
    robot = scenario.robots[name]
    lower, upper = np.array(scenario.world.lower), np.array(scenario.world.upper)
    for axis, sign in itertools.product(range(2), (1.0, -1.0)):
        normals = np.zeros((len(points), DEGREE + 1, 2))
        normals[..., axis] = sign
        edge = upper[axis] if sign > 0 else -lower[axis]
        ends = [robot.start[axis], robot.start[axis] if robot.goal is None else robot.goal[axis]]
        if any(robot.start_velocity):
            ends.append(find_halt(robot, problem.reserves)[axis])
        inset = min(robot.radius + problem.reserves.wall, edge - max(sign * end for end in ends))
        inset = max(inset, min(robot.radius, edge - sign * robot.start[axis]))
        rows.add_halfspaces(name, normals, np.full(normals.shape[:2], edge - inset), "area")


def _add_requirements(rows: SplineRows, problem: _Problem, points: dict[str, np.ndarray], name: str = "") -> None:
    """Keep what is demanded of one robot alone or, without a name, of several bodies together."""
    places = points | problem.object_points
    for need in problem.needs:
        if need.bodies == (name,) or (not name and len(need.bodies) > 1):
            add_requirement_rows(rows, problem.splines, need, problem.rho, places)


def _add_object_clearance(rows: SplineRows, problem: _Problem, name: str, struck: str, points: np.ndarray) -> None:
    """Keep the robot away from an object; only at its own impacts it is at contact distance."""
    scenario = problem.scenario
    own = [impact for impact in problem.impacts if (impact.robot, impact.object) == (name, struck)]
    touching = scenario.robots[name].radius + scenario.objects[struck].radius
    normals = find_sides(problem.object_points[struck] - points)
    for impact in own:
        for segment in np.flatnonzero((problem.times[:-1] == impact.time) | (problem.times[1:] == impact.time)):
            normals[segment] = impact.normal
    anchors = [(impact.time, touching, _compute_parting_speed(problem, impact)) for impact in own]
    anchors += _find_end_distances(problem, struck, name)
    wanted = _make_distance_profile(problem, name, touching + problem.reserves.clearance, anchors)
    limits = np.sum(normals * problem.object_points[struck], axis=2) - wanted
    rows.add_halfspaces(name, normals, limits, "clearance")


def _add_robot_clearance(
    rows: SplineRows, problem: _Problem, first: str, second: str, points: dict[str, np.ndarray]
) -> None:
    robots = problem.scenario.robots
    wanted = robots[first].radius + robots[second].radius + problem.reserves.clearance
    anchors = _find_end_distances(problem, first, second)
    normals = find_sides(points[second] - points[first]).reshape(-1, 2)
    parts = [(name, problem.splines[name].position, sign * normals) for name, sign in ((first, 1), (second, -1))]
    rows.add(parts, -_make_distance_profile(problem, first, wanted, anchors).ravel(), "clearance")


def _compute_parting_speed(problem: _Problem, impact: PlannedImpact) -> float:
    """Return how fast the least distance grows from an impact on: slower than the bodies really part [m/s]."""
    approach = float((impact.robot_minus - impact.object_minus) @ impact.normal)
    return min(problem.options.parting_speed, 0.5 * problem.scenario.believed.restitution * approach)


def _find_end_distances(problem: _Problem, first: str, second: str) -> list[tuple[float, float, float]]:
    """Return the distances at the ends of the horizon as anchors, for they may be smaller than wanted.

    Bodies that approach each other at the start first have to brake, which takes c^2 / (2 a) of their distance.
    """
    growth = problem.options.parting_speed
    places = problem.sequence.paths | problem.sequence.knots
    one, other = (problem.scenario.body(name) for name in (first, second))
    offset = np.subtract(one.start, other.start)
    start, end = float(np.linalg.norm(offset)), float(np.linalg.norm(places[first][-1] - places[second][-1]))
    if not any((*one.start_velocity, *other.start_velocity)):
        return [(float(problem.times[0]), start, growth), (float(problem.times[-1]), end, growth)]
    parting = float(np.subtract(one.start_velocity, other.start_velocity) @ offset) / start
    strength = sum(problem.reserves.acceleration(body) for body in (one, other) if isinstance(body, Robot))
    nearest = max(start - min(parting, 0.0) ** 2 / (2.0 * strength), min(start, one.radius + other.radius))
    rate = float(np.clip(0.5 * parting, growth / 3.0, growth))
    return [(float(problem.times[0]), nearest, rate), (float(problem.times[-1]), end, growth)]


def _make_distance_profile(
    problem: _Problem, name: str, wanted: float, anchors: Sequence[tuple[float, float, float]]
) -> np.ndarray:
    """Return the least distance at every control point, shape (S, 6): it grows from anchors (time, distance, rate)."""
    moments = problem.splines[name].greville()
    profile = np.full(len(moments), wanted)
    for time, distance, rate in anchors:
        profile = np.minimum(profile, distance + rate * np.abs(moments - time))
    return profile.reshape(-1, DEGREE + 1)

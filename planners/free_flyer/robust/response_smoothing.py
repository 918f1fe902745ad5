"""Smooth responses: one convex QP in true acceleration for all robots and all vertices of the object's boxes."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import clarabel
import numpy as np
from scipy import sparse

from impact_envs.free_flyer.schema import FreeFlyerScenario
from planners.cones import solve_clarabel
from planners.errors import Infeasible
from planners.free_flyer.reserves import Reserves
from planners.free_flyer.robust.box_sequence import VERTICES, BoxSequence, compute_vertices
from planners.free_flyer.robust.response import (
    ResponseInterval,
    Responses,
    compute_amplitudes,
    compute_returns,
    make_breakpoints,
    make_intervals,
)
from planners.free_flyer.robust.task import ResponseOptions
from planners.free_flyer.specification.direction import DIRECTIONS
from planners.free_flyer.specification.requirement import Requirement
from planners.quintic_spline import DEGREE, Breakpoint, QuinticSpline, build_quintic_spline
from planners.spline_rows import SplineRows, find_sides

TOLERANCE = 1e-6  # by which areas, walls and half the clearance may be violated [m]
COST_SCALE = 25.0  # accelerations are some 0.02 m/s^2


@dataclass(frozen=True)
class _Problem:
    scenario: FreeFlyerScenario
    sequence: BoxSequence
    needs: tuple[Requirement, ...]
    margin: float
    reserves: Reserves
    options: ResponseOptions
    times: np.ndarray
    moments: np.ndarray  # of the control points, shape (S, 6)
    intervals: dict[str, tuple[ResponseInterval, ...]]
    splines: dict[str, QuinticSpline]


def make_responses(
    scenario: FreeFlyerScenario,
    sequence: BoxSequence,
    needs: tuple[Requirement, ...],
    margin: float,
    reserves: Reserves,
    options: ResponseOptions,
) -> Responses:
    r"""Return the curves of all robots for all vertices: the sum of int |a|^2 + w |j|^2 dt is least.

    One QP for all robots and vertices. Where curves have to be the same they share the states of their breakpoints, so
    causality holds exactly. Limits of speed and acceleration hold on control points, less what the robot needs to meet
    the object exactly and to settle after its own deviation. The sides of bodies are taken from the previous round.

    Args:
        scenario: limits, radii, starts and goals.
        sequence: tight impacts.
        needs: requirements of the formula and of solid obstacles.
        margin: robustness to keep in them [m].
        reserves: clearances and thrust.
        options: weights and number of rounds.

    Returns:
        The responses.

    Raises:
        Infeasible: some limit, distance or area cannot be kept.
    """
    problem = _build_problem(scenario, sequence, needs, margin, reserves, options)
    points = {robot: np.stack([_interpolate_knots(problem, robot, i) for i in range(4)]) for robot in scenario.robots}
    # Walls and half the clearance are reserves that may be spent; the simulation knows what bodies really need.
    spent = {"area": 0.0, "wall": reserves.wall, "clearance": 0.5 * reserves.clearance}
    allowed = {kind: reserve + TOLERANCE for kind, reserve in spent.items()}
    short = np.inf
    for _ in range(options.smoothing.rounds):
        before = short
        points, worst = _solve_round(problem, points)
        short = max(worst[kind] - limit for kind, limit in allowed.items())
        # Stop once a round finds the sides that it was given, or nothing improves.
        settled = short <= 0.0 and (before <= 0.0 or sequence.points)
        if settled or 0.0 < 0.9 * before < short:
            break
    for kind, limit in allowed.items():
        if worst[kind] > limit:
            status = f"{kind} rows are {worst[kind]:.3g} m short"
            raise Infeasible("responses", status, "allow a longer gap, more thrust or a longer horizon")
    return Responses(scenario, sequence, problem.times, problem.intervals, points)


def _build_problem(
    scenario: FreeFlyerScenario,
    sequence: BoxSequence,
    needs: tuple[Requirement, ...],
    margin: float,
    reserves: Reserves,
    options: ResponseOptions,
) -> _Problem:
    times = make_breakpoints(sequence.times)
    splines = {}
    for robot, i in itertools.product(scenario.robots, range(4)):
        splines[_key(robot, i)] = _make_spline(scenario, sequence, times, robot, i)
    moments = next(iter(splines.values())).greville().reshape(-1, DEGREE + 1)
    intervals = {robot: make_intervals(sequence, times, robot, options.settle) for robot in scenario.robots}
    return _Problem(scenario, sequence, needs, margin, reserves, options, times, moments, intervals, splines)


def _make_spline(
    scenario: FreeFlyerScenario, sequence: BoxSequence, times: np.ndarray, name: str, vertex: int
) -> QuinticSpline:
    robot, rest = scenario.robots[name], (np.zeros(2), np.zeros(2))
    known = {
        0: Breakpoint(np.array(robot.start), rest),
        len(times) - 1: Breakpoint(None if robot.goal is None else np.array(robot.goal), rest),
    }
    for k, hitter in enumerate(sequence.hitters, start=1):
        if hitter == name:
            _, _, contacts = compute_vertices(scenario, sequence, k)
            j = int(np.abs(times - sequence.times[k]).argmin())
            known[j] = Breakpoint(contacts.robot[vertex], (contacts.minus[vertex], contacts.plus[vertex]))
    return build_quintic_spline(times, known)


def _interpolate_knots(problem: _Problem, robot: str, vertex: int) -> np.ndarray:
    sequence, moments = problem.sequence, problem.moments
    times, knots = sequence.knot_times, sequence.knots[robot].copy()
    for interval in problem.intervals[robot]:
        _, _, contacts = compute_vertices(problem.scenario, sequence, interval.impact)
        knots[np.abs(times - sequence.times[interval.impact]).argmin()] = contacts.robot[vertex]
    return np.stack([np.interp(moments, times, knots[:, d]) for d in range(2)], axis=2)


def _key(robot: str, vertex: int) -> str:
    return f"{robot} {vertex}"


def _solve_round(problem: _Problem, points: dict[str, np.ndarray]) -> tuple[dict[str, np.ndarray], dict[str, float]]:
    """Solve the QP with the sides of the previous points; returns new points and violations by kind."""
    rows, robots = SplineRows(problem.splines), problem.scenario.robots
    for robot in robots:
        _add_limits(rows, problem, robot)
        _add_areas(rows, problem, robot, points[robot])
        if not problem.sequence.points:
            _add_object_clearance(rows, problem, robot, points[robot])
    for first, second in itertools.combinations(robots, 2):
        if not problem.sequence.points:
            _add_robot_clearance(rows, problem, first, second, points)
    A, b = rows.stack()
    smoothing = problem.options.smoothing
    P, q = rows.make_cost(smoothing.jerk_weight, COST_SCALE, smoothing.slack_weights[0])
    merge = _merge_columns(problem, rows)
    P = sparse.triu(merge.T @ P @ merge, format="csc")
    x = merge @ solve_clarabel("responses", P, merge.T @ q, (A @ merge).tocsc(), b, [clarabel.NonnegativeConeT(len(b))])
    found = {robot: np.stack([rows.read_points(x, _key(robot, i)) for i in range(4)]) for robot in robots}
    return found, {kind: rows.measure_violation(x, kind) for kind in ("area", "wall", "clearance")}


def _merge_columns(problem: _Problem, rows: SplineRows) -> sparse.csc_matrix:
    """Return the matrix that gives four curves one state at breakpoints where they must be one."""
    source = np.arange(rows.size + rows.slacks)
    for robot, intervals in problem.intervals.items():
        spline = problem.splines[_key(robot, 0)]
        switches = [interval.start for interval in intervals] or [np.inf]
        shared = problem.times <= switches[0] + 1e-9
        for switch in switches[1:]:
            shared |= np.abs(problem.times - switch) < 1e-9
        ends = [spline.position.matrix[6 * j : 6 * j + 3] for j in np.flatnonzero(shared[:-1])]
        ends += [spline.position.matrix[-3:]] if shared[-1] else []
        columns = np.unique(np.concatenate([part.indices[part.data != 0.0] for part in ends]))
        for axis, i in itertools.product(range(2), range(1, 4)):
            first, other = (rows.starts[_key(robot, j)] + axis * spline.size for j in (0, i))
            source[other + columns] = first + columns
    _, index = np.unique(source, return_inverse=True)
    return sparse.csc_matrix((np.ones(len(source)), (np.arange(len(source)), index)))


def _corrections(problem: _Problem, robot: str) -> list[np.ndarray]:
    """Return how much corrections may take of position, velocity and acceleration, per control point.

    Returns:
        Shapes (S, 6, 2) [m], (S, 5, 2) [m/s] and (S, 4, 2) [m/s^2].
    """
    times, count = problem.times, len(problem.times) - 1
    taken = [np.zeros((count, DEGREE + 1 - order, 2)) for order in range(3)]
    steps = np.diff(times)[:, None]
    for interval in problem.intervals[robot]:
        off, before, after = compute_amplitudes(problem.scenario, problem.sequence, interval.impact)
        for rest, turn in ((interval.before, before), (interval.after, after)):
            part = slice(*sorted((rest, interval.event)))
            curves = compute_returns(times, rest, interval.event)
            for order in range(3):
                size = np.abs(curves)[..., None]
                # Contacts inside a box differ from the mean of its vertices; those nearest to a wall do not.
                taken[order][part] += size[0] * off * (order > 0) + size[1] * turn
                curves = (DEGREE - order) * np.diff(curves, axis=2) / steps[part]
        # Contact itself is where the box grid has made room for it.
        taken[0][interval.event - 1, -1] = taken[0][interval.event, 0] = 0.0
    return taken


def _add_limits(rows: SplineRows, problem: _Problem, name: str) -> None:
    """Bound speed and acceleration per axis, and acceleration along the diagonals, where both axes add up."""
    robot, taken = problem.scenario.robots[name], _corrections(problem, name)
    strongest, usual = robot.force_limit / robot.mass, problem.reserves.acceleration(robot)
    for i in range(4):
        spline = problem.splines[_key(name, i)]
        for direction in DIRECTIONS:
            speed = robot.speed_limit - taken[1] @ np.abs(direction)
            acceleration = np.minimum(usual, 0.95 * strongest - taken[2] @ np.abs(direction))
            if np.all(direction):
                speed, acceleration = np.full_like(speed, np.inf), 0.89 * strongest - taken[2] @ np.abs(direction)
            for part, limits in ((spline.velocity, speed), (spline.acceleration, acceleration)):
                normals = np.broadcast_to(direction, (limits.size, 2))
                rows.add([(_key(name, i), part, normals)], limits.ravel())


def _add_areas(rows: SplineRows, problem: _Problem, name: str, points: np.ndarray) -> None:
    """Keep the robot inside the world, inside areas to stay in and beyond one face of areas to avoid."""
    scenario, times = problem.scenario, problem.times
    robot, taken = scenario.robots[name], _corrections(problem, name)[0]
    shape = points.shape[1:]
    for axis, sign in itertools.product(range(2), (1.0, -1.0)):
        face = np.zeros(2)
        face[axis] = sign
        edge = (scenario.world.upper if sign > 0 else scenario.world.lower)[axis] * sign
        ends = [robot.start[axis], robot.start[axis] if robot.goal is None else robot.goal[axis]]
        inset = min(robot.radius + problem.reserves.wall, edge - max(sign * end for end in ends))
        _add_halfspaces(rows, problem, name, np.broadcast_to(face, shape), edge - inset - taken[..., axis], "wall")
    for need in problem.needs:
        if need.body != name:
            continue
        active = (times[1:] > need.start) & (times[:-1] < need.end)
        if need.start == need.end:
            active = (times[1:] >= need.start) & (times[:-1] <= need.end)
        if need.kind == "stay":
            for face, bound in zip(need.faces, need.bounds, strict=True):
                limit = np.where(active[:, None], bound - problem.margin - taken @ np.abs(face), np.inf)
                _add_halfspaces(rows, problem, name, np.broadcast_to(face, shape), limit, "area")
        else:
            beyond = (points @ need.faces.T - need.bounds).min(axis=(0, 2))
            faces = -need.faces[beyond.argmax(axis=1)]
            limit = -need.bounds[beyond.argmax(axis=1)] - need.margin(problem.margin)
            limit = limit[:, None] - np.sum(taken * np.abs(faces)[:, None], axis=2)
            limit = np.where(active[:, None], limit, np.inf)
            kind = "wall" if need.clearance > problem.margin + problem.reserves.wall else "area"
            _add_halfspaces(rows, problem, name, np.broadcast_to(faces[:, None], shape), limit, kind)


def _add_halfspaces(
    rows: SplineRows, problem: _Problem, name: str, normals: np.ndarray, limits: np.ndarray, kind: str
) -> None:
    """Add normals . p <= limits on the control points p of all four curves."""
    for i in range(4):
        rows.add_halfspaces(_key(name, i), normals, limits, kind)


def _add_object_clearance(rows: SplineRows, problem: _Problem, name: str, points: np.ndarray) -> None:
    """Keep the robot away from every place where the object may be, as far as its curve knows."""
    scenario, sequence, moments = problem.scenario, problem.sequence, problem.moments
    robot = scenario.robots[name]
    touching = robot.radius + scenario.objects[sequence.object].radius
    for i in range(4):
        center, half = _locate_object(problem, name, i)
        normals = find_sides(center - points[i])
        wanted = np.full(moments.shape, touching + problem.reserves.clearance)
        for time, at in ((0.0, 0), (sequence.times[-1], -1)):
            toward = sequence.centers[at] - sequence.knots[name][at]
            given = np.linalg.norm(toward) - np.abs(toward) @ sequence.halves[at] / np.linalg.norm(toward)
            wanted = np.minimum(wanted, given + problem.options.smoothing.parting_speed * np.abs(moments - time))
        for interval in problem.intervals[name]:
            _, arrival, contacts = compute_vertices(scenario, sequence, interval.impact)
            normal = contacts.normal[i]
            normals[interval.event - 1 : interval.event + 1] = normal
            approach = float((contacts.minus - arrival)[i] @ normal)
            rate = min(problem.options.smoothing.parting_speed, 0.5 * scenario.believed.restitution * approach)
            wanted = np.minimum(wanted, touching + rate * np.abs(moments - sequence.times[interval.impact]))
        limits = np.sum(normals * center - np.abs(normals) * half, axis=2) - wanted
        rows.add_halfspaces(_key(name, i), normals, limits, "clearance")


def _locate_object(problem: _Problem, name: str, vertex: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the object's box at every control point, given a vertex: centres and half widths, shape (S, 6, 2)."""
    sequence, moments = problem.sequence, problem.moments
    centers, halves = np.empty((*moments.shape, 2)), np.empty((*moments.shape, 2))
    for segment, moment in enumerate(moments):
        middle = 0.5 * (moment[0] + moment[-1])
        leg = int(np.searchsorted(sequence.times, middle)) - 1
        start, end = sequence.times[leg : leg + 2]
        share = ((moment - start) / (end - start))[:, None]
        ends = np.stack([sequence.centers[leg : leg + 2], sequence.halves[leg : leg + 2]])
        known = [interval.impact for interval in problem.intervals[name] if interval.start <= middle < interval.end]
        for k in known:
            corner = sequence.boxes[k][VERTICES[vertex], np.arange(2)]
            if k == leg:
                there = corner + sequence.command(k, corner) * (end - start)
                ends = np.array([[corner, there], [np.zeros(2), np.full(2, sequence.delta * (end - start))]])
            elif k == leg + 1:
                first = corner if leg == 0 else sequence.centers[leg]
                ends = np.array([[first, corner], [sequence.halves[leg] * (leg > 0), np.zeros(2)]])
        centers[segment] = ends[0, 0] + share * (ends[0, 1] - ends[0, 0])
        halves[segment] = ends[1, 0] + share * (ends[1, 1] - ends[1, 0])
    return centers, halves


def _add_robot_clearance(
    rows: SplineRows, problem: _Problem, first: str, second: str, points: dict[str, np.ndarray]
) -> None:
    robots, knots, moments = problem.scenario.robots, problem.sequence.knots, problem.moments
    touching = robots[first].radius + robots[second].radius
    taken = _corrections(problem, first)[0] + _corrections(problem, second)[0]
    middle = points[second].mean(axis=0) - points[first].mean(axis=0)
    normals = find_sides(middle)
    wanted = np.full(moments.shape, touching + problem.reserves.clearance)
    for time, at in ((0.0, 0), (problem.times[-1], -1)):
        given = np.linalg.norm(knots[first][at] - knots[second][at])
        wanted = np.minimum(wanted, given + problem.options.smoothing.parting_speed * np.abs(moments - time))
    wanted += np.sum(np.abs(normals) * taken, axis=2)
    for i, j in itertools.product(range(4), range(4)):
        apart = np.sum(normals * (points[second][j] - points[first][i]), axis=2)
        limits = np.where(apart < wanted + problem.options.near, -wanted, np.inf)
        parts = [
            (_key(first, i), problem.splines[_key(first, i)].position, normals.reshape(-1, 2)),
            (_key(second, j), problem.splines[_key(second, j)].position, -normals.reshape(-1, 2)),
        ]
        rows.add(parts, limits.ravel(), "clearance")

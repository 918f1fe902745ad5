"""A plan and what is believed of its scenario as tables, for the compiled expert."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from impact_envs.free_flyer.schema import FreeFlyerScenario
from planners.free_flyer.specification.impact_demand import Knot, find_knots, find_own_faces
from planners.free_flyer.tracking.course import convert_curve
from planners.free_flyer.tracking.problem import build_tracking_problem
from planners.plan import Plan

# Columns of PlanTable.body.
START_X, START_Y, HOME, MASS, RADIUS, SPEED, KEEPS, START_VX, START_VY = range(9)
# Columns of PlanTable.impact.
AT, ROBOT, OBJECT, PLACE_X, PLACE_Y, NORMAL_X, NORMAL_Y, NEXT, KNOT = range(9)
# Columns of PlanTable.knot.
KNOT_X, KNOT_Y, OPEN, CLOSE, DEPTH, FACES = range(6)
TOUCHING = 0.1  # touching a wall counts as so far inside of what a robot may not leave [m]
END = -1  # of an object's impacts


class PlanTable(NamedTuple):
    """What every world's expert follows; K impacts in order of time, n bodies of which the first r are robots.

    Attributes:
        period: control period [s].
        horizon: [s].
        restitution: believed.
        robots: r.
        body: KEEPS: force by which an object keeps its velocity [N], shape (n, 9).
        impact: index NEXT of the object's next impact, or END; index KNOT of its knot, shape (K, 9).
        first: first impact of each object, or END, shape (objects,).
        knot: of each impact, then of the end of each object: position, window, margin of the plan, number of faces,
            shape (K + objects, 6).
        face: rows (H, b) of each knot, H p <= b, shape (K + objects, f, 3).
        own: rows (H, b) of the areas a robot may not leave, shape (r, g, 3), filled up by 0 p <= 1.
        breaks: breakpoints of the robots' curves, filled up by inf, shape (r, S + 1) [s].
        coefficients: of their segments in power basis, shape (r, S, d + 1, 2) [m].
        side: of each object that is no disc, where a frictionless hit acts through its centre: unit vector from the
            centre in the body frame and distance; no rows filled up by distance 0, shape (objects, d, 3).
        pilot: of each robot's tracking problem, shape (r, 33).
    """

    period: float
    horizon: float
    restitution: float
    robots: int
    body: np.ndarray
    impact: np.ndarray
    first: np.ndarray
    knot: np.ndarray
    face: np.ndarray
    own: np.ndarray
    breaks: np.ndarray
    coefficients: np.ndarray
    side: np.ndarray
    pilot: np.ndarray


def make_plan_table(scenario: FreeFlyerScenario, plan: Plan, begin: float = 0.0) -> PlanTable:
    """Make the tables of a plan.

    Args:
        scenario: as believed.
        plan: to execute.
        begin: when the scenario and the plan begin [s].
    """
    names = scenario.bodies
    bodies = [scenario.body(name) for name in names]
    rows = [
        (
            *body.start,
            body.heading,
            body.mass,
            body.radius,
            body.speed_limit,
            getattr(body, "keep_force", 0.0),
            *body.start_velocity,
        )
        for body in bodies
    ]
    impact, first, knots = _make_impacts(scenario, plan)
    faces = max((len(knot.faces) for knot in knots), default=0)
    face = np.zeros((len(knots), max(faces, 1), 3))
    knot_rows = np.zeros((len(knots), 6))
    for i, knot in enumerate(knots):
        for j, row in enumerate(knot.faces):
            face[i, j] = row / np.hypot(*row[:2])
        margins = [row[2] - row[:2] @ knot.position for row in face[i, : len(knot.faces)]]
        knot_rows[i] = (
            *knot.position,
            *(begin + time for time in knot.window),
            min(margins, default=np.inf),
            len(knot.faces),
        )
    impact[:, AT] += begin
    breaks, coefficients = _make_curves(scenario, plan)
    return PlanTable(
        float(scenario.control_period),
        begin + float(plan.horizon),
        float(scenario.believed.restitution),
        len(scenario.robots),
        np.array(rows, dtype=float),
        impact,
        first,
        knot_rows,
        face,
        _make_own_faces(scenario),
        begin + breaks,
        coefficients,
        _make_sides(scenario),
        np.array([build_tracking_problem(robot, scenario.control_period).row for robot in scenario.robots.values()]),
    )


def _make_impacts(scenario: FreeFlyerScenario, plan: Plan) -> tuple[np.ndarray, np.ndarray, list[Knot]]:
    place = {name: i for i, name in enumerate(scenario.bodies)}
    impact, first = np.zeros((len(plan.impacts), 9)), np.full(len(scenario.objects), END)
    knots: dict[int, Knot] = {}
    for o, name in enumerate(scenario.objects):
        mine = [k for k, planned in enumerate(plan.impacts) if planned.object == name]
        found = find_knots(scenario, plan, name)
        first[o] = mine[0] if mine else END
        for k, after, knot in zip(mine, [*mine[1:], END], found, strict=False):
            planned = plan.impacts[k]
            where = place[planned.robot], place[name]
            impact[k] = planned.time, *where, *planned.position, *planned.normal, after, k
            knots[k] = knot
        knots[len(plan.impacts) + o] = found[-1]
    return impact, first, [knots[i] for i in range(len(knots))]


def _make_curves(scenario: FreeFlyerScenario, plan: Plan) -> tuple[np.ndarray, np.ndarray]:
    curves = [convert_curve(plan.robots[name]) for name in scenario.robots]
    segments = max(len(curve.times) - 1 for curve in curves)
    degree = max(curve.coefficients.shape[1] for curve in curves)
    breaks = np.full((len(curves), segments + 1), np.inf)
    coefficients = np.zeros((len(curves), segments, degree, 2))
    for i, curve in enumerate(curves):
        breaks[i, : len(curve.times)] = curve.times
        coefficients[i, : len(curve.times) - 1, : curve.coefficients.shape[1]] = curve.coefficients
    return breaks, coefficients


def _make_own_faces(scenario: FreeFlyerScenario) -> np.ndarray:
    found = [[*find_own_faces(scenario, name), *_find_walls(scenario, name)] for name in scenario.robots]
    own = np.zeros((len(found), max(len(faces) for faces in found), 3))
    own[:, :, 2] = 1.0
    for i, faces in enumerate(found):
        for j, row in enumerate(faces):
            own[i, j] = row / np.hypot(*row[:2])
    return own


def _find_walls(scenario: FreeFlyerScenario, name: str) -> list[np.ndarray]:
    """Return the faces that keep a robot from touching the world's walls."""
    inset = scenario.robots[name].radius - TOUCHING
    sides = [(-1.0, 0.0, -scenario.world.lower[0]), (0.0, -1.0, -scenario.world.lower[1])]
    sides += [(1.0, 0.0, scenario.world.upper[0]), (0.0, 1.0, scenario.world.upper[1])]
    return [np.array([x, y, b - inset]) for x, y, b in sides]


def _make_sides(scenario: FreeFlyerScenario) -> np.ndarray:
    found = [find_central_hits(np.array(item.vertices or ())) for item in scenario.objects.values()]
    sides = np.zeros((len(found), max(map(len, found), default=0), 3))
    for i, rows in enumerate(found):
        sides[i, : len(rows)] = rows
    return sides


def find_central_hits(vertices: np.ndarray) -> np.ndarray:
    """Return where a disc that touches a convex polygon without friction pushes it through its centre, the origin.

    On an edge that is the foot of the perpendicular from the origin, at a corner the line through it, if it lies in
    the cone of the neighbouring edges' normals.

    Args:
        vertices: counter-clockwise, shape (v, 2) [m].

    Returns:
        Rows (unit vector from the origin, distance), shape (d, 3).
    """
    rows = []
    for a, b, c in zip(np.roll(vertices, 1, axis=0), vertices, np.roll(vertices, -1, axis=0), strict=True):
        edge = c - b
        along = -(b @ edge) / (edge @ edge)
        foot = b + along * edge
        if 0.0 < along < 1.0 and np.hypot(*foot) > 0.0:
            rows.append((*foot / np.hypot(*foot), np.hypot(*foot)))
        if b @ (a - b) <= 0.0 and b @ (c - b) <= 0.0:
            rows.append((*b / np.hypot(*b), np.hypot(*b)))
    return np.array(rows).reshape(-1, 3)

"""A plan and what is believed of its scenario as tables, for the compiled expert."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from impact_envs.errors import InputError
from impact_envs.free_flyer.schema import Body, FreeFlyerScenario
from impact_envs.stl import In
from planners.free_flyer.specification.central_hit import find_central_hits
from planners.free_flyer.specification.impact_demand import Knot, find_knots, find_own_faces
from planners.free_flyer.specification.requirement import list_held_throughout, read_demands
from planners.free_flyer.tracking.course import convert_curve
from planners.free_flyer.tracking.problem import Weights, build_tracking_problem
from planners.plan import Plan, PlannedResponse, Tube

NO_IMPACT = -1
ROUND_OFF = 1e-6  # of times [s]
TOUCHING = 0.1  # touching a wall counts as so far inside of what a robot may not leave [m]

BODY = np.dtype(
    [
        ("start", float, 2),  # [m]
        ("start_velocity", float, 2),  # [m/s]
        ("heading", float),  # at the start [rad]
        ("start_rate", float),  # [rad/s]
        ("mass", float),  # [kg]
        ("radius", float),  # [m]
        ("gyration", float),  # inertia over mass [m^2]
        ("speed_limit", float),  # per axis [m/s]
        ("spread", float),  # greatest half width of the box it may start in [m]
        ("keep_force", float),  # by which an object keeps its velocity [N]
        ("jump", float),  # most that an impact changes its velocity at the speed limits [m/s]
    ]
)
IMPACT = np.dtype(
    [
        ("time", float),  # [s]
        ("robot", int),  # that hits
        ("body", int),  # that is hit; object o is body robots + o
        ("position", float, 2),  # of that body [m]
        ("normal", float, 2),  # unit vector from robot to body
        ("next", int),  # impact of that body, or NO_IMPACT
    ]
)
# What an object owes the formula at an impact, or at its end.
KNOT = np.dtype(
    [
        ("position", float, 2),  # planned [m]
        ("opens", float),  # window of time [s]
        ("closes", float),
        ("depth", float),  # planned distance to the nearest face, inf without faces [m]
        ("faces", int),  # number of faces
        ("stay", float),  # how long the object has to stay from its arrival on, whenever that is [s]
        # A place on the flight to the next knot that has to be passed: after which share of its time, 0: none, until
        # when [s], and by how much it may be missed [m].
        ("via_share", float),
        ("via_closes", float),
        ("via", float, 2),  # [m]
        ("via_depth", float),
        # Box for which the plan promises that all goes on well, empty where it promises nothing [m].
        ("lower", float, 2),
        ("upper", float, 2),
    ]
)
# The points p with normal . p <= offset.
HALF_PLANE = np.dtype(
    [
        ("normal", float, 2),  # outward unit vector
        ("offset", float),  # [m]
    ]
)
# Where a frictionless hit acts through the centre of an object that is no disc.
SIDE = np.dtype(
    [
        ("direction", float, 2),  # unit vector from the centre, in the body frame
        ("distance", float),  # from the centre, 0: no side [m]
    ]
)
# What the place of the object at an impact decides.
RESPONSE = np.dtype(
    [
        ("leave", float),  # when its robot leaves its responses to meet the object exactly [s]
        ("centre", float, 2),  # of the box in which the object will be [m]
        ("half", float, 2),  # widths of the box [m]
        ("velocity", float, 2),  # wanted after the impact at the centre [m/s]
        ("gain", float, 2),  # change of it over that of the place [1/s]
    ]
)
# With the place d in [-1, 1] per axis a robot's curve is that of the plan + d_x A + d_y B + d_x d_y C.
TERMS = 3


class PlanTable(NamedTuple):
    """What every world's expert follows; K impacts in order of time, n bodies of which the first r are robots.

    Attributes:
        period: control period [s].
        horizon: [s].
        restitution: believed.
        robots: r.
        body: BODY of every body, shape (n,).
        impact: IMPACT, shape (K,).
        first: first impact of each object, or NO_IMPACT, shape (objects,).
        knot: KNOT of each impact, then of the end of each object, shape (K + objects,).
        face: HALF_PLANE that a knot demands, shape (K + objects, f).
        own: HALF_PLANE that a robot may not leave, filled up by 0 . p <= 1, shape (r, g).
        breaks: breakpoints of the robots' curves, filled up by inf, shape (r, S + 1) [s].
        coefficients: of their segments in power basis, shape (r, S, d + 1, 2) [m].
        walls: of the world: least x, least y, greatest x, greatest y, shape (4,) [m].
        solid: corners of the solid obstacles, then of the areas that the formula tells a body to keep out of at all
            times, counter-clockwise, filled up by the last one, shape (s, c, 2) [m].
        inset: how far each body's centre has to stay outside them: its radius, 0 of an area that stops nobody, -inf
            where nothing forbids it to be inside, shape (s, n) [m].
        side: SIDE of each object that is no disc, shape (objects, d).
        pilot: of each robot's tracking problem, shape (r, 52).
        last: of each object, how long the plan lets it fly after its last impact if the plan says how much it may be
            off then, 0 otherwise, shape (objects,) [s].
        deviation: of an object's velocity after an impact per axis that the plan bears, 0: none [m/s].
        response: RESPONSE of each impact, shape (K,); of a plan without responses, or where nobody follows them, (0,).
        answer: number of the impact whose place decides where each robot goes on a segment of its curve, or NO_IMPACT,
            shape (r, S).
        term: A, B and C of the segments in power basis, shape (r, S, 3, d + 1, 2) [m]; empty without.
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
    walls: np.ndarray
    solid: np.ndarray
    inset: np.ndarray
    side: np.ndarray
    pilot: np.ndarray
    last: np.ndarray
    deviation: float
    response: np.ndarray
    answer: np.ndarray
    term: np.ndarray


def make_plan_table(
    scenario: FreeFlyerScenario,
    plan: Plan,
    begin: float = 0.0,
    weights: Weights = Weights(),  # noqa: B008 - frozen
    respond: bool = True,
) -> PlanTable:
    """Make the tables of a plan.

    Args:
        scenario: as believed.
        plan: to execute.
        begin: when the scenario and the plan begin [s].
        weights: of the tracking cost.
        respond: take its responses where it has any.
    """
    impact, first, knots = _make_impacts(scenario, plan, begin)
    knot, face = _make_knots(knots, begin)
    _write_boxes(scenario, plan, impact, knot, begin)
    breaks, coefficients = _make_curves(scenario, plan)
    responses = plan.planned_responses if respond else ()
    answer, term = _make_terms(scenario, plan, responses, coefficients)
    return PlanTable(
        float(scenario.control_period),
        begin + float(plan.horizon),
        float(scenario.believed.restitution),
        len(scenario.robots),
        _make_bodies(scenario),
        impact,
        first,
        knot,
        face,
        _make_own_faces(scenario),
        begin + breaks,
        coefficients,
        np.array([*scenario.world.lower, *scenario.world.upper], dtype=float),
        *_make_solids(scenario),
        _make_sides(scenario),
        np.array(
            [build_tracking_problem(robot, scenario.control_period, weights).row for robot in scenario.robots.values()]
        ),
        np.array([_find_last_flight(plan, name) for name in scenario.objects]),
        float(plan.deviation or 0.0),
        _make_responses(plan, responses, knot, begin),
        answer,
        term,
    )


def _make_bodies(scenario: FreeFlyerScenario) -> np.ndarray:
    bodies = [scenario.body(name) for name in scenario.bodies]
    table = np.zeros(len(bodies), BODY)
    for row, body in zip(table, bodies, strict=True):
        row["start"], row["start_velocity"] = body.start, body.start_velocity
        row["heading"], row["start_rate"] = body.heading, body.start_rate
        row["mass"], row["radius"], row["speed_limit"] = body.mass, body.radius, body.speed_limit
        row["gyration"] = body.inertia / body.mass
        row["spread"] = max(getattr(body, "start_uncertainty", (0.0, 0.0)))
        row["keep_force"] = getattr(body, "keep_force", 0.0)
        row["jump"] = max(_bound_jump(body, other) for other in (None, *bodies) if other is not body)
    return table


def _bound_jump(body: Body, other: Body | None) -> float:
    """Return the most that an elastic impact, with a body or a wall, changes a velocity, 2 m_eff v_rel / m [m/s]."""
    speed = math.sqrt(2.0) * body.speed_limit
    if other is None:
        return 2.0 * speed
    return 2.0 * other.mass / (body.mass + other.mass) * (speed + math.sqrt(2.0) * other.speed_limit)


def _make_impacts(scenario: FreeFlyerScenario, plan: Plan, begin: float) -> tuple[np.ndarray, np.ndarray, list[Knot]]:
    place = {name: i for i, name in enumerate(scenario.bodies)}
    impact, first = np.zeros(len(plan.impacts), IMPACT), np.full(len(scenario.objects), NO_IMPACT)
    knots: dict[int, Knot] = {}
    for o, name in enumerate(scenario.objects):
        mine = [k for k, planned in enumerate(plan.impacts) if planned.object == name]
        found = find_knots(scenario, plan, name)
        first[o] = mine[0] if mine else NO_IMPACT
        for k, after, knot in zip(mine, [*mine[1:], NO_IMPACT], found, strict=False):
            planned, row = plan.impacts[k], impact[k]
            row["time"] = planned.time + begin
            row["robot"], row["body"], row["next"] = place[planned.robot], place[name], after
            row["position"], row["normal"] = planned.position, planned.normal
            knots[k] = knot
        knots[len(plan.impacts) + o] = found[-1]
    return impact, first, [knots[i] for i in range(len(knots))]


def _make_knots(knots: list[Knot], begin: float) -> tuple[np.ndarray, np.ndarray]:
    most = max((len(knot.faces) for knot in knots), default=0)
    table, face = np.zeros(len(knots), KNOT), np.zeros((len(knots), max(most, 1)), HALF_PLANE)
    for row, faces, knot in zip(table, face, knots, strict=True):
        _write_half_planes(faces, knot.faces)
        x, y = knot.position
        known = faces[: len(knot.faces)]
        margins = [plane["offset"] - (plane["normal"][0] * x + plane["normal"][1] * y) for plane in known]
        row["position"], row["depth"], row["faces"] = knot.position, min(margins, default=np.inf), len(knot.faces)
        row["opens"], row["closes"] = (begin + time for time in knot.window)
        row["stay"] = knot.stay
        if knot.via is not None:
            row["via_share"], row["via"], row["via_depth"] = knot.via.share, knot.via.position, knot.via.depth
            row["via_closes"] = begin + knot.via.closes
    return table, face


def _write_boxes(scenario: FreeFlyerScenario, plan: Plan, impact: np.ndarray, knot: np.ndarray, begin: float) -> None:
    """Write the boxes of the plan's tubes at the knots."""
    knot["lower"], knot["upper"] = np.inf, -np.inf
    ends = np.full(len(scenario.objects), begin + plan.horizon)
    bodies = np.append(impact["body"] - len(scenario.robots), np.arange(len(scenario.objects)))
    for row, time, o in zip(knot, np.append(impact["time"], ends), bodies, strict=True):
        tube = plan.tubes.get(list(scenario.objects)[o])
        if tube is not None:
            centre, half = read_tube(tube, np.array([time - begin]))
            row["lower"], row["upper"] = (centre - half)[0], (centre + half)[0]


def read_tube(tube: Tube, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return centres and half widths of a tube's boxes of positions, before what happens at a breakpoint.

    Args:
        tube: of an object.
        times: within it, shape (n,) [s].

    Returns:
        Centres and half widths, shapes (n, 2) [m].
    """
    segment = np.clip(np.searchsorted(tube.times, times - ROUND_OFF, side="right") - 1, 0, len(tube.times) - 2)
    share = ((times - tube.times[segment]) / np.diff(tube.times)[segment])[:, None, None]
    boxes = (1.0 - share) * tube.start[segment] + share * tube.end[segment]
    return boxes[:, 0, :2], boxes[:, 1, :2]


def _find_last_flight(plan: Plan, name: str) -> float:
    times = [planned.time for planned in plan.impacts if planned.object == name]
    return plan.horizon - times[-1] if times and name in plan.tubes else 0.0


def _write_half_planes(planes: np.ndarray, rows: Sequence[np.ndarray]) -> None:
    """Write rows (H, b) of H p <= b, scaled to unit normals."""
    for plane, row in zip(planes, rows, strict=False):
        unit = row / np.hypot(*row[:2])
        plane["normal"], plane["offset"] = unit[:2], unit[2]


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


def _make_responses(plan: Plan, responses: Sequence[PlannedResponse], knot: np.ndarray, begin: float) -> np.ndarray:
    table = np.zeros(len(responses), RESPONSE)
    for row, response, planned, box in zip(table, responses, plan.impacts, knot, strict=False):
        row["leave"] = response.leave + begin
        row["centre"], row["half"] = (box["lower"] + box["upper"]) / 2, (box["upper"] - box["lower"]) / 2
        row["velocity"], row["gain"] = planned.object_plus, response.gain
    return table


def _make_terms(
    scenario: FreeFlyerScenario, plan: Plan, responses: Sequence[PlannedResponse], coefficients: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return `PlanTable.answer` and `PlanTable.term`: sum_v prod_i (1 + v_i d_i) / 2 curve_v, sorted by powers of d."""
    robots, segments, degree, _ = coefficients.shape
    answer = np.full((robots, segments), NO_IMPACT)
    term = np.zeros((robots, segments, TERMS if responses else 0, degree, 2))
    names = list(scenario.robots)
    for k, (response, planned) in enumerate(zip(responses, plan.impacts, strict=False)):
        curves = plan.responses[planned.robot]
        r, times = names.index(planned.robot), curves[0].times
        inside = np.flatnonzero((times[:-1] > response.start - ROUND_OFF) & (times[1:] < response.end + ROUND_OFF))
        low_low, low_high, high_low, high_high = (convert_curve(curve).coefficients[inside] for curve in curves)
        size = low_low.shape[1]
        answer[r, inside] = k
        term[r, inside, 0, :size] = (high_low + high_high - low_low - low_high) / 4
        term[r, inside, 1, :size] = (low_high + high_high - low_low - high_low) / 4
        term[r, inside, 2, :size] = (low_low + high_high - low_high - high_low) / 4
    return answer, term


def _make_own_faces(scenario: FreeFlyerScenario) -> np.ndarray:
    found = [[*find_own_faces(scenario, name), *_find_walls(scenario, name)] for name in scenario.robots]
    own = np.zeros((len(found), max(len(faces) for faces in found)), HALF_PLANE)
    own["offset"] = 1.0
    for planes, faces in zip(own, found, strict=True):
        _write_half_planes(planes, faces)
    return own


def _find_walls(scenario: FreeFlyerScenario, name: str) -> list[np.ndarray]:
    """Return the faces that keep a robot from touching the world's walls."""
    inset = scenario.robots[name].radius - TOUCHING
    sides = [(-1.0, 0.0, -scenario.world.lower[0]), (0.0, -1.0, -scenario.world.lower[1])]
    sides += [(1.0, 0.0, scenario.world.upper[0]), (0.0, 1.0, scenario.world.upper[1])]
    return [np.array([x, y, b - inset]) for x, y, b in sides]


def _make_solids(scenario: FreeFlyerScenario) -> tuple[np.ndarray, np.ndarray]:
    """Return `PlanTable.solid` and `PlanTable.inset`."""
    bodies = [scenario.body(name) for name in scenario.bodies]
    found = [np.array(area.corners, float) for area in scenario.obstacles.values() if area.solid]
    inset = [np.array([body.radius for body in bodies]) for _ in found]
    kept = _list_kept_out(scenario)
    for name, obstacle in scenario.obstacles.items():
        outside = np.array([(body, name) in kept for body in scenario.bodies])
        if not obstacle.solid and outside.any():
            found.append(np.array(obstacle.corners, float))
            inset.append(np.where(outside, 0.0, -np.inf))
    solid = np.zeros((len(found), max(map(len, found), default=0), 2))
    for row, corners in zip(solid, found, strict=True):
        row[: len(corners)], row[len(corners) :] = corners, corners[-1]
    return solid, np.array(inset).reshape(len(found), len(bodies))


def _list_kept_out(scenario: FreeFlyerScenario) -> set[tuple[str, str]]:
    """Return the bodies and obstacles such that the formula tells the body to be outside at all times."""
    try:
        demands = read_demands(scenario, 0.0)
    except InputError:
        return set()
    held = list_held_throughout(scenario, demands.conjuncts.values())
    return {(node.body, node.area) for node in held if isinstance(node, In) and node.negated}


def _make_sides(scenario: FreeFlyerScenario) -> np.ndarray:
    found = [find_central_hits(np.array(item.vertices or ())) for item in scenario.objects.values()]
    sides = np.zeros((len(found), max(map(len, found), default=0)), SIDE)
    for row, hits in zip(sides, found, strict=True):
        row["direction"][: len(hits)], row["distance"][: len(hits)] = hits[:, :2], hits[:, 2]
    return sides

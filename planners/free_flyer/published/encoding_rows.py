"""The paper's encoding row by row: Bezier curves r(s) and h(s), and a binary for every impact that could be."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from impact_envs.errors import InputError
from impact_envs.free_flyer.schema import FreeFlyerScenario, Robot
from impact_envs.physics.impact import compute_mass_fractions
from impact_envs.stl import Always, And, Eventually, Formula, In, Not
from planners.errors import Infeasible
from planners.mixed_integer import Affine, Model

ROBOT_DEGREE, OBJECT_DEGREE = 5, 1
SLOWEST, FASTEST = 0.1, 1000.0  # control points of h' [s]; the published code's bounds
FORMS = "it takes conjunctions of F[a,b] and G[a,b] over 'body in area', G[a,b] over 'body not in area'"


@dataclass(frozen=True)
class BezierModel:
    """Hold the model and the meaning of its variables.

    Args:
        model: rows and bounds; its objective is the greatest robustness.
        rho: robustness, one number for all predicates of all bodies [m].
        ceiling: least inradius of the areas to be in, or a little more [m].
        r: body to control points of r(s), shape (N, d+1, 2) [m].
        h: body to control points of h(s), shape (N, d+1) [s].
        hits: (robot, i, object, j) to the binary z_(R,O)[i, j]: curve i of the robot ends in an impact at the end
            of curve j of the object.
    """

    model: Model
    rho: Affine
    ceiling: float
    r: dict[str, np.ndarray]
    h: dict[str, np.ndarray]
    hits: dict[tuple[str, int, str, int], Affine] = field(default_factory=dict)


@dataclass(frozen=True)
class Clause:
    """Hold one conjunct of a formula.

    Args:
        predicate: body, area, and whether the body has to be outside.
        start: of the window [s].
        end: of the window [s].
        always: whether all instants of the window are meant, or some.
        scored: whether it counts for the robustness.
    """

    predicate: In
    start: float
    end: float
    always: bool = True
    scored: bool = True


def build_bezier_model(
    scenario: FreeFlyerScenario,
    curves: Mapping[str, int],
    constant_grid: bool = False,
    separation: bool = True,
    max_impacts: int | None = None,
) -> BezierModel:
    """Build the mixed-integer model of all motions that maximises the robustness.

    Args:
        scenario: any number of robots and objects, which are points here.
        curves: number N of curves of every body.
        constant_grid: all curves of an object last equally long, and h'_R = h'_O before an impact.
        separation: keep robots from robots and objects from objects by Eq. (26).
        max_impacts: greatest number of impacts; None: as many as the curves have ends.

    Returns:
        The model.

    Raises:
        InputError: a subformula of a form this encoding does not have.
        Infeasible: the variable bounds alone exclude every plan.

    Source: Verhagen & Tumova, Eqs. (15), (21)-(26), with M from interval arithmetic.
    """
    clauses = read_clauses(scenario)
    inside = [scenario.areas[c.predicate.area].corners for c in clauses if c.scored and not c.predicate.negated]
    # No disc in a convex area is wider than the area.
    ceiling = min([scenario.world.diagonal, *(0.5 * float(np.ptp(corners, axis=0).min()) for corners in inside)])
    model = Model(f"Bezier encoding of {scenario.name}")
    bezier = BezierModel(model, model.variable(0.0, ceiling), ceiling, r={}, h={})
    for name in scenario.bodies:
        _add_curves(bezier, scenario, name, curves[name], constant_grid)
    _add_impact_rows(bezier, scenario, constant_grid)
    for name in scenario.bodies:
        _add_continuity_rows(bezier, name)
    if max_impacts is not None:
        model.require(sum(bezier.hits.values(), Affine({})) - max_impacts)
    for clause in clauses:
        try:
            _add_clause(bezier, scenario, clause)
        except Infeasible:
            status = (
                f"'{clause.predicate}' in [{clause.start:g}, {clause.end:g}] s contradicts the limits of the curves"
            )
            raise Infeasible(model.name, status, "allow more curves, or relax the formula") from None
    if separation:
        _add_separation_rows(bezier, scenario)
    model.objective = -bezier.rho
    return bezier


def read_clauses(scenario: FreeFlyerScenario) -> tuple[Clause, ...]:
    """Return what formula and solid obstacles demand.

    Args:
        scenario: with its formula.

    Returns:
        The formula's conjuncts in order, then solid obstacles the formula does not name; a point only stays
        outside those.

    Raises:
        InputError: a subformula of a form this encoding does not have.
    """
    clauses = list(_read(scenario, scenario.specification.expand(scenario.bodies), None, 0.0, 0.0))
    known = {c.predicate for c in clauses if c.always and c.start == 0.0 and c.end >= scenario.horizon}
    for name, obstacle in scenario.obstacles.items():
        for body in scenario.bodies if obstacle.solid else ():
            if (outside := In(body, name, negated=True)) not in known:
                clauses.append(Clause(outside, 0.0, scenario.horizon, scored=False))
    return tuple(clauses)


def _read(
    scenario: FreeFlyerScenario, formula: Formula, always: bool | None, start: float, end: float
) -> Iterator[Clause]:
    """Open conjunctions and windows; `always` is None outside every temporal operator."""
    if isinstance(formula, And) and always is not False:
        for part in formula.operands:
            yield from _read(scenario, part, always, start, end)
        return
    if isinstance(formula, Always | Eventually) and (always is None or (always and isinstance(formula, Always))):
        lower, upper = formula.interval
        is_point = start + lower == end + upper
        yield from _read(scenario, formula.child, isinstance(formula, Always) or is_point, start + lower, end + upper)
        return
    predicate = formula.child if isinstance(formula, Not) else formula
    if isinstance(predicate, In):
        negated = predicate.negated != isinstance(formula, Not)
        if always is not False or not negated:
            yield Clause(In(predicate.body, predicate.area, negated), start, end, always is not False)
            return
    wish = f"eventually '{formula}'" if always is False else f"'{formula}'"
    raise InputError(f"{scenario.name}: formula: {wish} is not supported by the Bezier encoding; {FORMS}")


def differentiate(points: np.ndarray) -> np.ndarray:
    """Return the control points d (p_(b+1) - p_b) of the derivative by s.

    Args:
        points: shape (N, d+1, ...).

    Returns:
        Shape (N, d, ...).

    Source: Verhagen & Tumova, Sec. II-E, property 3.
    """
    return np.diff(points, axis=1) * (points.shape[1] - 1)


def _add_curves(bezier: BezierModel, scenario: FreeFlyerScenario, name: str, count: int, constant_grid: bool) -> None:
    """Add r(s) and h(s) of a body with start, goal, rest and Eq. (25); neighbouring curves share a control point."""
    model, body = bezier.model, scenario.body(name)
    is_robot = isinstance(body, Robot)
    degree = ROBOT_DEGREE if is_robot else OBJECT_DEGREE
    lower, upper = np.array(scenario.world.lower), np.array(scenario.world.upper)
    points = [np.array(body.start, dtype=object), *(model.vector(lower, upper) for _ in range(count * degree))]
    if isinstance(body, Robot) and body.goal is not None:
        points[-1] = np.array(body.goal, dtype=object)
    times: list[Affine | float] = np.linspace(0.0, scenario.horizon, count * degree + 1).tolist()
    if is_robot or not constant_grid:
        times[1:-1] = [model.variable(0.0, scenario.horizon) for _ in times[1:-1]]
    r = np.array([points[k * degree : (k + 1) * degree + 1] for k in range(count)], dtype=object)
    h = np.array([times[k * degree : (k + 1) * degree + 1] for k in range(count)], dtype=object)
    bezier.r[name], bezier.h[name] = r, h
    dr, dh = differentiate(r), differentiate(h)
    for rate, steps in zip(dh.ravel(), dr.reshape(-1, 2), strict=True):
        model.require(SLOWEST - rate)
        model.require(rate - FASTEST)
        for step in steps:
            model.require(step - rate * body.speed_limit)
            model.require(-step - rate * body.speed_limit)
    ends = [dr[0, 0], dr[-1, -1]] if isinstance(body, Robot) or body.rest else [dr[0, 0]]
    for step in np.concatenate(ends):
        model.require_equal(Affine({}) + step)


def _add_impact_rows(bezier: BezierModel, scenario: FreeFlyerScenario, constant_grid: bool) -> None:
    """Let curve ends of robots and objects meet, with Eq. (24) on r' and, separately, on h'."""
    model = bezier.model
    for robot, name in itertools.product(scenario.robots, scenario.objects):
        masses = scenario.robots[robot].mass, scenario.objects[name].mass
        m1, m2, m3, m4 = compute_mass_fractions(*masses, scenario.believed.restitution)
        rates_r, rates_o = (_rates(bezier, body) for body in (robot, name))
        for i, j in itertools.product(range(len(rates_r) - 1), range(len(rates_o) - 1)):
            hit = bezier.hits[robot, i, name, j] = model.binary()
            robot_minus, robot_plus = rates_r[i, -1], rates_r[i + 1, 0]
            object_minus, object_plus = rates_o[j, -1], rates_o[j + 1, 0]
            rows = [
                *(bezier.r[robot][i, -1] - bezier.r[name][j, -1]),
                bezier.h[robot][i, -1] - bezier.h[name][j, -1],
                *(robot_plus - robot_minus * m1 - object_minus * m2),
                *(object_plus - robot_minus * m3 - object_minus * m4),
            ]
            if constant_grid:
                rows.append(robot_minus[2] - object_minus[2])
            _require_zero(model, rows, unless=1.0 - hit)


def _rates(bezier: BezierModel, name: str) -> np.ndarray:
    """Return the control points of (r'_x, r'_y, h') of a body, shape (N, d, 3)."""
    dr, dh = differentiate(bezier.r[name]), differentiate(bezier.h[name])
    return np.concatenate([dr, dh[..., None]], axis=2)


def _add_continuity_rows(bezier: BezierModel, name: str) -> None:
    """Keep r' and h' continuous where a curve does not end in an impact, Eqs. (13), (14), (23)."""
    rates = _rates(bezier, name)
    for k in range(len(rates) - 1):
        here = [hit for (robot, i, object_, j), hit in bezier.hits.items() if (name, k) in ((robot, i), (object_, j))]
        impact = sum(here, Affine({}))
        bezier.model.require(impact - 1.0)
        _require_zero(bezier.model, list(rates[k + 1, 0] - rates[k, -1]), unless=impact)


def _require_zero(model: Model, rows: list[Affine | float], unless: Affine) -> None:
    for row in rows:
        model.require(row, unless)
        model.require(-row, unless)


def _add_clause(bezier: BezierModel, scenario: FreeFlyerScenario, clause: Clause) -> None:
    """Add a conjunct: Eq. (21) or (22) on every curve that meets the window, or the end of one curve in the area.

    "Eventually" requires the end of a curve, as in the published code: a moving point is at the best place of an area
    for an instant only.
    """
    faces, bounds = scenario.areas[clause.predicate.area].halfspaces()
    rho = bezier.rho if clause.scored else 0.0
    r, h = bezier.r[clause.predicate.body], bezier.h[clause.predicate.body]
    gaps = np.tensordot(r, faces, axes=(2, 1)) - bounds  # beyond every face, shape (N, d+1, f)
    if not clause.always:
        knots = [(h[0, 0], gaps[0, 0]), *((h[k, -1], gaps[k, -1]) for k in range(len(h)))]
        bezier.model.require_any([[clause.start - t, t - clause.end, *(gap + rho)] for t, gap in knots])
        return
    # Only the last curve reaches the horizon, as h increases.
    for k in range(len(h) - 1 if clause.start >= scenario.horizon else 0, len(h)):
        # A curve is outside a window only if it misses it by a control period.
        before = [h[k, -1] + scenario.control_period - clause.start]
        after = [clause.end + scenario.control_period - h[k, 0]]
        if clause.predicate.negated:
            within = [[rho - gap for gap in gaps[k, :, face]] for face in range(len(faces))]
        elif clause.start >= scenario.horizon:
            within = [list(gaps[k, -1] + rho)]
        else:
            within = [list((gaps[k] + rho).ravel())]
        bezier.model.require_any([*within, before, after])


def _add_separation_rows(bezier: BezierModel, scenario: FreeFlyerScenario) -> None:
    """Keep the boxes of two curves of like bodies apart unless their times are, Eq. (26) with its sign turned."""
    for kind in (scenario.robots, scenario.objects):
        boxes = {name: _add_boxes(bezier, scenario, name) for name in (kind if len(kind) > 1 else ())}
        for first, second in itertools.combinations(boxes, 2):
            reach = scenario.body(first).radius + scenario.body(second).radius
            times = bezier.h[first], bezier.h[second]
            for (k, a), (q, b) in itertools.product(enumerate(boxes[first]), enumerate(boxes[second])):
                before = [[times[0][k, -1] - times[1][q, 0]], [times[1][q, -1] - times[0][k, 0]]]
                beside = [[reach - apart] for apart in (*(b[0] - a[1]), *(a[0] - b[1]))]
                bezier.model.require_any([*beside, *before])


def _add_boxes(bezier: BezierModel, scenario: FreeFlyerScenario, name: str) -> list[np.ndarray]:
    """Return lower and upper corners round the control points of every curve, each of shape (2, 2)."""
    model, boxes = bezier.model, []
    lower, upper = np.array(scenario.world.lower), np.array(scenario.world.upper)
    for points in bezier.r[name]:
        box = np.array([model.vector(lower, upper) for _ in range(2)])
        for point in points:
            for row in (*(box[0] - point), *(point - box[1])):
                model.require(row)
        boxes.append(box)
    return boxes

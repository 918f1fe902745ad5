"""Conversion of plans into the published form and back: curves over physical time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from impact_envs.errors import InputError, choices
from impact_envs.free_flyer.schema import FreeFlyerScenario
from planners.bezier import Curve
from planners.free_flyer.published.curve import JUMP, PublishedBody, PublishedPlan, evaluate_bezier
from planners.free_flyer.published.impact import read_deviation, read_impacts
from planners.free_flyer.published.names import match_names, rename_bodies
from planners.free_flyer.validation import compute_robustness
from planners.plan import Plan, PlannedImpact, Tube

FIT = 5e-7  # greatest distance of a piece from the published curve at samples [m]
SAMPLES = np.arange(1, 16) / 16  # of a piece, in its parameter
HALVINGS = 20  # greatest number, of a curve


def make_published_plan(plan: Plan) -> PublishedPlan:
    """Return a plan in the form of the published ones: r are the control points, h is affine.

    In the published form bodies are points that meet; here r are the centres of bodies that touch. It has one path per
    robot, so responses are left out.

    Args:
        plan: its impacts are at ends of curves.

    Returns:
        The same motions; curves of objects are cut where their boxes change.

    Raises:
        InputError: an object's curve is not straight, a robot's is, or an impact lies within a curve.
    """
    curves = plan.robots | plan.objects
    for name, curve in curves.items():
        if (curve.degree == 1) != (name in plan.objects) or curve.degree < 1:
            kinds = "objects of degree 1, robots of a higher one"
            raise InputError(f"curve of {name} has degree {curve.degree}; the published format has {kinds}")
    zonotopes = {}
    for name, tube in plan.tubes.items():
        _check_span(name, tube, plan.horizon)
        curves[name] = _cut_curve(curves[name], tube.times)
        zonotopes[name] = _cut_tube(tube, curves[name].times)
    return PublishedPlan({name: _publish(curve, name, plan.impacts) for name, curve in curves.items()}, zonotopes)


def convert_published_plan(
    published: PublishedPlan, scenario: FreeFlyerScenario, names: Mapping[str, str] | None = None
) -> Plan:
    """Return a published plan as a `Plan`, for execution and pictures.

    Robots' curves become quintic pieces with the same position, velocity and acceleration at their ends, halved
    until they agree to within a micrometre; objects' curves are exact. Where the scenario lasts longer than the plan,
    every body keeps its last velocity.

    Args:
        published: to convert.
        scenario: whose bodies and formula the plan is judged with.
        names: of bodies in the plan to those in the scenario; the others are told by roles and starts.

    Returns:
        A plan of which nothing is proven: its bound is the world's diagonal, and it is not validated.

    Raises:
        InputError: other bodies than the scenario's, a longer horizon, or labels that do not match.
    """
    published = rename_bodies(published, match_names(published, scenario, names))
    _check_bodies(published, scenario)
    impacts, horizon = read_impacts(published), scenario.horizon
    end = published.horizon if horizon - published.horizon > JUMP else horizon
    marks = np.array([0.0, *(impact.time for impact in impacts), end])
    curves = {name: _fit_body(body, marks) for name, body in published.bodies.items()}
    tubes = published.zonotopes
    if end < horizon:
        curves = {name: _prolong_curve(curve, horizon) for name, curve in curves.items()}
        tubes = {name: _prolong_tube(tube, horizon) for name, tube in tubes.items()}
    samples = np.arange(round(horizon / scenario.control_period) + 1) * scenario.control_period
    rho = compute_robustness(scenario, samples, {name: curves[name].position(samples) for name in scenario.bodies})
    bound = max(rho, scenario.world.diagonal)
    return Plan(
        scenario=scenario.name,
        objective="impact_uncertainty" if published.zonotopes else "robustness",
        horizon=horizon,
        robustness=rho,
        bound=bound,
        gap=(bound - rho) / max(1.0, abs(bound)),
        effort=_compute_effort(curves, np.unique([0.0, *(impact.time for impact in impacts), horizon])),
        effort_bound=None,
        impacts=impacts,
        robots={name: curves[name] for name in scenario.robots},
        objects={name: curves[name] for name in scenario.objects},
        solve_seconds=0.0,
        stage_seconds={},
        validated=False,
        deviation=read_deviation(published),
        tubes=tubes,
    )


def _publish(curve: Curve, name: str, impacts: tuple[PlannedImpact, ...]) -> PublishedBody:
    """Return a curve with h affine, theta zero, and the labels of its impacts."""
    count, width = curve.points.shape[:2]
    ids, others = ["none"] * count, ["none"] * count
    hits = [(hit, hit.object if name == hit.robot else hit.robot) for hit in impacts if name in (hit.robot, hit.object)]
    # pre comes last, so that it wins on a curve between two impacts.
    for label, offset in (("post", 0), ("pre", -1)):
        for hit, other in hits:
            joint = int(np.abs(curve.times - hit.time).argmin())
            if abs(curve.times[joint] - hit.time) > JUMP or not 0 < joint < count:
                raise InputError(f"impact at {hit.time} s: no two curves of {name} meet then")
            ids[joint + offset], others[joint + offset] = label, other
    r = np.concatenate([curve.points, np.zeros((count, width, 1))], axis=2)
    return PublishedBody(r, np.linspace(curve.times[:-1], curve.times[1:], width, axis=1), tuple(ids), tuple(others))


def _check_span(name: str, tube: Tube, horizon: float) -> None:
    start, end = tube.times[[0, -1]].tolist()
    if abs(start) > JUMP or abs(end - horizon) > JUMP:
        raise InputError(f"tube of {name} spans [{start}, {end}] s, expected [0, {horizon}] s")


def _cut_curve(curve: Curve, times: np.ndarray) -> Curve:
    """Return straight pieces cut at further times that lie within them."""
    inside = [t for t in times if np.abs(curve.times - t).min() > JUMP and t < curve.times[-1]]
    cut = np.union1d(curve.times, inside)
    ends = np.stack([curve.position(cut[:-1], "right"), curve.position(cut[1:], "left")], axis=1)
    return Curve(cut, ends)


def _cut_tube(tube: Tube, times: np.ndarray) -> Tube:
    """Return the same boxes on finer segments; between start and end they move linearly."""
    middles = (times[:-1] + times[1:]) / 2
    k = np.clip(np.searchsorted(tube.times, middles, side="right") - 1, 0, len(tube.times) - 2)
    boxes = []
    for ends in (times[:-1], times[1:]):
        share = np.clip((ends - tube.times[k]) / np.diff(tube.times)[k], 0.0, 1.0)[:, None, None]
        boxes.append((1 - share) * tube.start[k] + share * tube.end[k])
    return Tube(times, *boxes)


def _check_bodies(published: PublishedPlan, scenario: FreeFlyerScenario) -> None:
    kinds = (("robot", published.robots, scenario.robots), ("object", published.objects, scenario.objects))
    for kind, found, known in kinds:
        for name in sorted({*found} ^ {*known}):
            has = f"{kind} of the plan" if name in found else f"{kind} of scenario {scenario.name}"
            raise InputError(f"'{name}' is a {has} only; {choices(name, known if name in found else found)}")
    if published.horizon > scenario.horizon + JUMP:
        lasts = f"the plan lasts {published.horizon:g} s"
        raise InputError(f"{lasts}, scenario {scenario.name} only {scenario.horizon:g} s; override its horizon")


def _fit_body(body: PublishedBody, marks: np.ndarray) -> Curve:
    """Return the curve of a body; breakpoints that are meant to lie on a mark lie on it exactly."""
    times, pieces = [0.0], []
    for k in range(len(body.h)):
        r, h = body.r[k, :, :2], body.h[k]
        for end, points in [(h[-1], r)] if body.degree == 1 else _fit_curve(r, h, 0.0, 1.0):
            times.append(end)
            pieces.append(points)
    grid = np.array(times)
    for mark in marks:
        near = int(np.abs(grid - mark).argmin())
        grid[near] = mark if abs(grid[near] - mark) <= JUMP else grid[near]
    return Curve(grid, np.array(pieces))


def _fit_curve(
    r: np.ndarray, h: np.ndarray, lower: float, upper: float, halvings: int = HALVINGS
) -> Iterator[tuple[float, np.ndarray]]:
    """Yield end time and control points, shape (6, 2), of quintic pieces that follow p(h(s)) = r(s)."""
    (t0, p0, v0, a0), (t1, p1, v1, a1) = (_evaluate_motion(r, h, s) for s in (lower, upper))
    T = t1 - t0
    points = np.array(
        [
            p0,
            p0 + T * v0 / 5,
            p0 + 2 * T * v0 / 5 + T**2 * a0 / 20,
            p1 - 2 * T * v1 / 5 + T**2 * a1 / 20,
            p1 - T * v1 / 5,
            p1,
        ]
    )
    s = lower + (upper - lower) * SAMPLES
    tr = evaluate_bezier(np.broadcast_to(np.column_stack([h, r]), (len(s), len(h), 3)), s)
    near = evaluate_bezier(np.broadcast_to(points, (len(s), 6, 2)), (tr[:, 0] - t0) / T)
    if np.abs(near - tr[:, 1:]).max() <= FIT or halvings == 0:
        yield t1, points
        return
    middle = (lower + upper) / 2
    yield from _fit_curve(r, h, lower, middle, halvings - 1)
    yield from _fit_curve(r, h, middle, upper, halvings - 1)


def _evaluate_motion(r: np.ndarray, h: np.ndarray, s: float) -> tuple[float, np.ndarray, np.ndarray, np.ndarray]:
    """Return t = h, p = r, v = r' / h' and a = (r'' - v h'') / h'^2 at a parameter."""
    points, found = np.column_stack([h, r]), []
    for _ in range(3):
        found.append(evaluate_bezier(points[None], np.array([s]))[0])
        points = (len(points) - 1) * np.diff(points, axis=0) if len(points) > 1 else np.zeros_like(points)
    (t, *p), (rate, *slope), (bend, *curvature) = found
    v = np.array(slope) / rate
    return float(t), np.array(p), v, (np.array(curvature) - v * bend) / rate**2


def _prolong_curve(curve: Curve, horizon: float) -> Curve:
    """Return a curve that keeps its last velocity up to a horizon [s]."""
    end, velocity = curve.points[-1, -1], curve.velocity(curve.times[-1], "left")
    share = np.linspace(0.0, horizon - curve.times[-1], curve.degree + 1)[:, None]
    return Curve(np.append(curve.times, horizon), np.concatenate([curve.points, (end + share * velocity)[None]]))


def _prolong_tube(tube: Tube, horizon: float) -> Tube:
    """Return boxes that keep their last velocities, whose half widths add to those of position."""
    last = tube.end[-1].copy()
    last[:, :2] += (horizon - tube.times[-1]) * last[:, 2:]
    return Tube(
        np.append(tube.times, horizon),
        np.concatenate([tube.start, tube.end[-1:]]),
        np.concatenate([tube.end, last[None]]),
    )


def _compute_effort(curves: dict[str, Curve], events: np.ndarray) -> float:
    """Return the sum over bodies and legs of |displacement|^2 / duration [m^2/s]."""
    spans = np.diff(events)[:, None]
    return float(sum(np.sum(np.diff(curve.position(events), axis=0) ** 2 / spans) for curve in curves.values()))

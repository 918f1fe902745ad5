"""What a plan from elsewhere breaks: the impact law, starts, limits, the world; where, and by how much."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from impact_envs.errors import InputError
from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.physics.impact import compute_velocity_gain
from planners.bezier import Curve
from planners.plan import Plan, PlannedImpact

# What is smaller counts as kept.
LENGTH, SPEED, SHARE = 1e-4, 1e-4, 1e-3  # [m, m/s, of a limit]
FASTEST = 2.0  # times the speed limit, above which a plan is refused
STRONGEST = 10.0  # times the force limit; for a moment the tracker falls behind, and catches up


@dataclass(frozen=True)
class Violation:
    """Hold by how much a plan breaks something at worst.

    Args:
        kind: start, start_velocity, goal, impact_law, contact, free_flight, speed, force, world, obstacle or overlap.
        time: at which it is worst [s].
        body: that breaks it, and the other one after "and", if any.
        amount: beyond what is allowed.
        unit: of the amount.
        refused: whether a plan that breaks it by so much is not flown.
    """

    kind: str
    time: float
    body: str
    amount: float
    unit: str
    refused: bool

    def __str__(self) -> str:
        """Return one line for people."""
        return f"{self.kind}: {self.body} at {self.time:.2f} s by {self.amount:.3g} {self.unit}"


def list_violations(scenario: FreeFlyerScenario, plan: Plan) -> tuple[Violation, ...]:
    """Return what a plan breaks, at worst by kind and body; of the impact law, every impact.

    Args:
        scenario: believed physics, limits and world.
        plan: for its bodies.

    Returns:
        Violations; none of a plan that this project has made for the scenario.

    Raises:
        InputError: the plan has other robots or objects.
    """
    if (plan.robots.keys(), plan.objects.keys()) != (scenario.robots.keys(), scenario.objects.keys()):
        plans = f"robots {', '.join(plan.robots)} and objects {', '.join(plan.objects)}"
        known = f"robots {', '.join(scenario.robots)} and objects {', '.join(scenario.objects)}"
        raise InputError(f"the plan has {plans}; scenario {scenario.name} has {known}")
    step = scenario.control_period
    times = np.arange(round(plan.horizon / step) + 1) * step
    times = times[times <= plan.horizon]
    curves = plan.robots | plan.objects
    places = {name: curves[name].position(times) for name in scenario.bodies}
    found = [
        *_list_ends(scenario, plan),
        *(one for impact in plan.impacts for one in _list_impact(scenario, plan, impact)),
        *(one for name in scenario.objects for one in _list_free_flight(scenario, plan, name)),
        *(one for name in scenario.bodies for one in _list_limits(scenario, plan, name, times)),
        *_list_places(scenario, plan, times, places),
    ]
    least = {"m": LENGTH, "m/s": SPEED, "N": 0.0}
    return tuple(one for one in found if not one.amount <= least[one.unit])


def _list_ends(scenario: FreeFlyerScenario, plan: Plan) -> Iterator[Violation]:
    for name, curve in (plan.robots | plan.objects).items():
        body = scenario.body(name)
        off = float(np.linalg.norm(curve.position(0.0) - body.start))
        yield Violation("start", 0.0, name, off, "m", off > body.radius)
        off = float(np.linalg.norm(curve.velocity(0.0) - body.start_velocity))
        yield Violation("start_velocity", 0.0, name, off, "m/s", off > body.speed_limit)
        goal = getattr(body, "goal", None)
        if goal is not None:
            off = float(np.linalg.norm(curve.position(plan.horizon) - goal))
            yield Violation("goal", plan.horizon, name, off, "m", False)


def _list_impact(scenario: FreeFlyerScenario, plan: Plan, impact: PlannedImpact) -> Iterator[Violation]:
    """Yield by how much velocities after an impact differ from the law of discs without friction."""
    robot, item = scenario.robots[impact.robot], scenario.objects[impact.object]
    before, after = (_velocity(plan.robots[impact.robot], impact.time, side) for side in (-1, 1))
    minus, plus = (_velocity(plan.objects[impact.object], impact.time, side) for side in (-1, 1))
    approach = max(float((before - minus) @ impact.normal), 0.0)
    gain = compute_velocity_gain(scenario.believed.restitution, robot.mass, item.mass)
    change = gain * approach * impact.normal
    for name, limit, off in (
        (impact.object, item.speed_limit, minus + change - plus),
        (impact.robot, robot.speed_limit, before - item.mass / robot.mass * change - after),
    ):
        amount = float(np.linalg.norm(off))
        yield Violation("impact_law", impact.time, name, amount, "m/s", amount > limit)
    apart = plan.objects[impact.object].position(impact.time) - plan.robots[impact.robot].position(impact.time)
    touching = robot.radius + item.radius
    off = float(np.linalg.norm(apart)) - touching
    pair = f"{impact.robot} and {impact.object}"
    # Published bodies are points, which meet at distance zero.
    yield Violation("contact", impact.time, pair, abs(off), "m", off > robot.radius)


def _list_free_flight(scenario: FreeFlyerScenario, plan: Plan, name: str) -> Iterator[Violation]:
    """Yield the greatest change of an object's velocity that no impact makes."""
    curve, hits = plan.objects[name], [impact.time for impact in plan.impacts if impact.object == name]
    worst, when = 0.0, 0.0
    for time in curve.times[1:-1]:
        if not any(abs(time - hit) < 1e-6 for hit in hits):
            jump = float(np.linalg.norm(_velocity(curve, time, 1) - _velocity(curve, time, -1)))
            worst, when = max((worst, when), (jump, float(time)))
    for start, end in itertools.pairwise(curve.times):
        inside = np.linspace(start, end, 6)
        speeds = np.diff(np.concatenate([curve.position(inside[:-1]), curve.position(inside[-1:], "left")]), axis=0)
        speeds /= np.diff(inside)[:, None]
        bend = float(np.linalg.norm(speeds - speeds[0], axis=1).max())
        worst, when = max((worst, when), (bend, float(end)))
    yield Violation("free_flight", when, name, worst, "m/s", worst > scenario.objects[name].speed_limit)


def _list_limits(scenario: FreeFlyerScenario, plan: Plan, name: str, times: np.ndarray) -> Iterator[Violation]:
    """Yield the worst speed per axis and, of robots, the worst mean force over a control period."""
    body, curve = scenario.body(name), (plan.robots | plan.objects)[name]
    moments = np.unique([*times, *curve.times])
    both = np.stack([curve.velocity(moments, "left"), curve.velocity(moments, "right")])
    speeds = np.abs(both).max(axis=(0, 2))
    worst = int(speeds.argmax())
    limit = max(body.speed_limit, *map(abs, body.start_velocity))
    over = float(speeds[worst]) - limit * (1 + SHARE)
    yield Violation("speed", float(moments[worst]), name, over, "m/s", float(speeds[worst]) > FASTEST * limit)
    if name not in scenario.robots:
        return
    robot = scenario.robots[name]
    speeds_after = curve.velocity(times[:-1], "right"), curve.velocity(times[1:], "left")
    force = robot.mass * np.linalg.norm(speeds_after[1] - speeds_after[0], axis=1) / np.diff(times)
    for impact in plan.impacts:
        if impact.robot == name:
            force[(times[:-1] < impact.time + 1e-9) & (times[1:] > impact.time - 1e-9)] = 0.0
    worst = int(force.argmax())
    over = float(force[worst]) - robot.force_limit * (1 + SHARE)
    refused = float(force[worst]) > STRONGEST * robot.force_limit
    yield Violation("force", float(times[worst]), name, over, "N", refused)


def _list_places(
    scenario: FreeFlyerScenario, plan: Plan, times: np.ndarray, places: dict[str, np.ndarray]
) -> Iterator[Violation]:
    lower, upper = np.array(scenario.world.lower), np.array(scenario.world.upper)
    for name, points in places.items():
        radius = scenario.body(name).radius
        yield _find_deepest(
            "world", name, times, np.minimum(points - lower, upper - points).min(axis=1) - radius, radius
        )
        for area, obstacle in scenario.obstacles.items():
            if obstacle.solid:
                H, b = obstacle.halfspaces()
                gap = (points @ H.T - b).max(axis=1) - radius
                yield _find_deepest("obstacle", f"{name} and {area}", times, gap, radius)
    hits: dict[tuple[str, str], list[float]] = {}
    for impact in plan.impacts:
        hits.setdefault((impact.robot, impact.object), []).append(impact.time)
    for first, second in itertools.combinations(places, 2):
        radii = scenario.body(first).radius, scenario.body(second).radius
        gap = np.linalg.norm(places[first] - places[second], axis=1) - sum(radii)
        moments = hits.get((first, second), [])
        for moment in moments:
            gap[_find_meeting(times, gap, moment)] = np.inf
        # The closed loop keeps a robot off an object that it is planned to pass.
        deepest = np.inf if moments else min(radii)
        yield _find_deepest("overlap", f"{first} and {second}", times, gap, deepest)


def _find_meeting(times: np.ndarray, gap: np.ndarray, moment: float) -> slice:
    """Return the samples round an impact at which two bodies overlap, as those do that are planned as points."""
    start = end = int(np.abs(times - moment).argmin())
    while start > 0 and gap[start - 1] < 0.0:
        start -= 1
    while end + 1 < len(gap) and gap[end + 1] < 0.0:
        end += 1
    return slice(start, end + 1)


def _find_deepest(kind: str, body: str, times: np.ndarray, gap: np.ndarray, deepest: float) -> Violation:
    worst = int(gap.argmin())
    return Violation(kind, float(times[worst]), body, -float(gap[worst]), "m", -float(gap[worst]) > deepest)


def _velocity(curve: Curve, time: float, side: int) -> np.ndarray:
    return curve.velocity(time, "right" if side > 0 else "left")

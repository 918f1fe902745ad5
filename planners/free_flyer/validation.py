"""An independent simulation of a plan: robots follow their curves, objects move by the impact law alone.

It uses nothing of the planner: velocities are finite differences of positions, impacts follow from where the bodies
are, the formula is evaluated on samples.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np

from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.stl import Trace, robustness
from planners.bezier import Curve
from planners.errors import SolverFailed
from planners.plan import Plan, PlannedImpact

ASTRAY = 0.01  # share of a tolerance, from which an error is not carried on
SUBSTEPS = 5  # samples per control period: 20 ms at 10 Hz
DIFFERENCE = 1e-4  # step of one-sided velocity differences [s]


@dataclass(frozen=True)
class Tolerances:
    """Hold by how much a simulated plan may miss its promises.

    Args:
        position: of objects and contacts [m].
        velocity: after impacts, and at the ends [m/s].
        clearance: overlap of bodies [m].
        robustness: of the sampled formula [m].
        share: relative excess of speed and force limits.
    """

    position: float = 1e-4
    velocity: float = 1e-5
    clearance: float = 1e-6
    robustness: float = 1e-2
    share: float = 1e-6

    def scaled(self, length: float) -> Tolerances:
        """Return the tolerances for bodies so many times as large."""
        scale = ("position", "velocity", "clearance", "robustness")
        return replace(self, **{name: getattr(self, name) * length for name in scale})


def validate_plan(scenario: FreeFlyerScenario, plan: Plan, tolerances: Tolerances = Tolerances()) -> float:
    """Simulate a plan and raise unless it keeps what it promises.

    Args:
        scenario: believed physics, limits and formula.
        plan: any plan for its robots and objects.
        tolerances: by how much it may miss its promises.

    Returns:
        Robustness of the formula over the simulated centres of all bodies, at the control steps, as the environment
        samples it [m].

    Raises:
        SolverFailed: a promise is broken; the status says which one.

    Source: Verhagen & Tumova, Eqs. (2), (6), (9).
    """
    if (plan.robots.keys(), plan.objects.keys()) != (scenario.robots.keys(), scenario.objects.keys()):
        _reject(f"it is for {', '.join((*plan.robots, *plan.objects))}, not for {', '.join(scenario.bodies)}")
    count = round(scenario.horizon / scenario.control_period) * SUBSTEPS
    times = np.linspace(0.0, scenario.horizon, count + 1)
    robots = {name: plan.robots[name].position(times) for name in scenario.robots}
    objects = {name: _simulate_object(scenario, plan, name, times, tolerances) for name in scenario.objects}
    _check_ends(scenario, plan, objects, tolerances)
    _check_motion(scenario, plan, times, robots, tolerances)
    _check_distances(scenario, times, robots | objects, tolerances)
    steps = {name: points[::SUBSTEPS] for name, points in (robots | objects).items()}
    rho = compute_robustness(scenario, times[::SUBSTEPS], steps)
    if rho < plan.robustness - tolerances.robustness:
        _reject(f"robustness is {rho:.6g} m, promised {plan.robustness:.6g} m")
    return rho


def compute_robustness(scenario: FreeFlyerScenario, times: np.ndarray, positions: dict[str, np.ndarray]) -> float:
    """Return the robustness of the scenario's formula over sampled centres.

    Args:
        scenario: formula and areas.
        times: samples, uniformly spaced, shape (n,) [s].
        positions: of every body, each shape (n, 2) [m].

    Returns:
        Robustness [m].
    """
    step = times[1] - times[0]
    signals: dict[str, np.ndarray] = {}
    for name, points in positions.items():
        velocity = np.gradient(points, step, axis=0)
        columns = {"x": points[:, 0], "y": points[:, 1], "vx": velocity[:, 0], "vy": velocity[:, 1]}
        # Robots hold their heading, and impacts without friction leave the spin of discs alone.
        body = scenario.body(name)
        columns |= {"heading": body.heading + body.start_rate * times, "omega": np.full(len(times), body.start_rate)}
        signals |= {f"{name}.{signal}": values for signal, values in columns.items()}
    trace = Trace(signals, step, scenario.areas, scenario.bodies)
    return float(robustness(scenario.specification, trace))


def _simulate_object(
    scenario: FreeFlyerScenario, plan: Plan, name: str, times: np.ndarray, tolerances: Tolerances
) -> np.ndarray:
    """Fly the object from its start through the impacts; returns its positions, shape (n, 2).

    Bodies that hit each other are chaotic: rounding grows tenfold with every impact. Where it has become a part of what
    is tolerated, the flight goes on from where the plan says the object is, which was shown to be right.
    """
    body = scenario.objects[name]
    position, velocity, now = np.array(body.start), np.array(body.start_velocity), 0.0
    found = np.empty((len(times), 2))
    for impact in [*(impact for impact in plan.impacts if impact.object == name), None]:
        until = plan.horizon if impact is None else impact.time
        here = (times >= now) & (times <= until)
        found[here] = position + velocity * (times[here, None] - now)
        position, now = position + velocity * (until - now), until
        if impact is not None:
            velocity = _hit(scenario, plan, impact, position, velocity, tolerances)
            astray = np.abs(position - impact.position).max() > ASTRAY * tolerances.position
            if astray or np.abs(velocity - impact.object_plus).max() > ASTRAY * tolerances.velocity:
                position, velocity = impact.position, impact.object_plus
    off = float(np.abs(found - plan.objects[name].position(times)).max())
    if off > tolerances.position:
        _reject(f"{name} leaves its curve by {off:.3g} m")
    hit = any(impact.object == name for impact in plan.impacts)
    slowest = tolerances.velocity if hit else max(body.final_speed, tolerances.velocity)
    if body.rest and np.abs(velocity).max() > slowest:
        _reject(f"{name} still moves at the end")
    return found


def _hit(
    scenario: FreeFlyerScenario,
    plan: Plan,
    impact: PlannedImpact,
    position: np.ndarray,
    velocity: np.ndarray,
    tolerances: Tolerances,
) -> np.ndarray:
    """Return the object's velocity after an impact of discs without friction; checks the robot's curve too."""
    robot, body = scenario.robots[impact.robot], scenario.objects[impact.object]
    curve, who = plan.robots[impact.robot], f"impact of {impact.robot} at {impact.time:g} s"
    offset = position - curve.position(impact.time)
    distance = float(np.linalg.norm(offset))
    # NaN, too, is not in contact; centres on one point have no normal.
    if not (abs(distance - robot.radius - body.radius) <= tolerances.position and distance > 0.0):
        _reject(f"{who}: centres are {distance:.6g} m apart, bodies in contact {robot.radius + body.radius:.6g} m")
    normal = offset / distance
    before, after = _difference(curve, impact.time, -1), _difference(curve, impact.time, 1)
    approach = float((before - velocity) @ normal)
    if approach <= 0.0:
        _reject(f"{who}: bodies do not approach")
    reduced = robot.mass * body.mass / (robot.mass + body.mass)
    impulse = (1.0 + scenario.believed.restitution) * reduced * approach * normal
    robot_off = float(np.abs(before - impulse / robot.mass - after).max())
    plus = velocity + impulse / body.mass
    stated = [(impact.robot_minus, before), (impact.robot_plus, after)]
    stated += [(impact.object_minus, velocity), (impact.object_plus, plus)]
    stated_off = max(float(np.abs(told - real).max()) for told, real in stated)
    places = [
        (impact.position, position),
        (impact.contact, curve.position(impact.time)),
        (impact.normal, normal),
    ]
    place_off = max(float(np.abs(told - real).max()) for told, real in places)
    if robot_off > tolerances.velocity:
        _reject(f"{who}: the robot's velocity after it is off by {robot_off:.3g} m/s")
    if stated_off > tolerances.velocity or place_off > tolerances.position:
        _reject(f"{who}: its table is off by {stated_off:.3g} m/s and {place_off:.3g} m")
    return plus


def _difference(curve: Curve, time: float, side: int) -> np.ndarray:
    """Return the one-sided velocity at a time by a three-point difference of second order."""
    h = side * DIFFERENCE
    here, near, far = (curve.position(time + k * h, side="left" if side < 0 else "right") for k in range(3))
    return (4.0 * near - 3.0 * here - far) / (2.0 * h)


def _check_ends(
    scenario: FreeFlyerScenario, plan: Plan, objects: dict[str, np.ndarray], tolerances: Tolerances
) -> None:
    if plan.horizon != scenario.horizon:
        _reject(f"it spans {plan.horizon:g} s, the scenario {scenario.horizon:g} s")
    for name, robot in scenario.robots.items():
        curve = plan.robots[name]
        ends = (0.0, robot.start, robot.start_velocity, 1), (plan.horizon, robot.goal, (0.0, 0.0), -1)
        for time, place, velocity, side in ends:
            speed = float(np.abs(_difference(curve, time, side) - velocity).max())
            off = 0.0 if place is None else float(np.abs(curve.position(time) - place).max())
            if off > tolerances.position or speed > tolerances.velocity:
                _reject(f"{name} at {time:g} s is off by {off:.3g} m and {speed:.3g} m/s")


def _check_motion(
    scenario: FreeFlyerScenario,
    plan: Plan,
    times: np.ndarray,
    robots: dict[str, np.ndarray],
    tolerances: Tolerances,
) -> None:
    """Check speed and thrust by differences of samples; velocities may jump at own impacts only."""
    step = times[1] - times[0]
    for name, points in robots.items():
        robot = scenario.robots[name]
        velocity = np.diff(points, axis=0) / step
        fastest = float(np.abs(velocity).max())
        if fastest > robot.speed_limit * (1 + tolerances.share):
            _reject(f"{name} reaches {fastest:.3g} m/s, its limit is {robot.speed_limit:g} m/s")
        force = robot.mass * np.linalg.norm(np.diff(velocity, axis=0) / step, axis=1)
        own = [impact.time for impact in plan.impacts if impact.robot == name]
        free = np.all([np.abs(times[1:-1] - time) > 1.5 * step for time in own], axis=0)
        strongest = float(force[free].max() if own else force.max())
        if strongest > robot.force_limit * (1 + tolerances.share):
            _reject(f"{name} needs {strongest:.3g} N, its limit is {robot.force_limit:g} N")
    for name, body in scenario.objects.items():
        fastest = float(np.abs(np.diff(plan.objects[name].position(times), axis=0)).max() / step)
        # A plan cannot change the speed with which the object starts.
        limit = max(body.speed_limit, *map(abs, body.start_velocity))
        if fastest > limit * (1 + tolerances.share):
            _reject(f"{name} reaches {fastest:.3g} m/s, its limit is {limit:g} m/s")


def _check_distances(
    scenario: FreeFlyerScenario, times: np.ndarray, positions: dict[str, np.ndarray], tolerances: Tolerances
) -> None:
    lower, upper = np.array(scenario.world.lower), np.array(scenario.world.upper)
    for name, points in positions.items():
        radius = scenario.body(name).radius
        inside = np.minimum(points - lower, upper - points).min(axis=1) - radius
        _check_gap(f"{name} and the world's edge", times, inside, tolerances)
        for area, obstacle in scenario.obstacles.items():
            if obstacle.solid:
                H, b = obstacle.halfspaces()
                _check_gap(f"{name} and {area}", times, (points @ H.T - b).max(axis=1) - radius, tolerances)
    for first, second in itertools.combinations(positions, 2):
        touching = scenario.body(first).radius + scenario.body(second).radius
        apart = np.linalg.norm(positions[first] - positions[second], axis=1) - touching
        _check_gap(f"{first} and {second}", times, apart, tolerances)


def _check_gap(who: str, times: np.ndarray, gap: np.ndarray, tolerances: Tolerances) -> None:
    worst = int(gap.argmin())
    if gap[worst] < -tolerances.clearance:
        _reject(f"{who} overlap by {-gap[worst]:.3g} m at {times[worst]:g} s")


def _reject(reason: str) -> None:
    raise SolverFailed("plan check", reason, "change the reserves or the number of impacts")

"""Closed-loop check of a robust plan: random deviations at every impact, robots that respond to the object's place.

The object moves by the impact law alone: by where the robot is and how fast, not by what was wanted.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from math import comb

import numpy as np

from planners.errors import SolverFailed
from planners.free_flyer.robust.response import Responses, follow_responses
from planners.free_flyer.validation import compute_robustness
from planners.quintic_spline import DEGREE

POSITION = 1e-6  # tolerance of boxes, contacts and distances [m]
VELOCITY = 1e-6  # tolerance of the impact law [m/s]


@dataclass(frozen=True)
class Runs:
    """Hold what happened in n simulated runs.

    Args:
        positions: of the object at impacts and at the horizon, shape (n, K+1, 2) [m].
        velocities: of the object after every impact, shape (n, K, 2) [m/s].
        robots: robot to its control points, shape (n, S, 6, 2) [m].
        law: greatest difference of robots' velocities after impacts from momentum and deviation [m/s].
        contact: greatest distance by which bodies miss each other at impacts [m].
    """

    positions: np.ndarray
    velocities: np.ndarray
    robots: dict[str, np.ndarray]
    law: float
    contact: float


def draw_deviations(delta: float, shape: tuple[int, ...], rng: np.random.Generator) -> np.ndarray:
    """Return deviations within delta per axis, in half of the runs at the vertices.

    Args:
        delta: greatest deviation [m/s].
        shape: (n, ...) with n runs.
        rng: source of randomness.
    """
    deviations = rng.uniform(-delta, delta, shape)
    half = shape[0] // 2
    deviations[:half] = delta * rng.choice([-1.0, 1.0], (half, *shape[1:]))
    return deviations


def simulate_runs(responses: Responses, starts: np.ndarray, deviations: np.ndarray) -> Runs:
    """Fly the object from its start at rest through all impacts of robots that follow their responses.

    v_O^+ = v_O^- + j n / m_O + d, v_R^+ = v_R^- - j n / m_R - m_O / m_R d with
    j = (1 + e) m_R m_O / (m_R + m_O) (v_R^- - v_O^-) n, where n is along the line of centres; for points it is
    Eq. (5), and d acts on the object alone.

    Args:
        responses: of all robots.
        starts: of the object, shape (n, 2) [m].
        deviations: d at every impact, shape (n, K, 2) [m/s].

    Returns:
        What happened.

    Source: Verhagen & Tumova, Eqs. (5), (6), (16), (17).
    """
    sequence, count = responses.sequence, len(responses.sequence.hitters)
    positions = np.repeat(starts[:, None], count + 1, axis=1)
    velocities, velocity = np.empty_like(deviations), np.zeros_like(starts)
    worst = np.zeros(2)
    for k, duration in enumerate(np.diff(sequence.times)[1:], start=1):
        push, off = _hit(responses, k, positions[:, :count], velocity, deviations)
        velocity = velocity + push + deviations[:, k - 1]
        velocities[:, k - 1] = velocity
        positions[:, k:] = (positions[:, k - 1] + velocity * duration)[:, None]
        worst = np.maximum(worst, off)
    robots = {}
    for name in responses.scenario.robots:
        recoils = -deviations * _recoil_share(responses, name)
        robots[name] = follow_responses(responses, name, positions[:, :count], recoils)
    return Runs(positions, velocities, robots, float(worst[0]), float(worst[1]))


def _hit(
    responses: Responses, k: int, positions: np.ndarray, velocity: np.ndarray, deviations: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return how impact k changes the object's velocity, shape (n, 2), and the errors of the robot, see `Runs`."""
    scenario, sequence, name = responses.scenario, responses.sequence, responses.sequence.hitters[k - 1]
    robot, body, e = scenario.robots[name], scenario.objects[sequence.object], scenario.believed.restitution
    recoils = -deviations * _recoil_share(responses, name)
    points = follow_responses(responses, name, positions, recoils)
    event = next(one.event for one in responses.intervals[name] if one.impact == k)
    steps = np.diff(responses.times)[event - 1 : event + 1]
    place = points[:, event - 1, -1]
    before = DEGREE * (place - points[:, event - 1, -2]) / steps[0]
    after = DEGREE * (points[:, event, 1] - points[:, event, 0]) / steps[1]
    offset, relative = positions[:, k - 1] - place, before - velocity
    apart, reach = np.linalg.norm(offset, axis=1, keepdims=True), 0.0
    if not sequence.points:
        reach, normal = robot.radius + body.radius, offset / apart
        relative = np.sum(relative * normal, axis=1, keepdims=True) * normal
    impulse = (1.0 + e) * robot.mass * body.mass / (robot.mass + body.mass) * relative
    law = np.abs(before - impulse / robot.mass + recoils[:, k - 1] - after).max()
    return impulse / body.mass, np.array([law, np.abs(apart - reach).max()])


def _recoil_share(responses: Responses, robot: str) -> float:
    """Return m_O / m_R, the share by which a robot's velocity deviates opposite to the object's; zero for points."""
    scenario, sequence = responses.scenario, responses.sequence
    return 0.0 if sequence.points else scenario.objects[sequence.object].mass / scenario.robots[robot].mass


def check_responses(responses: Responses, margin: float, runs: int, seed: int, samples: int) -> float:
    """Simulate the closed loop and raise unless every run keeps every promise.

    Promised are: the object is in its boxes at impacts and at the horizon and keeps its speed limit; robots keep
    their limits of speed and force at all times and meet the object as the impact law demands; bodies do not
    overlap, and the formula holds.

    Args:
        responses: of all robots.
        margin: robustness promised in every run [m].
        runs: number of runs; the deviations of half of them are at the vertices.
        seed: of the randomness.
        samples: number of equal steps to the horizon, at which distances and the formula are checked.

    Returns:
        The least robustness of all runs [m].

    Raises:
        SolverFailed: a promise is broken; the status says which one.
    """
    rng, scenario, sequence = np.random.default_rng(seed), responses.scenario, responses.sequence
    starts = sequence.centers[0] + draw_deviations(1.0, (runs, 2), rng) * sequence.halves[0]
    deviations = draw_deviations(sequence.delta, (runs, len(sequence.hitters), 2), rng)
    found = simulate_runs(responses, starts, deviations)
    _check_object(responses, found)
    _check_robots(responses, found)
    times = np.linspace(0.0, scenario.horizon, samples + 1)
    bodies = {name: _sample(responses.times, points, times) for name, points in found.robots.items()}
    bodies[sequence.object] = _fly(sequence.times, found.positions, times)
    _check_distances(responses, bodies)
    each = [{name: points[i] for name, points in bodies.items()} for i in range(runs)]
    worst = min(compute_robustness(scenario, times, positions) for positions in each)
    _check("the formula", margin - worst, POSITION)
    return worst


def _check_object(responses: Responses, found: Runs) -> None:
    sequence, body = responses.sequence, responses.scenario.objects[responses.sequence.object]
    lower, upper = sequence.boxes[1:, 0], sequence.boxes[1:, 1]
    _check("the object's box", float(np.maximum(lower - found.positions, found.positions - upper).max()), POSITION)
    _check("the object's speed limit", float(np.abs(found.velocities).max()) - body.speed_limit, VELOCITY)
    _check("contact", found.contact, POSITION)
    _check("the impact law", found.law, VELOCITY)


def _check_robots(responses: Responses, found: Runs) -> None:
    """Check limits on control points, which bound the curves at all times."""
    steps = np.diff(responses.times)[:, None, None]
    for name, points in found.robots.items():
        robot = responses.scenario.robots[name]
        velocity = DEGREE * np.diff(points, axis=2) / steps
        force = robot.mass * np.linalg.norm((DEGREE - 1) * np.diff(velocity, axis=2) / steps, axis=-1)
        _check(f"the speed limit of {name}", float(np.abs(velocity).max()) - robot.speed_limit, VELOCITY)
        _check(f"the force limit of {name}", float(force.max()) / robot.force_limit - 1.0, VELOCITY)


def _check_distances(responses: Responses, bodies: dict[str, np.ndarray]) -> None:
    scenario = responses.scenario
    lower, upper = np.array(scenario.world.lower), np.array(scenario.world.upper)
    for name, points in bodies.items():
        radius = scenario.body(name).radius
        out = float(np.maximum(lower - points, points - upper).max())
        _check(f"the distance of {name} from the world's edge", out + radius, POSITION)
        for area, obstacle in scenario.obstacles.items():
            H, b = obstacle.halfspaces()
            if obstacle.solid:
                beyond = float((points @ H.T - b).max(axis=-1).min())
                _check(f"the distance of {name} from {area}", radius - beyond, POSITION)
    for first, second in itertools.combinations(bodies, 2) if not responses.sequence.points else ():
        touching = scenario.body(first).radius + scenario.body(second).radius
        apart = float(np.linalg.norm(bodies[first] - bodies[second], axis=-1).min())
        _check(f"the distance of {first} and {second}", touching - apart, POSITION)


def _sample(times: np.ndarray, points: np.ndarray, moments: np.ndarray) -> np.ndarray:
    """Return positions on curves with common breakpoints, shape (n, len(moments), 2) [m]."""
    segment = np.clip(np.searchsorted(times, moments, side="right") - 1, 0, len(times) - 2)
    s = (moments - times[segment]) / np.diff(times)[segment]
    basis = np.stack([comb(DEGREE, b) * s**b * (1.0 - s) ** (DEGREE - b) for b in range(DEGREE + 1)], axis=1)
    return np.einsum("tb,ntbd->ntd", basis, points[:, segment])


def _fly(times: np.ndarray, positions: np.ndarray, moments: np.ndarray) -> np.ndarray:
    """Return positions of the object, straight between impacts, shape (n, len(moments), 2) [m]."""
    places = np.concatenate([positions[:, :1], positions], axis=1)
    leg = np.clip(np.searchsorted(times, moments, side="right") - 1, 0, len(times) - 2)
    share = ((moments - times[leg]) / np.diff(times)[leg])[:, None]
    return places[:, leg] + share * (places[:, leg + 1] - places[:, leg])


def _check(what: str, excess: float, tolerance: float) -> None:
    if excess > tolerance:
        status = f"{what} is violated by {excess:.3g} in a simulated run"
        raise SolverFailed("closed-loop check", status, "allow a longer gap, or a smaller share of the deviation")

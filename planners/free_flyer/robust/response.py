"""How robots respond to the place of the object: curves for the vertices of its boxes, and their interpolation.

For its next impact every robot has four curves, one per vertex of the box in which the object will be. The curves are
the same until the object's previous impact has shown where it will be, and they meet again before the box of the
robot's next impact becomes known. The robot follows their interpolation at the position of the object.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from impact_envs.free_flyer.schema import FreeFlyerScenario
from planners.bezier import Curve
from planners.free_flyer.robust.box_sequence import (
    VERTICES,
    BoxSequence,
    compute_arrival,
    compute_contacts,
    compute_vertices,
)

SAME_TIME = 1e-6  # differences of times that count as none [s]


@dataclass(frozen=True)
class ResponseInterval:
    """Hold when a robot responds to an impact of its own.

    Args:
        impact: its number k, from 1.
        start: from then on the place in the box of this impact decides what the robot does [s].
        end: until then [s].
        before: breakpoint at which the robot leaves its responses to meet the object exactly.
        event: breakpoint of the impact.
        after: breakpoint at which it is back on them.
    """

    impact: int
    start: float
    end: float
    before: int
    event: int
    after: int


@dataclass(frozen=True)
class Responses:
    """Hold the four curves of every robot, and what is needed to interpolate them.

    Args:
        scenario: what was planned.
        sequence: the impacts.
        times: breakpoints of all curves, shape (S+1,) [s].
        intervals: robot to those of its own impacts.
        points: robot to the control points for the vertices, shape (4, S, 6, 2) [m].
    """

    scenario: FreeFlyerScenario
    sequence: BoxSequence
    times: np.ndarray
    intervals: dict[str, tuple[ResponseInterval, ...]]
    points: dict[str, np.ndarray]

    def curves(self, robot: str) -> tuple[Curve, ...]:
        """Return the robot's curves for the vertices (x-, y-), (x-, y+), (x+, y-), (x+, y+)."""
        return tuple(Curve(self.times, points) for points in self.points[robot])


def make_breakpoints(events: np.ndarray) -> np.ndarray:
    """Return breakpoints, dense near events, the middle of every leg among them."""
    times = [0.0]
    for start, end in itertools.pairwise(events):
        count = 2 * int(np.clip(np.ceil((end - start) / 4.0), 3, 6))
        times += [*(start + (end - start) * (1 - np.cos(np.pi * np.arange(1, count) / count)) / 2), end]
    return np.array(times)


def make_intervals(sequence: BoxSequence, times: np.ndarray, robot: str, settle: float) -> tuple[ResponseInterval, ...]:
    """Return when a robot responds to its impacts.

    The box of an impact decides from the object's previous impact on; if that is the robot's own, the four curves first
    meet halfway. The robot prepares for exact contact as soon as its place is known.

    Args:
        sequence: the impacts.
        times: breakpoints of the curves, shape (S+1,) [s].
        robot: its name.
        settle: longest time it takes to leave its responses, or to return to them [s].
    """
    own = [k for k, name in enumerate(sequence.hitters, start=1) if name == robot]
    starts = [float(np.mean(sequence.times[k - 1 : k + 1]) if k - 1 in own else sequence.times[k - 1]) for k in own]
    ends = [*starts, float(sequence.times[-1])][1:]
    back = [*(sequence.times[k] for k in own), float(sequence.times[-1])][1:]
    intervals = []
    for k, start, end, latest in zip(own, starts, ends, back, strict=True):
        event = int(np.abs(times - sequence.times[k]).argmin())
        free = (times > sequence.times[k - 1] - SAME_TIME) & (times < latest + SAME_TIME)
        near = np.flatnonzero(free & (np.abs(times - times[event]) <= settle))
        intervals.append(
            ResponseInterval(k, start, end, int(min(near[0], event - 1)), event, int(max(near[-1], event + 1)))
        )
    return tuple(intervals)


def compute_amplitudes(
    scenario: FreeFlyerScenario, sequence: BoxSequence, k: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return how far a robot leaves the interpolation of its responses to meet the object exactly.

    The greatest values over ends and middles of the previous box, and of the deviation since then. After the impact the
    robot's own deviation is added: m_O / m_R delta, by momentum.

    Args:
        scenario: masses and radii.
        sequence: tight impacts.
        k: impact, from 1.

    Returns:
        Greatest differences of position [m], and of velocity before and after [m/s], each shape (2,).
    """
    thirds = np.stack(np.meshgrid(*[np.linspace(0, 1, 3)] * 4, indexing="ij"), axis=-1).reshape(-1, 2, 2)
    lower, upper = sequence.boxes[max(k - 1, 1)]
    previous = lower + thirds[:, 0] * (upper - lower)
    position = previous
    if k > 1:
        deviation = sequence.delta * (2.0 * thirds[:, 1] - 1.0)
        duration = sequence.times[k] - sequence.times[k - 1]
        position = previous + (sequence.command(k - 1, previous) + deviation) * duration
    off = compute_mismatch(scenario, sequence, k, position, previous)
    robot, body = scenario.robots[sequence.hitters[k - 1]], scenario.objects[sequence.object]
    recoil = 0.0 if sequence.points else sequence.delta * body.mass / robot.mass
    greatest = [np.abs(part).max(axis=0) for part in off]
    return greatest[0], greatest[1], greatest[2] + recoil


def compute_mismatch(
    scenario: FreeFlyerScenario, sequence: BoxSequence, k: int, position: np.ndarray, previous: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return exact contact minus the interpolated vertices: position, velocity before and after, each shape (n, 2).

    Args:
        scenario: masses and radii.
        sequence: tight impacts.
        k: impact, from 1.
        position: of the object at impact k, shape (n, 2) [m].
        previous: of the object at impact k - 1, shape (n, 2) [m].
    """
    before = compute_arrival(sequence, k, position, previous)
    exact = compute_contacts(scenario, sequence, k, position, before, sequence.command(k, position))
    _, _, vertices = compute_vertices(scenario, sequence, k)
    weights = compute_weights(sequence, k, position)
    pairs = ((exact.robot, vertices.robot), (exact.minus, vertices.minus), (exact.plus, vertices.plus))
    first, second, third = (real - weights @ known for real, known in pairs)
    return first, second, third


def compute_weights(sequence: BoxSequence, k: int, position: np.ndarray) -> np.ndarray:
    """Return the weights of the four vertices in positions of the object at impact k, shape (n, 4).

    Args:
        sequence: tight impacts.
        k: impact, from 1.
        position: shape (n, 2) [m].
    """
    share = sequence.share(k, position)
    ends = np.stack([1.0 - share, share], axis=1)  # (n, end, axis)
    return np.prod(ends[:, VERTICES, np.arange(2)], axis=2)


def compute_returns(times: np.ndarray, rest: int, event: int) -> np.ndarray:
    """Return two quintic basis functions, zero to second order at `rest`; at `event` one is 1, the other has slope 1.

    Args:
        times: breakpoints, shape (S+1,) [s].
        rest: breakpoint where value, slope and curvature of both are zero.
        event: breakpoint before or after it.

    Returns:
        Control points on the segments between, in the order of time, shape (2, n, 6) [1, s].
    """
    first, last = sorted((rest, event))
    span = times[event] - times[rest]
    s = (times[first : last + 1] - times[rest]) / span
    powers = s[:, None] ** np.arange(6)
    # Value, first and second derivative of 10 s^3 - 15 s^4 + 6 s^5 and of -4 s^3 + 7 s^4 - 3 s^5.
    states = np.empty((2, 3, len(s)))
    for i, coefficients in enumerate(([0, 0, 0, 10, -15, 6], [0, 0, 0, -4, 7, -3])):
        polynomial = np.array(coefficients, dtype=float)
        for order in range(3):
            states[i, order] = powers[:, : len(polynomial)] @ polynomial * span ** (i - order)
            polynomial = polynomial[1:] * np.arange(1, len(polynomial))
    p, v, a = states.transpose(1, 0, 2)
    h = np.diff(times[first : last + 1])
    ends = [p[:, :-1], p[:, :-1] + v[:, :-1] * h / 5, p[:, :-1] + v[:, :-1] * h * 2 / 5 + a[:, :-1] * h**2 / 20]
    ends += [p[:, 1:] - v[:, 1:] * h * 2 / 5 + a[:, 1:] * h**2 / 20, p[:, 1:] - v[:, 1:] * h / 5, p[:, 1:]]
    return np.stack(ends, axis=2)


def follow_responses(responses: Responses, robot: str, positions: np.ndarray, recoils: np.ndarray) -> np.ndarray:
    """Return how a robot moves, given where the object is at its impacts.

    During each interval it follows the interpolation of its four curves at the object's position; near the impact it
    leaves it by a quintic to meet the object exactly, and returns by another one, which takes in its own deviation.

    Args:
        responses: of all robots.
        robot: its name.
        positions: of the object at every impact, shape (n, K, 2) [m].
        recoils: deviation of the robot's velocity after every impact, shape (n, K, 2) [m/s].

    Returns:
        Control points, shape (n, S, 6, 2) [m].
    """
    times, vertices, sequence = responses.times, responses.points[robot], responses.sequence
    found = np.repeat(vertices[:1], len(positions), axis=0)
    for interval in responses.intervals[robot]:
        k = interval.impact
        position, previous = positions[:, k - 1], positions[:, max(k - 2, 0)]
        weights = compute_weights(sequence, k, position)
        inside = (times[:-1] > interval.start - SAME_TIME) & (times[1:] < interval.end + SAME_TIME)
        found[:, inside] = np.einsum("nv,vsbd->nsbd", weights, vertices[:, inside])
        off, before, after = compute_mismatch(responses.scenario, sequence, k, position, previous)
        for rest, turn in ((interval.before, before), (interval.after, after + recoils[:, k - 1])):
            step, slope = compute_returns(times, rest, interval.event)[..., None]
            part = slice(*sorted((rest, interval.event)))
            found[:, part] += step * off[:, None, None] + slope * turn[:, None, None]
    return found

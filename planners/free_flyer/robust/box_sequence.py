"""Impacts of a robust plan in numbers: their boxes, and the impact of each robot at every place in them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.physics.impact import compute_mass_fractions
from planners.plan import Tube

NARROW = 1e-9  # a box of this width has no inside [m]
VERTICES = np.array([[0, 0], [0, 1], [1, 0], [1, 1]])  # which end of x and of y: (x-,y-), (x-,y+), (x+,y-), (x+,y+)


@dataclass(frozen=True)
class BoxSequence:
    """Hold numbers for the impacts of a plan that bears deviations.

    Args:
        times: t_0 = 0, impact times, t_{K+1} = T, shape (K+2,) [s].
        object: name of the object.
        hitters: name of the robot of each impact.
        boxes: lower and upper end of the object's box at these times, per axis, shape (K+2, 2, 2) [m].
        commands: velocity wanted after impact k from the lower and from the upper end of its box, per axis,
            shape (K, 2, 2) [m/s].
        knot_times: increasing, shape (n,) [s].
        knots: robot name to its assumed positions at these times, shape (n, 2) [m].
        delta: deviation of the object's velocity after every impact that the plan bears [m/s].
        points: bodies have no extent.
    """

    times: np.ndarray
    object: str
    hitters: tuple[str, ...]
    boxes: np.ndarray
    commands: np.ndarray
    knot_times: np.ndarray
    knots: dict[str, np.ndarray]
    delta: float
    points: bool = False

    @property
    def centers(self) -> np.ndarray:
        """Return the centres of the boxes, shape (K+2, 2) [m]."""
        return self.boxes.mean(axis=1)

    @property
    def halves(self) -> np.ndarray:
        """Return the half widths of the boxes, shape (K+2, 2) [m]."""
        return 0.5 * (self.boxes[:, 1] - self.boxes[:, 0])

    def share(self, k: int, position: np.ndarray) -> np.ndarray:
        """Return the relative position in the box of impact k, per axis: 0 at its lower and 1 at its upper end.

        Args:
            k: impact, from 1.
            position: shape (..., 2) [m].
        """
        lower, upper = self.boxes[k]
        wide = upper - lower > NARROW
        return np.where(wide, (position - lower) / np.where(wide, upper - lower, 1.0), 0.5)

    def command(self, k: int, position: np.ndarray) -> np.ndarray:
        """Return the velocity wanted after impact k, which is affine in the position there, shape (..., 2) [m/s]."""
        first, second = self.commands[k - 1]
        return first + self.share(k, position) * (second - first)


@dataclass(frozen=True)
class Contacts:
    """Hold the robot's side of impacts, each shape (..., 2).

    Args:
        normal: direction of the impulse.
        robot: centre of the robot [m].
        minus: velocity of the robot just before [m/s].
        plus: velocity of the robot just after [m/s].
    """

    normal: np.ndarray
    robot: np.ndarray
    minus: np.ndarray
    plus: np.ndarray


def compute_contacts(
    scenario: FreeFlyerScenario,
    sequence: BoxSequence,
    k: int,
    position: np.ndarray,
    before: np.ndarray,
    after: np.ndarray,
) -> Contacts:
    r"""Return what the robot of impact k must do to change the object's velocity as wanted.

    v_R^- = (v_O^+ - m4 v_O^-) / m3, v_R^+ = m1 v_R^- + m2 v_O^-; discs touch at p - (r_R + r_O) n with
    n along v_O^+ - v_O^-, so that Eq. (6) for discs and Eq. (5) for points agree.

    Args:
        scenario: masses, radii and believed restitution.
        sequence: who hits.
        k: impact, from 1.
        position: of the object, shape (..., 2) [m].
        before: velocity of the object just before, shape (..., 2) [m/s].
        after: velocity wanted just after, shape (..., 2) [m/s].

    Returns:
        The robot's side of the impacts.

    Source: Verhagen & Tumova, Eqs. (5), (6), (16).
    """
    robot, body = scenario.robots[sequence.hitters[k - 1]], scenario.objects[sequence.object]
    m1, m2, m3, m4 = compute_mass_fractions(robot.mass, body.mass, scenario.believed.restitution)
    length = np.linalg.norm(after - before, axis=-1, keepdims=True)
    normal = np.where(length > 1e-9, (after - before) / np.maximum(length, 1e-9), [1.0, 0.0])
    reach = 0.0 if sequence.points else robot.radius + body.radius
    minus = (after - m4 * before) / m3
    return Contacts(normal, position - reach * normal, minus, m1 * minus + m2 * before)


def compute_vertices(
    scenario: FreeFlyerScenario, sequence: BoxSequence, k: int
) -> tuple[np.ndarray, np.ndarray, Contacts]:
    """Return the vertices of the box of impact k and what the robot does there.

    The velocity before the impact is that of a flight from the centre of the previous box, which is affine in the
    position as well.

    Args:
        scenario: masses, radii and believed restitution.
        sequence: the impacts.
        k: impact, from 1.

    Returns:
        Positions of the object, shape (4, 2) [m], its velocities before, shape (4, 2) [m/s], and the robot's
        side of the impacts.
    """
    corners = sequence.boxes[k][VERTICES, np.arange(2)]
    before = compute_arrival(sequence, k, corners, sequence.centers[k - 1])
    return corners, before, compute_contacts(scenario, sequence, k, corners, before, sequence.command(k, corners))


def compute_arrival(sequence: BoxSequence, k: int, position: np.ndarray, previous: np.ndarray) -> np.ndarray:
    """Return the object's velocity just before impact k, on its flight from the previous impact.

    Args:
        sequence: the impacts.
        k: impact, from 1; the object rests before the first.
        position: at impact k, shape (..., 2) [m].
        previous: at impact k - 1, shape (..., 2) [m].
    """
    if k == 1:
        return np.zeros_like(position)
    return (position - previous) / (sequence.times[k] - sequence.times[k - 1])


def tighten(sequence: BoxSequence) -> BoxSequence:
    """Shrink every box to what the same policy reaches from the box before.

    The centre of every box is then where the object is if nothing deviates.

    Args:
        sequence: impacts whose boxes may be too large.

    Returns:
        The same policy on the boxes it needs.
    """
    boxes, commands = sequence.boxes.copy(), sequence.commands.copy()
    boxes[1] = boxes[0]
    for k in range(1, len(boxes) - 1):
        duration = sequence.times[k + 1] - sequence.times[k]
        commands[k - 1] = sequence.command(k, boxes[k])
        reached = boxes[k] + commands[k - 1] * duration
        spread = sequence.delta * duration
        boxes[k + 1] = reached.min(axis=0) - spread, reached.max(axis=0) + spread
    return replace(sequence, boxes=boxes, commands=commands)


def make_tube(sequence: BoxSequence) -> Tube:
    """Return the boxes in state space that the object cannot leave, one segment per leg.

    Args:
        sequence: tight impacts.

    Returns:
        The tube.

    Source: Verhagen & Tumova, Eqs. (18), (19), per axis.
    """
    count = len(sequence.times) - 1
    velocity, spread = np.zeros((count, 2)), np.zeros((count, 2))
    velocity[1:] = sequence.commands.mean(axis=1)
    spread[1:] = 0.5 * np.abs(sequence.commands[:, 1] - sequence.commands[:, 0]) + sequence.delta
    states = [
        np.stack([np.hstack([sequence.centers[part], velocity]), np.hstack([sequence.halves[part], spread])], axis=1)
        for part in (slice(0, count), slice(1, count + 1))
    ]
    return Tube(sequence.times, *states)

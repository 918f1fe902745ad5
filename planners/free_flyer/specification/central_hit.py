"""Hits whose impulse passes through the centre of an object that is no disc: they do not turn it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from impact_envs.free_flyer.schema import FreeFlyerScenario, Object
from planners.plan import PlannedImpact

# By how much a hit misses, as measured in the nominal world: the robot beside the place of contact, which turns the
# normal at a corner, and turns an object that was hit before; and the heading of a side.
MISS, TURN = 2e-3, 1e-3  # [m, rad]


def find_central_impulses(item: Object) -> np.ndarray:
    """Return the directions in which an object at its start heading can be hit through its centre.

    Args:
        item: the object; so hit it keeps this heading.

    Returns:
        Unit vectors in the world frame, shape (d, 2); none of a disc, which takes any.
    """
    if item.vertices is None:
        return np.zeros((0, 2))
    cos, sin = np.cos(item.heading), np.sin(item.heading)
    return -find_central_hits(np.array(item.vertices))[:, :2] @ np.array([[cos, sin], [-sin, cos]])


def compute_shape_error(scenario: FreeFlyerScenario, impacts: Sequence[PlannedImpact], horizon: float) -> float:
    r"""Return how far objects that are no discs may end beside their places.

    sum over impacts of |Delta v| sin(angle) (T - t)

    The angle is from the planned impulse to the nearest one through the centre, which the closed loop gives, and what a
    hit misses it by, also because the object has turned since hits before. Areas are half-planes of unit normals, so
    their robustness is lower by no more. The misses are measured, not proven.

    Args:
        scenario: headings and shapes.
        impacts: of the plan.
        horizon: T [s].

    Returns:
        The distance [m]; 0 if all objects are discs.
    """
    found = 0.0
    turns: dict[str, list[tuple[float, float]]] = {name: [] for name in scenario.objects}  # time, rate [rad/s]
    for impact in impacts:
        item = scenario.objects[impact.object]
        central = find_central_impulses(item)
        if not len(central):
            continue
        nearest = int((central @ impact.normal).argmax())
        angle = float(np.arccos(np.clip(central[nearest] @ impact.normal, -1.0, 1.0)))
        angle += MISS / scenario.robots[impact.robot].radius if is_corner(item, central[nearest]) else TURN
        angle += sum(rate * (impact.time - time) for time, rate in turns[impact.object])
        change = float(np.linalg.norm(impact.object_plus - impact.object_minus))
        # The first hit finds the object where it starts, and hardly turns it.
        first = not any(other.object == impact.object for other in impacts if other.time < impact.time)
        turns[impact.object].append((impact.time, 0.0 if first else MISS * item.mass * change / item.inertia))
        found += change * np.sin(min(angle, np.pi / 2)) * (horizon - impact.time)
    return float(found)


def is_corner(item: Object, impulse: np.ndarray) -> bool:
    """Return whether an impulse through an object's centre, shape (2,), is given at one of its corners."""
    vertices = np.array(item.vertices)
    cos, sin = np.cos(item.heading), np.sin(item.heading)
    corners = vertices @ np.array([[cos, sin], [-sin, cos]])
    return bool((-(corners @ impulse) > (1.0 - 1e-9) * np.hypot(*corners.T)).any())


def find_central_hits(vertices: np.ndarray) -> np.ndarray:
    """Return the contact points where a frictionless disc's push passes through a convex polygon's centre, the origin.

    On an edge it is the foot of the perpendicular from the origin; a corner is one if the line through it lies in the
    cone of the neighbouring edges' normals.

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

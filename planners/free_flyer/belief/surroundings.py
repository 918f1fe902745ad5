"""Walls, solid obstacles and forbidden areas: how far a robot is from where it cannot or may not be; compiled.

Fixed body i is a wall of the world for i < WALLS, then a solid obstacle or an area that the formula tells bodies to
keep out of at all times, a convex polygon.
"""

from __future__ import annotations

import math

import numpy as np

from impact_envs.compiled import compiled, inlined
from planners.free_flyer.belief.plan_table import PlanTable

WALLS = 4  # sides of the world
STEPS = 8  # of a straight way that are looked at


@inlined
def measure_distance(plan: PlanTable, i: int, x: float, y: float) -> tuple[float, float, float]:
    """Return the distance from a point to a fixed body, negative inside [m], and the unit vector to it.

    Args:
        i: wall or solid obstacle.
        x, y: [m].
    """
    if i < WALLS:
        if i == 0:
            return x - plan.walls[0], -1.0, 0.0
        if i == 1:
            return y - plan.walls[1], 0.0, -1.0
        if i == 2:
            return plan.walls[2] - x, 1.0, 0.0
        return plan.walls[3] - y, 0.0, 1.0
    return measure_polygon(plan.solid, i - WALLS, x, y)


@compiled
def measure_polygon(solid: np.ndarray, i: int, x: float, y: float) -> tuple[float, float, float]:
    """Return the distance from a point to a convex polygon, negative inside [m], and the unit vector to it.

    Args:
        solid: corners of all polygons, shape (S, C, 2) [m].
        i: polygon.
        x, y: [m].
    """
    count = solid.shape[1]
    inside, in_x, in_y = -math.inf, 0.0, 0.0  # by the nearest face, where the point is behind all of them
    nearest, px, py = math.inf, 0.0, 0.0
    for a in range(count):
        b = a + 1 if a + 1 < count else 0
        ax, ay = solid[i, a, 0], solid[i, a, 1]
        ex, ey = solid[i, b, 0] - ax, solid[i, b, 1] - ay
        square = ex * ex + ey * ey
        if square == 0.0:  # filled up
            continue
        length = math.sqrt(square)
        beyond = (ey * (x - ax) - ex * (y - ay)) / length
        if beyond > inside:
            inside, in_x, in_y = beyond, -ey / length, ex / length
        share = min(max((ex * (x - ax) + ey * (y - ay)) / square, 0.0), 1.0)
        dx, dy = ax + share * ex - x, ay + share * ey - y
        if dx * dx + dy * dy < nearest:
            nearest, px, py = dx * dx + dy * dy, dx, dy
    if inside <= 0.0 or nearest == 0.0:
        return inside, in_x, in_y
    nearest = math.sqrt(nearest)
    return nearest, px / nearest, py / nearest


@inlined
def get_inset(plan: PlanTable, i: int, body: int) -> float:
    """Return how far a body's centre has to stay off fixed body i; -inf if it may be inside [m]."""
    return plan.body[body].radius if i < WALLS else plan.inset[i - WALLS, body]


@inlined
def measure_gap(plan: PlanTable, body: int, x: float, y: float) -> float:
    """Return the gap between a body's disc at a point and the nearest fixed body, negative where they overlap [m]."""
    walls, radius = plan.walls, plan.body[body].radius
    gap = min(x - walls[0], y - walls[1], walls[2] - x, walls[3] - y) - radius
    for i in range(len(plan.solid)):
        inset = plan.inset[i, body]
        if inset > -math.inf:
            gap = min(gap, measure_polygon(plan.solid, i, x, y)[0] - inset)
    return gap


@compiled
def is_way_clear(plan: PlanTable, body: int, x0: float, y0: float, x1: float, y1: float) -> bool:
    """Return whether a body's disc comes to no fixed body on a straight way to a point; where it is now counts not."""
    for i in range(1, STEPS + 1):
        share = i / STEPS
        if measure_gap(plan, body, x0 + share * (x1 - x0), y0 + share * (y1 - y0)) < 0.0:
            return False
    return True

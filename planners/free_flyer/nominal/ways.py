"""Shortest ways round obstacles, from a visibility graph: how many straight pieces the legs of robots need."""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Iterable, Sequence

import numpy as np

from impact_envs.free_flyer.schema import FreeFlyerScenario
from planners.free_flyer.specification.requirement import Demands, Requirement

TOUCH = 1e-6  # a way may graze a grown obstacle by so much [m]


def count_pieces(scenario: FreeFlyerScenario, demands: Demands, wall: float) -> int | None:
    """Return how many straight pieces the shortest way has on which some robot first reaches an object.

    For every object the robot counts that needs fewest pieces; of the objects, the one that needs most. A robot may
    come close to an object, so the object itself is no obstacle.

    Args:
        scenario: starts and world.
        demands: which solid obstacles every body keeps away from.
        wall: distance kept from the world's edge beyond touching [m].

    Returns:
        The number; None: no robot has a way to some object.
    """
    most = 1
    for body in scenario.objects.values():
        counts = []
        for name, robot in scenario.robots.items():
            inset = robot.radius + wall
            lower, upper = np.array(scenario.world.lower) + inset, np.array(scenario.world.upper) - inset
            needs = [need for need in list_avoided(demands) if need.body == name]
            way = find_way(np.array(robot.start), np.array(body.start), needs, lower, upper)
            if way is not None:
                counts.append(len(way) - 1)
        if not counts:
            return None
        most = max(most, min(counts))
    return most


def find_way(
    start: np.ndarray, goal: np.ndarray, needs: Sequence[Requirement], lower: np.ndarray, upper: np.ndarray
) -> np.ndarray | None:
    """Return the shortest way round convex areas, by their grown corners.

    Args:
        start: shape (2,) [m].
        goal: shape (2,) [m].
        needs: areas to avoid with their clearances; one that the start or the goal is too close to grows less.
        lower: corner of the box that holds corners of the way, shape (2,) [m].
        upper: opposite corner, shape (2,) [m].

    Returns:
        The way's corners, ends included, shape (n, 2) [m]; None: there is none.
    """
    grown = []
    for need in needs:
        ends = [float((need.faces @ end - need.bounds).max()) for end in (start, goal)]
        grown.append((need.faces, need.bounds + min(need.clearance, *ends)))
    corners = [corner for faces, bounds in grown for corner in _find_corners(faces, bounds)]
    inside = [corner for corner in corners if (corner >= lower - TOUCH).all() and (corner <= upper + TOUCH).all()]
    nodes = np.array([start, goal, *inside])
    best = np.full(len(nodes), np.inf)
    before = np.zeros(len(nodes), dtype=int)
    best[0], heap = 0.0, [(0.0, 0)]
    while heap:
        length, k = heapq.heappop(heap)
        if k == 1:
            chain = [1]
            while chain[-1]:
                chain.append(int(before[chain[-1]]))
            return nodes[chain[::-1]]
        if length > best[k]:
            continue
        for j in range(len(nodes)):
            total = length + float(np.linalg.norm(nodes[j] - nodes[k]))
            if total < best[j] - TOUCH and _is_free(nodes[k], nodes[j], grown):
                best[j], before[j] = total, k
                heapq.heappush(heap, (total, j))
    return None


def list_avoided(demands: Demands) -> Iterable[Requirement]:
    """Yield the solid obstacles, whether the formula names them or not."""
    named = (need for need in demands.predicates.values() if need.kind == "avoid" and need.clearance > 0.0)
    return itertools.chain(demands.solids, named)


def _find_corners(faces: np.ndarray, bounds: np.ndarray) -> list[np.ndarray]:
    """Return where neighbouring faces of a convex area meet; faces are in the order of its corners."""
    pairs = zip(faces, np.roll(faces, -1, axis=0), bounds, np.roll(bounds, -1), strict=True)
    return [np.linalg.solve(np.array([one, other]), np.array([a, b])) for one, other, a, b in pairs]


def _is_free(start: np.ndarray, end: np.ndarray, grown: Iterable[tuple[np.ndarray, np.ndarray]]) -> bool:
    """Return whether a line enters no area: the part of it inside all faces has no length."""
    for faces, bounds in grown:
        here, there = faces @ start - bounds + TOUCH, faces @ end - bounds + TOUCH
        enter, leave = 0.0, 1.0
        for a, b in zip(here, there, strict=True):
            if a > 0.0 and b > 0.0:
                enter, leave = 1.0, 0.0
            elif a > 0.0:
                enter = max(enter, a / (a - b))
            elif b > 0.0:
                leave = min(leave, a / (a - b))
        if enter < leave:
            return False
    return True

"""The least way of a disc's centre among obstacles, in the greatest norm: no motion of any kind is shorter.

Pulling a way taut shortens it in any norm, so some least way turns only at corners of obstacles: a visibility graph.
Obstacles count a little too small, never too large; what is told to be out of reach is.
"""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Sequence
from functools import cached_property

import numpy as np

from planners.free_flyer.impossibility.convex_polygon import clip, find_nearest, list_faces, measure_distance

ROUNDED = 1e-7  # by which obstacles count smaller, of the largest side of the world
MOST_OBSTACLES = 30  # that count: visibility is a matter of seconds for more
GRAZE = 1e-9  # share of a line that may lie in an obstacle


def grow(polygon: np.ndarray, radius: float) -> np.ndarray:
    """Return a polygon inside the places where a disc overlaps a convex polygon: its round corners are cut.

    Args:
        polygon: shape (n, 2) [m].
        radius: of the disc [m].
    """
    faces, _ = list_faces(polygon)
    before = np.roll(faces, 1, axis=0)
    middle = (before + faces) / np.linalg.norm(before + faces, axis=1, keepdims=True)
    return (polygon[:, None] + radius * np.stack([before, middle, faces], axis=1)).reshape(-1, 2)


class FreeSpace:
    """Hold where a body's centre may be, and measure ways from its start.

    Args:
        start: shape (2,) [m].
        box: convex polygon that the centre never leaves, shape (n, 2) [m].
        obstacles: convex polygons whose inside it never enters, by name.
    """

    def __init__(self, start: np.ndarray, box: np.ndarray, obstacles: Sequence[tuple[str, np.ndarray]]) -> None:
        # Ways among some of the obstacles are no longer than among all.
        self.start, self.box, self.obstacles = np.asarray(start, dtype=float), box, tuple(obstacles[:MOST_OBSTACLES])
        self.size = float(np.ptp(box, axis=0).max()) if len(box) else 0.0
        self._slack = ROUNDED * self.size
        self._measured: dict[bytes, float] = {}
        most = max((len(polygon) for _, polygon in self.obstacles), default=0)
        # A face without a direction holds everywhere.
        self._faces, self._bounds = np.zeros((len(self.obstacles), most, 2)), np.ones((len(self.obstacles), most))
        for k, (_, polygon) in enumerate(self.obstacles):
            faces, bounds = list_faces(polygon)
            self._faces[k, : len(bounds)], self._bounds[k, : len(bounds)] = faces, bounds - self._slack

    def without(self, name: str) -> FreeSpace:
        """Return the space without the obstacles of a name."""
        return FreeSpace(self.start, self.box, [one for one in self.obstacles if one[0] != name])

    def measure(self, place: np.ndarray) -> float:
        """Return the length of the least way from the start into a convex polygon [m]; infinite where there is none."""
        if not len(place):
            return np.inf
        key = place.tobytes()
        if key not in self._measured:
            self._measured[key] = self._measure(place)
        return self._measured[key]

    def _measure(self, place: np.ndarray) -> float:
        """Return the same of a place that is not empty: nodes that may be nearest are asked first."""
        order = sorted(
            (length + float(np.abs(find_nearest(node, place) - node).max()), length, k)
            for k, (length, node) in enumerate(zip(self._lengths, self._nodes, strict=True))
            if np.isfinite(length)
        )
        best = np.inf
        for least, length, k in order:
            if least >= best:
                break
            best = min(best, length + self._measure_seen(self._nodes[k], place))
        return best

    @cached_property
    def _nodes(self) -> np.ndarray:
        """Return the start and the corners at which ways may turn, shape (n, 2)."""
        faces, bounds = list_faces(self.box)
        corners = [point for _, polygon in self.obstacles for point in polygon]
        inside = [point for point in corners if (faces @ point <= bounds + self._slack).all() and self._is_free(point)]
        return np.array([self.start, *inside])

    @cached_property
    def _lengths(self) -> np.ndarray:
        """Return the lengths of the least ways from the start to the nodes, shape (n,) (Dijkstra)."""
        nodes = self._nodes
        best, heap, done = np.full(len(nodes), np.inf), [(0.0, 0)], np.zeros(len(nodes), dtype=bool)
        best[0] = 0.0
        while heap:
            length, k = heapq.heappop(heap)
            if done[k]:
                continue
            done[k] = True
            total = length + np.abs(nodes - nodes[k]).max(axis=1)
            nearer = np.flatnonzero(total < best)
            for j in nearer[self._sees(nodes[k], nodes[nearer])]:
                best[j] = total[j]
                heapq.heappush(heap, (float(total[j]), int(j)))
        return best

    def _is_free(self, point: np.ndarray) -> bool:
        return not ((self._faces @ point < self._bounds).all(axis=1)).any() if len(self.obstacles) else True

    def _enter(self, point: np.ndarray, steps: np.ndarray) -> np.ndarray:
        """Return the shares of steps at which each enters its first obstacle, shape (n,); infinite: none in a step."""
        if not len(self.obstacles):
            return np.full(len(steps), np.inf)
        here = self._faces @ point - self._bounds
        slopes = np.einsum("mfd,nd->nmf", self._faces, steps)
        with np.errstate(divide="ignore", invalid="ignore"):
            cross = -here / slopes
        enter = np.maximum(np.where(slopes < 0.0, cross, -np.inf).max(axis=2), 0.0)
        leave = np.where(slopes > 0.0, cross, np.inf).min(axis=2)
        missed = ((slopes == 0.0) & (here >= 0.0)).any(axis=2)
        return np.where(missed | (leave - enter <= GRAZE), np.inf, enter).min(axis=1)

    def _sees(self, point: np.ndarray, others: np.ndarray) -> np.ndarray:
        """Return which straight lines from a point to others enter no obstacle, shape (n,)."""
        return self._enter(point, others - point) >= 1.0 - GRAZE

    def _measure_seen(self, node: np.ndarray, place: np.ndarray) -> float:
        """Return the distance of a node from the part of a place that it sees [m].

        Between neighbouring directions to corners either the whole border of the place that faces the node is seen, or
        nothing of it.
        """
        nearest = find_nearest(node, place)
        if self._sees(node, nearest[None])[0]:
            return float(np.abs(nearest - node).max())
        if len(place) < 3:
            return float(np.abs(nearest - node).max()) if len(place) == 2 else np.inf  # a line counts as seen
        corners = np.concatenate([place, *(polygon for _, polygon in self.obstacles)]) - node
        middle = place.mean(axis=0) - node
        x, y = corners @ middle, corners @ np.array([-middle[1], middle[0]])
        angles = np.arctan2(y, x)
        first, last = angles[: len(place)].min(), angles[: len(place)].max()
        turns = np.unique(angles[(angles >= first) & (angles <= last)]) + np.arctan2(middle[1], middle[0])
        best = np.inf
        for low, high in itertools.pairwise(turns):
            if high - low < GRAZE:
                continue
            ray = self.size * 2.0 * np.array([np.cos(0.5 * (low + high)), np.sin(0.5 * (low + high))])
            near = clip_ray(node, ray, place)
            if near is None or near > self._enter(node, ray[None])[0] + GRAZE:
                continue
            # The wedge between both directions, as half-planes through the node.
            sides = np.array([(np.sin(low), -np.cos(low)), (-np.sin(high), np.cos(high))])
            part = clip(place, sides, sides @ node + self._slack)
            if len(part):
                best = min(best, measure_distance(node[None], part))
        return best


def clip_ray(point: np.ndarray, step: np.ndarray, polygon: np.ndarray) -> float | None:
    """Return the share of a step at which it enters a polygon of three corners or more; None: it misses it."""
    faces, bounds = list_faces(polygon)
    here, slopes = faces @ point - bounds, faces @ step
    enter, leave = 0.0, 1.0
    for value, slope in zip(here, slopes, strict=True):
        if slope < 0.0:
            enter = max(enter, -value / slope)
        elif slope > 0.0:
            leave = min(leave, -value / slope)
        elif value > 0.0:
            return None
    return enter if enter <= leave else None

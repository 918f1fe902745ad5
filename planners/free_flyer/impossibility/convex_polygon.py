"""Convex polygons as arrays of corners, counter-clockwise: points and lines are polygons of one and two corners.

Distances are in the greatest norm, for limits of speed hold per axis: |d| is what a body at most as fast as v needs
|d| / v for.
"""

from __future__ import annotations

import numpy as np

SAME = 1e-12  # corners nearer than this share of the largest coordinate are one


def make_box(lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Return a box as a polygon, shape (4, 2) [m]."""
    (x0, y0), (x1, y1) = lower, upper
    return np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)], dtype=float)


def clip(polygon: np.ndarray, faces: np.ndarray, bounds: np.ndarray) -> np.ndarray:
    """Return the part of a polygon in which H p <= b; without corners where there is none.

    Args:
        polygon: shape (n, 2) [m].
        faces: H, shape (f, 2).
        bounds: b, shape (f,) [m].
    """
    corners = [(float(x), float(y)) for x, y in polygon]
    for (hx, hy), bound in zip(np.asarray(faces).tolist(), np.asarray(bounds).tolist(), strict=True):
        beyond = [hx * x + hy * y - bound for x, y in corners]
        if all(value <= 0.0 for value in beyond):
            continue
        kept: list[tuple[float, float]] = []
        for k, (here, value) in enumerate(zip(corners, beyond, strict=True)):
            before, other = corners[k - 1], beyond[k - 1]
            if (value <= 0.0) != (other <= 0.0):
                share = other / (other - value)
                kept.append((before[0] + share * (here[0] - before[0]), before[1] + share * (here[1] - before[1])))
            if value <= 0.0:
                kept.append(here)
        corners = kept
    return np.array(corners, dtype=float).reshape(-1, 2)


def list_faces(polygon: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a polygon of at least three corners as H p <= b with rows of unit length; of none nothing holds."""
    if not len(polygon):
        return np.zeros((1, 2)), np.full(1, -1.0)
    edges = np.roll(polygon, -1, axis=0) - polygon
    lengths = np.linalg.norm(edges, axis=1)
    some = lengths > SAME * max(1.0, float(np.abs(polygon).max()))
    faces = np.stack([edges[some, 1], -edges[some, 0]], axis=1) / lengths[some, None]
    return faces, np.sum(faces * polygon[some], axis=1)


def find_hull(points: np.ndarray) -> np.ndarray:
    """Return the corners of the convex hull of points, shape (n, 2) (Andrew's monotone chain)."""
    ordered = sorted({(float(x), float(y)) for x, y in points})
    if len(ordered) < 3:
        return np.array(ordered)

    def make_chain(run: list[tuple[float, float]]) -> list[tuple[float, float]]:
        chain: list[tuple[float, float]] = []
        for x, y in run:
            while len(chain) > 1:
                (ax, ay), (bx, by) = chain[-2:]
                if (bx - ax) * (y - ay) - (by - ay) * (x - ax) > 0.0:
                    break
                chain.pop()
            chain.append((x, y))
        return chain

    return np.array(make_chain(ordered)[:-1] + make_chain(ordered[::-1])[:-1])


def find_nearest(point: np.ndarray, polygon: np.ndarray) -> np.ndarray:
    """Return the place in a polygon that is nearest to a point in the greatest norm, shape (2,) [m]."""
    if len(polygon) > 2:
        faces, bounds = list_faces(polygon)
        if len(bounds) > 2 and (faces @ point <= bounds).all():
            return np.array(point, dtype=float)
    starts = polygon - point
    steps = np.roll(polygon, -1, axis=0) - polygon
    # On an edge max(|x|, |y|) is least at an end or where |x| = |y|, x = 0 or y = 0.
    shares = [np.zeros(len(polygon)), np.ones(len(polygon))]
    with np.errstate(divide="ignore", invalid="ignore"):
        for row in np.array([(1.0, 0.0), (0.0, 1.0), (1.0, 1.0), (1.0, -1.0)]):
            share = -(starts @ row) / (steps @ row)
            shares.append(np.clip(np.where(np.isfinite(share), share, 0.0), 0.0, 1.0))
    offsets = (starts + np.stack(shares)[:, :, None] * steps).reshape(-1, 2)
    return point + offsets[np.abs(offsets).max(axis=1).argmin()]


def measure_distance(one: np.ndarray, other: np.ndarray) -> float:
    """Return the least distance of two polygons in the greatest norm [m]."""
    differences = find_hull((other[None] - one[:, None]).reshape(-1, 2))
    return float(np.abs(find_nearest(np.zeros(2), differences)).max())


def measure_span(one: np.ndarray, other: np.ndarray) -> float:
    """Return the greatest Euclidean distance of a place in one polygon from a place in another one [m]."""
    return float(np.linalg.norm(other[None] - one[:, None], axis=2).max())

"""Gap, normal and points of contact between discs and convex polygons."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

Point = tuple[float, float]
Face = tuple[float, float, float, float, float]
# Corners this much farther than the nearest one belong to the same contact [m].
FLATNESS = 1e-7


@dataclass(frozen=True, slots=True)
class Disc:
    """A disc in the world: centre and radius [m]."""

    x: float
    y: float
    radius: float


@dataclass(frozen=True, slots=True)
class Polygon:
    """A convex polygon in the world: corners, counter-clockwise [m]."""

    vertices: tuple[Point, ...]


class Contact(NamedTuple):
    """How two shapes lie to each other.

    Attributes:
        gap: distance, negative in overlap [m].
        normal: unit vector from the first to the second shape.
        points: where they touch or would touch: one point, or the two ends of a flat contact [m].
    """

    gap: float
    normal: Point
    points: tuple[Point, ...]


def compute_contact(a: Disc | Polygon, b: Disc | Polygon) -> Contact:
    """Return gap, normal and points of contact of two shapes.

    Between polygons the gap is that of the best separating face: the distance wherever a face is nearest, and
    never more than the distance.

    Args:
        a, b: the shapes.

    Returns:
        The contact, normal from a to b.
    """
    if isinstance(a, Disc):
        if isinstance(b, Disc):
            return _touch_discs(a, b)
        return _flip(_touch_polygon_disc(b, a))
    if isinstance(b, Disc):
        return _touch_polygon_disc(a, b)
    of_a, of_b = _find_best_face(a, b), _find_best_face(b, a)
    # The small preference keeps the choice the same when both faces are equally good.
    if of_a[0] >= of_b[0] - FLATNESS:
        return _make_flat_contact(a, b, of_a)
    return _flip(_make_flat_contact(b, a, of_b))


def compute_faces(vertices: tuple[Point, ...]) -> tuple[Face, ...]:
    """Return a polygon's faces (px, py, nx, ny, length): start corner, outward unit normal, length [m]."""
    faces = []
    for (px, py), (qx, qy) in zip(vertices, (*vertices[1:], vertices[0]), strict=True):
        length = math.hypot(qx - px, qy - py)
        faces.append((px, py, (qy - py) / length, (px - qx) / length, length))
    return tuple(faces)


def _flip(contact: Contact) -> Contact:
    return Contact(contact.gap, (-contact.normal[0], -contact.normal[1]), contact.points)


def _touch_discs(a: Disc, b: Disc) -> Contact:
    dx, dy = b.x - a.x, b.y - a.y
    distance = math.hypot(dx, dy)
    nx, ny = dx / distance, dy / distance
    return Contact(distance - a.radius - b.radius, (nx, ny), ((a.x + a.radius * nx, a.y + a.radius * ny),))


def _touch_polygon_disc(a: Polygon, b: Disc) -> Contact:
    """Return the contact at the face or corner of a nearest to the disc's centre."""
    inside, outside = [], []
    for px, py, nx, ny, length in compute_faces(a.vertices):
        x, y = b.x - px, b.y - py
        height, along = nx * x + ny * y, -ny * x + nx * y
        if height <= 0:
            inside.append((height, (nx, ny)))
        elif 0 <= along <= length:
            outside.append((height, (nx, ny)))
        else:
            end = 0.0 if along < 0 else length
            x, y = x + end * ny, y - end * nx
            distance = math.hypot(x, y)
            outside.append((distance, (x / distance, y / distance)))
    distance, normal = min(outside) if outside else max(inside)
    point = (b.x - distance * normal[0], b.y - distance * normal[1])
    return Contact(distance - b.radius, normal, (point,))


def _find_best_face(a: Polygon, b: Polygon) -> tuple[float, Face]:
    """Return the largest gap seen along a face normal of a, and that face."""
    best = (-math.inf, (0.0, 0.0, 0.0, 0.0, 0.0))
    for face in compute_faces(a.vertices):
        px, py, nx, ny, _ = face
        gap = min(nx * (x - px) + ny * (y - py) for x, y in b.vertices)
        if gap > best[0]:
            best = (gap, face)
    return best


def _make_flat_contact(a: Polygon, b: Polygon, best: tuple[float, Face]) -> Contact:
    """Return the contact at a face of a: the nearest corner of b, or the common part of two faces."""
    gap, (px, py, nx, ny, length) = best
    near = [(x, y) for x, y in b.vertices if nx * (x - px) + ny * (y - py) <= gap + FLATNESS]
    along = sorted(-ny * (x - px) + nx * (y - py) for x, y in near)
    low, high = max(along[0], 0.0), min(along[-1], length)
    ends = [along[0]] if len(near) == 1 or high <= low else [low, high]
    return Contact(gap, (nx, ny), tuple((px - s * ny, py + s * nx) for s in ends))

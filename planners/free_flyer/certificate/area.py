"""Areas as exact half-planes: by how much a point is inside each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

from planners.free_flyer.certificate.polynomial import Polynomial, Range, combine, root_above, root_below


@dataclass(frozen=True)
class Face:
    """The half-plane left of an edge, whose slack is (offset + nx x + ny y) / length.

    Attributes:
        nx, ny, offset: exact.
        length: bounds of the edge's length; equal for edges along an axis [m].
    """

    nx: Fraction
    ny: Fraction
    offset: Fraction
    length: Range

    def make_part(self, x: Polynomial, y: Polynomial) -> Polynomial:
        """Return the slack times the length over a path."""
        return combine([x, y], [self.nx, self.ny], self.offset)

    def bound(self, part: Range) -> Range:
        """Return bounds of the slack from those of the slack times the length [m]."""
        low, high = part
        short, long = self.length
        return low / (long if low > 0 else short), high / (short if high > 0 else long)


def make_faces(corners: Sequence[tuple[float, float]]) -> list[Face]:
    """Return the faces of a convex polygon.

    Args:
        corners: counter-clockwise [m].
    """
    points = [(Fraction(x), Fraction(y)) for x, y in corners]
    faces = []
    for (x0, y0), (x1, y1) in zip(points, points[1:] + points[:1], strict=True):
        dx, dy = x1 - x0, y1 - y0
        squared = dx * dx + dy * dy
        faces.append(Face(-dy, dx, dy * x0 - dx * y0, (root_below(squared), root_above(squared))))
    return faces

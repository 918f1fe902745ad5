"""Contact geometry of the tip, a disc, and the box: gap, normal, rates, and the gap's acceleration without forces."""

from __future__ import annotations

from typing import NamedTuple

from impact_envs.compiled import compiled
from impact_envs.elementary import cos_sin, hypot


class Contact(NamedTuple):
    """Geometry of the tip relative to the box.

    Attributes:
        gap: distance between disc and box, negative in overlap [m].
        rate: of the gap, negative when it closes [m/s].
        nx, ny: unit normal from the box to the tip.
        rx, ry: nearest point of the box, relative to its centre [m].
        slip: speed of the tip along the box [m/s].
        bias: acceleration of the gap that comes from velocities alone [m/s^2].
    """

    gap: float
    rate: float
    nx: float
    ny: float
    rx: float
    ry: float
    slip: float
    bias: float


@compiled
def compute_contact(
    tip: tuple[float, float, float, float, float, float],
    radius: float,
    box: tuple[float, float, float, float, float, float],
    half_length: float,
    half_width: float,
) -> Contact:
    """Return the contact geometry of a disc and a box.

    Beside a face the normal turns with the box; at a corner it points from the corner to the disc's centre.

    Args:
        tip: x, y, vx, vy, ax, ay of the disc's centre; the acceleration without forces.
        radius: of the disc [m].
        box: x, y, heading, vx, vy, omega.
        half_length, half_width: of the box along its own axes [m].
    """
    c, s = cos_sin(box[2])
    dx, dy = tip[0] - box[0], tip[1] - box[1]
    ux, uy = tip[2] - box[3], tip[3] - box[4]
    omega = box[5]
    along, across = c * dx + s * dy, -s * dx + c * dy
    beyond_x, beyond_y = abs(along) - half_length, abs(across) - half_width
    sx = 1.0 if along >= 0.0 else -1.0
    sy = 1.0 if across >= 0.0 else -1.0
    if beyond_x > 0.0 and beyond_y > 0.0:
        px, py = sx * half_length, sy * half_width
        rx, ry = c * px - s * py, s * px + c * py
        ex, ey = dx - rx, dy - ry
        distance = hypot(ex, ey)
        nx, ny = ex / distance, ey / distance
        wx, wy = ux + omega * ry, uy - omega * rx
        rate = nx * wx + ny * wy
        slip = nx * wy - ny * wx
        bias = nx * tip[4] + ny * tip[5] + omega * omega * (nx * rx + ny * ry) + slip * slip / distance
        return Contact(distance - radius, rate, nx, ny, rx, ry, slip, bias)
    if beyond_x > beyond_y:
        nx, ny, height = sx * c, sx * s, beyond_x
    else:
        nx, ny, height = -sy * s, sy * c, beyond_y
    rx, ry = dx - height * nx, dy - height * ny
    rate = nx * ux + ny * uy - omega * (rx * ny - ry * nx)
    slide = nx * uy - ny * ux
    bias = nx * tip[4] + ny * tip[5] + 2.0 * omega * slide - omega * omega * (nx * dx + ny * dy)
    return Contact(height - radius, rate, nx, ny, rx, ry, slide - omega * (nx * rx + ny * ry), bias)

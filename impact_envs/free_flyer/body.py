"""One planar rigid body in flight: exact motion under a constant force and torque."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from impact_envs.elementary import cos_sin
from impact_envs.physics.convex import Disc, Face, Point, Polygon, compute_faces


@dataclass(slots=True)
class Body:
    """A rigid body, or a fixed one with infinite mass and inertia.

    Attributes:
        name: in the scenario.
        radius: of the disc, or of the circle round the polygon [m].
        vertices: of a polygon, in the body's frame [m]; None for a disc.
        offset: centre of mass in the body's frame, from the geometric centre [m].
        mass, inertia: about the centre of mass [kg], [kg m^2].
        faces: of a fixed body, in the world; none for a movable one.
        x, y, vx, vy: of the centre of mass [m], [m/s].
        heading, omega: [rad], [rad/s].
        ax, ay, alpha: acceleration by the forces held over the control period [m/s^2], [rad/s^2].
        fixed: nothing can move it.
        reach: radius of the circle round the centre of mass that holds the shape [m].
        lever: how far from the centre of mass a rotation moves the shape; 0 for a centred disc [m].
    """

    name: str
    radius: float
    vertices: tuple[Point, ...] | None = None
    offset: Point = (0.0, 0.0)
    mass: float = math.inf
    inertia: float = math.inf
    faces: tuple[Face, ...] = ()
    x: float = 0.0
    y: float = 0.0
    vx: float = 0.0
    vy: float = 0.0
    heading: float = 0.0
    omega: float = 0.0
    ax: float = 0.0
    ay: float = 0.0
    alpha: float = 0.0
    fixed: bool = field(init=False)
    reach: float = field(init=False)
    lever: float = field(init=False)

    def __post_init__(self) -> None:
        self.fixed = self.mass == math.inf
        off_centre = math.hypot(*self.offset)
        self.reach = self.radius + off_centre
        turns = self.vertices is not None and not self.fixed
        self.lever = off_centre + (self.radius if turns else 0.0)

    def fly(self, h: float) -> None:
        """Move for a time h [s] without contact.

        x+ = x + v h + a h^2 / 2, v+ = v + a h, which is a half kick, a drift and a half kick.
        """
        self.x += (self.vx + 0.5 * self.ax * h) * h
        self.y += (self.vy + 0.5 * self.ay * h) * h
        self.heading += (self.omega + 0.5 * self.alpha * h) * h
        self.vx += self.ax * h
        self.vy += self.ay * h
        self.omega += self.alpha * h

    def centre(self, t: float = 0.0) -> tuple[float, float, float]:
        """Return geometric centre and heading after a flight of t.

        Args:
            t: from now [s].

        Returns:
            x, y [m], heading [rad].
        """
        heading = self.heading + (self.omega + 0.5 * self.alpha * t) * t
        x = self.x + (self.vx + 0.5 * self.ax * t) * t
        y = self.y + (self.vy + 0.5 * self.ay * t) * t
        if self.offset != (0.0, 0.0):
            c, s = cos_sin(heading)
            x -= c * self.offset[0] - s * self.offset[1]
            y -= s * self.offset[0] + c * self.offset[1]
        return x, y, heading

    def shape(self, t: float = 0.0) -> Disc | Polygon:
        """Return where its shape is after a flight of t [s]."""
        if self.fixed:
            assert self.vertices is not None
            return Polygon(self.vertices)
        x, y, heading = self.centre(t)
        if self.vertices is None:
            return Disc(x, y, self.radius)
        c, s = cos_sin(heading)
        return Polygon(tuple((x + c * px - s * py, y + s * px + c * py) for px, py in self.vertices))

    def velocity_at(self, point: Point) -> Point:
        """Return the velocity of a point of the body [m/s]."""
        return self.vx - self.omega * (point[1] - self.y), self.vy + self.omega * (point[0] - self.x)

    def thrust_at(self, point: Point) -> Point:
        """Return what force and torque add to the acceleration of a point of the body [m/s^2]."""
        return self.ax - self.alpha * (point[1] - self.y), self.ay + self.alpha * (point[0] - self.x)


def make_walls(lower: Point, upper: Point) -> list[Body]:
    """Return the four sides of the world box as fixed bodies, all called ``world``.

    Args:
        lower, upper: corners of the box [m].

    Returns:
        Slabs outside the box, with the inner face only: the others cannot be reached.
    """
    (x0, y0), (x1, y1) = lower, upper
    d = math.dist(lower, upper)
    corners = (
        ((x0 - d, y0 - d), (x0, y0 - d), (x0, y1 + d), (x0 - d, y1 + d)),
        ((x1, y0 - d), (x1 + d, y0 - d), (x1 + d, y1 + d), (x1, y1 + d)),
        ((x0 - d, y0 - d), (x1 + d, y0 - d), (x1 + d, y0), (x0 - d, y0)),
        ((x0 - d, y1), (x1 + d, y1), (x1 + d, y1 + d), (x0 - d, y1 + d)),
    )
    inner = ((x0, y0, 1.0, 0.0), (x1, y0, -1.0, 0.0), (x0, y0, 0.0, 1.0), (x0, y1, 0.0, -1.0))
    return [
        Body("world", d, vertices, faces=((*face, math.inf),)) for vertices, face in zip(corners, inner, strict=True)
    ]


def make_obstacle(name: str, vertices: tuple[Point, ...]) -> Body:
    """Return a fixed convex polygon.

    Args:
        name: in the scenario.
        vertices: in the world, counter-clockwise [m].
    """
    return Body(name, math.inf, vertices, faces=compute_faces(vertices))

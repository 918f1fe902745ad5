"""Contacts that last: pymunk's solver finds the forces between bodies that press on each other."""

from __future__ import annotations

from collections.abc import Sequence

import pymunk

from impact_envs.free_flyer.body import Body
from impact_envs.free_flyer.contact.pair import SKIN

# Few sweeps leave a symmetric squeeze of an object asymmetric; a test holds 50 to keep it still.
ITERATIONS = 50


class ContactSolver:
    """A pymunk space that finds the forces of lasting contacts; it is made anew in every control period.

    Only the change of velocity over a step is taken from it, as accelerations: bodies then move exactly under
    all forces, so neither pymunk's order of integration nor its penetration slop is seen.

    Args:
        bodies: movable and fixed ones.
        friction: Coulomb coefficient of every contact.

    Attributes:
        impulses: of each pair over the last step, on its second body [N s].
    """

    def __init__(self, bodies: Sequence[Body], friction: float) -> None:
        self.space = pymunk.Space()
        self.space.iterations = ITERATIONS
        self.space.collision_slop = 4 * SKIN  # overlap of two skins is no penetration
        self.friction = friction
        self.pairs: set[tuple[int, int]] = set()
        self.movable: list[tuple[Body, pymunk.Body]] = []
        for index, body in enumerate(bodies):
            self._add(body, index)
        self.impulses: dict[tuple[int, int], tuple[float, float]] = {}
        self.space.on_collision(pre_solve=self._accept_pair, post_solve=self._keep_impulse)

    def add_contact_forces(self, pairs: set[tuple[int, int]], h: float) -> None:
        """Add to the accelerations of all bodies what keeps some pairs from closing in over a time h.

        Args:
            pairs: indices of the bodies that rest on each other; all others pass through each other.
            h: for which the contact forces are held [s].
        """
        self.pairs, self.impulses = pairs, {}
        for body, twin in self.movable:
            twin.position = body.x, body.y
            twin.angle = body.heading
            twin.velocity = body.vx, body.vy
            twin.angular_velocity = body.omega
            twin.force = body.ax * body.mass, body.ay * body.mass
            twin.torque = body.alpha * body.inertia
        self.space.step(h)
        for body, twin in self.movable:
            vx, vy = twin.velocity
            body.ax, body.ay = (vx - body.vx) / h, (vy - body.vy) / h
            body.alpha = (twin.angular_velocity - body.omega) / h

    def _add(self, body: Body, index: int) -> None:
        twin = self.space.static_body if body.fixed else pymunk.Body(body.mass, body.inertia)
        ox, oy = body.offset
        shape: pymunk.Shape
        if body.vertices is None:
            shape = pymunk.Circle(twin, body.radius + SKIN, (-ox, -oy))
        else:
            shape = pymunk.Poly(twin, [(x - ox, y - oy) for x, y in body.vertices], radius=SKIN)
        shape.collision_type = index
        if not body.fixed:
            self.space.add(twin)
            self.movable.append((body, twin))
        self.space.add(shape)

    def _accept_pair(self, arbiter: pymunk.Arbiter, space: pymunk.Space, data: object) -> None:
        a, b = (shape.collision_type for shape in arbiter.shapes)
        arbiter.process_collision = (min(a, b), max(a, b)) in self.pairs
        arbiter.restitution = 0.0
        arbiter.friction = self.friction

    def _keep_impulse(self, arbiter: pymunk.Arbiter, space: pymunk.Space, data: object) -> None:
        a, b = (shape.collision_type for shape in arbiter.shapes)
        x, y = arbiter.total_impulse  # on the first shape
        self.impulses[min(a, b), max(a, b)] = (-x, -y) if a < b else (x, y)

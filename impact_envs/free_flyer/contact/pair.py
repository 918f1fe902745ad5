"""Two bodies: how they touch, close in, press on each other, and when they will touch.

Also the numbers by which both engines judge a pair: what counts as an impact, what as resting.
"""

from __future__ import annotations

import math

from impact_envs.free_flyer.body import Body
from impact_envs.physics.convex import Contact, compute_contact
from impact_envs.physics.time_of_impact import find_crossing, find_disc_impact, find_face_impact

# More in one control period, and the rules below have failed: the episode ends (see `failure`).
EVENTS = 20_000
# Lasting contacts hold their forces for this long [s].
CONTACT_STEP = 0.01
# Bodies this near [m] rest on each other if they close in no faster than this share of the scenario's rest speed, and
# part no faster than pymunk, whose shapes are this much larger than they are [m], sees over a contact step. Smaller
# accelerations are rounding [m/s^2].
REST_GAP, REST_SHARE, SKIN = 1e-5, 1e-3, 1e-4
PART_SPEED = SKIN / CONTACT_STEP
REST_PRESS = 1e-9
# A contact step says what presses bodies only where they turn by no more than this in it [rad].
MOST_TURN = 0.1
# Impacts this close in time are solved together, so that symmetric squeezes stay symmetric [s].
SIMULTANEOUS = 1e-12
# Polygons may graze each other unseen over this much motion, and touch when they overlap by this much; all
# bodies may sink this much into what they rest on [m].
STRIDE, GRAZE, SINK = 1e-3, 1e-10, 1e-6


def find_contact(a: Body, b: Body) -> Contact:
    """Return gap, normal from a to b, and points of contact of two bodies now."""
    return compute_contact(a.shape(), b.shape())


def compute_approach(a: Body, b: Body, contact: Contact) -> float:
    """Return the speed at which two bodies close in, at their fastest point of contact [m/s]."""
    nx, ny = contact.normal
    velocities = [(a.velocity_at(point), b.velocity_at(point)) for point in contact.points]
    return max(nx * (va[0] - vb[0]) + ny * (va[1] - vb[1]) for va, vb in velocities)


def compute_press(a: Body, b: Body, contact: Contact) -> float:
    """Return the acceleration at which the gap closes in free flight over a contact step.

    It holds all there is: forces, centrifugal and Coriolis terms, a change of the touching corner. Bodies that turn
    far within a step only bring their next corner, so of those it is what the forces alone do.

    Args:
        a, b: the bodies.
        contact: of theirs, now.

    Returns:
        Acceleration, positive when they are pressed together [m/s^2].
    """
    h = CONTACT_STEP
    if max(a.lever * abs(a.omega), b.lever * abs(b.omega)) > 0 and h * (abs(a.omega) + abs(b.omega)) > MOST_TURN:
        return compute_force_press(a, b, contact)
    gap = compute_contact(a.shape(h), b.shape(h)).gap
    return 2 * (contact.gap - compute_approach(a, b, contact) * h - gap) / h**2


def compute_force_press(a: Body, b: Body, contact: Contact) -> float:
    """Return the acceleration with which forces and torques alone press two bodies together.

    An impact changes the other terms of ``compute_press``: they do not tell when a rebound would end.

    Args:
        a, b: the bodies.
        contact: of theirs, now.

    Returns:
        Acceleration, positive when they are pressed together [m/s^2].
    """
    nx, ny = contact.normal
    pairs = [(a.thrust_at(point), b.thrust_at(point)) for point in contact.points]
    return max(nx * (of_a[0] - of_b[0]) + ny * (of_a[1] - of_b[1]) for of_a, of_b in pairs)


def find_time_of_impact(a: Body, b: Body, resting: bool, end: float) -> float:
    """Return when two bodies touch in free flight.

    Args:
        a: a movable body.
        b: a movable or fixed body.
        resting: they rest on each other, and the question is when they sink into each other.
        end: last time looked at [s].

    Returns:
        Time from now, infinity if it does not happen [s].
    """
    if a.lever > 0 or b.lever > 0:
        rate = math.hypot(a.vx - b.vx, a.vy - b.vy) + math.hypot(a.ax - b.ax, a.ay - b.ay) * end
        rate += a.lever * (abs(a.omega) + abs(a.alpha) * end)
        rate += b.lever * (abs(b.omega) + abs(b.alpha) * end)
        slack = SINK if resting else GRAZE
        return find_crossing(lambda t: compute_contact(a.shape(t), b.shape(t)).gap, rate, STRIDE, slack, end)
    slack = SINK if resting else 0.0
    if b.fixed:
        motion = (a.x, a.y, a.vx, a.vy, a.ax, a.ay)
        return min(find_face_impact(*motion, face, a.radius, slack, end) for face in b.faces)
    relative = (a.x - b.x, a.y - b.y, a.vx - b.vx, a.vy - b.vy, a.ax - b.ax, a.ay - b.ay)
    return find_disc_impact(*relative, a.radius + b.radius, slack, end)


def remove_overlap(a: Body, b: Body, contact: Contact) -> None:
    """Take back an overlap, sharing the way so that the centre of mass of both stays."""
    share = 1.0 if b.fixed else b.mass / (a.mass + b.mass)
    for body, way in ((a, contact.gap * share), (b, -contact.gap * (1 - share))):
        body.x += way * contact.normal[0]
        body.y += way * contact.normal[1]

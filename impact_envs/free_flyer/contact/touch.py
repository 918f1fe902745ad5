"""Two discs, or a disc and a fixed polygon, of world k: gap, approach, pressure, and when they touch.

Compiled scalar functions. Pairs are (i, j) with i movable; j >= n is fixed body j - n. Results of one moment are
(gap, nx, ny, px, py): distance [m], unit normal from i to j, point of contact [m].
"""

from __future__ import annotations

import math

from impact_envs.compiled import compiled
from impact_envs.elementary import cos_sin
from impact_envs.free_flyer.contact.pair import CONTACT_STEP, SINK
from impact_envs.free_flyer.truth import OFFSET_X, OFFSET_Y
from impact_envs.free_flyer.worlds import ACCELERATION, RADIUS, Arena, Scratch, Worlds
from impact_envs.physics.time_of_impact import NEWTON_STEPS, TOUCHING, find_disc_impact, find_face_impact


@compiled
def find_centre(worlds: Worlds, scratch: Scratch, c: int, k: int, i: int, t: float) -> tuple[float, float]:
    """Return the geometric centre of body i after a flight of t [m]."""
    state, motion = worlds.state, scratch.motion
    x = state[k, i, 0] + (state[k, i, 2] + 0.5 * motion[c, i, ACCELERATION + 0] * t) * t
    y = state[k, i, 1] + (state[k, i, 3] + 0.5 * motion[c, i, ACCELERATION + 1] * t) * t
    if worlds.body.shape[2] > OFFSET_X:
        heading = state[k, i, 4] + (state[k, i, 5] + 0.5 * motion[c, i, ACCELERATION + 2] * t) * t
        cos, sin = cos_sin(heading)
        ox, oy = worlds.body[k, i, OFFSET_X], worlds.body[k, i, OFFSET_Y]
        x -= cos * ox - sin * oy
        y -= sin * ox + cos * oy
    return x, y


@compiled
def find_gap(
    arena: Arena, worlds: Worlds, scratch: Scratch, c: int, k: int, i: int, j: int, t: float
) -> tuple[float, float, float, float, float]:
    """Return gap, normal and point of contact of a pair after a flight of t."""
    n = arena.discs.shape[0]
    x, y = find_centre(worlds, scratch, c, k, i, t)
    radius = arena.discs[i, RADIUS]
    if j < n:
        bx, by = find_centre(worlds, scratch, c, k, j, t)
        dx, dy = bx - x, by - y
        distance = math.sqrt(dx * dx + dy * dy)
        nx, ny = dx / distance, dy / distance
        return distance - radius - arena.discs[j, RADIUS], nx, ny, x + radius * nx, y + radius * ny
    distance, nx, ny = find_distance(arena, j - n, x, y)
    return distance - radius, -nx, -ny, x - distance * nx, y - distance * ny


@compiled
def find_distance(arena: Arena, fixed: int, x: float, y: float) -> tuple[float, float, float]:
    """Return the distance of a point from a fixed polygon, negative inside, and the normal towards the point."""
    best, best_x, best_y = -math.inf, 0.0, 0.0
    nearest, nearest_x, nearest_y = math.inf, 0.0, 0.0
    for f in range(arena.first_face[fixed], arena.first_face[fixed + 1]):
        rx, ry = x - arena.faces[f, 0], y - arena.faces[f, 1]
        nx, ny, length = arena.faces[f, 2], arena.faces[f, 3], arena.faces[f, 4]
        height, along = nx * rx + ny * ry, nx * ry - ny * rx
        if height <= 0:
            if height > best:
                best, best_x, best_y = height, nx, ny
            continue
        if length < math.inf and (along < 0 or along > length):
            if along > 0:
                rx, ry = rx + length * ny, ry - length * nx
            height = math.sqrt(rx * rx + ry * ry)
            nx, ny = rx / height, ry / height
        if height < nearest:
            nearest, nearest_x, nearest_y = height, nx, ny
    if nearest < math.inf:
        return nearest, nearest_x, nearest_y
    return best, best_x, best_y


@compiled
def find_approach(
    arena: Arena, worlds: Worlds, k: int, i: int, j: int, nx: float, ny: float, px: float, py: float
) -> float:
    """Return the speed at which a pair closes in at its point of contact [m/s]."""
    state = worlds.state
    vx = state[k, i, 2] - state[k, i, 5] * (py - state[k, i, 1])
    vy = state[k, i, 3] + state[k, i, 5] * (px - state[k, i, 0])
    if j < arena.discs.shape[0]:
        vx -= state[k, j, 2] - state[k, j, 5] * (py - state[k, j, 1])
        vy -= state[k, j, 3] + state[k, j, 5] * (px - state[k, j, 0])
    return nx * vx + ny * vy


@compiled
def find_press(
    arena: Arena, worlds: Worlds, scratch: Scratch, c: int, k: int, i: int, j: int, gap: float, approach: float
) -> float:
    """Return the acceleration at which a pair's gap closes in free flight over a contact step [m/s^2]."""
    later, _, _, _, _ = find_gap(arena, worlds, scratch, c, k, i, j, CONTACT_STEP)
    return 2 * (gap - approach * CONTACT_STEP - later) / (CONTACT_STEP * CONTACT_STEP)


@compiled
def find_touch(
    arena: Arena, worlds: Worlds, scratch: Scratch, c: int, k: int, i: int, j: int, resting: bool, end: float
) -> float:
    """Return when a pair touches in free flight, infinity if not within end [s]; resting ones may sink a little."""
    state, motion = worlds.state, scratch.motion
    n = arena.discs.shape[0]
    slack = SINK if resting else 0.0
    x, y, vx, vy = state[k, i, 0], state[k, i, 1], state[k, i, 2], state[k, i, 3]
    ax, ay = motion[c, i, ACCELERATION + 0], motion[c, i, ACCELERATION + 1]
    radius = arena.discs[i, RADIUS]
    if j < n:
        x, y, vx, vy = x - state[k, j, 0], y - state[k, j, 1], vx - state[k, j, 2], vy - state[k, j, 3]
        ax, ay = ax - motion[c, j, ACCELERATION + 0], ay - motion[c, j, ACCELERATION + 1]
        radius += arena.discs[j, RADIUS]
    swings = worlds.body.shape[2] > OFFSET_X
    if j < n:
        if swings and (is_offset(worlds, k, i) or is_offset(worlds, k, j)):
            return find_offset_touch(worlds, scratch, c, k, i, j, x, y, vx, vy, ax, ay, 0.0, 0.0, radius, slack, end)
        return find_disc_impact(x, y, vx, vy, ax, ay, radius, slack, end)
    swings = swings and is_offset(worlds, k, i)
    first = math.inf
    for f in range(arena.first_face[j - n], arena.first_face[j - n + 1]):
        px, py, nx, ny = arena.faces[f, 0], arena.faces[f, 1], arena.faces[f, 2], arena.faces[f, 3]
        length = arena.faces[f, 4]
        if not swings:
            hit = find_face_impact(x, y, vx, vy, ax, ay, (px, py, nx, ny, length), radius, slack, end)
        else:
            rx, ry = x - px, y - py
            hit = find_offset_touch(worlds, scratch, c, k, i, i, rx, ry, vx, vy, ax, ay, nx, ny, radius, slack, end)
            if hit < math.inf and length < math.inf:
                cx, cy = find_centre(worlds, scratch, c, k, i, hit)
                along = nx * (cy - py) - ny * (cx - px)
                if along < 0 or along > length:
                    hit = math.inf
            if length < math.inf:
                corner = find_offset_touch(
                    worlds, scratch, c, k, i, i, rx, ry, vx, vy, ax, ay, 0.0, 0.0, radius, slack, end
                )
                hit = min(hit, corner)
        first = min(first, hit)
    return first


@compiled
def is_offset(worlds: Worlds, k: int, i: int) -> bool:
    """Return whether body i's centre of mass is not its centre."""
    return worlds.body[k, i, OFFSET_X] != 0 or worlds.body[k, i, OFFSET_Y] != 0


@compiled
def find_centre_motion(
    worlds: Worlds, scratch: Scratch, c: int, k: int, i: int, t: float
) -> tuple[float, float, float, float]:
    """Return where the centre is, seen from the centre of mass, and its velocity, after a flight of t."""
    omega, alpha = worlds.state[k, i, 5], scratch.motion[c, i, ACCELERATION + 2]
    heading = worlds.state[k, i, 4] + (omega + 0.5 * alpha * t) * t
    cos, sin = cos_sin(heading)
    rate = omega + alpha * t
    rx = sin * worlds.body[k, i, OFFSET_Y] - cos * worlds.body[k, i, OFFSET_X]
    ry = -sin * worlds.body[k, i, OFFSET_X] - cos * worlds.body[k, i, OFFSET_Y]
    return rx, ry, -rate * ry, rate * rx


@compiled
def find_offset_touch(
    worlds: Worlds,
    scratch: Scratch,
    c: int,
    k: int,
    i: int,
    j: int,
    x: float,
    y: float,
    vx: float,
    vy: float,
    ax: float,
    ay: float,
    nx: float,
    ny: float,
    radius: float,
    slack: float,
    end: float,
) -> float:
    """Return when discs that turn about an offset centre of mass first touch, by certified steps.

    f is the gap, to first order near contact: n d - R for a face with normal n, (d d - R^2) / 2R for discs and
    corners (n = 0), with d the way between the centres. From t, the parabola f + f' s + m s^2 / 2 with m <= f'' in
    [t, end] lies below f, so no touch is left out by jumping to its first root.

    Args:
        worlds, scratch, c, k: where.
        i, j: the bodies; j = i for a fixed partner.
        x, y, vx, vy, ax, ay: relative motion of the centres of mass, of j's from i's [m], [m/s], [m/s^2].
        nx, ny: of the face, 0 for discs and corners.
        radius: sum of the radii [m].
        slack: overlap beyond the present one that is let pass [m].
        end: last time looked at [s].

    Returns:
        Time of the touch, infinity if there is none [s].
    """
    bend_i, bend_j = bound_centre_acceleration(worlds, scratch, c, k, i, end), 0.0
    if j != i:
        bend_j = bound_centre_acceleration(worlds, scratch, c, k, j, end)
    most = math.sqrt(ax * ax + ay * ay) + bend_i + bend_j
    shift, t = slack, 0.0
    for step in range(NEWTON_STEPS):
        dx, dy = x + (vx + 0.5 * ax * t) * t, y + (vy + 0.5 * ay * t) * t
        ux, uy = vx + ax * t, vy + ay * t
        rx, ry, wx, wy = find_centre_motion(worlds, scratch, c, k, i, t)
        dx, dy, ux, uy = dx + rx, dy + ry, ux + wx, uy + wy
        if j != i:
            rx, ry, wx, wy = find_centre_motion(worlds, scratch, c, k, j, t)
            dx, dy, ux, uy = dx - rx, dy - ry, ux - wx, uy - wy
        if nx != 0 or ny != 0:
            f, slope, bend = nx * dx + ny * dy - radius, nx * ux + ny * uy, -most
            if f < -radius:  # from behind it is no contact with this face
                return math.inf
        else:
            left = end - t
            far = math.sqrt(dx * dx + dy * dy) + (math.sqrt(ux * ux + uy * uy) + most * left) * left
            f, slope = 0.5 * (dx * dx + dy * dy - radius * radius) / radius, (dx * ux + dy * uy) / radius
            bend = -most * far / radius
        if step == 0:
            shift += max(-f, 0.0)
        f += shift
        if f <= TOUCHING and slope < 0:
            return t
        f = max(f, 0.0)
        if slope >= 0 and bend >= 0:
            return math.inf
        inside = slope * slope - 2 * bend * f
        t += 2 * f / (math.sqrt(inside) - slope) if slope < 0 else (slope + math.sqrt(inside)) / -bend
        if t > end:
            return math.inf
    return t


@compiled
def bound_centre_acceleration(worlds: Worlds, scratch: Scratch, c: int, k: int, i: int, end: float) -> float:
    """Return a bound on the acceleration of body i's centre about its centre of mass until end [m/s^2]."""
    alpha = abs(scratch.motion[c, i, ACCELERATION + 2])
    rate = abs(worlds.state[k, i, 5]) + alpha * end
    ox, oy = worlds.body[k, i, OFFSET_X], worlds.body[k, i, OFFSET_Y]
    return math.sqrt(ox * ox + oy * oy) * (rate * rate + alpha)

"""When discs and polygons first touch.

The functions on numbers are exact and compiled; ``find_crossing`` serves shapes whose gap has no closed form.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from impact_envs.compiled import compiled

# A gap below this counts as touching [m].
TOUCHING = 1e-14
NEWTON_STEPS = 64


@compiled
def find_first_root(c0: float, c1: float, c2: float, c3: float, c4: float, end: float) -> float:
    """Return when a quartic first falls through zero.

    f(t) = c0 + c1 t + c2 t^2 + c3 t^3 + c4 t^4. From t, the parabola f + f' s + min(f'') s^2 / 2 lies below
    f, so no root is left out by jumping to the parabola's first root, and its having none proves that f has
    none.

    Args:
        c0, c1, c2, c3, c4: coefficients [m], [m/s], ...; c0 >= 0.
        end: last time looked at [s].

    Returns:
        First t in [0, end] with f(t) = 0 and f'(t) < 0, infinity if there is none [s].
    """
    t = 0.0
    for _ in range(NEWTON_STEPS):
        f = c0 + t * (c1 + t * (c2 + t * (c3 + t * c4)))
        slope = c1 + t * (2 * c2 + t * (3 * c3 + t * 4 * c4))
        if f <= TOUCHING and slope < 0:
            return t
        bend = min(2 * c2 + t * (6 * c3 + t * 12 * c4), 2 * c2 + end * (6 * c3 + end * 12 * c4))
        if c4 > 0 and t < -c3 / (4 * c4) < end:
            bend = min(bend, 2 * c2 - 0.75 * c3 * c3 / c4)
        f = max(f, 0.0)
        inside = slope * slope - 2 * bend * f
        if slope < 0:
            if inside < 0:
                return math.inf
            t += 2 * f / (math.sqrt(inside) - slope)
        elif bend < 0:
            t += (slope + math.sqrt(inside)) / -bend
        else:
            return math.inf
        if t > end:
            return math.inf
    return t  # not converged, but nothing was passed: looking again from here is right


@compiled
def find_disc_impact(
    x: float,
    y: float,
    vx: float,
    vy: float,
    ax: float,
    ay: float,
    radius: float,
    slack: float,
    end: float,
) -> float:
    """Return when a point in uniformly accelerated motion first enters a circle round the origin.

    Two discs: relative motion of the centres, radius = sum of the radii.

    Args:
        x, y: position [m].
        vx, vy: velocity [m/s].
        ax, ay: acceleration [m/s^2].
        radius: of the circle, above 0 [m].
        slack: overlap beyond the present one that is let pass [m].
        end: last time looked at [s].

    Returns:
        Time of impact, infinity if there is none [s].
    """
    scale = 0.5 / radius  # makes f the gap, to first order
    return find_first_root(
        max(scale * (x * x + y * y - radius * radius), 0.0) + slack,
        2 * scale * (x * vx + y * vy),
        scale * (vx * vx + vy * vy + x * ax + y * ay),
        scale * (vx * ax + vy * ay),
        scale * (ax * ax + ay * ay) / 4,
        end,
    )


@compiled
def find_face_impact(
    x: float,
    y: float,
    vx: float,
    vy: float,
    ax: float,
    ay: float,
    face: tuple[float, float, float, float, float],
    radius: float,
    slack: float,
    end: float,
) -> float:
    """Return when a disc first touches one face of a fixed polygon, or the corner where the face starts.

    Args:
        x, y, vx, vy, ax, ay: motion of the centre [m], [m/s], [m/s^2].
        face: start corner (px, py), outward unit normal (nx, ny) and length; an infinite one has no corner
            [m].
        radius: of the disc [m].
        slack: overlap beyond the present one that is let pass [m].
        end: last time looked at [s].

    Returns:
        Time of impact, infinity if there is none [s].
    """
    px, py, nx, ny, length = face
    x, y = x - px, y - py
    outside = nx * x + ny * y
    hit = math.inf
    # Overlap of the face from outside counts as touching; from behind it is no contact with this face.
    fall = find_fall(
        (max(outside - radius, 0.0) if outside > 0 else outside - radius) + slack,
        nx * vx + ny * vy,
        nx * ax + ny * ay,
    )
    if fall <= end:
        along = -ny * x + nx * y + fall * (-ny * vx + nx * vy + fall * (-ny * ax + nx * ay) / 2)
        if length == math.inf or 0 <= along <= length:
            hit = fall
    if length < math.inf:
        hit = min(hit, find_disc_impact(x, y, vx, vy, ax, ay, radius, slack, min(hit, end)))
    return hit


@compiled
def find_fall(height: float, speed: float, acceleration: float) -> float:
    """Return when a height in uniformly accelerated motion falls through zero, which it does at most once.

    Args:
        height: h in h + v t + a t^2 / 2 [m].
        speed: v, upwards [m/s].
        acceleration: a, upwards [m/s^2].

    Returns:
        Time, infinity if it never falls through zero [s].
    """
    inside = speed * speed - 2 * acceleration * height
    if inside < 0:
        return math.inf
    root = math.sqrt(inside)
    if height >= 0 and speed < 0:
        return 2 * height / (root - speed)
    if height < 0 and speed <= 0:
        return math.inf  # said here, for an acceleration near zero makes rounding of the sum below an impact at once
    return (speed + root) / -acceleration if acceleration < 0 and speed + root >= 0 else math.inf


def find_crossing(gap: Callable[[float], float], rate: float, stride: float, slack: float, end: float) -> float:
    """Return when a gap first falls below zero, or below its start if it starts in overlap.

    Steps are conservative: the gap cannot close within gap / rate. Near contact they are ``stride / rate``,
    so a touch that comes and goes within a stride of motion is passed over.

    Args:
        gap: distance at a time, negative in overlap [m].
        rate: bound on how fast it changes in [0, end] [m/s].
        stride: motion between two looks near contact [m].
        slack: how far below is let pass, above rounding [m].
        end: last time looked at [s].

    Returns:
        Time of the crossing, infinity if there is none [s].
    """
    start = gap(0.0)
    floor = min(start, 0.0) - slack
    t, here = 0.0, start - floor
    if rate * end <= here:
        return math.inf
    while t < end:
        ahead = min(t + max(here, stride) / rate, end)
        there = gap(ahead) - floor
        if there < 0:
            return _find_sign_change(lambda s: gap(s) - floor, t, here, ahead, there)
        t, here = ahead, there
    return math.inf


def _find_sign_change(f: Callable[[float], float], low: float, f_low: float, high: float, f_high: float) -> float:
    """Return the last time found with f >= 0 before f changes sign (regula falsi, Illinois weights)."""
    weight_low = weight_high = 1.0
    side = 0
    for _ in range(100):
        if f_low <= TOUCHING or high - low <= 1e-15 * high:
            break
        a, b = weight_low * f_low, weight_high * f_high
        middle = (low * b - high * a) / (b - a)
        if not low < middle < high:
            middle = (low + high) / 2
        value = f(middle)
        if value >= 0:
            weight_low, weight_high = 1.0, weight_high / 2 if side > 0 else weight_high
            low, f_low, side = middle, value, 1
        else:
            weight_high, weight_low = 1.0, weight_low / 2 if side < 0 else weight_low
            high, f_high, side = middle, value, -1
    return low

"""Velocity fields of the pads before the impact and of the box after it; continuously differentiable in position.

The acceleration of a field is its derivative along itself, not along the measured velocity.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from impact_envs.compiled import compiled, interpret
from impact_envs.elementary import apply, exp, hypot
from impact_envs.physics.multibody import factorise, solve_factorised

NEAR = 1e-9  # below this a distance [m] or a velocity [m/s] has no direction


class AnteField(NamedTuple):
    """The velocity field of the pads before the impact.

    Attributes:
        points: desired impact positions of the pads, shape (2, 2) [m].
        velocities: desired velocities there, shape (2, 2) [m/s].
        headings: of the pads, shape (2,) [rad].
        box: estimated x, y, heading of the box, shape (3,) [m, rad].
        alpha, r_min, r_max, kappa_theta: see `options.ControllerOptions` [1/s], [m], [m], [1/s].
    """

    points: np.ndarray
    velocities: np.ndarray
    headings: np.ndarray
    box: np.ndarray
    alpha: float
    r_min: float
    r_max: float
    kappa_theta: float


class PostField(NamedTuple):
    """The velocity field of the box after the impact.

    Attributes:
        start: estimated pose just after the impact, shape (3,) [m, rad].
        twist: predicted velocity just after the impact, shape (3,) [m/s, rad/s].
        target: final pose, shape (3,) [m, rad].
        kappa, kappa_theta, r_max: see `options.ControllerOptions` [1/s], [1/s], [m].
        blend: start at the predicted velocity and leave it over r_max.
    """

    start: np.ndarray
    twist: np.ndarray
    target: np.ndarray
    kappa: float
    kappa_theta: float
    r_max: float
    blend: bool


@compiled
def compute_smoothstep(r: float, r_min: float, r_max: float) -> tuple[float, float]:
    """Return S_1 = 3 w^2 - 2 w^3 with w = (r - r_min) / (r_max - r_min), held at 0 and 1, and its derivative.

    Source: van Steen et al., Eqs. 12 and 13.
    """
    if r <= r_min:
        return 0.0, 0.0
    if r >= r_max:
        return 1.0, 0.0
    w = (r - r_min) / (r_max - r_min)
    return w * w * (3.0 - 2.0 * w), 6.0 * w * (1.0 - w) / (r_max - r_min)


@compiled
def compute_ante_velocity(field: AnteField, i: int, x: float, y: float) -> tuple[float, float]:
    """Return the extended velocity reference of pad i at a position.

    v = |v_imp| w / |w| with w = v_imp + alpha (p_t - p) and p_t = p_imp - v_imp / |v_imp| |p_imp - p|, blended into
    v_imp near the box: beta v + (1 - beta) v_imp, beta = S_1(|p - p_b|).

    Args:
        field: the reference.
        i: pad, 0 or 1.
        x, y: its position [m].

    Returns:
        Velocity [m/s].

    Source: van Steen et al., Eqs. 8 to 11.
    """
    vx, vy, _, _ = _differentiate_ante(field, i, x, y, 0.0, 0.0)
    return vx, vy


@compiled
def compute_ante_acceleration(field: AnteField, i: int, x: float, y: float) -> tuple[float, float]:
    """Return the acceleration of a pad that follows the velocity reference: (d v / d p) v.

    Source: van Steen et al., Eq. 27.
    """
    vx, vy, _, _ = _differentiate_ante(field, i, x, y, 0.0, 0.0)
    _, _, ax, ay = _differentiate_ante(field, i, x, y, vx, vy)
    return ax, ay


@compiled
def _differentiate_ante(
    field: AnteField, i: int, x: float, y: float, dx: float, dy: float
) -> tuple[float, float, float, float]:
    """Return the field and its derivative along (dx, dy)."""
    ux, uy = field.velocities[i, 0], field.velocities[i, 1]
    cx, cy = x - field.box[0], y - field.box[1]
    r = hypot(cx, cy)
    beta, slope = compute_smoothstep(r, field.r_min, field.r_max)
    speed = hypot(ux, uy)
    if beta == 0.0 or speed < NEAR:
        return ux, uy, 0.0, 0.0
    alpha = field.alpha
    ex, ey = field.points[i, 0] - x, field.points[i, 1] - y
    away = max(hypot(ex, ey), NEAR)
    wx = ux + alpha * (ex - ux / speed * away)
    wy = uy + alpha * (ey - uy / speed * away)
    size = hypot(wx, wy)
    if size < NEAR:
        return ux, uy, 0.0, 0.0
    closing = (ex * dx + ey * dy) / away
    wx_d, wy_d = alpha * (ux / speed * closing - dx), alpha * (uy / speed * closing - dy)
    nx, ny = wx / size, wy / size
    along = nx * wx_d + ny * wy_d
    vx, vy = speed * nx, speed * ny
    vx_d, vy_d = speed * (wx_d - nx * along) / size, speed * (wy_d - ny * along) / size
    beta_d = slope * (cx * dx + cy * dy) / r
    return (
        beta * vx + (1.0 - beta) * ux,
        beta * vy + (1.0 - beta) * uy,
        beta * vx_d + beta_d * (vx - ux),
        beta * vy_d + beta_d * (vy - uy),
    )


@compiled
def compute_ante_rate(field: AnteField, i: int, heading: float) -> tuple[float, float]:
    """Return angular velocity and acceleration references: kappa (theta_d - theta), wrapped, and its derivative.

    Source: van Steen et al., Eqs. 14 to 16.
    """
    turn = field.headings[i] - heading
    turn -= 2.0 * math.pi * math.floor(turn / (2.0 * math.pi) + 0.5)
    rate = field.kappa_theta * turn
    return rate, -field.kappa_theta * rate


@compiled
def compute_post_reference(
    field: PostField, x: float, y: float, heading: float
) -> tuple[float, float, float, float, float, float]:
    """Return velocity and acceleration references of the box at a pose.

    v = beta kappa (p_f - p) + (1 - beta) v+, beta = S_1(|p - p+|; 0, r_max), and the angle likewise with the same beta;
    beta = 1 without blending.

    Args:
        field: the reference.
        x, y, heading: of the box [m, rad].

    Returns:
        v_x, v_y, omega [m/s, rad/s] and their derivatives along themselves [m/s^2, rad/s^2].

    Source: van Steen et al., Eqs. 17 to 21, with |p - p+| where Eq. 19 prints a velocity.
    """
    kappa, turn = field.kappa, field.kappa_theta
    gx, gy, gw = kappa * (field.target[0] - x), kappa * (field.target[1] - y), turn * (field.target[2] - heading)
    if not field.blend:
        return gx, gy, gw, -kappa * gx, -kappa * gy, -turn * gw
    cx, cy = x - field.start[0], y - field.start[1]
    r = hypot(cx, cy)
    beta, slope = compute_smoothstep(r, 0.0, field.r_max)
    hx, hy, hw = field.twist[0], field.twist[1], field.twist[2]
    vx, vy, w = beta * gx + (1.0 - beta) * hx, beta * gy + (1.0 - beta) * hy, beta * gw + (1.0 - beta) * hw
    beta_d = slope * (cx * vx + cy * vy) / r if r > NEAR else 0.0
    return (
        vx,
        vy,
        w,
        beta_d * (gx - hx) - beta * kappa * vx,
        beta_d * (gy - hy) - beta * kappa * vy,
        beta_d * (gw - hw) - beta * turn * w,
    )


class ImpactMap(NamedTuple):
    """The predicted velocity of the box after an impact, by radial basis functions of the heights of contact.

    Attributes:
        heights: of the simulated impacts, y of both pads in the box frame, shape (n, 2) [m].
        weights: W with V = W Phi, shape (3, n).
        rho: 1 over the width of a basis function [1/m].
    """

    heights: np.ndarray
    weights: np.ndarray
    rho: float


def make_impact_map(heights: np.ndarray, twists: np.ndarray, rho: float) -> ImpactMap:
    """Interpolate simulated velocities after impacts: W = V Phi^-1, Phi_ij = exp(-(rho |y_i - y_j|)^2).

    Args:
        heights: y of both pads in the box frame, shape (n, 2) [m].
        twists: velocity of the box after each impact, shape (n, 3) [m/s, rad/s].
        rho: 1 over the width of a basis function [1/m].

    Returns:
        The interpolation.

    Source: van Steen et al., App. A, Eq. A.1 with the dimensions of W corrected.
    """
    apart = rho * (heights[:, None] - heights[None])
    near = apply(interpret(exp), -(apart[..., 0] * apart[..., 0] + apart[..., 1] * apart[..., 1]))
    weights = np.ascontiguousarray(twists.T)
    # Not LAPACK: it is rounded otherwise on other processors.
    factorise(near)
    for row in weights:
        solve_factorised(near, row)
    return ImpactMap(np.ascontiguousarray(heights), weights, rho)


@compiled
def predict_twist(impact_map: ImpactMap, heights: np.ndarray, twist: np.ndarray) -> None:
    """Write the predicted velocity of the box after an impact.

    Heights are clipped to the simulated ones: outside, the basis functions fall to zero.

    Args:
        impact_map: the interpolation.
        heights: y of both pads in the box frame at the impact, shape (2,) [m].
        twist: written, shape (3,) [m/s, rad/s].

    Source: van Steen et al., Eq. A.2.
    """
    first, second = heights[0], heights[1]
    low_1, low_2 = impact_map.heights[0, 0], impact_map.heights[0, 1]
    high_1, high_2 = low_1, low_2
    count = len(impact_map.heights)
    for i in range(count):
        low_1, high_1 = min(low_1, impact_map.heights[i, 0]), max(high_1, impact_map.heights[i, 0])
        low_2, high_2 = min(low_2, impact_map.heights[i, 1]), max(high_2, impact_map.heights[i, 1])
    first, second = min(max(first, low_1), high_1), min(max(second, low_2), high_2)
    twist[0] = twist[1] = twist[2] = 0.0
    for i in range(count):
        away = impact_map.rho * hypot(impact_map.heights[i, 0] - first, impact_map.heights[i, 1] - second)
        near = exp(-(away * away))
        for r in range(3):
            twist[r] += impact_map.weights[r, i] * near

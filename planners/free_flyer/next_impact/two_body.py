"""Two-body impact: which approach of a disc robot gives a disc object the velocity it should have.

Scalar functions in the subset of Python that numba compiles: they run at every replan, in batches too.
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import NamedTuple

from impact_envs.compiled import compiled
from impact_envs.elementary import atan2, cos_sin
from impact_envs.physics.impact import compute_velocity_gain

Pair = tuple[float, float]

NO_CHANGE = 1e-9  # velocity changes below this [m/s] have no direction


class Outcome(IntEnum):
    """Say how much of the desired velocity an impact can give."""

    EXACT = 0  # the object gets exactly the desired velocity
    NOT_NEEDED = 1  # the object already has it, the robot matches its velocity
    TOO_FAST = 2  # beyond the speed limit: the impulse has the right direction and the nearest possible size
    OUT_OF_REACH = 3  # the object flees faster than the robot may fly: no impulse in this direction exists


class TwoBodyImpact(NamedTuple):
    """Hold the answer of the two-body impact problem; pairs are (x, y) in the world frame.

    Attributes:
        outcome: an `Outcome`.
        normal: unit vector from robot to object, the direction of the impulse.
        contact: centre of the robot at the impact [m].
        robot_minus, robot_plus: velocity of the robot just before and after [m/s].
        object_minus, object_plus: velocity of the object just before and after [m/s].
    """

    outcome: Outcome
    normal: Pair
    contact: Pair
    robot_minus: Pair
    robot_plus: Pair
    object_minus: Pair
    object_plus: Pair


@compiled
def clip_tangential(normal_speed: float, wish: float, normal: Pair, limit: float) -> float:
    """Return the tangential speed nearest to a wish for which both axes keep the speed limit.

    nearest t with |v_n n_i + t t_i| <= limit, t = (-n_y, n_x)

    Args:
        normal_speed: v_n, at most limit (|n_x| + |n_y|) in size [m/s].
        wish: wanted tangential speed [m/s].
        normal: unit vector.
        limit: greatest speed per axis [m/s].

    Returns:
        Tangential speed along (-n_y, n_x) [m/s].
    """
    low, high = -math.inf, math.inf
    for along, across in ((normal[0], -normal[1]), (normal[1], normal[0])):
        if abs(across) > 1e-12:
            a = (-limit - normal_speed * along) / across
            b = (limit - normal_speed * along) / across
            low, high = max(low, min(a, b)), min(high, max(a, b))
    return min(max(wish, low), high)


@compiled
def compute_lever_gain(restitution: float, robot_mass: float, object_mass: float, lever: float) -> float:
    """Return alpha = (1 + e) / (1 + m_O / m_R + lever), the object's change of speed per speed of approach.

    Args:
        restitution, robot_mass, object_mass, lever: see `solve_two_body_impact`.
    """
    gain = compute_velocity_gain(restitution, robot_mass, object_mass)
    return gain / (1.0 + lever * robot_mass / (robot_mass + object_mass))


@compiled
def solve_two_body_impact(
    object_position: Pair,
    object_minus: Pair,
    object_desired: Pair,
    robot_wish: Pair,
    default_normal: Pair,
    robot_mass: float,
    object_mass: float,
    restitution: float,
    reach: float,
    speed_limit: float,
    lever: float = 0.0,
) -> TwoBodyImpact:
    r"""Solve the two-body impact problem in closed form.

    With Delta = v_des - v_O^- everything but the tangential motion of the robot is fixed:
    n = Delta / |Delta|, s = |Delta| / alpha, v_R^- . n = v_O^- . n + s, p_R = p_O - (r_R + r_O) n;
    v_O^+ = v_O^- + alpha s n, v_R^+ = v_R^- - (m_O / m_R) alpha s n. The tangential speed is the one
    nearest to the wish. Where a speed limit forbids s, n stays and s is as near as possible.

    Args:
        object_position: centre of the object at the impact [m].
        object_minus: v_O^-, velocity of the object before [m/s].
        object_desired: v_des, the velocity it should have after [m/s].
        robot_wish: velocity whose tangential part the robot takes over [m/s].
        default_normal: unit normal to take when no impact is needed.
        robot_mass: m_R [kg].
        object_mass: m_O [kg].
        restitution: coefficient of restitution e.
        reach: r_R + r_O [m].
        speed_limit: greatest speed of the robot per axis [m/s].
        lever: of a hit beside the object's centre of mass, see `offset.compute_lever`; then v_O^- is the velocity of
            the geometric centre, and v_O^+ the one it would have if the object did not turn.

    Returns:
        The answer, whose outcome says whether it is exact.

    Source: Verhagen & Tumova, Appendix A, Eq. 32 with the object's velocity as a hard constraint, and Eq. 6.
    """
    delta_x, delta_y = object_desired[0] - object_minus[0], object_desired[1] - object_minus[1]
    size = math.hypot(delta_x, delta_y)
    needed = size > NO_CHANGE
    normal = (delta_x / size, delta_y / size) if needed else default_normal
    alpha = compute_lever_gain(restitution, robot_mass, object_mass, lever)
    approach = size / alpha if needed else 0.0
    return limit_approach(
        object_position,
        object_minus,
        robot_wish,
        normal,
        approach,
        needed,
        alpha,
        robot_mass,
        object_mass,
        reach,
        speed_limit,
    )


@compiled
def solve_soft_two_body_impact(
    object_position: Pair,
    object_minus: Pair,
    object_desired: Pair,
    robot_wish: Pair,
    default_normal: Pair,
    robot_mass: float,
    object_mass: float,
    restitution: float,
    reach: float,
    speed_limit: float,
    object_weight: float,
    robot_weight: float,
    lever: float = 0.0,
) -> TwoBodyImpact:
    r"""Solve the two-body impact problem with both velocities as wishes, exactly, as a 2x2 eigenproblem.

    min  w_O |v_O^+ - v_des|^2 + w_R |v_R^- - w|^2  over n, v_R^- with (v_R^- - v_O^-) . n >= 0 and Eq. 6

    With Delta = v_des - v_O^-, g = w - v_O^-, s = (v_R^- - v_O^-) . n and the tangential speed of the wish the cost is
    w_O |alpha s n - Delta|^2 + w_R (s - g . n)^2. Its minimum over s, where D = w_O alpha^2 + w_R and
    b = w_O alpha Delta + w_R g, is at s = b . n / D:  J(n) = w_O |Delta|^2 + n' M n,  M = w_R g g' - b b' / D.
    So n is the eigenvector of M to its smaller eigenvalue, with the sign for which b . n >= 0. That eigenvalue is never
    positive, because det M = -w_R w_O^2 alpha^2 (g x Delta)^2 / D: the best impact costs no more than none at all. As
    w_R / w_O goes to 0 the answer goes to that of `solve_two_body_impact`. Where a speed limit forbids s, n stays
    and s is as near as possible.

    Args:
        object_position, object_minus, object_desired: see `solve_two_body_impact`.
        robot_wish: w, velocity that the robot should have before [m/s].
        default_normal: unit normal to take where all are equally good.
        robot_mass, object_mass, restitution, reach, speed_limit, lever: see `solve_two_body_impact`.
        object_weight: w_O, positive, on the object's velocity [s^2/m^2].
        robot_weight: w_R, positive, on the robot's velocity [s^2/m^2].

    Returns:
        The answer, whose outcome says whether it is the optimum.

    Source: Verhagen & Tumova, Appendix A, Eq. 32 with squared norms, and Eq. 6.
    """
    alpha = compute_lever_gain(restitution, robot_mass, object_mass, lever)
    gx, gy = robot_wish[0] - object_minus[0], robot_wish[1] - object_minus[1]
    pull, D = object_weight * alpha, object_weight * alpha * alpha + robot_weight
    bx = pull * (object_desired[0] - object_minus[0]) + robot_weight * gx
    by = pull * (object_desired[1] - object_minus[1]) + robot_weight * gy
    xx, xy = robot_weight * gx * gx - bx * bx / D, robot_weight * gx * gy - bx * by / D
    yy = robot_weight * gy * gy - by * by / D
    normal = default_normal
    if xx != 0.0 or xy != 0.0 or yy != 0.0:
        larger = atan2(2.0 * xy, xx - yy) / 2.0
        cos, sin = cos_sin(larger)
        normal = (-sin, cos)
    approach = (bx * normal[0] + by * normal[1]) / D
    if approach < 0.0:
        normal, approach = (-normal[0], -normal[1]), -approach
    return limit_approach(
        object_position,
        object_minus,
        robot_wish,
        normal,
        approach,
        alpha * approach > NO_CHANGE,
        alpha,
        robot_mass,
        object_mass,
        reach,
        speed_limit,
    )


@compiled
def limit_approach(
    object_position: Pair,
    object_minus: Pair,
    robot_wish: Pair,
    normal: Pair,
    approach: float,
    needed: bool,
    gain: float,
    robot_mass: float,
    object_mass: float,
    reach: float,
    speed_limit: float,
) -> TwoBodyImpact:
    """Return the impact along a normal whose approach speed is as near as possible to a wanted one.

    Args:
        object_position, object_minus, robot_wish, reach, speed_limit: see `solve_two_body_impact`.
        normal: unit vector from robot to object.
        approach: wanted (v_R^- - v_O^-) . n [m/s].
        needed: whether there is anything to gain.
        gain: alpha, see `compute_velocity_gain`.
        robot_mass, object_mass: [kg].
    """
    object_speed = object_minus[0] * normal[0] + object_minus[1] * normal[1]
    wanted = object_speed + approach
    fastest = speed_limit * (abs(normal[0]) + abs(normal[1]))
    normal_speed = min(max(wanted, -fastest), fastest)
    possible = max(normal_speed - object_speed, 0.0)
    if not needed:
        outcome = Outcome.NOT_NEEDED
    elif normal_speed == wanted:
        outcome = Outcome.EXACT
    else:
        outcome = Outcome.TOO_FAST if possible > 0.0 else Outcome.OUT_OF_REACH

    wish = robot_wish[1] * normal[0] - robot_wish[0] * normal[1]
    sideways = clip_tangential(normal_speed, wish, normal, speed_limit)
    robot_minus = (
        normal_speed * normal[0] - sideways * normal[1],
        normal_speed * normal[1] + sideways * normal[0],
    )
    jump = gain * possible
    recoil = jump * object_mass / robot_mass
    return TwoBodyImpact(
        outcome,
        normal,
        (object_position[0] - reach * normal[0], object_position[1] - reach * normal[1]),
        robot_minus,
        (robot_minus[0] - recoil * normal[0], robot_minus[1] - recoil * normal[1]),
        object_minus,
        (object_minus[0] + jump * normal[0], object_minus[1] + jump * normal[1]),
    )

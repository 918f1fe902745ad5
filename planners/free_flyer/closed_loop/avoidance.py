"""Keep robots off bodies that they are not to hit: barriers on their acceleration, ours and the published; compiled."""

from __future__ import annotations

import math

from impact_envs.compiled import compiled
from planners.free_flyer.belief.options import Options
from planners.free_flyer.belief.plan_table import PlanTable
from planners.free_flyer.belief.world_memory import WorldMemory
from planners.free_flyer.tracking.mpc import GAIN, INPUT_LIMIT

NO_TARGET = -1


@compiled
def avoid_bodies(
    plan: PlanTable, memory: WorldMemory, options: Options, k: int, r: int, target: int, ax: float, ay: float
) -> tuple[float, float, float]:
    r"""Return the acceleration nearest to a desired one with which robot r can still brake before all but its target.

    (v_r - v_j) . n + h a . n <= sqrt(b^2 h^2 + 2 b max(d - d_min, 0)) - b h for each body j, n from robot to body, b
    the braking acceleration (of both, if both are robots): the row of a barrier, projected onto in turn. What the
    limits leave of it is slack; a robot that hits is exempt from the object it hits.

    Args:
        target: body that the robot is on course to hit, or NO_TARGET.
        ax, ay: desired acceleration [m/s^2].

    Returns:
        Acceleration [m/s^2], and the greatest slack [m/s].

    Source: Ames et al., Control barrier functions: theory and applications, 2019; braking distance v^2 / (2 b).
    """
    h, z = plan.period, memory.filter[k, r]
    most = plan.pilot[r, GAIN] * plan.pilot[r, INPUT_LIMIT]
    slack, changed = 0.0, False
    for _ in range(options.avoidance.sweeps):
        slack = 0.0
        for j in range(len(plan.body)):
            if j in (r, target):
                continue
            y = memory.filter[k, j]
            dx, dy = y.position[0] - z.position[0], y.position[1] - z.position[1]
            distance = math.hypot(dx, dy)
            nx, ny = dx / max(distance, 1e-9), dy / max(distance, 1e-9)
            room = distance - plan.body[r].radius - plan.body[j].radius - options.avoidance.clearance
            brake = options.avoidance.braking * most
            if j < plan.robots and not memory.course[k, j].ends_in_impact:
                brake *= 2.0
            lost = brake * h  # a control period passes before it brakes
            fastest = math.sqrt(lost * lost + 2.0 * brake * max(room, 0.0)) - lost
            closing = (z.velocity[0] - y.velocity[0]) * nx + (z.velocity[1] - y.velocity[1]) * ny
            excess = closing + h * (ax * nx + ay * ny) - fastest
            if excess > 0.0:
                slack, changed = max(slack, excess), True
                ax, ay = ax - excess / h * nx, ay - excess / h * ny
                size = math.hypot(ax, ay)
                if size > most:
                    ax, ay = ax * most / size, ay * most / size
    memory.counts[k].avoided += 1 if changed else 0
    return ax, ay, slack


@compiled
def hold_barrier(
    plan: PlanTable, memory: WorldMemory, options: Options, k: int, r: int, target: int, ax: float, ay: float
) -> tuple[float, float, float]:
    r"""Return the acceleration nearest to a desired one that keeps the published barrier to all objects but the target.

    h'' + gamma_1 h' + gamma_0 h >= -delta,  h = |p_r - p_o|^2 - (r_r + r_o + clearance)^2, the object unaccelerated

    What the limits leave of it is the slack delta.

    Args:
        target: body that the robot is about to hit, or NO_TARGET.
        ax, ay: desired acceleration [m/s^2].

    Returns:
        Acceleration [m/s^2], and the greatest slack [m^2/s^2].

    Source: Verhagen & Tumova, Secs. VII and VIII-A.2: a control barrier function; its form and numbers from the
        published code, which adds it to the first stage of the MPC.
    """
    z, published = memory.filter[k, r], options.published
    most = plan.pilot[r, GAIN] * plan.pilot[r, INPUT_LIMIT]
    slack, changed = 0.0, False
    for j in range(plan.robots, len(plan.body)):
        if j == target:
            continue
        y = memory.filter[k, j]
        dx, dy = z.position[0] - y.position[0], z.position[1] - y.position[1]
        vx, vy = z.velocity[0] - y.velocity[0], z.velocity[1] - y.velocity[1]
        apart, reach = dx * dx + dy * dy, plan.body[r].radius + plan.body[j].radius + published.clearance
        free = 2.0 * (vx * vx + vy * vy + published.damping * (dx * vx + dy * vy))
        free += published.stiffness * (apart - reach * reach)
        missing = -free - 2.0 * (dx * ax + dy * ay)
        if missing > 0.0:
            changed, share = True, missing / (2.0 * max(apart, 1e-9))
            ax, ay = ax + share * dx, ay + share * dy
            size = math.hypot(ax, ay)
            if size > most:
                ax, ay = ax * most / size, ay * most / size
                slack = max(slack, -free - 2.0 * (dx * ax + dy * ay))
    memory.counts[k].avoided += 1 if changed else 0
    return ax, ay, slack

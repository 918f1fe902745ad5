"""Keep robots off bodies that they are not to hit: braking-distance barriers on their acceleration; compiled."""

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

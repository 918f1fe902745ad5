"""Keep robots off what they are not to hit: barriers on their acceleration, ours and the published; compiled."""

from __future__ import annotations

import math

from impact_envs.compiled import compiled, inlined
from planners.free_flyer.belief.options import Options
from planners.free_flyer.belief.plan_table import PlanTable
from planners.free_flyer.belief.surroundings import WALLS, get_inset, measure_distance
from planners.free_flyer.belief.world_memory import WorldMemory
from planners.free_flyer.tracking.mpc import GAIN, INPUT_LIMIT

NO_TARGET = -1
ROUND_OFF = 1e-9  # share, or square of a speed [m^2/s^2], by which what is no danger is told without roots


@compiled
def avoid_bodies(
    plan: PlanTable, memory: WorldMemory, options: Options, k: int, r: int, target: int, ax: float, ay: float
) -> tuple[float, float, float]:
    r"""Return the acceleration nearest to a desired one with which robot r can still brake before all but its target.

    (v_r - v_j) . n + h a . n <= sqrt(b^2 h^2 + 2 b max(d - d_min, 0)) - b h for each body j, n from robot to body, b
    the braking acceleration (of both, if both are robots): the row of a barrier, projected onto in turn. What the
    limits leave of it is slack; a robot that hits is exempt from the object it hits. Where options say so, walls and
    solid obstacles are such bodies, too.

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
            if j == r:
                continue
            early = find_earliness(plan, memory, options, k, r, target) if j == target else math.inf
            if early <= 0.0:
                continue
            y = memory.filter[k, j]
            dx, dy = y.position[0] - z.position[0], y.position[1] - z.position[1]
            vx, vy = z.velocity[0] - y.velocity[0] + h * ax, z.velocity[1] - y.velocity[1] + h * ay
            if vx * dx + vy * dy < -ROUND_OFF:
                continue
            distance = math.hypot(dx, dy)
            nx, ny = dx / max(distance, 1e-9), dy / max(distance, 1e-9)
            clearance = options.avoidance.target_clearance if j == target else options.avoidance.clearance
            room = distance - plan.body[r].radius - plan.body[j].radius - clearance
            brake = options.avoidance.braking * most
            if j < plan.robots and not memory.course[k, j].ends_in_impact:
                brake *= 2.0
            fastest = compute_fastest(brake, room, h)
            if j == target:
                fastest = max(fastest, max(room, 0.0) / early)
            closing = (z.velocity[0] - y.velocity[0]) * nx + (z.velocity[1] - y.velocity[1]) * ny
            excess = closing + h * (ax * nx + ay * ny) - fastest
            if excess > 0.0:
                slack, changed = max(slack, excess), True
                ax, ay = reduce_closing(ax, ay, nx, ny, excess / h, most)
        first = WALLS if options.walls and is_off_walls(plan, memory, options, k, r, ax, ay) else 0
        for i in range(first, WALLS + len(plan.solid) if options.walls else 0):
            if get_inset(plan, i, r) == -math.inf:
                continue
            fastest, nx, ny = limit_speed(plan, memory, options, k, r, target, i)
            excess = z.velocity[0] * nx + z.velocity[1] * ny + h * (ax * nx + ay * ny) - fastest
            if excess > 0.0:
                slack, changed = max(slack, excess), True
                ax, ay = reduce_closing(ax, ay, nx, ny, excess / h, most)
        if slack == 0.0:  # a further sweep would change nothing
            break
    memory.counts[k].avoided += 1 if changed else 0
    return ax, ay, slack


@compiled
def find_earliness(plan: PlanTable, memory: WorldMemory, options: Options, k: int, r: int, target: int) -> float:
    """Return for how long robot r may not yet touch its target [s]: 0 or less: it may, inf: it is on the wrong side."""
    strike, z, y = memory.strike[k, target - plan.robots], memory.filter[k, r], memory.filter[k, target]
    if not strike.is_solved:
        return 0.0
    dx, dy = y.position[0] - z.position[0], y.position[1] - z.position[1]
    if dx * strike.normal[0] + dy * strike.normal[1] < options.avoidance.target_side * math.hypot(dx, dy):
        return math.inf
    return strike.time - memory.time[k] - options.avoidance.target_early


@inlined
def compute_fastest(brake: float, room: float, h: float) -> float:
    """Return the speed from which a robot that may not go on for longer than a room stops in it [m/s]."""
    lost = brake * h  # a control period passes before it brakes
    return math.sqrt(lost * lost + 2.0 * brake * max(room, 0.0)) - lost


@inlined
def reduce_closing(ax: float, ay: float, nx: float, ny: float, excess: float, most: float) -> tuple[float, float]:
    """Return an acceleration less its excess along a direction, within the greatest one [m/s^2]."""
    ax, ay = ax - excess * nx, ay - excess * ny
    size = math.hypot(ax, ay)
    if size > most:
        ax, ay = ax * most / size, ay * most / size
    return ax, ay


@inlined
def is_off_walls(plan: PlanTable, memory: WorldMemory, options: Options, k: int, r: int, ax: float, ay: float) -> bool:
    """Return whether robot r would stop before the nearest wall even if it flew straight at it: so most of the time."""
    z, h, walls = memory.filter[k, r], plan.period, plan.walls
    x, y = z.position[0], z.position[1]
    nearest = min(min(x - walls[0], walls[2] - x), min(y - walls[1], walls[3] - y))
    room = nearest - plan.body[r].radius - options.surroundings.clearance
    brake = options.avoidance.braking * plan.pilot[r, GAIN] * plan.pilot[r, INPUT_LIMIT]
    lost = brake * h
    most = abs(z.velocity[0]) + abs(z.velocity[1]) + h * (abs(ax) + abs(ay)) + lost
    return room > 0.0 and most * most < (1.0 - ROUND_OFF) * (lost * lost + 2.0 * brake * room)


@compiled
def limit_speed(
    plan: PlanTable, memory: WorldMemory, options: Options, k: int, r: int, target: int, i: int
) -> tuple[float, float, float]:
    """Return how fast robot r may close in on fixed body i [m/s], and the unit vector to it.

    It stops at a clearance. On course to an impact it may come as near as the place of contact is, and as fast as that
    impact needs if it does not reach the wall before the impact.
    """
    z, h = memory.filter[k, r], plan.period
    distance, nx, ny = measure_distance(plan, i, z.position[0], z.position[1])
    inset = get_inset(plan, i, r)
    gap, clearance = distance - inset, options.surroundings.clearance
    brake = options.avoidance.braking * plan.pilot[r, GAIN] * plan.pilot[r, INPUT_LIMIT]
    if target == NO_TARGET:
        return compute_fastest(brake, gap - clearance, h), nx, ny
    strike = memory.strike[k, target - plan.robots]
    left = measure_distance(plan, i, strike.contact[0], strike.contact[1])[0] - inset
    clearance = min(clearance, max(left, 0.0))
    fastest = compute_fastest(brake, gap - clearance, h)
    late = strike.time + options.surroundings.late - memory.time[k]
    if left >= 0.0 and late > 0.0:
        needed = strike.robot_minus[0] * nx + strike.robot_minus[1] * ny
        fastest = max(fastest, min(gap / max(late, h), needed))
    return fastest, nx, ny


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

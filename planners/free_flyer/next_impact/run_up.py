"""How fast a robot can be where it hits an object, by the room that it has behind it to run up; compiled."""

from __future__ import annotations

import math

from impact_envs.compiled import compiled
from planners.free_flyer.belief.estimator import extrapolate_flight
from planners.free_flyer.belief.options import Options
from planners.free_flyer.belief.plan_table import PlanTable
from planners.free_flyer.belief.surroundings import measure_gap
from planners.free_flyer.belief.world_memory import WorldMemory
from planners.free_flyer.next_impact.two_body import NO_CHANGE
from planners.free_flyer.tracking.mpc import GAIN, INPUT_LIMIT


@compiled
def find_run_up_share(
    plan: PlanTable,
    memory: WorldMemory,
    options: Options,
    k: int,
    r: int,
    o: int,
    place: tuple[float, float],
    velocity: tuple[float, float],
    change: tuple[float, float],
    reach: float,
    gain: float,
) -> float:
    """Return the share of a change of object o's velocity that robot r can give it after a run-up from rest.

    v_R . n <= sqrt(2 a d), with the room d behind the place of contact, straight against the impulse

    Args:
        place, velocity: of the object at the impact [m], [m/s].
        change: wished, of its velocity [m/s].
        reach: from its centre to the robot's at the contact [m].
        gain: change of the object's speed per speed of approach.
    """
    size = math.hypot(change[0], change[1])
    if size < NO_CHANGE:
        return 1.0
    nx, ny = change[0] / size, change[1] / size
    most = options.reach.run_up * plan.pilot[r, GAIN] * plan.pilot[r, INPUT_LIMIT]
    along, approach = velocity[0] * nx + velocity[1] * ny, size / gain
    needed = max(along + approach, 0.0)
    x, y, time = place[0] - reach * nx, place[1] - reach * ny, memory.strike[k, o].time
    room, far = 0.0, needed * needed / (2.0 * most)
    for _ in range(options.reach.steps):
        gap = measure_gap(plan, r, x - room * nx, y - room * ny)
        for j in range(len(plan.first)):
            if j != o:
                ox, oy, _, _ = extrapolate_flight(memory, k, plan.robots + j, time)
                apart = math.hypot(x - room * nx - ox, y - room * ny - oy)
                gap = min(gap, apart - plan.body[r].radius - plan.body[plan.robots + j].radius)
        room += max(gap, 0.0)
        if room >= far:
            return 1.0
    fastest = math.sqrt(2.0 * most * room)
    return min(max((fastest - along) / approach, 0.0), 1.0)

"""Optimise the rest of a plan after an impact: when and where the object is hit next; who hits it is kept; compiled.

Unknown are the places P_i and times t_i of the impacts that are left. The next one lies on the object's present flight,
P_1 = x_O + v_O (t_1 - now); all the others are free. The sequence of robots and objects is kept. Then the demands of
the formula, the time windows, the speed limit of objects and the times that robots need are rows in (P, t), and the
best point is a projection:

    min (rho_plan - rho)^2 / s_rho^2 + sum |P_i - P_i,plan|^2 / s_P^2 + sum (t_i - t_i,now)^2 / s_t^2
    with H_i P_i + rho <= b_i, ...
"""

from __future__ import annotations

import math
from typing import NamedTuple

from impact_envs.compiled import compiled
from planners.free_flyer.belief.estimator import extrapolate_flight
from planners.free_flyer.belief.options import Options
from planners.free_flyer.belief.plan_table import NO_IMPACT, PlanTable
from planners.free_flyer.belief.world_memory import WorldMemory
from planners.free_flyer.next_impact.projection import FOUND, project_point
from planners.free_flyer.next_impact.reachability import compute_leg_speed, compute_time
from planners.free_flyer.next_impact.rest_qp import (
    MOST_KNOTS,
    Rest,
    RestQP,
    open_row,
    put_place,
    put_time,
    put_variable,
)

NO_STAGE = -1


class Way(NamedTuple):
    """A way of a robot between an impact of the chain and another place.

    Attributes:
        robot: its number.
        stage: of the impact in the chain.
        here: place of the object at that impact, as expected now [m].
        vector: from the other place to the robot's at the impact, as expected now [m].
        time: at the other place [s].
        sign: 1: the robot comes from there, -1: it goes there.
        longest: time that the way may be given [s].
    """

    robot: int
    stage: int
    here: tuple[float, float]
    vector: tuple[float, float]
    time: float
    sign: float
    longest: float


@compiled
def reoptimise_rest(
    plan: PlanTable, memory: WorldMemory, options: Options, qp: RestQP, c: int, k: int, o: int, now: float
) -> bool:
    """Optimise the places and times of object o's impacts that are left; return whether a feasible point exists.

    Args:
        memory: of all worlds; `place` and `clock` are written if one exists.
        o: object, with a planned impact to come and none inserted.
        now: [s].
    """
    stages = _find_chain(plan, memory, qp, c, k, o)
    size = 3 * stages + 1
    rows, bounds, used = qp.rows[c], qp.bounds[c], qp.used[c : c + 1]
    rest = Rest(stages, qp.chain[c], qp.line[c], qp.centre[c], qp.scale[c], rows, bounds, used)
    _set_references(plan, memory, options, rest, k, o)
    _add_demands(plan, rest)
    _add_order(plan, memory, options, rest, k, now)
    _add_flights(plan, options, rest, o)
    _add_robots(plan, memory, options, rest, k, o, now)
    point = qp.point[c, :size]
    for i in range(size):
        point[i] = 0.0
    if project_point(rest.rows[:, :size], rest.bounds, rest.used[0], point, qp.scratch[c]) != FOUND:
        return False
    for i in range(stages):
        memory.clock[k, rest.chain[i]] = rest.centre[i] + rest.scale[i] * point[i]
    memory.strike[k, o].time = memory.strike[k, o].due = memory.clock[k, rest.chain[0]]
    # Do not overwrite the first place: it is where the object is going, not where we want it.
    for i in range(1, stages + 1):
        knot, v = rest.chain[i], stages + 2 * (i - 1)
        for axis in range(2):
            memory.place[k, knot, axis] = rest.centre[v + axis] + rest.scale[v + axis] * point[v + axis]
    return True


@compiled
def _find_chain(plan: PlanTable, memory: WorldMemory, qp: RestQP, c: int, k: int, o: int) -> int:
    """Write the chain of object o's knots and when it ends, without any rows; return the number of impacts in it."""
    index, stages = memory.strike[k, o].index, 0
    while index != NO_IMPACT and stages < MOST_KNOTS:
        qp.chain[c, stages] = index
        index, stages = plan.impact[index].next, stages + 1
    qp.chain[c, stages] = len(plan.impact) + o if index == NO_IMPACT else index
    qp.line[c].end = plan.horizon if index == NO_IMPACT else memory.clock[k, index]
    qp.used[c] = 0
    return stages


@compiled
def _set_references(plan: PlanTable, memory: WorldMemory, options: Options, rest: Rest, k: int, o: int) -> None:
    """Set the centres and scales of the cost: of the times, of all places but the first, of rho."""
    depth, stages = math.inf, rest.stages
    for i in range(stages + 1):
        knot = rest.chain[i]
        depth = min(depth, plan.knot[knot].depth)
        if i < stages:
            rest.centre[i], rest.scale[i] = memory.clock[k, knot], options.reoptimisation.scale_time
        if i > 0:
            for axis in range(2):
                v = stages + 2 * (i - 1) + axis
                rest.centre[v], rest.scale[v] = plan.knot[knot].position[axis], options.reoptimisation.scale_place
    rho = 3 * stages
    rest.centre[rho], rest.scale[rho] = (depth if depth < math.inf else 0.0), options.reoptimisation.scale_rho
    # The object's flight to its next impact, as a line about the time at which that is expected.
    first = rest.chain[0]
    time, line = memory.clock[k, first], rest.line
    x, y, vx, vy = extrapolate_flight(memory, k, plan.robots + o, time)
    line.position[0], line.position[1] = x - vx * time, y - vy * time
    line.velocity[0], line.velocity[1] = vx, vy
    # Its first place is no variable: the cost of that place acts on its time.
    dx, dy = plan.knot[first].position[0] - x, plan.knot[first].position[1] - y
    there = (vx * vx + vy * vy) / (options.reoptimisation.scale_place * options.reoptimisation.scale_place)
    weight = there + 1.0 / (options.reoptimisation.scale_time * options.reoptimisation.scale_time)
    rest.centre[0] = (
        time + (vx * dx + vy * dy) / (options.reoptimisation.scale_place * options.reoptimisation.scale_place) / weight
    )
    rest.scale[0] = 1.0 / math.sqrt(weight)


@compiled
def _add_demands(plan: PlanTable, rest: Rest) -> None:
    """Add what the formula demands of the places, with the margin rho."""
    for i in range(rest.stages + 1):
        knot = rest.chain[i]
        for j in range(plan.knot[knot].faces):
            face = plan.face[knot, j]
            row = open_row(rest, face.offset)
            put_place(rest, row, i, face.normal[0], face.normal[1])
            put_variable(rest, row, 3 * rest.stages, 1.0)


@compiled
def _add_order(plan: PlanTable, memory: WorldMemory, options: Options, rest: Rest, k: int, now: float) -> None:
    """Add the windows, the order, and time at both ends."""
    for i in range(rest.stages):
        knot = rest.chain[i]
        opens, closes = plan.knot[knot].opens, plan.knot[knot].closes
        inset = min(options.reoptimisation.inset, (closes - opens) / 4)
        # Never later than the impact was expected, if that is later than the reserve allows.
        latest = max(
            plan.horizon - max(options.retiming.reserve, options.retiming.reserve_share * plan.horizon),
            memory.clock[k, knot],
        )
        row = open_row(rest, min(closes - inset, latest))
        put_time(rest, row, i, 1.0)
        earliest = (
            max(opens + inset, min(now + options.reoptimisation.notice, memory.clock[k, knot]))
            if i == 0
            else opens + inset
        )
        row = open_row(rest, -earliest)
        put_time(rest, row, i, -1.0)
        if i > 0:
            planned = plan.impact[knot].time - plan.impact[rest.chain[i - 1]].time
            row = open_row(rest, -min(options.reoptimisation.gap, planned))
            put_time(rest, row, i - 1, 1.0)
            put_time(rest, row, i, -1.0)


@compiled
def _add_flights(plan: PlanTable, options: Options, rest: Rest, o: int) -> None:
    """Add the object's speed limit, and cones round the planned normals for the legs before and after an impact."""
    limit = plan.body[plan.robots + o].speed_limit
    for i in range(rest.stages):
        here, there = rest.chain[i], rest.chain[i + 1]
        fastest = compute_leg_speed(plan, options, o, here, options.reoptimisation.share * limit)
        for axis in range(2):
            for side in range(2):
                sign = 1.0 - 2.0 * side
                x, y = (sign, 0.0) if axis == 0 else (0.0, sign)
                row = open_row(rest, 0.0)
                put_place(rest, row, i + 1, x, y)
                put_place(rest, row, i, -x, -y)
                put_time(rest, row, i + 1, -fastest)
                put_time(rest, row, i, fastest)
        dx = plan.knot[there].position[0] - plan.knot[here].position[0]
        dy = plan.knot[there].position[1] - plan.knot[here].position[1]
        if math.hypot(dx, dy) < options.reoptimisation.shortest_leg:
            continue
        _add_cone(plan, options, rest, i, here, 1.0, dx, dy)
        if i + 1 < rest.stages:
            _add_cone(plan, options, rest, i, there, -1.0, -dx, -dy)


@compiled
def _add_cone(
    plan: PlanTable, options: Options, rest: Rest, i: int, knot: int, sign: float, dx: float, dy: float
) -> None:
    """Add the cone of an impact for leg i, or for the way back along it, unless the plan itself leaves it."""
    nx, ny = plan.impact[knot].normal[0], plan.impact[knot].normal[1]
    if abs(-ny * dx + nx * dy) > options.reoptimisation.widest * (nx * dx + ny * dy):
        return
    for side in range(2):
        turn = 1.0 - 2.0 * side
        x, y = (
            sign * (-turn * ny - options.reoptimisation.widest * nx),
            sign * (turn * nx - options.reoptimisation.widest * ny),
        )
        row = open_row(rest, 0.0)
        put_place(rest, row, i + 1, x, y)
        put_place(rest, row, i, -x, -y)


@compiled
def _add_robots(plan: PlanTable, memory: WorldMemory, options: Options, rest: Rest, k: int, o: int, now: float) -> None:
    """Add the time that every robot needs to come to an impact from where it is or has to be, at most the plan's."""
    for i in range(rest.stages):
        knot, before = rest.chain[i], NO_STAGE
        r = plan.impact[knot].robot
        for j in range(i):
            if plan.impact[rest.chain[j]].robot == r:
                before = j
        x, y = _find_place(plan, memory, k, o, knot, i == 0)
        cx, cy = _find_contact(plan, r, o, knot, x, y)
        if before == NO_STAGE:
            z = memory.filter[k, r]
            vector = (cx - z.position[0], cy - z.position[1])
            _add_way(plan, options, rest, Way(r, i, (x, y), vector, now, 1.0, math.inf))
        else:
            at = rest.chain[before]
            ox, oy = _find_place(plan, memory, k, o, at, before == 0)
            ox, oy = _find_contact(plan, r, o, at, ox, oy)
            planned = plan.impact[knot].time - plan.impact[at].time
            row = _add_way(plan, options, rest, Way(r, i, (x, y), (cx - ox, cy - oy), 0.0, 1.0, planned))
            put_time(rest, row, before, 1.0)
        for other in range(len(plan.first)):
            at = memory.strike[k, other].index
            while at != NO_IMPACT and other != o:
                if plan.impact[at].robot == r:
                    ox, oy = _find_place(plan, memory, k, other, at, False)
                    ox, oy = _find_contact(plan, r, other, at, ox, oy)
                    time, planned = memory.clock[k, at], abs(plan.impact[knot].time - plan.impact[at].time)
                    sign = 1.0 if memory.clock[k, knot] >= time else -1.0
                    _add_way(plan, options, rest, Way(r, i, (x, y), (cx - ox, cy - oy), time, sign, planned))
                at = plan.impact[at].next


@compiled
def _add_way(plan: PlanTable, options: Options, rest: Rest, way: Way) -> int:
    """Add the time that a robot needs for a way, sign (t_i - time) >= tau(|way|); return the row.

    tau is concave in the length of the way, so that its tangent at the way expected now is on the safe side.
    """
    d = max(math.hypot(way.vector[0], way.vector[1]), options.reoptimisation.shortest_way)
    tau = min(compute_time(plan, options, way.robot, d), way.longest)
    slope = tau / (2.0 * d) if tau < way.longest else 0.0
    ux, uy = slope * way.vector[0] / d, slope * way.vector[1] / d
    row = open_row(rest, ux * way.here[0] + uy * way.here[1] - tau - way.sign * way.time)
    put_time(rest, row, way.stage, -way.sign)
    put_place(rest, row, way.stage, ux, uy)
    return row


@compiled
def _find_place(plan: PlanTable, memory: WorldMemory, k: int, o: int, knot: int, flying: bool) -> tuple[float, float]:
    """Return where object o is expected at a knot: on its present flight, or where it should be."""
    if not flying:
        return memory.place[k, knot, 0], memory.place[k, knot, 1]
    x, y, _, _ = extrapolate_flight(memory, k, plan.robots + o, memory.clock[k, knot])
    return x, y


@compiled
def _find_contact(plan: PlanTable, r: int, o: int, knot: int, x: float, y: float) -> tuple[float, float]:
    """Return the centre of robot r when it hits object o at (x, y) as planned."""
    reach = plan.body[r].radius + plan.body[plan.robots + o].radius
    normal = plan.impact[knot].normal
    return x - reach * normal[0], y - reach * normal[1]

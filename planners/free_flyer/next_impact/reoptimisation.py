"""What is left of a plan, optimised anew after an impact: when and where the object is hit next, by whom is kept.

The places P_i and times t_i of the impacts that are left are linear in each other where it counts: the next one lies on
the object's present flight, P_1 = x_O + v_O (t_1 - now), all the others are free. With who hits what in which order
kept, what the formula demands, the windows of time, how fast objects may fly and robots can come are rows in (P, t),
and the best point is a projection:

    min (rho_plan - rho)^2 / s_rho^2 + sum |P_i - P_i,plan|^2 / s_P^2 + sum (t_i - t_i,now)^2 / s_t^2
    with H_i P_i + rho <= b_i, ...
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from impact_envs.compiled import compiled
from planners.free_flyer.belief.estimator import extrapolate
from planners.free_flyer.belief.plan_table import (
    AT,
    CLOSE,
    DEPTH,
    END,
    FACES,
    KNOT_X,
    KNOT_Y,
    NEXT,
    NORMAL_X,
    NORMAL_Y,
    OPEN,
    RADIUS,
    ROBOT,
    SPEED,
    PlanTable,
)
from planners.free_flyer.belief.world_memory import (
    IMPACT_INDEX,
    TIME,
    WorldMemory,
)
from planners.free_flyer.next_impact.projection import FOUND, project
from planners.free_flyer.next_impact.reachability import compute_time

MOST_KNOTS = 8  # impacts of an object that are optimised at once; further ones keep their times
SIZE = 3 * MOST_KNOTS + 1  # of the variables
ROWS = 320
SCALE_RHO = 0.1  # s_rho [m]
SCALE_PLACE = 0.3  # s_P [m]
SCALE_TIME = 10.0  # s_t [s]
NOTICE = 4.0  # from now to the next impact [s]
GAP = 4.0  # between impacts of one object [s]
SHARE = 0.6  # of an object's greatest speed that legs may need
WIDEST = math.tan(math.pi / 3)  # of the cone round the planned normal that legs before and after an impact fill
SHORTEST_WAY = 0.05  # of a robot, for the linearisation of its time [m]
SHORTEST_LEG = 0.05  # of an object, that has a direction [m]
INSET = 0.25  # from both ends of a window [s]
RESERVE, RESERVE_SHARE = 4.0, 0.1  # after the last impact [s], or of the horizon


class Program(NamedTuple):
    """Where T threads optimise what is left of a plan: t_1..t_m, P_2..P_{m+1}, rho.

    Attributes:
        chain: knots of an object that are left, shape (T, 9).
        line: its flight to the first of them, position at time 0 and velocity, and the time of the last, shape (T, 5).
        centre, scale, point: what the variables are pulled to, s, and the point from there in units of s,
            shape (T, 25).
        rows, bounds: of that point, shapes (T, 320, 25), (T, 320).
        scratch: of the projection, shape (T, 29, 26).
    """

    chain: np.ndarray
    line: np.ndarray
    centre: np.ndarray
    scale: np.ndarray
    point: np.ndarray
    rows: np.ndarray
    bounds: np.ndarray
    scratch: np.ndarray


def make_program(threads: int = 1) -> Program:
    """Make room for threads to optimise in."""
    T, n = threads, SIZE
    return Program(
        chain=np.zeros((T, MOST_KNOTS + 1), np.int64),
        line=np.zeros((T, 5)),
        centre=np.zeros((T, n)),
        scale=np.zeros((T, n)),
        point=np.zeros((T, n)),
        rows=np.zeros((T, ROWS, n)),
        bounds=np.zeros((T, ROWS)),
        scratch=np.zeros((T, n + 4, n + 1)),
    )


@compiled
def reoptimise(plan: PlanTable, memory: WorldMemory, program: Program, c: int, k: int, o: int, now: float) -> bool:
    """Move the places and times of object o's impacts that are left; return whether there is such a point.

    Args:
        plan: what is followed.
        memory: of all worlds; ``place`` and ``clock`` are written if there is a point.
        program: of all threads.
        c: thread.
        k: world.
        o: object, with a planned impact to come and none inserted.
        now: [s].
    """
    strike, body, W = memory.strike[k, o], plan.robots + o, program
    index, last = int(strike[IMPACT_INDEX]), len(plan.impact) + o
    stages = 0
    while index != END and stages < MOST_KNOTS:
        W.chain[c, stages] = index
        index, stages = int(plan.impact[index, NEXT]), stages + 1
    W.chain[c, stages] = last if index == END else index
    W.line[c, 4] = plan.horizon if index == END else memory.clock[k, index]
    _set_references(plan, memory, W, c, k, o, stages)
    rows = _add_demands(plan, W, c, stages)
    rows = _add_order(plan, memory, W, c, k, o, stages, rows, now)
    rows = _add_flights(plan, W, c, body, stages, rows)
    rows = _add_robots(plan, memory, W, c, k, o, stages, rows, now)
    size = 3 * stages + 1
    point = W.point[c, :size]
    for i in range(size):
        point[i] = 0.0
    if project(W.rows[c, :, :size], W.bounds[c], rows, point, W.scratch[c]) != FOUND:
        return False
    for i in range(stages):
        knot = int(W.chain[c, i])
        memory.clock[k, knot] = W.centre[c, i] + W.scale[c, i] * point[i]
    strike[TIME] = memory.clock[k, int(W.chain[c, 0])]
    # Where the object's present flight leads is no wish: the first place stays, in case that flight is corrected.
    for i in range(1, stages + 1):
        knot, v = int(W.chain[c, i]), stages + 2 * (i - 1)
        for axis in range(2):
            memory.place[k, knot, axis] = W.centre[c, v + axis] + W.scale[c, v + axis] * point[v + axis]
    return True


@compiled
def _set_references(plan: PlanTable, memory: WorldMemory, W: Program, c: int, k: int, o: int, stages: int) -> None:
    """Set what the variables are pulled to, and how strongly: times, places but the first, rho."""
    depth = math.inf
    for i in range(stages + 1):
        knot = int(W.chain[c, i])
        depth = min(depth, plan.knot[knot, DEPTH])
        if i < stages:
            W.centre[c, i], W.scale[c, i] = memory.clock[k, knot], SCALE_TIME
        if i > 0:
            for axis in range(2):
                v = stages + 2 * (i - 1) + axis
                W.centre[c, v], W.scale[c, v] = plan.knot[knot, KNOT_X + axis], SCALE_PLACE
    rho = 3 * stages
    W.centre[c, rho], W.scale[c, rho] = (depth if depth < math.inf else 0.0), SCALE_RHO
    # The object's flight to its next impact, as a line about the time at which that is expected.
    time = memory.clock[k, int(W.chain[c, 0])]
    x, y, vx, vy = extrapolate(memory, k, plan.robots + o, time)
    W.line[c, 0], W.line[c, 1], W.line[c, 2], W.line[c, 3] = x - vx * time, y - vy * time, vx, vy
    # Its first place has no variable of its own; what pulls at it pulls at its time.
    first = int(W.chain[c, 0])
    dx, dy = plan.knot[first, KNOT_X] - x, plan.knot[first, KNOT_Y] - y
    there = (vx * vx + vy * vy) / (SCALE_PLACE * SCALE_PLACE)
    weight = there + 1.0 / (SCALE_TIME * SCALE_TIME)
    W.centre[c, 0] = time + (vx * dx + vy * dy) / (SCALE_PLACE * SCALE_PLACE) / weight
    W.scale[c, 0] = 1.0 / math.sqrt(weight)


@compiled
def _open_row(W: Program, c: int, row: int, stages: int, bound: float) -> int:
    """Start a row 0 <= bound; return its number, the last one if there is no room."""
    at = min(row, W.rows.shape[1] - 1)
    for i in range(3 * stages + 1):
        W.rows[c, at, i] = 0.0
    W.bounds[c, at] = bound
    return at


@compiled
def _put(W: Program, c: int, row: int, v: int, factor: float) -> None:
    """Add factor times a variable to the left side of a row."""
    W.rows[c, row, v] += factor * W.scale[c, v]
    W.bounds[c, row] -= factor * W.centre[c, v]


@compiled
def _put_time(W: Program, c: int, row: int, stages: int, i: int, factor: float) -> None:
    if i < stages:
        _put(W, c, row, i, factor)
    else:
        W.bounds[c, row] -= factor * W.line[c, 4]


@compiled
def _put_place(W: Program, c: int, row: int, stages: int, i: int, x: float, y: float) -> None:
    """Add the scalar product of (x, y) with the place of a stage."""
    if i == 0:
        _put(W, c, row, 0, x * W.line[c, 2] + y * W.line[c, 3])
        W.bounds[c, row] -= x * W.line[c, 0] + y * W.line[c, 1]
    else:
        _put(W, c, row, stages + 2 * (i - 1), x)
        _put(W, c, row, stages + 2 * (i - 1) + 1, y)


@compiled
def _add_demands(plan: PlanTable, W: Program, c: int, stages: int) -> int:
    """Keep what the formula demands of the places, with the margin rho."""
    rows = 0
    for i in range(stages + 1):
        knot = int(W.chain[c, i])
        for j in range(int(plan.knot[knot, FACES])):
            face = plan.face[knot, j]
            row = _open_row(W, c, rows, stages, face[2])
            _put_place(W, c, row, stages, i, face[0], face[1])
            _put(W, c, row, 3 * stages, 1.0)
            rows = row + 1
    return rows


@compiled
def _add_order(
    plan: PlanTable, memory: WorldMemory, W: Program, c: int, k: int, o: int, stages: int, rows: int, now: float
) -> int:
    """Keep the windows, the order, and time at both ends."""
    for i in range(stages):
        knot = int(W.chain[c, i])
        opens, closes = plan.knot[knot, OPEN], plan.knot[knot, CLOSE]
        inset = min(INSET, (closes - opens) / 4)
        # Never later than the impact was expected, if that is later than the reserve allows.
        latest = max(plan.horizon - max(RESERVE, RESERVE_SHARE * plan.horizon), memory.clock[k, knot])
        row = _open_row(W, c, rows, stages, min(closes - inset, latest))
        _put_time(W, c, row, stages, i, 1.0)
        earliest = max(opens + inset, min(now + NOTICE, memory.clock[k, knot])) if i == 0 else opens + inset
        row = _open_row(W, c, row + 1, stages, -earliest)
        _put_time(W, c, row, stages, i, -1.0)
        rows = row + 1
        if i > 0:
            planned = plan.impact[knot, AT] - plan.impact[int(W.chain[c, i - 1]), AT]
            row = _open_row(W, c, rows, stages, -min(GAP, planned))
            _put_time(W, c, row, stages, i - 1, 1.0)
            _put_time(W, c, row, stages, i, -1.0)
            rows = row + 1
    return rows


@compiled
def _add_flights(plan: PlanTable, W: Program, c: int, body: int, stages: int, rows: int) -> int:
    """Keep the objects' speed, and the legs before and after an impact in a cone round its planned normal."""
    fastest = SHARE * plan.body[body, SPEED]
    for i in range(stages):
        here, there = int(W.chain[c, i]), int(W.chain[c, i + 1])
        for axis in range(2):
            for side in range(2):
                sign = 1.0 - 2.0 * side
                x, y = (sign, 0.0) if axis == 0 else (0.0, sign)
                row = _open_row(W, c, rows, stages, 0.0)
                _put_place(W, c, row, stages, i + 1, x, y)
                _put_place(W, c, row, stages, i, -x, -y)
                _put_time(W, c, row, stages, i + 1, -fastest)
                _put_time(W, c, row, stages, i, fastest)
                rows = row + 1
        dx = plan.knot[there, KNOT_X] - plan.knot[here, KNOT_X]
        dy = plan.knot[there, KNOT_Y] - plan.knot[here, KNOT_Y]
        if math.hypot(dx, dy) < SHORTEST_LEG:
            continue
        rows = _add_cone(plan, W, c, stages, rows, i, 1.0, dx, dy, here)
        if i + 1 < stages:
            rows = _add_cone(plan, W, c, stages, rows, i, -1.0, -dx, -dy, there)
    return rows


@compiled
def _add_cone(
    plan: PlanTable, W: Program, c: int, stages: int, rows: int, i: int, sign: float, dx: float, dy: float, knot: int
) -> int:
    """Keep leg i, or the way back along it, in the cone of an impact, unless the plan does not keep to it."""
    nx, ny = plan.impact[knot, NORMAL_X], plan.impact[knot, NORMAL_Y]
    if abs(-ny * dx + nx * dy) > WIDEST * (nx * dx + ny * dy):
        return rows
    for side in range(2):
        turn = 1.0 - 2.0 * side
        x, y = sign * (-turn * ny - WIDEST * nx), sign * (turn * nx - WIDEST * ny)
        row = _open_row(W, c, rows, stages, 0.0)
        _put_place(W, c, row, stages, i + 1, x, y)
        _put_place(W, c, row, stages, i, -x, -y)
        rows = row + 1
    return rows


@compiled
def _add_robots(
    plan: PlanTable, memory: WorldMemory, W: Program, c: int, k: int, o: int, stages: int, rows: int, now: float
) -> int:
    """Give every robot time to come to an impact from where it is or has to be, as the plan does at least."""
    for i in range(stages):
        knot, before = int(W.chain[c, i]), END
        r = int(plan.impact[knot, ROBOT])
        for j in range(i):
            if plan.impact[int(W.chain[c, j]), ROBOT] == r:
                before = j
        x, y = _find_place(plan, memory, k, o, knot, i == 0)
        cx, cy = _find_contact(plan, r, o, knot, x, y)
        if before == END:
            way = (cx - memory.filter[k, r, 0], cy - memory.filter[k, r, 1])
            rows = _add_way(plan, W, c, stages, rows, r, i, (x, y), way, now, 1.0, math.inf)
        else:
            at = int(W.chain[c, before])
            ox, oy = _find_place(plan, memory, k, o, at, before == 0)
            ox, oy = _find_contact(plan, r, o, at, ox, oy)
            planned = plan.impact[knot, AT] - plan.impact[at, AT]
            rows = _add_way(plan, W, c, stages, rows, r, i, (x, y), (cx - ox, cy - oy), 0.0, 1.0, planned)
            _put_time(W, c, rows - 1, stages, before, 1.0)
        for other in range(len(plan.first)):
            at = int(memory.strike[k, other, IMPACT_INDEX])
            while at != END and other != o:
                if plan.impact[at, ROBOT] == r:
                    ox, oy = _find_place(plan, memory, k, other, at, False)
                    ox, oy = _find_contact(plan, r, other, at, ox, oy)
                    time, planned = memory.clock[k, at], abs(plan.impact[knot, AT] - plan.impact[at, AT])
                    sign = 1.0 if memory.clock[k, knot] >= time else -1.0
                    rows = _add_way(plan, W, c, stages, rows, r, i, (x, y), (cx - ox, cy - oy), time, sign, planned)
                at = int(plan.impact[at, NEXT])
    return rows


@compiled
def _add_way(
    plan: PlanTable,
    W: Program,
    c: int,
    stages: int,
    rows: int,
    r: int,
    i: int,
    here: tuple[float, float],
    way: tuple[float, float],
    time: float,
    sign: float,
    longest: float,
) -> int:
    """Give robot r so much time between stage i and another time as its way takes: sign (t_i - time) >= tau(|way|).

    tau grows ever more slowly with the way, so that its tangent at the way expected now is on the safe side.

    Args:
        plan: what is followed.
        W: program.
        c: thread.
        stages: number of impacts.
        rows: so far.
        r: robot.
        i: stage.
        here: of the object there, as expected now [m].
        way: from the other place to that of stage i, as expected now [m].
        time: to come from or to go to the other place [s].
        sign: 1 to come, -1 to go.
        longest: that tau may be [s].
    """
    d = max(math.hypot(way[0], way[1]), SHORTEST_WAY)
    tau = min(compute_time(plan, r, d), longest)
    slope = tau / (2.0 * d) if tau < longest else 0.0
    ux, uy = slope * way[0] / d, slope * way[1] / d
    row = _open_row(W, c, rows, stages, ux * here[0] + uy * here[1] - tau - sign * time)
    _put_time(W, c, row, stages, i, -sign)
    _put_place(W, c, row, stages, i, ux, uy)
    return row + 1


@compiled
def _find_place(plan: PlanTable, memory: WorldMemory, k: int, o: int, knot: int, flying: bool) -> tuple[float, float]:
    """Return where object o is expected at a knot: on its present flight, or where it should be."""
    if not flying:
        return memory.place[k, knot, 0], memory.place[k, knot, 1]
    x, y, _, _ = extrapolate(memory, k, plan.robots + o, memory.clock[k, knot])
    return x, y


@compiled
def _find_contact(plan: PlanTable, r: int, o: int, knot: int, x: float, y: float) -> tuple[float, float]:
    """Return the centre of robot r when it hits object o at (x, y) as planned."""
    reach = plan.body[r, RADIUS] + plan.body[plan.robots + o, RADIUS]
    return x - reach * plan.impact[knot, NORMAL_X], y - reach * plan.impact[knot, NORMAL_Y]

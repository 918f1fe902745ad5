"""Follow a plan's responses: where a robot goes is an affine function of where the object will be; compiled.

In a plan that bears deviations every impact has a box, and every place in the box its own motion of the robot that hits
there. Which one it is shows after the object's previous impact: then the robot's curve becomes the one of the place
where the object will be, and the course goes over to it by a quintic.
"""

from __future__ import annotations

import math

from impact_envs.compiled import compiled
from planners.free_flyer.belief.estimator import extrapolate_flight
from planners.free_flyer.belief.options import Options
from planners.free_flyer.belief.plan_table import NO_IMPACT, PlanTable
from planners.free_flyer.belief.world_memory import WorldMemory, find_next_event
from planners.free_flyer.next_impact.desired_velocity import ROUND_OFF, is_answered, is_settled
from planners.free_flyer.tracking.course import evaluate_course, rejoin_plan

NARROW = 1e-9  # a box of this half width has one place [m]


@compiled
def forget_responses(plan: PlanTable, memory: WorldMemory, k: int) -> None:
    """Let every robot of world k follow the curve of the plan: the response to no deviation."""
    for r in range(plan.robots):
        memory.responded[k, r] = -math.inf
        for segment in range(plan.answer.shape[1] if len(plan.response) > 0 else 0):
            write_segment(plan, memory, k, r, segment, 0.0, 0.0)
    for index in range(len(plan.response)):
        memory.answered[k, index, 0] = memory.answered[k, index, 1] = 0.0


@compiled
def write_curve(plan: PlanTable, memory: WorldMemory, k: int, index: int, dx: float, dy: float) -> None:
    """Make the robot of an impact respond to a place of the object, given in the box, from -1 to 1 per axis."""
    r = plan.impact[index].robot
    memory.answered[k, index, 0], memory.answered[k, index, 1] = dx, dy
    for segment in range(plan.answer.shape[1]):
        if plan.answer[r, segment] == index:
            write_segment(plan, memory, k, r, segment, dx, dy)


@compiled
def write_segment(plan: PlanTable, memory: WorldMemory, k: int, r: int, segment: int, dx: float, dy: float) -> None:
    """Write the plan's segment + d_x A + d_y B + d_x d_y C; at zero it is the plan's, bit for bit."""
    term = plan.term[r, segment]
    for j in range(plan.coefficients.shape[2]):
        for axis in range(2):
            change = dx * term[0, j, axis] + dy * term[1, j, axis] + dx * dy * term[2, j, axis]
            memory.flown[k, r, segment, j, axis] = plan.coefficients[r, segment, j, axis] + change


@compiled
def find_place(plan: PlanTable, memory: WorldMemory, k: int, o: int, index: int) -> tuple[float, float]:
    """Return where object o will be in the box of an impact, at most at its edge: from -1 to 1 per axis."""
    x, y, _, _ = extrapolate_flight(memory, k, plan.robots + o, plan.impact[index].time)
    centre, half = plan.response[index].centre, plan.response[index].half
    dx = (x - centre[0]) / half[0] if half[0] > NARROW else 0.0
    dy = (y - centre[1]) / half[1] if half[1] > NARROW else 0.0
    return min(max(dx, -1.0), 1.0), min(max(dy, -1.0), 1.0)


@compiled
def respond(plan: PlanTable, memory: WorldMemory, options: Options, k: int, r: int, now: float) -> None:
    """Let robot r respond to where the object of its next impact will be, once its flight is known."""
    if len(plan.response) == 0 or now < memory.responded[k, r] + options.timing.replan_period - ROUND_OFF:
        return
    _, _, index = find_next_event(plan, memory, k, r)
    course = memory.course[k, r]
    if index == NO_IMPACT or course.ends_in_impact:
        return
    o = plan.impact[index].body - plan.robots
    strike = memory.strike[k, o]
    if strike.index != index or not is_answered(plan, memory, options, k, o):
        return
    if not is_settled(plan, memory, options, k, o, now):
        return
    memory.responded[k, r] = now
    dx, dy = find_place(plan, memory, k, o, index)
    half, old = plan.response[index].half, memory.answered[k, index]
    if max(abs(dx - old[0]) * half[0], abs(dy - old[1]) * half[1]) <= options.response.least:
        return
    begin = evaluate_course(course, plan.breaks, memory.flown[k], r, now)
    write_curve(plan, memory, k, index, dx, dy)
    rejoin_plan(course, plan.breaks, memory.flown[k], r, now, begin, options.response.rejoin)
    memory.counts[k].responded += 1

"""A learner's correction of a coming impact: what it changes, and how much of it is taken; compiled."""

from __future__ import annotations

import math

from impact_envs.compiled import compiled, inlined
from impact_envs.elementary import cos_sin, exp
from planners.free_flyer.belief.drift import find_drift
from planners.free_flyer.belief.estimator import extrapolate_flight
from planners.free_flyer.belief.options import Options
from planners.free_flyer.belief.plan_table import NO_IMPACT, PlanTable
from planners.free_flyer.belief.world_memory import WorldMemory
from planners.free_flyer.next_impact.aim import choose_desired_velocity
from planners.free_flyer.next_impact.bookkeeping import set_clocks, set_time
from planners.free_flyer.next_impact.desired_velocity import (
    ROUND_OFF,
    compute_margin,
    compute_room,
    find_mass,
    find_next_knot,
    is_answered,
)
from planners.free_flyer.next_impact.reachability import compute_arrival, is_reachable

CORRECTION_SIZE = 3  # impulse's logarithm, its direction, time of the impact


@inlined
def correct_change(options: Options, scale: float, turn: float, dx: float, dy: float) -> tuple[float, float]:
    """Return the wished change of an object's velocity as a correction has it [m/s].

    Args:
        scale, turn: correction, in [-1, 1].
        dx, dy: as the expert wishes it [m/s].
    """
    size, angle = exp(options.correction.scale * scale), options.correction.turn * turn
    cos, sin = cos_sin(angle)
    return size * (cos * dx - sin * dy), size * (sin * dx + cos * dy)


@compiled
def take_correction(
    plan: PlanTable, memory: WorldMemory, options: Options, k: int, o: int, correction: tuple[float, float, float]
) -> None:
    """Correct the coming impact of object o, by the greatest share of the correction that promises enough.

    Args:
        correction: of the impulse's logarithm, its direction and the impact's time, in [-1, 1]; zero changes nothing.
    """
    strike = memory.strike[k, o]
    strike.scale = strike.turn = strike.shift = 0.0
    scale, turn, shift = correction
    if scale == 0.0 and turn == 0.0 and shift == 0.0:
        return
    shares, least = options.correction.shares, -math.inf
    if options.filter:
        least = predict_margin(plan, memory, options, k, o, 0.0, 0.0, strike.time) - options.correction.margin
    for i in range(shares, 0, -1):
        share = i / shares
        time = move_time(plan, memory, options, k, o, share * shift)
        if options.filter and predict_margin(plan, memory, options, k, o, share * scale, share * turn, time) < least:
            continue
        strike.scale, strike.turn = share * scale, share * turn
        if time != strike.time:
            strike.shift = share * shift
            set_time(plan, memory, k, o, strike.index, time)
            set_clocks(plan, memory, options, k, memory.time[k])
        memory.counts[k].filtered += i < shares
        return
    memory.counts[k].filtered += 1


@compiled
def move_time(plan: PlanTable, memory: WorldMemory, options: Options, k: int, o: int, shift: float) -> float:
    """Return when the coming impact of object o takes place if it is shifted, as far as it can be [s]; as now if not.

    A small shift moves it by little, too, where it comes sooner than an impact should that is moved.

    Args:
        shift: correction, in [-1, 1].
    """
    strike, now = memory.strike[k, o], memory.time[k]
    index, r, old = strike.index, strike.robot, strike.time
    if shift == 0.0 or strike.is_inserted or is_answered(plan, memory, options, k, o):
        return old
    knot = plan.knot[index]
    arrival = compute_arrival(plan, memory, options, k, index)
    earliest = min(max(now + options.correction.notice, knot.opens, arrival), old)
    _, due, _ = find_next_knot(plan, memory, k, o, False)
    latest = max(min(knot.closes, due - options.reoptimisation.gap), old)
    time = min(max(old + options.correction.shift * shift, earliest), latest)
    if time > old:
        return time
    x, y, _, _ = extrapolate_flight(memory, k, plan.robots + o, time)
    reach = plan.body[r].radius + plan.body[plan.robots + o].radius
    x, y = x - reach * strike.reference_normal[0], y - reach * strike.reference_normal[1]
    return time if is_reachable(plan, memory, options, k, r, x, y, 0.0, 0.0, time - now) else old


@compiled
def predict_margin(
    plan: PlanTable, memory: WorldMemory, options: Options, k: int, o: int, scale: float, turn: float, time: float
) -> float:
    """Return how deep object o will be, by the present estimates, in what its coming impact and its next knot demand.

    The next impact follows the object, within half a leg; a knot without faces demands the planned place. Of depth
    nothing counts beyond the plan's.

    Args:
        scale, turn: correction of the coming impact, in [-1, 1].
        time: of that impact [s].

    Returns:
        Distance to the nearest face, negative outside [m].
    """
    strike, body, old = memory.strike[k, o], plan.robots + o, memory.strike[k, o].time
    strike.time = time
    x, y, vx, vy = extrapolate_flight(memory, k, body, time)
    wish = choose_desired_velocity(plan, memory, options, k, o)
    dx, dy = correct_change(options, scale, turn, wish[0] - vx, wish[1] - vy)
    vx, vy = vx + dx, vy + dy
    room = compute_room(plan, memory, k, o, strike.robot, time, vx, vy)
    margin = min(room, options.insertion.edge)
    if strike.index != NO_IMPACT and not strike.is_inserted:
        here = plan.knot[strike.index]
        margin = min(margin, compute_margin(plan, strike.index, x, y), here.depth)
    px, py = find_mass(memory, k, body, time)
    knot, due, last = find_next_knot(plan, memory, k, o, strike.is_inserted)
    strike.time = old
    ax, ay = find_drift(memory.filter[k, body])
    target_x, target_y = memory.place[k, knot, 0], memory.place[k, knot, 1]
    flight = max(due - time, ROUND_OFF)
    if not last:
        toward = (target_x - px) * vx + (target_y - py) * vy
        nearest = toward / max(vx * vx + vy * vy, ROUND_OFF * ROUND_OFF)
        flight = min(max(nearest, 0.5 * flight), 1.5 * flight, max(plan.knot[knot].closes - time, ROUND_OFF))
    end_x, end_y = px + flight * (vx + flight / 2 * ax), py + flight * (vy + flight / 2 * ay)
    if plan.knot[knot].faces == 0:
        return min(margin, -math.hypot(end_x - target_x, end_y - target_y))
    return min(margin, compute_margin(plan, knot, end_x, end_y), plan.knot[knot].depth)

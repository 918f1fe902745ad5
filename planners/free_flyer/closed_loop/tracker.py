"""Follow a course: fill the tracking problem, solve it, apply the solution or a fallback, keep off others; compiled."""

from __future__ import annotations

import math

import numpy as np

from impact_envs.compiled import inlined
from impact_envs.elementary import cos_sin
from planners.free_flyer.belief.options import BY_LQR, BY_MPC, Options
from planners.free_flyer.belief.plan_table import PlanTable
from planners.free_flyer.belief.thruster import find_thruster
from planners.free_flyer.belief.world_memory import NO_OBJECT, WorldMemory
from planners.free_flyer.closed_loop.avoidance import NO_TARGET, avoid_bodies, hold_barrier
from planners.free_flyer.next_impact.replanner import find_law
from planners.free_flyer.tracking.course import evaluate_course
from planners.free_flyer.tracking.course_sampling import sample_course
from planners.free_flyer.tracking.lqr import solve_lqr
from planners.free_flyer.tracking.mpc import GAIN, INPUT_LIMIT, NO_JUMP, STAGES, Workspace, solve_tracking


@inlined
def track_course(
    plan: PlanTable,
    memory: WorldMemory,
    options: Options,
    workspace: Workspace,
    c: int,
    k: int,
    r: int,
    o: int,
    actions: np.ndarray,
) -> None:
    """Write robot r's action by a compiled tracker: the three steps of a tracker in one go."""
    fill_state(memory, workspace, c, k, r)
    if options.tracker == BY_MPC:
        fill_reference(plan, memory, workspace, c, k, r, o)
        workspace.solved[c] = STAGES if solve_tracking(workspace, c, plan.pilot[r]) else 0
    apply_solution(plan, memory, options, workspace, c, k, r, o, actions)


@inlined
def fill_state(memory: WorldMemory, workspace: Workspace, c: int, k: int, r: int) -> None:
    """Write robot r's estimated state into the tracking problem."""
    z, heading, state = memory.filter[k, r], memory.heading[k, r], workspace.state[c]
    state[0], state[1], state[2] = z.position[0], z.position[1], heading.angle
    state[3], state[4], state[5] = z.velocity[0], z.velocity[1], heading.rate


@inlined
def apply_solution(
    plan: PlanTable,
    memory: WorldMemory,
    options: Options,
    workspace: Workspace,
    c: int,
    k: int,
    r: int,
    o: int,
    actions: np.ndarray,
) -> None:
    """Write robot r's action, and remember the acceleration it should cause.

    The fallbacks: what is left of the last solution, then LQR, then nothing where that is no number; each is counted.
    """
    h, pilot = plan.period, plan.pilot[r]
    heading, rate = memory.heading[k, r].angle, memory.heading[k, r].rate
    left = 0
    if options.tracker != BY_LQR:
        shifted, solved = memory.shifted[k, r], workspace.solved[c]
        if solved > 0:
            left = solved
            for i in range(3):
                actions[k, r, i] = workspace.solution[c, i]
            for j in range(solved - 1):
                for i in range(3):
                    shifted.inputs[j, i] = workspace.solution[c, 3 * (j + 1) + i]
        elif shifted.count > 0:
            left = shifted.count
            memory.counts[k].shifted_plan += 1
            for i in range(3):
                actions[k, r, i] = shifted.inputs[0, i]
            for j in range(left - 1):
                for i in range(3):
                    shifted.inputs[j, i] = shifted.inputs[j + 1, i]
        else:
            memory.counts[k].lqr += 1
        shifted.count = max(left - 1, 0)
    if left == 0:
        feed_back(plan, memory, workspace, c, k, r, actions)
    g, (cos, sin) = pilot[GAIN], cos_sin(heading)
    ax = g * (cos * actions[k, r, 0] - sin * actions[k, r, 1])
    ay = g * (sin * actions[k, r, 0] + cos * actions[k, r, 1])
    striking = o != NO_OBJECT and memory.course[k, r].ends_in_impact
    if options.avoid:
        bx, by, _ = avoid_bodies(plan, memory, options, k, r, plan.robots + o if striking else NO_TARGET, ax, ay)
    else:
        striking = striking and memory.strike[k, o].time - memory.time[k] <= options.published.open
        bx, by, _ = hold_barrier(plan, memory, options, k, r, plan.robots + o if striking else NO_TARGET, ax, ay)
    if bx != ax or by != ay:
        actions[k, r, 0], actions[k, r, 1] = (cos * bx + sin * by) / g, (cos * by - sin * bx) / g
    for i in range(3):
        share = actions[k, r, i] / pilot[INPUT_LIMIT + i]
        if i < 2:
            share /= memory.thrust[k, r].gain[find_thruster(i, share)]
        if math.isnan(share):
            share = 0.0
            memory.counts[k].no_action += 1
        actions[k, r, i] = min(max(share, -1.0), 1.0)
    middle = heading + rate * h / 2
    cos, sin = cos_sin(middle)
    thrust = memory.thrust[k, r]
    fx, fy = actions[k, r, 0] * pilot[INPUT_LIMIT], actions[k, r, 1] * pilot[INPUT_LIMIT + 1]
    thrust.command[0], thrust.command[1] = fx * pilot[GAIN], fy * pilot[GAIN]
    fx, fy = fx * thrust.gain[find_thruster(0, fx)], fy * thrust.gain[find_thruster(1, fy)]
    memory.push[k, r, 0] = (cos * fx - sin * fy) * pilot[GAIN]
    memory.push[k, r, 1] = (sin * fx + cos * fy) * pilot[GAIN]
    memory.spin[k, r] = actions[k, r, 2] * pilot[INPUT_LIMIT + 2] * pilot[GAIN + 2]


@inlined
def feed_back(
    plan: PlanTable, memory: WorldMemory, workspace: Workspace, c: int, k: int, r: int, actions: np.ndarray
) -> None:
    """Write robot r's input by LQR on its course."""
    now, h, reference = memory.time[k], plan.period, workspace.states[c, 0]
    curves = memory.flown[k] if len(plan.response) > 0 else plan.coefficients
    here = evaluate_course(memory.course[k, r], plan.breaks, curves, r, now)
    ahead = evaluate_course(memory.course[k, r], plan.breaks, curves, r, now + h)
    reference[0], reference[1], reference[2] = here[0], here[1], plan.body[r].heading
    reference[3], reference[4], reference[5] = here[2], here[3], 0.0
    ax = (ahead[2] - here[2]) / h
    ay = (ahead[3] - here[3]) / h
    solve_lqr(workspace.state[c], reference, ax, ay, plan.pilot[r], actions[k, r])


@inlined
def fill_reference(plan: PlanTable, memory: WorldMemory, workspace: Workspace, c: int, k: int, r: int, o: int) -> None:
    """Sample robot r's course at the nodes of the horizon, with the feed-forward forces that reproduce its velocities.

    A border between stages is moved onto an impact within the horizon.

    Source: Verhagen & Tumova, Sec. VII: Eq. 7 in the prediction at t_m = t_impact.
    """
    now, h, mass = memory.time[k], plan.period, plan.body[r].mass
    states, inputs, durations = workspace.states[c], workspace.inputs[c], workspace.durations[c]
    jump, heading = workspace.jump[c], memory.heading[k, r].angle
    for j in range(STAGES):
        durations[j] = h
    node, striking = NO_JUMP, o != NO_OBJECT and memory.course[k, r].ends_in_impact
    ahead = memory.strike[k, o].time - now if striking else math.inf
    if ahead >= 0.0 and ahead < (STAGES - 0.5) * h:
        strike = memory.strike[k, o]
        node = min(max(math.floor(ahead / h + 0.5), 1), STAGES - 1)
        durations[node - 1] = ahead - (node - 1) * h
        durations[node] = (node + 1) * h - ahead
        # The robot's own jump: v+ = v- - c (n . v- - n . v_O) n with c = alpha m_O / m_R.
        restitution, ratio = find_law(plan, memory, k, r, o)
        gain = (1.0 + restitution) / (1.0 + ratio + strike.lever) * ratio
        jump[0], jump[1], jump[2] = strike.normal[0], strike.normal[1], gain
        jump[3] = strike.normal[0] * strike.object_minus[0] + strike.normal[1] * strike.object_minus[1]
    workspace.node[c] = node
    cos, sin = cos_sin(heading)
    curves = memory.flown[k] if len(plan.response) > 0 else plan.coefficients
    before = STAGES + 1 if node == NO_JUMP else node + 1
    sample_course(memory.course[k, r], plan.breaks, curves, r, now, durations, before, states)
    for j in range(STAGES + 1):
        bounced = j >= before
        if bounced:
            plus = memory.strike[k, o].robot_plus
            plus_x, plus_y = plus[0], plus[1]
            states[j, 0] = states[j - 1, 0] + durations[j - 1] * plus_x
            states[j, 1] = states[j - 1, 1] + durations[j - 1] * plus_y
            states[j, 3], states[j, 4] = plus_x, plus_y
        states[j, 2], states[j, 5] = plan.body[r].heading, 0.0
        if j > 0:
            scale = 0.0 if bounced else mass / max(durations[j - 1], 1e-9)
            fx, fy = scale * (states[j, 3] - states[j - 1, 3]), scale * (states[j, 4] - states[j - 1, 4])
            inputs[j - 1, 0], inputs[j - 1, 1] = cos * fx + sin * fy, cos * fy - sin * fx
            inputs[j - 1, 2] = 0.0

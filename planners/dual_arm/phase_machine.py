"""One tick of time-invariant reference spreading in one world: phases, program, torques; compiled.

`control_arms` is the whole tick. Where another solver is chosen, `build_program` and `take_torques` are its two halves.

Source: van Steen et al., Sec. 4.
"""

from __future__ import annotations

import numpy as np

from impact_envs.compiled import compiled, inlined
from impact_envs.elementary import cos_sin, exp
from planners.dual_arm.control_memory import (
    ANTE,
    INTERIM,
    NEVER,
    POST,
    get_ante_field,
    get_ante_gains,
    get_interim_gains,
    get_post_field,
    get_post_gains,
    get_program,
    get_terms,
    get_workspace,
)
from planners.dual_arm.grasp_qp import RELAXED, assemble_post, relax_contacts
from planners.dual_arm.reference import ImpactMap, compute_post_reference, compute_smoothstep, predict_twist
from planners.dual_arm.terms import Terms, compute_terms, estimate_box
from planners.dual_arm.torque_qp import BOUNDED, EQUALITIES_FREE, EQUALITIES_GRASP, assemble_ante, assemble_interim
from planners.goldfarb_idnani import SOLVED, solve_qp
from planners.measurement import LARGEST

FADED = 20.0  # time constants after which e^-20 = 2e-9 is left of a step
# What `build_program` has built: nothing where a measurement is none.
HOLD, FREE_PROGRAM, GRASP_PROGRAM = range(3)


@compiled
def control_arms(law: np.record, impact_map: ImpactMap, memory: np.record, scratch: np.record) -> None:
    """Compute the torques of one tick; where a program has no solution use its slack form, else the last torques.

    Args:
        law: a LAW.
        impact_map: predicted velocity of the box after the impact.
        memory: a CONTROL with what is measured; `torques` are written.
        scratch: a SCRATCH.
    """
    build_program(law, impact_map, memory, scratch)
    scratch.solved, work = 0, get_workspace(scratch.work)
    if memory.built == FREE_PROGRAM:
        p = scratch.free
        status = solve_qp(p.H, p.f, p.A, p.lower, p.upper, BOUNDED, EQUALITIES_FREE, work, scratch.x)
        scratch.solved = status == SOLVED
    elif memory.built == GRASP_PROGRAM:
        p = scratch.grasp
        status = solve_qp(p.H, p.f, p.A, p.lower, p.upper, BOUNDED, EQUALITIES_GRASP, work, scratch.x)
        if status != SOLVED:
            relax_contacts(get_program(scratch.grasp), law.w_slack)
            status = solve_qp(p.H, p.f, p.A, p.lower, p.upper, BOUNDED, RELAXED, work, scratch.x)
            memory.slack += status == SOLVED
        scratch.solved = status == SOLVED
    take_torques(law, memory, scratch)


@compiled
def build_program(law: np.record, impact_map: ImpactMap, memory: np.record, scratch: np.record) -> None:
    """Update the phase and build its program; `built` says which.

    Args:
        law, impact_map, memory, scratch: see `control_arms`.
    """
    total = 0.0
    for i in range(2):
        for j in range(3):
            total += abs(memory.q[i, j]) + abs(memory.v[i, j])
    memory.built = HOLD
    if not total < LARGEST:
        return
    terms, field = get_terms(scratch.terms), get_ante_field(law)
    update_phase(law, impact_map, memory, terms)
    memory.built = FREE_PROGRAM
    if memory.phase == ANTE:
        rise, since = law.soft_start, memory.ticks * law.tick
        ramp = compute_smoothstep(since, 0.0, rise)[0] if rise > 0.0 else 1.0
        program, gains = get_program(scratch.free), get_ante_gains(law)
        assemble_ante(program, terms, field, gains, law.arms, memory.q, memory.v, ramp)
    elif memory.phase == INTERIM:
        rise, since = law.press_rise, (memory.ticks - memory.touched) * law.tick
        press = law.press * (compute_smoothstep(since, 0.0, rise)[0] if rise > 0.0 else 1.0)
        program, weak = get_program(scratch.free), get_interim_gains(law)
        q, v = memory.q, memory.v
        assemble_interim(program, terms, field, weak, law.arms, q, v, memory.integrated, press, law.tick)
    else:
        reference, post = get_post_field(law, memory), get_post_gains(law, memory)
        grasp, q, v = get_program(scratch.grasp), memory.q, memory.v
        assemble_post(grasp, terms, reference, post, law.arms, q, v, memory.box)
        memory.built = GRASP_PROGRAM


@inlined
def update_phase(law: np.record, impact_map: ImpactMap, memory: np.record, terms: Terms) -> None:
    """Enter the next phase when contact begins or is full.

    Args:
        law, impact_map, memory: see `control_arms`.
        terms: scratch.
    """
    if memory.phase == POST:
        return
    least, most = memory.forces[0], memory.forces[0]
    for k in range(1, 4):
        least, most = min(least, memory.forces[k]), max(most, memory.forces[k])
    memory.full = memory.full + 1 if least > law.contact_force else 0
    if memory.touched == NEVER and most > 0.0:
        compute_terms(law.arms, memory.q, memory.v, terms)
        c, d = cos_sin(law.believed_box[2])
        for i in range(2):
            x, y = terms.pose[i, 0] - law.believed_box[0], terms.pose[i, 1] - law.believed_box[1]
            memory.heights[i] = c * y - d * x
        memory.touched = memory.ticks
        if law.interim_phase > 0.0:
            memory.phase = INTERIM
            for i in range(2):
                for r in range(3):
                    memory.integrated[i, r] = terms.pose[i, r]
    late = memory.touched != NEVER and (memory.ticks - memory.touched) * law.tick >= law.time_out
    if memory.full >= law.dwell_ticks or late:
        compute_terms(law.arms, memory.q, memory.v, terms)
        estimate_box(terms, memory.box)
        for r in range(3):
            memory.start[r] = memory.box[r]
        if law.impact_map > 0.0:
            predict_twist(impact_map, memory.heights, memory.predicted)
        memory.phase, memory.grasped = POST, memory.ticks


@compiled
def take_torques(law: np.record, memory: np.record, scratch: np.record) -> None:
    """Take the torques of a program's solution, after the impact with the fading step; without one hold the last.

    A tick without a measurement is not counted.

    Args:
        law, memory, scratch: see `control_arms`.
    """
    x, solved = scratch.x, scratch.solved > 0
    if not solved:
        memory.held += 1
    if memory.built == HOLD:
        return
    for j in range(len(memory.solution)):
        memory.solution[j] = x[j] if solved else 0.0
    since, fade = (memory.ticks - memory.grasped) * law.tick, law.fade
    fading = memory.phase == POST and since < FADED * fade
    for i in range(2):
        for j in range(3):
            torque = x[3 * i + j] if solved else memory.torques[i, j]
            if fading:
                if since == 0.0:
                    memory.step[i, j] = memory.torques[i, j] - torque
                limit = law.limits[i, j]
                torque = min(max(torque + memory.step[i, j] * exp(-since / fade), -limit), limit)
            memory.torques[i, j] = torque
    memory.ticks += 1


@inlined
def count_grasp_ticks(memory: np.record) -> int:
    """Return the number of ticks controlled since full contact, 0 before."""
    return memory.ticks - memory.grasped if memory.phase == POST else 0


@inlined
def compute_reference_error(law: np.record, memory: np.record) -> tuple[float, float, float]:
    """Return the post-impact reference minus the box's estimated velocity; 0 before [m/s, rad/s]."""
    if memory.phase != POST:
        return 0.0, 0.0, 0.0
    box = memory.box
    vx, vy, w, _, _, _ = compute_post_reference(get_post_field(law, memory), box[0], box[1], box[2])
    return vx - box[3], vy - box[4], w - box[5]


# What `run_tick` does.
WHOLE, BUILD, TAKE, NOTHING = range(4)


@compiled
def run_tick(
    law: np.ndarray, heights: np.ndarray, weights: np.ndarray, memory: np.ndarray, scratch: np.ndarray, part: int
) -> None:
    """Control one world, for Python.

    Args:
        law: LAW, shape (1,).
        heights, weights: of the impact map.
        memory, scratch: CONTROL and SCRATCH, shape (1,).
        part: the whole tick, what comes before or after the solver, or nothing.
    """
    impact_map = ImpactMap(heights, weights, law[0].rho)
    if part == WHOLE:
        control_arms(law[0], impact_map, memory[0], scratch[0])
    elif part == BUILD:
        build_program(law[0], impact_map, memory[0], scratch[0])
    elif part == TAKE:
        take_torques(law[0], memory[0], scratch[0])

"""Tracking control of one free-flyer: impact-aware MPC, as one box-constrained QP or, where no limit binds, recursion.

State (q, v) = [x, y, heading, vx, vy, omega] in the world frame, input [Fx, Fy, torque] in the body frame. With the
heading held over the horizon the dynamics are linear and the whole problem condenses into the inputs.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from impact_envs.compiled import compiled, inlined
from impact_envs.elementary import cos_sin
from planners.free_flyer.tracking.box_qp import NEWTON_STEPS, NOT_SOLVED, VECTORS, solve_box_qp
from planners.free_flyer.tracking.condensing import FORCES, UNKNOWNS, condense, find_unknown
from planners.free_flyer.tracking.problem import (
    EFFORT,
    ENDLESS,
    FEEDBACK,
    GAIN,
    INPUT_LIMIT,
    NO_JUMP,
    STAGES,
    WEIGHT,
    TrackingTask,
)


class Workspace(NamedTuple):
    """Where T threads solve the tracking problem.

    Attributes:
        state: measured, shape (T, 6).
        states: reference at the nodes 0..10; at the node of a predicted impact the state just before it, shape
            (T, 11, 6).
        inputs: feed-forward inputs of the stages in the body frame, shape (T, 10, 3) [N, N, N m].
        durations: of the stages, shape (T, 10) [s].
        node: of a predicted impact, 1..9; NO_JUMP without one, shape (T,).
        jump: of that impact: unit normal n from robot to object, c = (1 + e) m_O / (m_R + m_O), v_O . n before it,
            shape (T, 4).
        solution: inputs of all stages, shape (T, 30) [N, N, N m].
        solved: stages of ``solution`` that were just found; 0 where the solve failed, shape (T,).
        target: object that the robot is to hit, or END, shape (T,).
        Z, H, U, vectors, free: scratch, shapes (T, 6, 31), (T, 30, 30) twice, (T, 9, 30), (T, 2, 30).
        steps: Newton steps allowed, shape (T,).
    """

    state: np.ndarray
    states: np.ndarray
    inputs: np.ndarray
    durations: np.ndarray
    node: np.ndarray
    jump: np.ndarray
    solution: np.ndarray
    solved: np.ndarray
    target: np.ndarray
    Z: np.ndarray
    H: np.ndarray
    U: np.ndarray
    vectors: np.ndarray
    free: np.ndarray
    steps: np.ndarray


def make_workspace(threads: int = 1) -> Workspace:
    """Make room for threads to solve tracking problems in."""
    T, n = threads, UNKNOWNS
    return Workspace(
        state=np.zeros((T, 6)),
        states=np.zeros((T, STAGES + 1, 6)),
        inputs=np.zeros((T, STAGES, 3)),
        durations=np.zeros((T, STAGES)),
        node=np.zeros(T, np.int64),
        jump=np.zeros((T, 4)),
        solution=np.zeros((T, n)),
        solved=np.zeros(T, np.int64),
        target=np.zeros(T, np.int64),
        Z=np.zeros((T, 6, n + 1)),
        H=np.zeros((T, n, n)),
        U=np.zeros((T, n, n)),
        vectors=np.zeros((T, 4 + VECTORS, n)),
        free=np.zeros((T, 2, n), np.int64),
        steps=np.full(T, NEWTON_STEPS),
    )


def view_task(workspace: Workspace, c: int) -> TrackingTask:
    """Return row c's tracking problem; its arrays are views."""
    state, states, inputs, durations = (column[c] for column in workspace[:4])
    return TrackingTask(state, states, inputs, durations, int(workspace.node[c]), workspace.jump[c])


class Axis(NamedTuple):
    """What the recursion of `solve_freely` needs of one axis: numbers that stay the same at all stages.

    Attributes:
        at: 0, 1, 2 for x, y, heading.
        pp, pv, vv: weight P of the end.
        kp, kv: feedback K on position and velocity.
        bp, bv: what an input changes of position and velocity over a stage, B.
        share: 1 / (R + B' P B).
    """

    at: int
    pp: float
    pv: float
    vv: float
    kp: float
    kv: float
    bp: float
    bv: float
    share: float


@inlined
def read_axis(pilot: np.ndarray, at: int, h: float) -> Axis:
    """Return one axis of a robot's problem for stages of a duration [s]."""
    P, K, g = WEIGHT + 9 + 3 * at, FEEDBACK + 2 * at, pilot[GAIN + at]
    pp, pv, vv, bp, bv = pilot[P], pilot[P + 1], pilot[P + 2], g * h * h / 2, g * h
    share = 1.0 / (pilot[EFFORT + at] + bp * (pp * bp + pv * bv) + bv * (pv * bp + vv * bv))
    return Axis(at, pp, pv, vv, pilot[K], pilot[K + 1], bp, bv, share)


@inlined
def step_back(
    axis: Axis, states: np.ndarray, k: int, h: float, u: float, q: float, w: float
) -> tuple[float, float, float]:
    """Return B' (P c_k + p_{k+1}) and p_k of `solve_freely` for one axis, from p_{k+1} = (q, w) and feed-forward u."""
    position, speed = states[k, axis.at], states[k, 3 + axis.at]
    cp = position + h * speed + axis.bp * u - states[k + 1, axis.at]
    cv = speed + axis.bv * u - states[k + 1, 3 + axis.at]
    if cp == 0.0 and cv == 0.0 and q == 0.0 and w == 0.0:  # a reference that rests, as every heading does
        return 0.0, q, w
    q, w = q + axis.pp * cp + axis.pv * cv, w + axis.pv * cp + axis.vv * cv
    along = axis.bp * q + axis.bv * w
    q, w = (
        (1.0 - axis.bp * axis.kp) * q - axis.bv * axis.kp * w,
        (h - axis.bp * axis.kv) * q + (1.0 - axis.bv * axis.kv) * w,
    )
    return along, q, w


@inlined
def step_on(
    axis: Axis, states: np.ndarray, k: int, h: float, feed: float, along: float, position: float, speed: float
) -> tuple[float, float, float]:
    """Return the input of stage k in one axis, and position and velocity after it."""
    d = -axis.kp * (position - states[k, axis.at]) - axis.kv * (speed - states[k, 3 + axis.at]) - axis.share * along
    u = feed + d
    return u, position + h * speed + axis.bp * u, speed + axis.bv * u


@inlined
def solve_freely(workspace: Workspace, c: int, pilot: np.ndarray) -> bool:
    r"""Solve the MPC without limits and without an impact in the horizon, by its Riccati recursion.

    e_{k+1} = A e_k + B d_k + c_k with c_k = A x_ref,k + B u_ref,k - x_ref,k+1;  p_k = (A - B K)' (P c_k + p_{k+1});
    d_k = -K e_k - B' (P c_k + p_{k+1}) / (R + B' P B)

    P is the same at all stages, because the end is weighted by it; so it is for each axis in the world frame, where
    the weights of x and y are equal. The axes go side by side, because each waits for its own stage before.

    Args:
        workspace: with the reference filled in; ``solution`` is written.
        c: thread.
        pilot: of the robot, see `TrackingProblem.row`.

    Returns:
        Whether the inputs are within the limits, and so solve the MPC.
    """
    state, states, inputs = workspace.state[c], workspace.states[c], workspace.inputs[c]
    feed, along, solution = workspace.Z[c, :3], workspace.Z[c, 3:], workspace.solution[c]
    (cos, sin), h = cos_sin(state[2]), workspace.durations[c, 0]
    x, y, turn = read_axis(pilot, 0, h), read_axis(pilot, 1, h), read_axis(pilot, 2, h)
    qx, wx, qy, wy, qt, wt = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(STAGES - 1, -1, -1):
        feed[0, k] = cos * inputs[k, 0] - sin * inputs[k, 1]
        feed[1, k] = sin * inputs[k, 0] + cos * inputs[k, 1]
        feed[2, k] = inputs[k, 2]
        along[0, k], qx, wx = step_back(x, states, k, h, feed[0, k], qx, wx)
        along[1, k], qy, wy = step_back(y, states, k, h, feed[1, k], qy, wy)
        along[2, k], qt, wt = step_back(turn, states, k, h, feed[2, k], qt, wt)
    px, py, pt, vx, vy, vt = state[0], state[1], state[2], state[3], state[4], state[5]
    for k in range(STAGES):
        ux, px, vx = step_on(x, states, k, h, feed[0, k], along[0, k], px, vx)
        uy, py, vy = step_on(y, states, k, h, feed[1, k], along[1, k], py, vy)
        ut, pt, vt = step_on(turn, states, k, h, feed[2, k], along[2, k], pt, vt)
        solution[3 * k], solution[3 * k + 1], solution[3 * k + 2] = cos * ux + sin * uy, cos * uy - sin * ux, ut
        for i in range(3):
            if not abs(solution[3 * k + i]) <= pilot[INPUT_LIMIT + i]:
                return False
    return True


@inlined
def solve_tracking(workspace: Workspace, c: int, pilot: np.ndarray) -> bool:
    """Solve the MPC in thread c's workspace.

    Args:
        workspace: with the reference filled in; ``solution`` is written.
        c: thread.
        pilot: of the robot, see `TrackingProblem.row`.

    Returns:
        False if the QP was not solved within the Newton steps allowed, or the state is not finite.
    """
    if pilot[ENDLESS] == 1.0 and workspace.node[c] == NO_JUMP and solve_freely(workspace, c, pilot):
        return True
    return solve_in_limits(workspace, c, pilot)


@compiled
def solve_in_limits(workspace: Workspace, c: int, pilot: np.ndarray) -> bool:
    """Solve the MPC as a QP: `solve_tracking` where a limit binds or an impact comes."""
    H, g, inputs = workspace.H[c], workspace.vectors[c, 0], workspace.inputs[c]
    lower, upper, x = workspace.vectors[c, 1], workspace.vectors[c, 2], workspace.vectors[c, 3]
    condense(
        workspace.state[c],
        workspace.states[c],
        inputs,
        workspace.durations[c],
        workspace.node[c],
        workspace.jump[c],
        pilot,
        workspace.Z[c],
        H,
        g,
    )
    for k in range(STAGES):
        for i in range(3):
            at, limit = find_unknown(k, i), pilot[INPUT_LIMIT + i]
            lower[at], upper[at], x[at] = -limit - inputs[k, i], limit - inputs[k, i], 0.0
    scratch = workspace.vectors[c, 4:]
    used = solve_box_qp(H, g, lower, upper, x, FORCES, workspace.U[c], scratch, workspace.free[c], workspace.steps[c])
    for k in range(STAGES):
        for i in range(3):
            workspace.solution[c, 3 * k + i] = inputs[k, i] + x[find_unknown(k, i)]
    return used != NOT_SOLVED

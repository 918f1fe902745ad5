"""Tracking control of one free-flyer: impact-aware MPC, as one box-constrained QP or, where no limit binds, recursion.

State (q, v) = [x, y, heading, vx, vy, omega] in the world frame, input [Fx, Fy, torque] in the body frame. With the
heading held over the horizon the dynamics are linear and the whole problem condenses into the inputs.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from impact_envs.compiled import compiled
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


@compiled
def solve_freely(workspace: Workspace, c: int, pilot: np.ndarray) -> bool:
    r"""Solve the MPC without limits and without an impact in the horizon, by its Riccati recursion.

    e_{k+1} = A e_k + B d_k + c_k with c_k = A x_ref,k + B u_ref,k - x_ref,k+1;  p_k = (A - B K)' (P c_k + p_{k+1});
    d_k = -K e_k - B' (P c_k + p_{k+1}) / (R + B' P B)

    P is the same at all stages, because the end is weighted by it; so it is for each axis in the world frame, where
    the weights of x and y are equal.

    Args:
        workspace: with the reference filled in; ``solution`` is written.
        c: thread.
        pilot: of the robot, see `TrackingProblem.row`.

    Returns:
        Whether the inputs are within the limits, and so solve the MPC.
    """
    state, states, inputs = workspace.state[c], workspace.states[c], workspace.inputs[c]
    offset, feed, solution = workspace.Z[c, 0], workspace.Z[c, 1], workspace.solution[c]
    cos, sin, h = math.cos(state[2]), math.sin(state[2]), workspace.durations[c, 0]
    for axis in range(3):
        P, K, g = WEIGHT + 9 + 3 * axis, FEEDBACK + 2 * axis, pilot[GAIN + axis]
        pp, pv, vv, kp, kv = pilot[P], pilot[P + 1], pilot[P + 2], pilot[K], pilot[K + 1]
        bp, bv = g * h * h / 2, g * h
        q, w = 0.0, 0.0
        for k in range(STAGES - 1, -1, -1):
            u = inputs[k, 2]
            if axis == 0:
                u = cos * inputs[k, 0] - sin * inputs[k, 1]
            elif axis == 1:
                u = sin * inputs[k, 0] + cos * inputs[k, 1]
            position, speed = states[k, axis], states[k, 3 + axis]
            cp = position + h * speed + bp * u - states[k + 1, axis]
            cv = speed + bv * u - states[k + 1, 3 + axis]
            feed[k], offset[k] = u, 0.0
            if cp == 0.0 and cv == 0.0 and q == 0.0 and w == 0.0:  # a reference that rests, as every heading does
                continue
            q, w = q + pp * cp + pv * cv, w + pv * cp + vv * cv
            offset[k] = bp * q + bv * w
            q, w = (1.0 - bp * kp) * q - bv * kp * w, (h - bp * kv) * q + (1.0 - bv * kv) * w
        share = 1.0 / (pilot[EFFORT + axis] + bp * (pp * bp + pv * bv) + bv * (pv * bp + vv * bv))
        position, speed = state[axis], state[3 + axis]
        for k in range(STAGES):
            d = -kp * (position - states[k, axis]) - kv * (speed - states[k, 3 + axis]) - share * offset[k]
            u = feed[k] + d
            position, speed = position + h * speed + bp * u, speed + bv * u
            solution[3 * k + axis] = u
    for k in range(STAGES):
        x, y = solution[3 * k], solution[3 * k + 1]
        solution[3 * k], solution[3 * k + 1] = cos * x + sin * y, cos * y - sin * x
        for i in range(3):
            if not abs(solution[3 * k + i]) <= pilot[INPUT_LIMIT + i]:
                return False
    return True


@compiled
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

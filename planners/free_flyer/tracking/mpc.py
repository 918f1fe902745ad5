"""Tracking control of one free-flyer: impact-aware MPC, as one box-constrained QP or, where no limit binds, recursion.

State (q, v) = [x, y, heading, vx, vy, omega] in the world frame, input [Fx, Fy, torque] in the body frame. With the
heading held over the horizon the dynamics are linear and the whole problem condenses into the inputs.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from impact_envs.compiled import compiled
from planners.free_flyer.tracking.box_qp import NEWTON_STEPS, NOT_SOLVED, solve_box_qp
from planners.free_flyer.tracking.problem import (
    EFFORT,
    ENDLESS,
    FEEDBACK,
    GAIN,
    INPUT_LIMIT,
    NEAR_WEIGHT,
    NO_JUMP,
    STAGES,
    WEIGHT,
    TrackingTask,
)


@compiled
def jump(z: np.ndarray, normal: tuple[float, float], gain: float, object_speed: float) -> None:
    """Apply the impact to a state in place: v+ = v- - c (n . v- - n . v_O) n.

    Args:
        z: state, shape (6,).
        normal: unit vector n from robot to object.
        gain: c = (1 + e) m_O / (m_R + m_O).
        object_speed: n . v_O [m/s].

    Source: Verhagen & Tumova, Eq. 6, solved for the robot.
    """
    kick = gain * (normal[0] * z[3] + normal[1] * z[4] - object_speed)
    z[3] -= kick * normal[0]
    z[4] -= kick * normal[1]


@compiled
def push(z: np.ndarray, axis: int, acceleration: float, h: float) -> None:
    """Add the effect of an acceleration held over a stage to a state in place.

    Args:
        z: state at the end of the stage, shape (6,).
        axis: 0, 1, 2 for x, y, heading.
        acceleration: along that axis [m/s^2, rad/s^2].
        h: duration of the stage [s].
    """
    z[axis] += h * h / 2 * acceleration
    z[3 + axis] += h * acceleration


@compiled
def push_body(z: np.ndarray, channel: int, u: float, heading: float, gains: np.ndarray, h: float) -> None:
    """Add the effect of one input channel, given in the body frame, held over a stage, to a state in place.

    Args:
        z: state at the end of the stage, shape (6,).
        channel: 0, 1, 2 for Fx, Fy, torque.
        u: input [N, N m].
        heading: of the body [rad].
        gains: acceleration per input, shape (3,).
        h: duration of the stage [s].
    """
    a = gains[channel] * u
    c, s = math.cos(heading), math.sin(heading)
    if channel == 0:
        push(z, 0, c * a, h)
        push(z, 1, s * a, h)
    elif channel == 1:
        push(z, 0, -s * a, h)
        push(z, 1, c * a, h)
    else:
        push(z, 2, a, h)


@compiled
def condense(
    state: np.ndarray,
    states: np.ndarray,
    inputs: np.ndarray,
    durations: np.ndarray,
    jump_node: int,
    impact: np.ndarray,
    pilot: np.ndarray,
    Z: np.ndarray,
    H: np.ndarray,
    g: np.ndarray,
) -> None:
    """Condense the tracking problem into the deviations d = u - u_ref.

    sum_k |x_k - x_ref,k|^2_Q + |d_k|^2_R + |x_N - x_ref,N|^2_P  =  d' H d + 2 g' d + const, with
    x_{k+1} = A(h_k) x_k + B(h_k) u_k, and the jump of an impact before the stage that starts at its node.

    Args:
        state: measured state, shape (6,); its heading turns the forces over the whole horizon.
        states, inputs, durations, jump_node, impact: see `Workspace`.
        pilot: of the robot, see `TrackingProblem.row`.
        Z: scratch, shape (31, 6): row i is the sensitivity of the state to input i, the last row the state itself.
        H: Hessian, written, shape (30, 30).
        g: gradient at d = 0, written, shape (30,).

    Source: Verhagen & Tumova, Eqs. 6, 31 and 33.
    """
    size, stages, heading = len(g), len(durations), state[2]
    for i in range(size):
        g[i] = 0.0
        for j in range(6):
            Z[i, j] = 0.0
        for j in range(size):
            H[i, j] = 0.0
    for i in range(6):
        Z[size, i] = state[i]
    normal, gain = (impact[0], impact[1]), impact[2]
    for k in range(stages):
        h = durations[k]
        for i in range(3 * k + 1):
            z, speed = (Z[size], impact[3]) if i == 3 * k else (Z[i], 0.0)
            if k == jump_node and k > 0:
                jump(z, normal, gain, speed)
            for axis in range(3):
                z[axis] += h * z[3 + axis]
        for channel in range(3):
            push_body(Z[size], channel, inputs[k, channel], heading, pilot, h)
            push_body(Z[3 * k + channel], channel, 1.0, heading, pilot, h)
        W = (WEIGHT if jump_node == NO_JUMP else NEAR_WEIGHT) + (9 if k == stages - 1 else 0)
        for i in range(3 * k + 3):
            for axis in range(3):
                pp, pv, vv = pilot[W + 3 * axis], pilot[W + 3 * axis + 1], pilot[W + 3 * axis + 2]
                position = pp * Z[i, axis] + pv * Z[i, 3 + axis]
                velocity = pv * Z[i, axis] + vv * Z[i, 3 + axis]
                g[i] += position * (Z[size, axis] - states[k + 1, axis])
                g[i] += velocity * (Z[size, 3 + axis] - states[k + 1, 3 + axis])
                for j in range(i + 1):
                    H[i, j] += position * Z[j, axis] + velocity * Z[j, 3 + axis]
    for i in range(size):
        H[i, i] += pilot[EFFORT + i % 3]
        for j in range(i):
            H[j, i] = H[i, j]


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
        Z, H, L, vectors, free: scratch, shapes (T, 31, 6), (T, 30, 30) twice, (T, 6, 30), (T, 30).
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
    L: np.ndarray
    vectors: np.ndarray
    free: np.ndarray
    steps: np.ndarray


def make_workspace(threads: int = 1) -> Workspace:
    """Make room for threads to solve tracking problems in."""
    T, n = threads, 3 * STAGES
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
        Z=np.zeros((T, n + 1, 6)),
        H=np.zeros((T, n, n)),
        L=np.zeros((T, n, n)),
        vectors=np.zeros((T, 6, n)),
        free=np.zeros((T, n), np.bool_),
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
    offset, solution = workspace.Z[c], workspace.solution[c]
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
            q, w = q + pp * cp + pv * cv, w + pv * cp + vv * cv
            offset[k, axis] = bp * q + bv * w
            offset[k, 3 + axis] = u
            q, w = (1.0 - bp * kp) * q - bv * kp * w, (h - bp * kv) * q + (1.0 - bv * kv) * w
        share = 1.0 / (pilot[EFFORT + axis] + bp * (pp * bp + pv * bv) + bv * (pv * bp + vv * bv))
        position, speed = state[axis], state[3 + axis]
        for k in range(STAGES):
            d = -kp * (position - states[k, axis]) - kv * (speed - states[k, 3 + axis]) - share * offset[k, axis]
            u = offset[k, 3 + axis] + d
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
            at, limit = 3 * k + i, pilot[INPUT_LIMIT + i]
            lower[at], upper[at], x[at] = -limit - inputs[k, i], limit - inputs[k, i], 0.0
    d, trial = workspace.vectors[c, 4], workspace.vectors[c, 5]
    used = solve_box_qp(H, g, lower, upper, x, workspace.L[c], d, trial, workspace.free[c], workspace.steps[c])
    for k in range(STAGES):
        for i in range(3):
            workspace.solution[c, 3 * k + i] = inputs[k, i] + x[3 * k + i]
    return used != NOT_SOLVED

"""The tracking problem of one robot as one box-constrained QP: all states are condensed into the inputs; compiled.

Unknowns are the inputs' deviations from the feed-forward: the forces (Fx, Fy) of all stages, then their torques. No
force turns the robot and no torque moves it, so the Hessian has a block of forces and one of torques.
"""

from __future__ import annotations

import numpy as np

from impact_envs.compiled import compiled, inlined
from impact_envs.elementary import cos_sin
from planners.free_flyer.tracking.problem import EFFORT, NEAR_WEIGHT, NO_JUMP, STAGES, WEIGHT

UNKNOWNS, FORCES = 3 * STAGES, 2 * STAGES


@inlined
def find_unknown(k: int, channel: int) -> int:
    """Return the place of stage k's Fx, Fy or torque among the unknowns."""
    return 2 * k + channel if channel < 2 else FORCES + k


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
        state: measured, shape (6,); its heading turns the forces over the whole horizon.
        states, inputs, durations, jump_node, impact: see `mpc.Workspace`.
        pilot: of the robot, see `TrackingProblem.row`.
        Z: scratch, shape (6, 31): column i is the sensitivity of the state to unknown i, the last column the state.
        H: Hessian, written but for the zeros between forces and torques, shape (30, 30).
        g: gradient at d = 0, written, shape (30,).

    Source: Verhagen & Tumova, Eqs. 6, 31 and 33.
    """
    for i in range(UNKNOWNS):
        g[i] = 0.0
        for j in range(i + 1):
            H[i, j] = 0.0
    for component in range(6):
        Z[component, UNKNOWNS] = state[component]
    cos, sin = cos_sin(state[2])
    for k in range(STAGES):
        h = durations[k]
        if k == jump_node and k > 0:
            for i in range(2 * k):
                jump(Z, i, impact, 0.0)
            jump(Z, UNKNOWNS, impact, impact[3])
        drift(Z, 0, 2 * k, 0, 2, h)
        drift(Z, FORCES, FORCES + k, 2, 3, h)
        drift(Z, UNKNOWNS, UNKNOWNS + 1, 0, 3, h)
        for channel in range(3):
            i = find_unknown(k, channel)
            for component in range(6):
                Z[component, i] = 0.0
            push(Z, UNKNOWNS, channel, pilot[channel] * inputs[k, channel], cos, sin, h)
            push(Z, i, channel, pilot[channel], cos, sin, h)
        W = (WEIGHT if jump_node == NO_JUMP else NEAR_WEIGHT) + (9 if k == STAGES - 1 else 0)
        for axis in range(2):
            add_cost(Z, H, g, states[k + 1], pilot, W, axis, 0, 2 * k + 2)
        add_cost(Z, H, g, states[k + 1], pilot, W, 2, FORCES, FORCES + k + 1)
    for i in range(UNKNOWNS):
        H[i, i] += pilot[EFFORT + (i % 2 if i < FORCES else 2)]
        for j in range(0 if i < FORCES else FORCES, i):
            H[j, i] = H[i, j]


@inlined
def jump(Z: np.ndarray, i: int, impact: np.ndarray, object_speed: float) -> None:
    """Apply the impact to column i: v+ = v- - c (n . v- - n . v_O) n.

    Args:
        Z: see `condense`.
        impact: unit vector n from robot to object, c = (1 + e) m_O / (m_R + m_O).
        object_speed: n . v_O [m/s].

    Source: Verhagen & Tumova, Eq. 6, solved for the robot.
    """
    kick = impact[2] * (impact[0] * Z[3, i] + impact[1] * Z[4, i] - object_speed)
    Z[3, i] -= kick * impact[0]
    Z[4, i] -= kick * impact[1]


@inlined
def drift(Z: np.ndarray, first: int, end: int, axis: int, last: int, h: float) -> None:
    """Let the columns from first to before end fly freely over a stage of h [s], in the axes from axis to before last.

    The axes are x, y, heading.
    """
    for along in range(axis, last):
        for i in range(first, end):
            Z[along, i] += h * Z[3 + along, i]


@inlined
def push(Z: np.ndarray, i: int, channel: int, a: float, cos: float, sin: float, h: float) -> None:
    """Add the effect of an acceleration of one channel in the body frame, held over a stage, to column i.

    Args:
        Z: see `condense`.
        channel: 0, 1, 2 for Fx, Fy, torque.
        a: acceleration [m/s^2, rad/s^2].
        cos, sin: of the heading.
        h: duration of the stage [s].
    """
    if channel == 2:
        Z[2, i] += h * h / 2 * a
        Z[5, i] += h * a
        return
    ax, ay = (cos * a, sin * a) if channel == 0 else (-sin * a, cos * a)
    Z[0, i] += h * h / 2 * ax
    Z[3, i] += h * ax
    Z[1, i] += h * h / 2 * ay
    Z[4, i] += h * ay


@inlined
def add_cost(
    Z: np.ndarray,
    H: np.ndarray,
    g: np.ndarray,
    reference: np.ndarray,
    pilot: np.ndarray,
    W: int,
    axis: int,
    first: int,
    end: int,
) -> None:
    """Add what the error of one axis costs at one node to the unknowns from first to before end.

    Args:
        Z, H, g: see `condense`; of H below the diagonal alone.
        reference: state to be in there, shape (6,).
        pilot: of the robot; its weights (pp, pv, vv) stand from W on.
        axis: 0, 1, 2 for x, y, heading.
    """
    pp, pv, vv = pilot[W + 3 * axis], pilot[W + 3 * axis + 1], pilot[W + 3 * axis + 2]
    off, ahead = Z[axis, UNKNOWNS] - reference[axis], Z[3 + axis, UNKNOWNS] - reference[3 + axis]
    for i in range(first, end):
        position = pp * Z[axis, i] + pv * Z[3 + axis, i]
        velocity = pv * Z[axis, i] + vv * Z[3 + axis, i]
        g[i] += position * off
        g[i] += velocity * ahead
        row, where, speed = H[i, first : i + 1], Z[axis, first : i + 1], Z[3 + axis, first : i + 1]
        for j in range(len(row)):
            row[j] += position * where[j] + velocity * speed[j]

"""Tracking control of one free-flyer without a prediction: feed-forward and LQR feedback of each axis; compiled."""

from __future__ import annotations

import numpy as np

from impact_envs.compiled import compiled
from impact_envs.elementary import cos_sin
from planners.free_flyer.tracking.problem import FEEDBACK, GAIN


@compiled
def solve_lqr(
    state: np.ndarray, reference: np.ndarray, ax: float, ay: float, pilot: np.ndarray, inputs: np.ndarray
) -> None:
    """Write the input [Fx, Fy, torque] in the body frame: u = u_ref - K (x - x_ref); it knows no limits.

    Args:
        state: measured, shape (6,).
        reference: state to be in now, with no turning, shape (6,).
        ax, ay: feed-forward acceleration in the world frame [m/s^2].
        pilot: of the robot, see `TrackingProblem.row`; K is that of the terminal cost of the MPC.
        inputs: written, shape (3,) [N, N, N m].
    """
    g, heading = pilot[GAIN], state[2]
    ax -= g * (pilot[FEEDBACK] * (state[0] - reference[0]) + pilot[FEEDBACK + 1] * (state[3] - reference[3]))
    ay -= g * (pilot[FEEDBACK + 2] * (state[1] - reference[1]) + pilot[FEEDBACK + 3] * (state[4] - reference[4]))
    cos, sin = cos_sin(heading)
    inputs[0] = (cos * ax + sin * ay) / g
    inputs[1] = (cos * ay - sin * ax) / g
    turn = heading - reference[2]
    inputs[2] = -pilot[FEEDBACK + 4] * turn - pilot[FEEDBACK + 5] * state[5]

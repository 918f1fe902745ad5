"""Terms added to the OSDRE torques: cancel the drift, damp joint motion that does not move the tip, avoid the box.

The OSDRE feeds back the error alone. The drift pushes the tip off its goal as long as the joints move; with more than
two joints they continue to move, undamped, while the tip rests. A box that was only grazed still blocks the way.
"""

from __future__ import annotations

import numpy as np

from impact_envs.compiled import compiled
from impact_envs.floating_manipulator.contact import Contact
from planners.floating_manipulator.options import CompensationOptions


@compiled
def compensate_drift(
    options: CompensationOptions, drift: np.ndarray, B: np.ndarray, rates: np.ndarray, u: np.ndarray
) -> None:
    """Cancel the drift, and damp the joint motion that does not move the tip.

    u <- u - B^+ drift - d (1 - B^+ B) dq/dt  with  B^+ = B' (B B' + s^2 1)^-1,  s = `damped_authority`,
    d = `joint_damping`.

    Args:
        options: of the compensation.
        drift: acceleration of the tip without torque, shape (2,) [m/s^2].
        B: its acceleration per torque, shape (2, n) [1/kg/m].
        rates: of the joints, shape (n,) [rad/s].
        u: torques, updated, shape (n,) [N m].
    """
    damping = options.joint_damping
    xx = yy = options.damped_authority * options.damped_authority
    xy, ax, ay = 0.0, drift[0], drift[1]
    for j in range(len(u)):
        xx += B[0, j] * B[0, j]
        yy += B[1, j] * B[1, j]
        xy += B[0, j] * B[1, j]
        ax -= damping * B[0, j] * rates[j]
        ay -= damping * B[1, j] * rates[j]
    determinant = xx * yy - xy * xy
    px, py = (yy * ax - xy * ay) / determinant, (xx * ay - xy * ax) / determinant
    for j in range(len(u)):
        u[j] -= B[0, j] * px + B[1, j] * py + damping * rates[j]


@compiled
def avoid_box(options: CompensationOptions, contact: Contact, B: np.ndarray, u: np.ndarray) -> None:
    """Keep the tip off the box by the smallest change of torques.

    Torques satisfy  d^2 gap/dt^2 + 2 a d gap/dt + a^2 (gap - c) >= 0  with c = `clearance`, a = `approach_rate`: if the
    tip approaches no faster than that, the gap never falls below c (a second-order control barrier function).

    Args:
        options: of the compensation.
        contact: of tip and box; its bias is the gap's acceleration without torque.
        B: the tip's acceleration per torque, shape (2, n) [1/kg/m].
        u: torques, updated, shape (n,) [N m].
    """
    rate = options.approach_rate
    opening = contact.bias + 2.0 * rate * contact.rate + rate * rate * (contact.gap - options.clearance)
    square = options.damped_authority * options.damped_authority
    for j in range(len(u)):
        response = contact.nx * B[0, j] + contact.ny * B[1, j]
        opening += response * u[j]
        square += response * response
    if opening < 0.0:
        for j in range(len(u)):
            u[j] -= (contact.nx * B[0, j] + contact.ny * B[1, j]) * opening / square

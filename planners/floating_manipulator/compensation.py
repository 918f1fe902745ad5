"""What the OSDRE leaves out: acceleration without torque, joint motion that the tip does not feel, and the box.

The OSDRE feeds back the error alone. The drift pushes the tip off its goal as long as the joints move, and with more
than two joints they go on moving, undamped, while the tip rests. A box that was only grazed still lies in the way.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from impact_envs.floating_manipulator.contact import Contact

# Below this singular value of B its generalised inverse is damped: near 0 torques would grow without bound.
DAMPED_AUTHORITY = 1e-2  # [1/kg/m]
CLEARANCE, APPROACH_RATE = 0.02, 2.0  # kept between tip and box [m]; how fast the tip may come nearer to it [1/s]


@njit(cache=True)
def compensate(drift: np.ndarray, B: np.ndarray, rates: np.ndarray, damping: float, u: np.ndarray) -> None:
    """Cancel the drift and damp the joint motion that does not move the tip.

    u <- u - B^+ drift - d (1 - B^+ B) dq/dt  with  B^+ = B' (B B' + s^2 1)^-1,  s = `DAMPED_AUTHORITY`.

    Args:
        drift: acceleration of the tip without torque, shape (2,) [m/s^2].
        B: its acceleration per torque, shape (2, n) [1/kg/m].
        rates: of the joints, shape (n,) [rad/s].
        damping: d [N m s/rad].
        u: torques, shape (n,) [N m]; the result is written here.
    """
    xx = yy = DAMPED_AUTHORITY * DAMPED_AUTHORITY
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


@njit(cache=True)
def keep_off(contact: Contact, B: np.ndarray, u: np.ndarray) -> None:
    """Keep the tip off the box by the smallest change of torques.

    Torques satisfy  d^2 gap/dt^2 + 2 a d gap/dt + a^2 (gap - c) >= 0  with c = `CLEARANCE`, a = `APPROACH_RATE`: once
    the tip comes near no faster than that, the gap never falls below c (a control barrier of second order).

    Args:
        contact: of tip and box; its bias is the gap's acceleration without torque.
        B: the tip's acceleration per torque, shape (2, n) [1/kg/m].
        u: torques, shape (n,) [N m]; the result is written here.
    """
    opening = contact.bias + 2.0 * APPROACH_RATE * contact.rate + APPROACH_RATE**2 * (contact.gap - CLEARANCE)
    square = DAMPED_AUTHORITY * DAMPED_AUTHORITY
    for j in range(len(u)):
        response = contact.nx * B[0, j] + contact.ny * B[1, j]
        opening += response * u[j]
        square += response * response
    if opening < 0.0:
        for j in range(len(u)):
            u[j] -= (contact.nx * B[0, j] + contact.ny * B[1, j]) * opening / square

"""Compliant contact of two surfaces: a normal force that never pulls, and smooth friction that only dissipates.

Scalar functions in the subset of Python that numba compiles. The gap is negative when the surfaces overlap.
"""

from __future__ import annotations

import math

from impact_envs.compiled import compiled
from impact_envs.elementary import atan, exp, power


@compiled
def compute_normal_force(gap: float, gap_rate: float, stiffness: float, damping: float, exponent: float) -> float:
    """Return the force that pushes two surfaces apart: Hunt-Crossley, exponentially extended to separation.

    lambda_N = K (-gap)^c, with K = k - d gap' while they close in and K = k exp(-(d / k) gap') while they part; so it
    is continuous at first touch, smooth at the turning point and never below zero.

    Args:
        gap: distance of the surfaces, negative in overlap [m].
        gap_rate: its derivative [m/s].
        stiffness: k [N/m^c].
        damping: d [N s/m^(c+1)].
        exponent: c of the surfaces' shape.

    Returns:
        lambda_N >= 0 [N].

    Source: Carvalho & Martins (2019), Eq. 38; van Steen et al., Eqs. 5 and 6.
    """
    if gap >= 0.0:
        return 0.0
    factor = stiffness - damping * gap_rate if gap_rate <= 0.0 else stiffness * exp(-damping / stiffness * gap_rate)
    return factor * power(-gap, exponent)


@compiled
def compute_friction(normal_force: float, slip_rate: float, friction: float, slope: float) -> float:
    """Return the smoothed Coulomb force that the moving surface puts on the other, along its slip.

    lambda_T = mu lambda_N (2 / pi) arctan(epsilon sigma'). A steady load below the cone creeps at
    sigma' = tan(pi / 2 * load / (mu lambda_N)) / epsilon.

    Args:
        normal_force: lambda_N [N].
        slip_rate: velocity sigma' of the surface relative to the other along the tangent [m/s].
        friction: mu.
        slope: epsilon [s/m].

    Returns:
        lambda_T, of the sign of the slip [N]; the surface itself feels its opposite.

    Source: van Steen et al., Eq. 7, with the sign that dissipates; Leine & Nijmeijer (2004).
    """
    return friction * normal_force * (2.0 / math.pi) * atan(slope * slip_rate)

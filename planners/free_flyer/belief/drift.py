r"""Weigh whether an object drifts at all: its flight is the mean of one with a drift and one without; compiled.

A filter has a drift a with prior N(0, s^2) per axis. What it would be without one follows from it, since that is the
same filter told that a is nil:

x_0 = x - P_xa a / P_aa,  P_0 = P - P_xa P_ax / P_aa,  and the odds are  p / (1 - p) s^2 / P_aa exp(-|a|^2 / (2 P_aa)),

where p is the share of objects that do not drift (Savage-Dickey). So a drift state costs nothing where nothing drifts,
once it is seen; until then a drift that noise feigns is believed in part only.
"""

from __future__ import annotations

import math

import numpy as np

from impact_envs.compiled import compiled, inlined
from impact_envs.elementary import exp
from planners.free_flyer.belief.options import Options


@inlined
def weigh_drift(z: np.record, options: Options) -> None:
    """Compute the probability that a filter's object does not drift, in place."""
    share = options.estimation.still
    z.still = 0.0
    if z.P_aa > 0.0 and share > 0.0:
        s = options.estimation.drift
        size = z.drift[0] * z.drift[0] + z.drift[1] * z.drift[1]
        likelihood = exp(-size / (2.0 * z.P_aa))
        odds = share * s * s / z.P_aa * likelihood if likelihood > 0.0 else 0.0
        z.still = odds / (odds + 1.0 - share) if odds < math.inf else 1.0


@inlined
def let_drift_change(z: np.record, options: Options, h: float) -> None:
    """Let a drift change over a step, in place; the offset of a turning body would otherwise take up that it does.

    Args:
        z: a FILTER.
        h: step [s].
    """
    if z.P_aa > 0.0 and z.P_dd > 0.0:
        z.P_aa += options.estimation.drift_change * options.estimation.drift_change * h


@inlined
def find_motion(z: np.record) -> tuple[complex, complex, complex]:
    """Return the likely position [m], velocity [m/s] and drift [m/s^2] of a filter, as complex numbers."""
    p, v = complex(z.position[0], z.position[1]), complex(z.velocity[0], z.velocity[1])
    a = complex(z.drift[0], z.drift[1])
    if z.still > 0.0:
        share = z.still / z.P_aa
        p, v, a = p - share * (z.P_pa * a), v - share * (z.P_va * a), (1.0 - z.still) * a
    return p, v, a


@compiled
def find_drift(z: np.record) -> tuple[float, float]:
    """Return the likely drift of a filter [m/s^2]."""
    left = 1.0 - z.still
    return left * z.drift[0], left * z.drift[1]


@inlined
def mix_variance(z: np.record, variance: float, c: complex) -> float:
    """Return the variance of what is linear in a filter's state, with and without a drift.

    Args:
        z: a FILTER.
        variance: of it with a drift, per axis.
        c: its covariance with the drift.
    """
    if z.still == 0.0:
        return variance
    known = (c * c.conjugate()).real / z.P_aa
    size = z.drift[0] * z.drift[0] + z.drift[1] * z.drift[1]
    return variance - z.still * known + z.still * (1.0 - z.still) * known * size / (2.0 * z.P_aa)

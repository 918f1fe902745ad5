r"""Follow the geometric centre of a body about its centre of mass, and say how a hit beside that acts; compiled.

With d the geometric centre seen from the centre of mass in the body's frame, R(theta) the body's heading and omega its
rate, which are measured,

p = p_com + R(theta) d,  v = v_com + omega x R(theta) d.

A filter has p, of the geometric centre, and v_com, so that d counts for nothing as long as the body does not turn:
between two headings p moves by (R(theta') - R(theta)) d beside what v_com does. Plane vectors are complex numbers here,
R(theta) d = exp(i theta) d, and everything is linear in (p, v_com, a, d) over the complex numbers. Errors that are
alike in all directions stay so, and one Hermitian covariance over these four serves both axes.
"""

from __future__ import annotations

import numpy as np

from impact_envs.compiled import compiled, inlined
from impact_envs.elementary import cos_sin
from planners.free_flyer.belief.world_memory import WorldMemory

LEAST = 1e-18  # variance of an offset that is known: a nanometre squared [m^2]; 0 says that there is none


@inlined
def compute_direction(angle: float) -> complex:
    """Return exp(i angle)."""
    cos, sin = cos_sin(angle)
    return complex(cos, sin)


@inlined
def get_offset(z: np.record) -> complex:
    """Return the estimated offset of a FILTER in the body's frame [m]."""
    return complex(z.offset[0], z.offset[1])


@compiled
def open_offset(z: np.record, sigma: float, angle: float, rate: float) -> None:
    """Open a filter for an unknown offset; position and velocity that are known are those of the geometric centre.

    Args:
        z: a FILTER without one.
        sigma: standard deviation of the offset per axis [m].
        angle, rate: heading [rad], [rad/s].
    """
    g, P_dd = 1j * rate * compute_direction(angle), sigma * sigma
    z.P_dd, z.P_vd = P_dd, -g * P_dd
    z.P_vv += rate * rate * P_dd


@compiled
def swing_centre(z: np.record, before: float, after: float) -> None:
    """Move a filter's position, in place, as the body turns about its centre of mass.

    Args:
        z: a FILTER.
        before, after: heading [rad].
    """
    if z.P_dd == 0.0 or before == after:
        return
    s = compute_direction(after) - compute_direction(before)
    move, sd = s * get_offset(z), s * z.P_dd
    z.position[0] += move.real
    z.position[1] += move.imag
    # P_dp = conj(P_pd), and so on.
    z.P_pp += 2.0 * (s * z.P_pd.conjugate()).real + (s * sd.conjugate()).real
    z.P_pv += s * z.P_vd.conjugate()
    z.P_pa += s * z.P_ad.conjugate()
    z.P_pd += sd


@compiled
def correct_centre_velocity(z: np.record, vx: float, vy: float, variance: float, angle: float, rate: float) -> None:
    """Update a filter in place by a measured velocity of the geometric centre of a body that turns.

    Args:
        z: a FILTER.
        vx, vy: measured velocity [m/s].
        variance: of the measurement per axis, above zero [m^2/s^2].
        angle, rate: heading [rad], [rad/s].
    """
    g = 1j * rate * compute_direction(angle)
    back = g.conjugate()
    c_p, c_v = z.P_pv + z.P_pd * back, z.P_vv + z.P_vd * back
    c_a, c_d = z.P_va.conjugate() + z.P_ad * back, z.P_vd.conjugate() + z.P_dd * back
    total = (c_v + g * c_d).real + variance
    expected = complex(z.velocity[0], z.velocity[1]) + g * get_offset(z)
    innovation = complex((vx - expected.real) / total, (vy - expected.imag) / total)
    for field, c in ((z.position, c_p), (z.velocity, c_v), (z.drift, c_a), (z.offset, c_d)):
        change = c * innovation
        field[0] += change.real
        field[1] += change.imag
    share = 1.0 / total
    z.P_pp = max(z.P_pp - share * (c_p * c_p.conjugate()).real, 0.0)
    z.P_vv = max(z.P_vv - share * (c_v * c_v.conjugate()).real, 0.0)
    z.P_aa = max(z.P_aa - share * (c_a * c_a.conjugate()).real, 0.0)
    z.P_dd = max(z.P_dd - share * (c_d * c_d.conjugate()).real, LEAST)
    z.P_pv -= share * c_p * c_v.conjugate()
    z.P_pa -= share * c_p * c_a.conjugate()
    z.P_pd -= share * c_p * c_d.conjugate()
    z.P_va -= share * c_v * c_a.conjugate()
    z.P_vd -= share * c_v * c_d.conjugate()
    z.P_ad -= share * c_a * c_d.conjugate()


@compiled
def find_swing(z: np.record, angle: float, rate: float) -> tuple[float, float, float, float]:
    """Return the geometric centre as seen from the centre of mass [m], and its velocity about it [m/s].

    Args:
        z: a FILTER.
        angle, rate: heading [rad], [rad/s].
    """
    at = compute_direction(angle) * get_offset(z)
    return at.real, at.imag, -rate * at.imag, rate * at.real


@compiled
def extrapolate_swing(memory: WorldMemory, k: int, i: int, time: float) -> tuple[float, float, float, float]:
    """Return what `find_swing` says of body i in free flight at a time."""
    heading = memory.heading[k, i]
    return find_swing(memory.filter[k, i], heading.angle + (time - memory.time[k]) * heading.rate, heading.rate)


@compiled
def compute_lever(z: np.record, gyration: float, angle: float, nx: float, ny: float) -> float:
    """Return m (r x n)^2 / I of a hit: how much of the speed of the place that is hit goes into turning the body.

    1 / m_eff = 1 / m_R + (1 + m (r x n)^2 / I) / m;  a disc's normal goes through its centre: r x n = R(theta) d x n.

    Args:
        z: a FILTER.
        gyration: I / m [m^2].
        angle: heading [rad].
        nx, ny: direction of the impulse, a unit vector.
    """
    at = compute_direction(angle) * get_offset(z)
    arm = at.real * ny - at.imag * nx
    return arm * arm / gyration


@compiled
def compute_spin(z: np.record, gyration: float, angle: float, dx: float, dy: float) -> float:
    """Return what a hit changes a body's rate by that changes its velocity: m (r x dv) / I [rad/s].

    Args:
        z, gyration, angle: see `compute_lever`.
        dx, dy: change of the velocity of the centre of mass [m/s].
    """
    at = compute_direction(angle) * get_offset(z)
    return (at.real * dy - at.imag * dx) / gyration

"""From impact to impact within a control period: the impact law of tip and box, compiled."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from impact_envs.compiled import compiled
from impact_envs.floating_manipulator.actuation import Actuators, compute_forces
from impact_envs.floating_manipulator.events import HIT, RELEASED, advance_to_event
from impact_envs.floating_manipulator.flow import Scratch, System, compute_opening, find_contact
from impact_envs.physics.impact import compute_restitution, is_rebound

# An impact slower than this [m/s], or whose rebound would end within this time [s], is the start of pushing.
LOW_SPEED, CONTACT_TIME = 1e-6, 0.005
EVENTS = 20_000  # in one control period; more means the rule above has failed
# How `advance_to_impact` ends: at the end of the period, at an impact, after too many events, with a lost state.
DONE, STRUCK, ENDLESS, LOST = range(4)

# One impact of the tip on the box.
STRIKE = np.dtype(
    [
        ("time", float),  # since the start of the control period [s]
        ("point", float, 2),  # where they touch [m]
        ("normal", float, 2),  # unit vector from tip to box
        ("impulse", float),  # along it, on the box [N s]
        ("speed", float),  # of approach [m/s]
    ],
    align=True,
)


class Progress(NamedTuple):
    """How far a control period is followed.

    Attributes:
        t: time since its start [s].
        touching: the tip pushes the box.
        events: that were followed.
    """

    t: float
    touching: bool
    events: int


@compiled
def advance_to_impact(
    system: System,
    restitution: tuple[float, float],
    force: np.ndarray,
    q: np.ndarray,
    v: np.ndarray,
    period: float,
    progress: Progress,
    scratch: Scratch,
    strike: np.ndarray,
) -> tuple[int, Progress]:
    """Advance (q, v) in place to the next impact or the end of the control period.

    Args:
        system: true physics.
        restitution: e_0 and v_e [m/s], see `compute_restitution`.
        force: generalised forces, held, shape (m,) [N], [N m].
        q, v: state, shape (m,).
        period: of control [s].
        progress: how far the period is followed.
        scratch: v_minus holds the rates before an impact.
        strike: takes the impact, shape (1,) STRIKE.

    Returns:
        DONE, STRUCK, ENDLESS or LOST, and how far the period is followed.
    """
    t, touching, events = progress.t, progress.touching, progress.events
    while events < EVENTS:
        event, taken = advance_to_event(system, force, q, v, period - t, touching, scratch)
        t += taken
        events += 1
        if event != HIT and event != RELEASED:
            return DONE, Progress(t, touching, events)
        touching = False
        if event == HIT:
            struck, touching = collide(system, restitution, force, q, v, scratch, strike)
            if struck:
                strike[0].time = t
                return STRUCK, Progress(t, touching, events)
        if not is_finite(q, v):
            return LOST, Progress(t, touching, events)
    return ENDLESS, Progress(t, touching, events)


@compiled
def hold_controls(
    system: System,
    actuators: Actuators,
    restitution: tuple[float, float],
    command: np.ndarray,
    force: np.ndarray,
    q: np.ndarray,
    v: np.ndarray,
    period: float,
    progress: Progress,
    scratch: Scratch,
    strike: np.ndarray,
) -> tuple[int, Progress]:
    """Compute the forces that controls bring, and advance (q, v) to the first impact or the end of the control period.

    Args:
        command: Fx, Fy and torque on the base, joint torques, shape (n + 3,) [N], [N m].
        force: takes the forces, shape (m,) [N], [N m].
        system, restitution, q, v, period, progress, scratch, strike: as for `advance_to_impact`.

    Returns:
        As `advance_to_impact`.
    """
    compute_forces(actuators, v, command, force)
    return advance_to_impact(system, restitution, force, q, v, period, progress, scratch, strike)


@compiled
def collide(
    system: System,
    restitution: tuple[float, float],
    force: np.ndarray,
    q: np.ndarray,
    v: np.ndarray,
    scratch: Scratch,
    strike: np.ndarray,
) -> tuple[bool, bool]:
    """Apply an impact to the velocities, or start to push.

    v+ = v- + M^-1 row' p with p = (1 + e) m_eff v_rel; the start of a push takes e = 0.

    Args:
        system, restitution, force, q, v, scratch, strike: as for `advance_to_impact`.

    Returns:
        Whether there is an impact, and whether the tip pushes the box from now on.

    Source: Newton's law of restitution in generalised coordinates, see `physics.impact`.
    """
    contact = find_contact(system, q, v, scratch)
    press = -compute_opening(system, force, q, v, scratch)
    speed = -contact.rate
    rebounds = is_rebound(speed, press, LOW_SPEED, CONTACT_TIME)
    e = compute_restitution(speed, restitution[0], restitution[1]) if rebounds else 0.0
    inverse_mass = 0.0
    for i in range(len(v)):
        inverse_mass += scratch.row[i] * scratch.response[i]
    impulse = (1.0 + e) / inverse_mass * max(speed, 0.0)
    for i in range(len(v)):
        scratch.v_minus[i] = v[i]
        v[i] += scratch.response[i] * impulse
    if rebounds:
        record, m = strike[0], len(q)
        record.point[0], record.point[1] = q[m - 3] + contact.rx, q[m - 2] + contact.ry
        record.normal[0], record.normal[1] = -contact.nx, -contact.ny
        record.impulse, record.speed = impulse, speed
    return rebounds, not rebounds and press > 0.0


@compiled
def is_finite(q: np.ndarray, v: np.ndarray) -> bool:
    """Return whether all numbers of a state are finite."""
    total = 0.0
    for i in range(len(q)):
        total += 0.0 * q[i] + 0.0 * v[i]
    return total == 0.0

"""Simulation from event to event: when the tip meets the box, and when it stops pushing it."""

from __future__ import annotations

import math

import numpy as np

from impact_envs.compiled import compiled
from impact_envs.floating_manipulator.flow import (
    Scratch,
    System,
    compute_acceleration,
    compute_response,
    find_contact,
    take_step,
)
from impact_envs.physics.multibody import compute_mass_matrix, factorise

# Longest integration step, shortest step while pushing, and times that are rounding errors [s].
STEP, SHORTEST, ROUNDING = 0.0025, 1e-5, 1e-12
# Greatest overlap by rounding, and greatest gap that counts as touching [m].
TOUCHING = 1e-12
BISECTIONS = 60
# Greatest slide of the tip in a step while pushing, relative to its radius: no corner of the box is missed.
STRIDE = 0.1
FLOWN, HIT, RELEASED = 0, 1, 2


@compiled
def look_ahead(
    system: System, force: np.ndarray, q: np.ndarray, v: np.ndarray, h: float, scratch: Scratch
) -> tuple[float, float]:
    """Return the gap and its rate after a time h of free flight; scratch holds the state there."""
    take_step(system, force, q, v, h, False, scratch)
    contact = find_contact(system, scratch.q_next, scratch.v_next, scratch)
    return contact.gap, contact.rate


@compiled
def find_turn(
    system: System, force: np.ndarray, q: np.ndarray, v: np.ndarray, h: float, sign: float, scratch: Scratch
) -> float:
    """Return the time before h at which the gap's rate loses a sign, by bisection from below."""
    low, high = 0.0, h
    for _ in range(BISECTIONS):
        middle = (low + high) / 2.0
        _, rate = look_ahead(system, force, q, v, middle, scratch)
        if sign * rate > 0.0:
            low = middle
        else:
            high = middle
    return low


@compiled
def find_hit(
    system: System, force: np.ndarray, q: np.ndarray, v: np.ndarray, h: float, scratch: Scratch
) -> tuple[bool, float]:
    """Find the time at which the tip meets the box within a step of free flight.

    A step that starts in touch meets the box at once if the gap closes; if the gap opens and closes again, the hit is
    searched after its maximum.

    Args:
        system: true physics.
        force: generalised forces, shape (m,).
        q, v: state at the start of the step, shape (m,).
        h: length of the step [s].
        scratch: holds the state after h if there is no hit.

    Returns:
        Whether there is a hit, and its time from the start; the gap there is not negative.
    """
    start = find_contact(system, q, v, scratch)
    gap, rate = look_ahead(system, force, q, v, h, scratch)
    low, high = 0.0, h
    if gap >= -TOUCHING:
        if not (start.rate < 0.0 < rate and start.gap + start.rate * h < 0.0):
            return False, h
        high = find_turn(system, force, q, v, h, -1.0, scratch)
        gap, _ = look_ahead(system, force, q, v, high, scratch)
        if gap >= -TOUCHING:
            look_ahead(system, force, q, v, h, scratch)
            return False, h
    if start.gap <= TOUCHING:
        if start.rate <= 0.0:
            return True, 0.0
        low = find_turn(system, force, q, v, high, 1.0, scratch)
        gap, _ = look_ahead(system, force, q, v, low, scratch)
        if gap < 0.0:
            return True, low
    for _ in range(BISECTIONS):
        middle = (low + high) / 2.0
        gap, _ = look_ahead(system, force, q, v, middle, scratch)
        if gap >= 0.0:
            low = middle
        else:
            high = middle
    return True, low


@compiled
def find_release(
    system: System, force: np.ndarray, q: np.ndarray, v: np.ndarray, h: float, scratch: Scratch
) -> tuple[bool, float]:
    """Find the time at which the tip stops pushing within a step, by bisection on the normal force.

    Args:
        system: true physics.
        force: generalised forces, shape (m,).
        q, v: state at the start of the step, shape (m,).
        h: length of the step [s].
        scratch: holds the state after h if there is no release.

    Returns:
        Whether there is a release, and its time from the start.
    """
    low, high, end = 0.0, 0.0, h
    for _ in range(BISECTIONS):
        take_step(system, force, q, v, end, True, scratch)
        if compute_acceleration(system, force, scratch.q_next, scratch.v_next, True, scratch.a[0], scratch) >= 0.0:
            low = end
        else:
            high = end
        if high == 0.0:
            return False, h
        end = (low + high) / 2.0
    return True, low


@compiled
def close_gap(system: System, q: np.ndarray, v: np.ndarray, scratch: Scratch) -> None:
    """Correct the rounding errors of a closed gap and of its rate, by equal and opposite impulses."""
    contact = find_contact(system, q, v, scratch)
    compute_mass_matrix(system.chain, scratch.w, scratch.M)
    factorise(scratch.M)
    inverse_mass = compute_response(system, contact, scratch)
    for i in range(len(q)):
        q[i] -= scratch.response[i] * contact.gap / inverse_mass
        v[i] -= scratch.response[i] * contact.rate / inverse_mass


@compiled
def advance_to_event(
    system: System,
    force: np.ndarray,
    q: np.ndarray,
    v: np.ndarray,
    duration: float,
    touching: bool,
    scratch: Scratch,
) -> tuple[int, float]:
    """Advance (q, v) in place until an event or the end of the duration.

    Args:
        system: true physics.
        force: generalised forces, held, shape (m,) [N], [N m].
        q, v: state, shape (m,).
        duration: [s].
        touching: the tip pushes the box.
        scratch: working arrays.

    Returns:
        FLOWN (no event), HIT (the tip meets the box) or RELEASED (it stops pushing), and the time until then [s].
    """
    t = 0.0
    while duration - t > ROUNDING:
        left = duration - t
        h = left / max(math.ceil(left / STEP - 1e-9), 1)
        if touching:
            slip = abs(find_contact(system, q, v, scratch).slip)
            h = min(h, max(STRIDE * system.radius / max(slip, ROUNDING), SHORTEST))
            happened, when = find_release(system, force, q, v, h, scratch)
        else:
            happened, when = find_hit(system, force, q, v, h, scratch)
        if happened:
            take_step(system, force, q, v, when, touching, scratch)
        for i in range(len(q)):
            q[i], v[i] = scratch.q_next[i], scratch.v_next[i]
        t += when
        if touching:
            close_gap(system, q, v, scratch)
        if happened:
            return RELEASED if touching else HIT, t
    return FLOWN, duration

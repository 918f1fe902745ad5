"""Which readings of a mechanism's coordinates are believed: those that motion within the limits explains; compiled.

Coordinates q and rates v are believed together if each lies within reach of the last ones that were believed or
predicted, moved on at constant rates:

|q - (q_hat + T v_hat)| <= m_q + dv dt,  |v - v_hat| <= m_v + a dt + dv,

with margins m for noise, a what the actuators' limits allow, and dv what an impact can change the rates by; dv counts
where an impact may have happened: one was felt, or readings were missing. dt is the time since the last reading,
believed or not: missing readings open the gate, wrong ones do not. One number out of reach rejects the reading. So does
a reading that repeats the one before it bit for bit although it has a rate.

Readings that stay out of reach, but agree with each other (each is within reach of the one before it) for `patience`,
are taken up: then what was predicted was wrong, and not the sensor.
"""

from __future__ import annotations

import math

import numpy as np

from impact_envs.compiled import compiled

# What is done with a reading, in `COUNTS` by name; the first two are replaced by a prediction.
MISSING, REJECTED, TAKEN_UP, BELIEVED = range(4)
COUNTS = ("no_measurement", "rejected", "taken_up")
# Rows of a gate, an array of a column for each coordinate, in SI units. What is known: coordinate and rate that are
# believed, and those read last. Its reach: margins of both, acceleration by the actuators at their limits, change of
# the rate by an impact, and whether the coordinate is known up to whole turns only.
Q, V, LAST_Q, LAST_V, PLACE, RATE, PUSH, JUMP, TURNS, STATE, ROWS = range(11)
# Columns of the row STATE: periods since anything was read, periods for which readings that are rejected agree, and
# how many different readings there were: sensors with a delay repeat the first one.
UNREAD, AGREEING, DIFFERENT = range(3)
NEVER = 1e9  # periods since the last reading, before the first one
STILL = 1e-9  # what moves more slowly can be read twice at the same place


def make_gate(place: np.ndarray, rate: np.ndarray, push: np.ndarray, jump: np.ndarray, turns: np.ndarray) -> np.ndarray:
    """Make the gate of n >= 3 coordinates.

    Args:
        place, rate: margins of coordinates and rates, shape (n,).
        push: acceleration by the actuators at their limits, shape (n,).
        jump: change of the rate by an impact, at most, shape (n,).
        turns: which coordinates are known up to whole turns only, shape (n,).

    Returns:
        Shape (ROWS, n).
    """
    gate = np.zeros((ROWS, len(place)))
    gate[PLACE], gate[RATE], gate[PUSH], gate[JUMP], gate[TURNS] = place, rate, push, jump, turns
    return gate


def open_gate(gate: np.ndarray, q: np.ndarray, known: bool = True) -> None:
    """Expect the first reading at rest at coordinates q.

    Args:
        gate: changed in place.
        q: at the start, shape (n,).
        known: otherwise the first reading may be anywhere.
    """
    gate[Q], gate[V], gate[LAST_Q], gate[LAST_V], gate[STATE] = q, 0.0, np.nan, np.nan, 0.0
    gate[STATE, UNREAD] = 0.0 if known else NEVER


@compiled
def judge_reading(gate: np.ndarray, q: np.ndarray, v: np.ndarray, period: float, touched: bool, patience: float) -> int:
    """Return what is done with a reading; if it is believed or taken up, it is what is believed now.

    Args:
        gate: changed in place, shape (ROWS, n).
        q, v: as read, shape (n,).
        period: of control, T [s].
        touched: an impact was felt.
        patience: after which readings that are rejected, but agree, are taken up [s].
    """
    n, state = gate.shape[1], gate[STATE]
    total, moving, repeated = 0.0, False, True
    for i in range(n):
        total += q[i] + v[i]
        repeated = repeated and q[i] == gate[LAST_Q, i] and v[i] == gate[LAST_V, i]
        moving = moving or abs(v[i]) > STILL
    if not math.isfinite(total):
        state[UNREAD] += 1.0
        return MISSING
    hit, dt = touched or state[UNREAD] > 0.0, (1.0 + state[UNREAD]) * period
    stale = repeated and moving and state[DIFFERENT] > 1.0
    state[UNREAD] = state[UNREAD] + 1.0 if stale else 0.0
    state[DIFFERENT] += 0.0 if repeated else 1.0
    near, agrees = not stale, True
    if near:
        near = is_near(gate, Q, q, v, period, dt, hit)
    if not near:
        agrees = is_near(gate, LAST_Q, q, v, period, dt, hit)
    for i in range(n):
        gate[LAST_Q, i], gate[LAST_V, i] = q[i], v[i]
    if near:
        state[AGREEING] = 0.0
    else:
        state[AGREEING] = state[AGREEING] + 1.0 if agrees else 0.0
        if state[AGREEING] * period < patience - period / 2.0:
            return REJECTED
        state[AGREEING] = 0.0
    for i in range(n):
        gate[Q, i], gate[V, i] = q[i], v[i]
    return BELIEVED if near else TAKEN_UP


@compiled
def is_near(gate: np.ndarray, row: int, q: np.ndarray, v: np.ndarray, period: float, dt: float, hit: bool) -> bool:
    """Return whether coordinates and rates lie within reach of others a period before them.

    Args:
        gate: holds the others.
        row: of their coordinates; that of their rates comes next.
        q, v: as read, shape (n,).
        period: of control [s].
        dt: time since the last reading [s].
        hit: an impact may have happened since then.
    """
    for i in range(gate.shape[1]):
        jump = gate[JUMP, i] if hit else 0.0
        away = q[i] - gate[row, i] - period * gate[row + 1, i]
        if gate[TURNS, i]:
            away -= 2.0 * math.pi * math.floor(away / (2.0 * math.pi) + 0.5)
        near = abs(away) <= gate[PLACE, i] + jump * dt
        if not (near and abs(v[i] - gate[row + 1, i]) <= gate[RATE, i] + gate[PUSH, i] * dt + jump):
            return False
    return True


@compiled
def predict_reading(gate: np.ndarray, a: np.ndarray, period: float) -> None:
    """Move on what is believed by a period instead of a reading: q += T v + T^2 a / 2, v += T a.

    Args:
        gate: changed in place.
        a: acceleration, shape (n,).
        period: T [s].
    """
    for i in range(gate.shape[1]):
        gate[Q, i] += period * (gate[V, i] + period / 2.0 * a[i])
        gate[V, i] += period * a[i]

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
from typing import NamedTuple

import numpy as np
from numba import njit

# What is done with a reading; the first two are replaced by a prediction.
MISSING, REJECTED, TAKEN_UP, BELIEVED = range(4)
NEVER = 1e9  # periods since the last reading, before the first one
STILL = 1e-9  # what moves more slowly can be read twice at the same place
# Places in `ReadingGate._state`: periods since anything was read, periods for which readings that are rejected agree,
# and how many different readings there were: sensors with a delay repeat the first one.
UNREAD, AGREEING, DIFFERENT, STATE_SIZE = range(4)


class Reach(NamedTuple):
    """How far from what is predicted a coordinate and its rate are believed; SI units, each of shape (n,).

    Attributes:
        place, rate: margins.
        push: acceleration by the actuators at their limits.
        jump: change of the rate by an impact.
        turns: whether the coordinate is known up to whole turns only.
    """

    place: np.ndarray
    rate: np.ndarray
    push: np.ndarray
    jump: np.ndarray
    turns: np.ndarray


class ReadingGate:
    """Judge the readings of n coordinates and their rates, one call per control period.

    Args:
        reach: of every coordinate.
        period: of control, T [s].
        patience: after which readings that are rejected, but agree, are taken up [s].

    Attributes:
        q, v: what is believed now, shape (n,): the reading, or what `predict` was told.
    """

    def __init__(self, reach: Reach, period: float, patience: float) -> None:
        self._reach, self._period = reach, period
        self._patience = math.ceil(patience / period)
        self.reset(np.zeros(len(reach.place)))

    def reset(self, q: np.ndarray, known: bool = True) -> None:
        """Expect the first reading at rest at coordinates q, shape (n,).

        Args:
            q: at the start.
            known: otherwise the first reading may be anywhere.
        """
        self.q, self.v = np.array(q, dtype=float), np.zeros(len(q))
        self._last_q, self._last_v = np.full(len(q), np.nan), np.full(len(q), np.nan)
        self._state = np.zeros(STATE_SIZE)
        self._state[UNREAD] = 0.0 if known else NEVER

    def judge(self, q: np.ndarray, v: np.ndarray, touched: bool) -> int:
        """Return what is done with a reading; if it is believed or taken up, it is the new `q` and `v`.

        Args:
            q, v: as read, shape (n,).
            touched: an impact was felt.
        """
        believed, last = (self.q, self.v), (self._last_q, self._last_v)
        return judge_reading(self._reach, q, v, *believed, *last, self._state, self._period, touched, self._patience)

    def predict(self, a: np.ndarray) -> None:
        """Move on what is believed by a period instead of a reading: q += T v + T^2 a / 2, v += T a.

        Args:
            a: acceleration, shape (n,).
        """
        self.q += self._period * (self.v + self._period / 2.0 * a)
        self.v += self._period * a


@njit(cache=True)
def judge_reading(
    reach: Reach,
    q: np.ndarray,
    v: np.ndarray,
    q_hat: np.ndarray,
    v_hat: np.ndarray,
    last_q: np.ndarray,
    last_v: np.ndarray,
    state: np.ndarray,
    period: float,
    touched: bool,
    patience: int,
) -> int:
    """Judge a reading, see `ReadingGate.judge`; what is believed, the last reading and the state are updated."""
    total, moving, repeated = 0.0, False, True
    for i in range(len(q)):
        total += q[i] + v[i]
        repeated = repeated and q[i] == last_q[i] and v[i] == last_v[i]
        moving = moving or abs(v[i]) > STILL
    if not math.isfinite(total):
        state[UNREAD] += 1.0
        return MISSING
    hit, dt = touched or state[UNREAD] > 0.0, (1.0 + state[UNREAD]) * period
    stale = repeated and moving and state[DIFFERENT] > 1.0
    state[UNREAD] = state[UNREAD] + 1.0 if stale else 0.0
    state[DIFFERENT] += 0.0 if repeated else 1.0
    near = not stale and is_near(reach, q, v, q_hat, v_hat, period, dt, hit)
    agrees = is_near(reach, q, v, last_q, last_v, period, dt, hit)
    last_q[:], last_v[:] = q, v
    if near:
        state[AGREEING] = 0.0
    else:
        state[AGREEING] = state[AGREEING] + 1.0 if agrees else 0.0
        if state[AGREEING] < patience:
            return REJECTED
        state[AGREEING] = 0.0
    q_hat[:], v_hat[:] = q, v
    return BELIEVED if near else TAKEN_UP


@njit(cache=True)
def is_near(
    reach: Reach,
    q: np.ndarray,
    v: np.ndarray,
    q_hat: np.ndarray,
    v_hat: np.ndarray,
    period: float,
    dt: float,
    hit: bool,
) -> bool:
    """Return whether coordinates and rates lie within reach of others a period before them.

    Args:
        dt: time since the last reading [s].
        hit: an impact may have happened since then.
    """
    for i in range(len(q)):
        jump = reach.jump[i] if hit else 0.0
        away = q[i] - q_hat[i] - period * v_hat[i]
        if reach.turns[i]:
            away -= 2.0 * math.pi * math.floor(away / (2.0 * math.pi) + 0.5)
        near = abs(away) <= reach.place[i] + jump * dt
        if not (near and abs(v[i] - v_hat[i]) <= reach.rate[i] + reach.push[i] * dt + jump):
            return False
    return True

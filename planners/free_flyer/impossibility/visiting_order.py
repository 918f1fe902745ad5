"""Whether one body can visit its places in their windows of time, in any order, and why not."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from impact_envs.stl import In, Predicate
from planners.free_flyer.impossibility.convex_polygon import measure_distance
from planners.free_flyer.impossibility.necessary_visits import Moment, Recurrence, Stay

MOST_CALLS = 8  # places of one body whose orders are compared; with more, the first ones
ROUND_OFF = 1e-9  # of times [s], and relative
LATER = "allow more time, move the places nearer, or raise speed limits"


@dataclass(frozen=True)
class Impossibility:
    """Say why there is no plan, and what would help."""

    reason: str
    remedy: str


@dataclass(frozen=True, eq=False)
class Call:
    """Say that a body is in a place at some instant of a window.

    Args:
        body: its name.
        said: what it is told by, such as "in dock".
        place: convex polygon, shape (n, 2) [m].
        start: of the window [s].
        end: of the window [s].
        moment: of which the window is.
    """

    body: str
    said: str
    place: np.ndarray
    start: float
    end: float
    moment: Moment

    @property
    def when(self) -> str:
        """Return the window that the formula gives, in words."""
        start, end = self.moment.start, self.moment.end
        if start == end:
            return f"at {start:.4g} s"
        return f"by {end:.4g} s" if start <= 0.0 else f"between {start:.4g} and {end:.4g} s"


def say_place(predicate: Predicate) -> str:
    """Return a predicate about one body, after "the body has to be"."""
    if isinstance(predicate, In):
        return f"{'not ' * predicate.negated}in {predicate.area}"
    return f"where '{predicate}'"


def check_orders(
    calls: Sequence[Call],
    stays: Sequence[Stay],
    cut: Callable[[np.ndarray, Sequence[Predicate]], np.ndarray],
    speed: float,
    forgiven: float,
) -> Impossibility | None:
    """Return which places one body cannot visit in their windows in any order; None: nothing tells.

    Args:
        calls: of the body; windows start when it can first be there.
        stays: for how long it has to be in places.
        cut: returns the part of a place in which predicates hold.
        speed: its greatest [m/s].
        forgiven: by which places may be missed [m].
    """
    own: list[Call] = []
    for call in calls:
        found = _leave_stays(call, stays, cut)
        if isinstance(found, Impossibility):
            return found
        own.append(found)
    own = own[:MOST_CALLS]
    times = np.array([[_find_time(one, other, speed, forgiven) for other in own] for one in own])
    for i, j in itertools.combinations(range(len(own)), 2):
        one, other = own[i], own[j]
        between = min(one.moment.find_spread(other.moment), max(one.end - other.start, other.end - one.start))
        if times[i, j] > between * (1.0 + ROUND_OFF) + ROUND_OFF:
            return _tell_order([one, other], speed, times[i, j], between)
    for size in sorted({3, max(3, len(own))}):
        for chosen in itertools.combinations(range(len(own)), size):
            picked = list(chosen)
            if not _has_order([own[k] for k in picked], times[np.ix_(picked, picked)]):
                return _tell_order([own[k] for k in picked], speed)
    return None


def check_recurrences(
    name: str, recurrences: Sequence[tuple[Recurrence, np.ndarray]], speed: float, period: float, forgiven: float
) -> Impossibility | None:
    """Return which two places one body cannot visit again and again.

    Between the visits of one place before and after one of the other lie two ways; where both recur for long enough
    there is such a pair, and its visits are no farther apart than the span and a control period.

    Args:
        name: of the body.
        recurrences: of its places, with these.
        speed: its greatest [m/s].
        period: of control [s].
        forgiven: by which places may be missed [m].
    """
    for (one, here), (other, there) in itertools.permutations(recurrences, 2):
        begin = max(one.start, other.start)
        lasting = begin + one.span <= other.end and begin + one.span + other.span + period <= one.end
        apart = max(0.0, measure_distance(here, there) - 2.0 * forgiven)
        needed = 2.0 * apart / speed
        if lasting and needed > (one.span + period) * (1.0 + ROUND_OFF):
            asked = f"{name} has to be {say_place(one.predicate)} every {one.span:.4g} s"
            again = f"{say_place(other.predicate)} again and again from {begin:.4g} s on"
            told = f"they are {apart:.3g} m apart, and to and fro takes {needed:.3g} s at {speed:.3g} m/s"
            return Impossibility(f"{asked} and {again}: {told}", LATER)
    return None


def _find_time(one: Call, other: Call, speed: float, forgiven: float) -> float:
    return max(0.0, measure_distance(one.place, other.place) - 2.0 * forgiven) / speed


def _leave_stays(
    call: Call, stays: Sequence[Stay], cut: Callable[[np.ndarray, Sequence[Predicate]], np.ndarray]
) -> Call | Impossibility:
    """Return a call whose window leaves out times at which its body has to be elsewhere."""
    for stay in stays:
        if len(cut(call.place, [stay.predicate])):
            continue
        start, end = call.start, call.end
        if stay.start <= start <= stay.end:
            start = stay.end
        if stay.start <= end <= stay.end:
            end = stay.start
        if start > end:
            told = f"{call.body} has to be {call.said} {call.when}, and {say_place(stay.predicate)}"
            elsewhere = f"from {stay.start:.4g} to {stay.end:.4g} s"
            return Impossibility(f"{told} {elsewhere}: no time is left for both", "change one of the two")
        call = replace(call, start=start, end=end)
    return call


def _tell_order(calls: Sequence[Call], speed: float, time: float | None = None, between: float = 0.0) -> Impossibility:
    asked = " and ".join(f"{call.said} {call.when}" for call in calls)
    told = f"{calls[0].body} has to be {asked}"
    if time is None:
        return Impossibility(f"{told}: at most {speed:.3g} m/s are too slow for any order", LATER)
    apart = measure_distance(calls[0].place, calls[1].place)
    left = f"{between:.3g} s are left" if between > 0.0 else "no time is left"
    return Impossibility(
        f"{told}: they are {apart:.3g} m apart, at most {speed:.3g} m/s need {time:.3g} s, and {left}", LATER
    )


def _has_order(calls: Sequence[Call], times: np.ndarray) -> bool:
    """Return whether some order of calls lets each be reached within its window, however long one stays.

    Args:
        calls: of one body.
        times: between places, shape (n, n) [s].
    """
    count = len(calls)
    before = [
        [i for i in range(count) if i != j and calls[j].moment.find_lag(calls[i].moment) is not None]
        for j in range(count)
    ]
    earliest = {(1 << k, k): calls[k].start for k in range(count) if not before[k]}
    for _ in range(count - 1):
        after: dict[tuple[int, int], float] = {}
        for (done, last), time in earliest.items():
            for k in range(count):
                if done >> k & 1 or not all(done >> i & 1 for i in before[k]):
                    continue
                reached = max(calls[k].start, time + times[last, k])
                if reached <= calls[k].end * (1.0 + ROUND_OFF) + ROUND_OFF:
                    key = done | 1 << k, k
                    after[key] = min(after.get(key, math.inf), reached)
        earliest = after
    return bool(earliest)

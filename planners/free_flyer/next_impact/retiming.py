"""When and how often an object is hit: move an impact to where the object will be, insert one where it goes astray."""

from __future__ import annotations

import math

from impact_envs.compiled import compiled
from planners.free_flyer.belief.estimator import extrapolate
from planners.free_flyer.belief.plan_table import (
    CLOSE,
    DEPTH,
    END,
    NEXT,
    OPEN,
    Script,
)
from planners.free_flyer.belief.world_memory import (
    AGENT,
    IMPACT_INDEX,
    RETIMED,
    TIME,
    Progress,
)
from planners.free_flyer.next_impact.bookkeeping import set_clocks, set_time
from planners.free_flyer.next_impact.desired_velocity import (
    CRUISE,
    ROUND_OFF,
    compute_margin,
)
from planners.free_flyer.next_impact.reachability import compute_arrival, find_contact, is_reachable

FROZEN = 4.0  # before an impact its time is kept [s]
CANDIDATES = 121
REFINED = 20
CROWDING = 0.1  # the object should be hit so deep inside what its knot demands [m]
OUTSIDE = 20.0  # weight of missing that, squared, over missing the planned place, squared
PULL = 1e-5  # weight of changing the time, squared [m^2/s^2]
RESERVE = 4.0  # after the last impact [s], or
RESERVE_SHARE = 0.1  # of the horizon


@compiled
def compute_reserve(script: Script, progress: Progress, k: int, knot: int) -> float:
    """Return the latest time of an impact from which all later ones can be reached [s]."""
    latest, at = script.horizon - max(RESERVE, RESERVE_SHARE * script.horizon), int(script.impact[knot, NEXT])
    x, y = progress.place[k, knot, 0], progress.place[k, knot, 1]
    while at != END:
        latest -= math.hypot(progress.place[k, at, 0] - x, progress.place[k, at, 1] - y) / CRUISE
        x, y = progress.place[k, at, 0], progress.place[k, at, 1]
        at = int(script.impact[at, NEXT])
    return latest


@compiled
def retime(script: Script, progress: Progress, k: int, o: int, now: float) -> None:
    """Move the coming impact of object o to when the object is nearest to where it should be hit.

    min_t |x_O(t) - P_k|^2 + 20 max(0, crowding - margin_k(x_O(t)))^2 + 1e-5 (t - t_k)^2
    """
    strike = progress.strike[k, o]
    index, old = int(strike[IMPACT_INDEX]), strike[TIME]
    latest = min(script.knot[index, CLOSE], max(compute_reserve(script, progress, k, index), old))
    notice = FROZEN
    r = int(strike[AGENT])
    place_x, place_y = find_contact(script, progress, k, index)
    while now + notice < old and not is_reachable(script, progress, k, r, place_x, place_y, 0.0, 0.0, notice):
        notice += 1.0
    earliest = min(max(now + notice, script.knot[index, OPEN]), old)
    best, time = compute_miss(script, progress, k, o, old, old), old
    arrival = compute_arrival(script, progress, k, index)
    if arrival > old:
        # Its robot has to hit something else before: the impact comes when it can.
        earliest, latest, best = arrival, max(latest, arrival + FROZEN), math.inf
    earliest = max(earliest, arrival)
    if latest <= earliest:
        return
    step = (latest - earliest) / (CANDIDATES - 1)
    for i in range(CANDIDATES):
        t = earliest + i * step
        miss = compute_miss(script, progress, k, o, t, old)
        if miss < best:
            best, time = miss, t
    middle = time
    for i in range(1, 2 * REFINED):
        t = min(max(middle + (i / REFINED - 1.0) * step, earliest), latest)
        miss = compute_miss(script, progress, k, o, t, old)
        if miss < best:
            best, time = miss, t
    if abs(time - old) > ROUND_OFF:
        progress.counts[k, RETIMED] += 1
        set_time(script, progress, k, o, index, time)
        set_clocks(script, progress, k, now)


@compiled
def compute_miss(script: Script, progress: Progress, k: int, o: int, time: float, old: float) -> float:
    """Return what `retime` minimises."""
    knot = int(progress.strike[k, o, IMPACT_INDEX])
    x, y, _, _ = extrapolate(progress, k, script.robots + o, time)
    dx, dy = x - progress.place[k, knot, 0], y - progress.place[k, knot, 1]
    outside = max(min(CROWDING, 0.4 * script.knot[knot, DEPTH]) - compute_margin(script, knot, x, y), 0.0)
    return dx * dx + dy * dy + OUTSIDE * outside * outside + PULL * (time - old) * (time - old)

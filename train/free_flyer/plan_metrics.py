"""How well a flight kept what its plan promises: the deviations of objects at impacts, and the boxes they stay in.

Plans for the greatest robustness promise neither; there these metrics are not applicable.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from impact_envs.rollout import Episode
from planners.free_flyer.belief.plan_table import read_tube
from planners.plan import Plan
from train.evaluation.metric import Metric

SETTLED = 0.5  # after an impact the object's velocity is read [s]
_AXES = (("x", "y"), ("vx", "vy"))
ON_EDGE = 1e-3  # so far outside its box an object still counts as inside [m]


def measure_permissible(episode: Episode, scenario: Any, plan: Plan | None) -> float | None:
    """Return the deviation of an object's velocity after an impact that the plan bears, per axis."""
    return plan.deviation if plan else None


def measure_deviation(episode: Episode, scenario: Any, plan: Plan | None) -> float | None:
    """Return the greatest deviation of an object's velocity after an impact, per axis.

    It is taken from the velocity that leads to the plan's next place of the object in the time that is left.
    """
    if plan is None or plan.deviation is None:
        return None
    return max((float(np.abs(each).max()) for each in _list_deviations(episode, plan)), default=None)


def _list_deviations(episode: Episode, plan: Plan) -> Iterator[np.ndarray]:
    for hit in episode.impacts:
        name = hit.a if hit.a in plan.objects else hit.b
        if name not in plan.objects or not {hit.a, hit.b} & {*plan.robots}:
            continue
        at = int(np.searchsorted(episode.times, hit.time + SETTLED))
        knots = [(i.time, i.position) for i in plan.impacts if i.object == name]
        knots.append((plan.horizon, plan.objects[name].position(plan.horizon, "left")))
        # The planned impact nearest in time is the one that came.
        nearest = int(np.argmin([abs(time - hit.time) for time, _ in knots[:-1]])) if len(knots) > 1 else -1
        due, place = knots[nearest + 1]
        if at < len(episode.times) and due > episode.times[at]:
            position, velocity = (np.array([episode.signals[f"{name}.{key}"][at] for key in keys]) for keys in _AXES)
            yield velocity - (place - position) / (due - episode.times[at])


def measure_inside(episode: Episode, scenario: Any, plan: Plan | None) -> float | None:
    """Return the share of the time that the objects are in the boxes of their tubes."""
    off = _measure_outside(episode, plan)
    return None if off is None else float((off <= ON_EDGE).mean())


def measure_outside(episode: Episode, scenario: Any, plan: Plan | None) -> float | None:
    """Return the greatest distance of an object from its box, per axis; 0 inside."""
    off = _measure_outside(episode, plan)
    return None if off is None else float(off.max())


def _measure_outside(episode: Episode, plan: Plan | None) -> np.ndarray | None:
    """Return how far outside its box an object is at every sample, shape (T+1,); None without tubes."""
    if plan is None or not plan.tubes:
        return None
    off, times = np.zeros(len(episode.times)), np.minimum(episode.times, plan.horizon)
    for name, tube in plan.tubes.items():
        centre, half = read_tube(tube, times)
        positions = np.stack([episode.signals[f"{name}.{axis}"] for axis in "xy"], axis=1)
        off = np.maximum(off, (np.abs(positions - centre) - half).max(axis=1))
    return off


METRICS = (
    Metric("permissible_deviation", "m/s", measure_permissible, of_plan=True),
    Metric("flown_deviation", "m/s", measure_deviation, of_plan=True),
    Metric("time_in_tube", "", measure_inside, of_plan=True),
    Metric("outside_tube", "m", measure_outside, of_plan=True),
)

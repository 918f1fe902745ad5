"""Robustness of a plan over continuous time: what holds at the samples holds between them as well.

Time is cut into cells by instants a fraction of a control period apart. A predicate has a value at every instant and,
on every cell, a bound that it does not fall below: a body leaves the line between two instants by no more than its
acceleration and its impacts there let it. Instants and cells take turns in one trace of twice as many samples, on
which the sampled semantics is a lower bound of the continuous one: a window from an instant to another holds the cells
between them, one from a cell to another all that the windows of the cell's instants hold.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.stl import Always, Distance, Eventually, Formula, In, Linear, Not, Predicate, Speed, Until
from impact_envs.stl.robustness import Semantics
from planners.bezier import Curve
from planners.free_flyer.specification.negation_normal_form import Release, compute_normal_form
from planners.free_flyer.validation import SUBSTEPS
from planners.plan import Plan

ROUND_OFF = 1e-6  # by which ends of intervals and impacts may miss an instant [cells]


def compute_continuous_robustness(scenario: FreeFlyerScenario, plan: Plan) -> float | None:
    """Return a robustness that a plan has over continuous time, at most some micrometres less than the exact one.

    Exact but for the bound on the bending of motions within a cell, if all intervals end at instants, no impact is
    within a cell, and no disjunction or F takes its greatest value within one; otherwise it is less by up to the way in
    a cell, some millimetres.

    Args:
        scenario: formula and areas.
        plan: any plan for its robots and objects.

    Returns:
        Lower bound of the robustness [m]; None: the formula speaks of speeds or angles.

    Source: Verhagen & Tumova, Eq. 2, in continuous time.
    """
    formula = compute_normal_form(scenario.specification.expand(scenario.bodies))
    leaves = [node for node in formula.walk() if isinstance(node, Predicate)]
    if any(isinstance(leaf, Speed) or not _is_about_places(leaf) for leaf in leaves):
        return None
    count = round(scenario.horizon / scenario.control_period) * SUBSTEPS
    times = np.linspace(0.0, scenario.horizon, count + 1)
    bodies = {name: _Motion.of(curve, times) for name, curve in (plan.robots | plan.objects).items()}
    cell = float(times[1])

    def measure(predicate: Predicate, number: int) -> np.ndarray:
        return _interleave(*_measure(scenario, predicate, bodies))[:number]

    rows = Semantics(cell / 2.0, np, measure).rho(_align(formula, cell), 1)
    return float(rows[0])


def _is_about_places(predicate: Predicate) -> bool:
    return all(signal.partition(".")[2] in ("x", "y") for signal in predicate.signals())


@dataclass(frozen=True)
class _Motion:
    """Hold where a body is at instants, and how far it may be from the line between them.

    Args:
        places: shape (n + 1, 2) [m].
        bends: on every cell, shape (n,) [m].
    """

    places: np.ndarray
    bends: np.ndarray

    @classmethod
    def of(cls, curve: Curve, times: np.ndarray) -> _Motion:
        """Return the motion of a curve.

        A point that is bound to |p''| <= a is within a h^2 / 8 of the chord of a cell of length h; a jump of its
        velocity by d at a share s of the cell takes it d h s (1 - s) further.
        """
        h = float(times[1] - times[0])
        first = np.clip(np.searchsorted(curve.times, times[:-1], side="right") - 1, 0, len(curve.times) - 2)
        last = np.clip(np.searchsorted(curve.times, times[1:], side="left") - 1, 0, len(curve.times) - 2)
        speeds, strengths = curve.derivative, curve.derivative.derivative
        strongest = np.linalg.norm(strengths.points, axis=2).max(axis=1)
        bends = np.array([strongest[a : b + 1].max() for a, b in zip(first, last, strict=True)]) * h**2 / 8.0
        jumps = np.linalg.norm(speeds.points[1:, 0] - speeds.points[:-1, -1], axis=1)
        for time, jump in zip(curve.times[1:-1], jumps, strict=True):
            cell, share = divmod(time / h, 1.0)
            if min(share, 1.0 - share) > ROUND_OFF:
                bends[int(cell)] += jump * h * share * (1.0 - share)
        return cls(curve.position(times), bends)


def _interleave(instants: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Return instants and the cells between them in the order of time, shape (2 n + 1,)."""
    both = np.empty(len(instants) + len(cells))
    both[::2], both[1::2] = instants, cells
    return both


def _measure(
    scenario: FreeFlyerScenario, predicate: Predicate, bodies: dict[str, _Motion]
) -> tuple[np.ndarray, np.ndarray]:
    """Return a predicate's robustness at instants, and what it does not fall below on the cells between them."""
    match predicate:
        case In(name, area, negated):
            H, b = scenario.areas[area].halfspaces()
            body = bodies[name]
            beyond = body.places @ np.asarray(H).T - np.asarray(b)
            if not negated:
                values = -beyond.max(axis=1)
                return values, np.minimum(values[1:], values[:-1]) - body.bends
            return beyond.max(axis=1), _find_least_of_greatest(beyond) - body.bends
        case Distance(first, second, _, bound):
            one, other = bodies[first], bodies[second]
            offsets, bends = one.places - other.places, one.bends + other.bends
            far = np.linalg.norm(offsets, axis=1)
            if predicate.is_upper:
                return bound - far, bound - np.maximum(far[1:], far[:-1]) - bends
            return far - bound, _measure_nearest(offsets) - bound - bends
        case Linear(terms=terms):
            total: np.ndarray | float = 0.0
            bends = np.zeros(len(next(iter(bodies.values())).bends))
            for signal, factor in terms:
                name, _, axis = signal.partition(".")
                total = total + factor * bodies[name].places[:, "xy".index(axis)]
                bends = bends + abs(factor) * bodies[name].bends
            values = predicate.sign * (predicate.bound - np.asarray(total))
            return values, np.minimum(values[1:], values[:-1]) - bends
    raise TypeError(f"{predicate} is not about places")


def _find_least_of_greatest(values: np.ndarray) -> np.ndarray:
    """Return the least value of the greatest of several lines, between each two instants.

    Args:
        values: of every line at instants, shape (n + 1, f).

    Returns:
        Shape (n,); it is at an end, or where the greatest two lines cross.
    """
    starts, ends = values[:-1], values[1:]
    found = np.minimum(starts.max(axis=1), ends.max(axis=1))
    turning = np.flatnonzero(starts.argmax(axis=1) != ends.argmax(axis=1))
    for k in turning:
        for i, j in itertools.combinations(range(values.shape[1]), 2):
            gap, change = starts[k, i] - starts[k, j], (ends[k, i] - ends[k, j]) - (starts[k, i] - starts[k, j])
            share = -gap / change if change else -1.0
            if 0.0 < share < 1.0:
                found[k] = min(found[k], float(((1.0 - share) * starts[k] + share * ends[k]).max()))
    return found


def _measure_nearest(offsets: np.ndarray) -> np.ndarray:
    """Return the distance of the origin from the lines between each two offsets, shape (n,)."""
    steps = np.diff(offsets, axis=0)
    lengths = np.maximum(np.sum(steps**2, axis=1), 1e-300)
    shares = np.clip(-np.sum(offsets[:-1] * steps, axis=1) / lengths, 0.0, 1.0)
    return np.linalg.norm(offsets[:-1] + shares[:, None] * steps, axis=1)


def _align(formula: Formula, cell: float) -> Formula:
    """Return a formula that implies another one, whose intervals end at instants, and without release."""
    children = [_align(child, cell) for child in formula.children]
    match formula:
        case Always(interval, _):
            return Always(_widen(interval, cell), *children)
        case Eventually(interval, _):
            lower, upper = _narrow(interval, cell)
            if lower > upper:  # no instant within: what always holds there holds there once
                return Always(_widen(interval, cell), *children)
            return Eventually((lower, upper), *children)
        case Until(interval, _, _):
            return Until(_narrow(interval, cell), *children)
        case Release(interval, left, right):
            left, right = children
            return Not(Until(_widen(interval, cell), Not(left), Not(right)))
    return formula.rebuild(children) if children else formula


def _widen(interval: tuple[float, float], cell: float) -> tuple[float, float]:
    lower, upper = (end / cell for end in interval)
    return math.floor(lower + ROUND_OFF) * cell, math.ceil(upper - ROUND_OFF) * cell


def _narrow(interval: tuple[float, float], cell: float) -> tuple[float, float]:
    lower, upper = (end / cell for end in interval)
    return math.ceil(lower - ROUND_OFF) * cell, math.floor(upper + ROUND_OFF) * cell

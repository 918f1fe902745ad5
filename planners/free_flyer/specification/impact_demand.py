"""The region and the time window that the formula requires at each impact of an object, and at its end."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from impact_envs.errors import InputError
from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.stl import Always, And, Eventually, Formula, Or, Predicate, Until
from planners.bezier import Curve
from planners.free_flyer.specification.requirement import Requirement, read_demands
from planners.plan import Plan

AT_REST = 1e-4  # speed below which an object counts as at rest [m/s]
LOOKS = 64  # at a flight between two knots, for where it serves a demand best
ROUND_OFF = 1e-6  # differences of times [s] and margins [m] that count as none


@dataclass(frozen=True, eq=False)
class Via:
    """Hold a place on a flight between two knots at which it serves a demand that none of them serves.

    Args:
        share: of the flight's time.
        position: planned, shape (2,) [m].
        depth: how far it may be off [m].
        closes: until when it has to be passed [s].
    """

    share: float
    position: np.ndarray
    depth: float
    closes: float


@dataclass(eq=False)
class Knot:
    """Hold an impact of an object, or its end.

    Attributes:
        time: planned [s].
        position: planned, of the object's centre, shape (2,) [m].
        faces: rows (H, b) with H p <= b for the object's centre p, shape (f, 3).
        window: when the object may be here [s].
        rests: whether the object stays here until the next knot.
        stay: how long it has to stay from its arrival on, whenever that is; 0: no such demand [s].
        via: what it has to fly through on its way to the next knot, if any.
    """

    time: float
    position: np.ndarray
    faces: list[np.ndarray] = field(default_factory=list)
    window: tuple[float, float] = (0.0, np.inf)
    rests: bool = False
    stay: float = 0.0
    via: Via | None = None

    def narrow(self, start: float, end: float) -> None:
        """Narrow the window to its part between two times [s]."""
        self.window = max(self.window[0], start), min(self.window[1], end)


def find_knots(scenario: FreeFlyerScenario, plan: Plan, name: str) -> list[Knot]:
    """Return the knots of an object, with what the formula demands of its position there.

    "Always" binds every knot in its window; an area to avoid binds it by the face beyond which the plan stays on the
    legs before and after or, where a leg passes a corner, by its own. "Eventually" binds the knot in its window that
    serves it best, the last of several equal ones; if the plan serves it between knots only, it binds none, but the
    knot before notes where. "Until" is an "eventually", and an "always" until that knot. Of a disjunction, the part
    that the knots serve best counts; if they serve none, as where another body does, it binds none. A knot at which the
    object rests is also bound by the demands of the next one. Demands on several bodies at once, and formulas that the
    planner does not take, bind nothing.

    Args:
        scenario: with its formula.
        plan: to execute.
        name: of the object.

    Returns:
        Its impacts in order of time, then its end.
    """
    curve = plan.objects[name]
    impacts = [impact for impact in plan.impacts if impact.object == name]
    knots = [Knot(i.time, i.position, rests=bool(np.abs(i.object_plus).max() < AT_REST)) for i in impacts]
    knots.append(Knot(plan.horizon, curve.position(plan.horizon, "left")))
    try:
        demands = read_demands(scenario, 0.0)
    except InputError:
        return knots
    owned = {p: r for p, r in demands.predicates.items() if r.body == name and not r.others and r.kind != "apart"}
    for formula in demands.conjuncts.values():
        _bind(formula, 0.0, 0.0, knots, owned)
        _add_via(formula, curve, knots, owned)
    for need in demands.solids:
        if need.body == name:
            _bind_throughout(need, need.start, need.end, knots)
    for knot, after in reversed(list(itertools.pairwise(knots))):
        if knot.rests:
            knot.faces += after.faces
    for knot in knots:
        knot.faces = list({tuple(face): face for face in knot.faces}.values())
    return knots


def find_own_faces(scenario: FreeFlyerScenario, name: str) -> list[np.ndarray]:
    """Return the faces (H, b) of the convex areas that a robot must stay in at all times.

    Args:
        scenario: with its formula.
        name: of the robot.
    """
    try:
        demands = read_demands(scenario, 0.0)
    except InputError:
        return []
    faces: list[np.ndarray] = []
    for formula in demands.conjuncts.values():
        for predicate in _list_always(formula, 0.0, 0.0, scenario.horizon):
            need = demands.predicates[predicate]
            if need.body == name and need.kind == "stay" and not need.others:
                faces += list(np.column_stack([need.faces, need.bounds]))
    return faces


def _list_always(formula: Formula, start: float, end: float, horizon: float) -> Iterator[Predicate]:
    match formula:
        case And(operands):
            for part in operands:
                yield from _list_always(part, start, end, horizon)
        case Always((lower, upper), child):
            yield from _list_always(child, start + lower, end + upper, horizon)
        case Predicate() if start <= ROUND_OFF and end >= horizon - ROUND_OFF:
            yield formula


def _bind(formula: Formula, start: float, end: float, knots: list[Knot], owned: dict[Predicate, Requirement]) -> None:
    """Bind knots by a formula that has to hold at all times in [start, end]."""
    match formula:
        case And(operands):
            for part in operands:
                _bind(part, start, end, knots, owned)
        case Or(operands):
            served = [(_measure_throughout(part, start, end, owned, knots), i) for i, part in enumerate(operands)]
            margin, best = max(served)
            if margin > 0.0:  # otherwise it is another body, or a flight between knots, that serves it
                _bind(operands[best], start, end, knots, owned)
        case Always((lower, upper), child):
            _bind(child, start + lower, end + upper, knots, owned)
        case Eventually((lower, upper), child) if end + lower <= start + upper + ROUND_OFF:
            # Once in what all windows have in common is enough for all of them.
            _bind_best(child, end + lower, start + upper, knots, owned)
        case Until((lower, upper), left, right) if end + lower <= start + upper + ROUND_OFF:
            time = _bind_best(right, end + lower, start + upper, knots, owned)
            if time is not None:
                _bind(left, start, time, knots, owned)
        case Predicate() if formula in owned:
            _bind_throughout(owned[formula], start, end, knots)


def _bind_best(
    formula: Formula, opens: float, closes: float, knots: list[Knot], owned: dict[Predicate, Requirement]
) -> float | None:
    """Bind the last of the best knots for what has to hold once in a window, or at which the object comes to rest.

    Returns:
        When it holds, None if it does at no knot [s].
    """
    # Every object starts at rest. A knot that ends a rest belongs to that rest.
    stays: list[tuple[Knot | None, Knot]] = [(None, knots[0])]
    for before, knot, after in zip([None, *knots], knots, [*knots[1:], knots[-1]], strict=False):
        if knot.rests:
            stays.append((knot, after))
        elif before is not None and not before.rests:
            stays.append((knot, knot))
    found = [
        (arrival, leaving)
        for arrival, leaving in stays
        if (arrival is None or arrival.time <= closes + ROUND_OFF) and leaving.time >= opens - ROUND_OFF
    ]
    margins = [_measure_at(formula, arrival or leaving, owned, knots) for arrival, leaving in found]
    if not found or max(margins) <= 0:
        return None
    arrival, leaving = found[max(i for i, margin in enumerate(margins) if margin >= max(margins) - ROUND_OFF)]
    first = arrival or leaving
    _bind(formula, first.time, first.time, knots, owned)
    if leaving is not first:  # nothing is asked of where it goes then
        _bind(formula, leaving.time, leaving.time, [leaving], owned)
    inner = closes < knots[-1].time - ROUND_OFF
    if opens > ROUND_OFF or inner:
        # It does no harm if the object stays longer than it has to, but waiting for it would.
        leaving.narrow(opens, closes if leaving.time <= closes + ROUND_OFF else np.inf)
    if arrival is not None and inner:
        arrival.narrow(0.0, closes)
    if arrival is not None and opens <= ROUND_OFF:
        arrival.stay = max(arrival.stay, _measure_stay(formula))
    return first.time


def _add_via(formula: Formula, curve: Curve, knots: list[Knot], owned: dict[Predicate, Requirement]) -> None:
    """Note where an object flies through what it has to be in once, if it is there at no knot."""
    match formula:
        case Eventually((lower, upper), child) | Until((lower, upper), _, child):
            pass
        case _:
            return
    parts = child.operands if isinstance(child, And) else (child,)
    places = [part for part in parts if part in owned and owned[part].kind == "stay"]
    if len(places) != 1:
        return
    need = owned[places[0]]
    if any(_measure_at(child, knot, owned, knots) > 0.0 for knot in _list_knots_between(lower, upper, knots)):
        return
    best, found = ROUND_OFF, None
    for before, after in itertools.pairwise(knots):
        for i in range(1, LOOKS):
            time = before.time + i / LOOKS * (after.time - before.time)
            position = curve.position(time, "left")
            margin = float((need.bounds - need.faces @ position).min())
            if lower <= time <= upper and margin > best:
                best, found = margin, (before, time, Via(i / LOOKS, position, margin, float(upper)))
    if found is None:
        return
    before, time, before.via = found
    for part in parts:  # what has to hold from then on
        if part is not places[0]:
            _bind(part, time, time, knots, owned)


def _measure_stay(formula: Formula) -> float:
    """Return how long a formula holds "always" from an arrival on [s]."""
    match formula:
        case And(operands):
            return max(_measure_stay(part) for part in operands)
        case Always((_, upper), child):
            return float(upper) + _measure_stay(child)
    return 0.0


def _bind_throughout(need: Requirement, start: float, end: float, knots: list[Knot]) -> None:
    inside = _list_knots_between(start, end, knots)
    table = np.column_stack([need.faces, need.bounds])
    if need.kind == "stay":
        for knot in inside:
            knot.faces += list(table)
        return
    for pair in itertools.pairwise(inside) if len(inside) > 1 else [tuple(inside)] if inside else []:
        margins = np.array([need.faces @ knot.position - need.bounds for knot in pair]) - need.clearance
        best = int(np.argmax(margins.min(axis=0)))
        for knot, own in zip(pair, margins, strict=True):
            # A flight past a corner stays beyond no single face: each of its ends is beyond its own.
            i = best if margins[:, best].min() >= -ROUND_OFF else int(np.argmax(own))
            face = -table[i]
            face[2] -= need.clearance * np.hypot(*face[:2])
            knot.faces.append(face)


def _list_knots_between(start: float, end: float, knots: list[Knot]) -> list[Knot]:
    return [knot for knot in knots if start - ROUND_OFF <= knot.time <= end + ROUND_OFF]


def _measure_throughout(
    formula: Formula, start: float, end: float, owned: dict[Predicate, Requirement], knots: list[Knot]
) -> float:
    """Return the least margin with which planned positions serve a formula that has to hold in all of [start, end].

    -inf if that cannot be said: no knot is in the window, or the formula speaks of other bodies.
    """
    match formula:
        case And(operands):
            return min(_measure_throughout(part, start, end, owned, knots) for part in operands)
        case Or(operands):
            return max(_measure_throughout(part, start, end, owned, knots) for part in operands)
        case Always((lower, upper), child):
            return _measure_throughout(child, start + lower, end + upper, owned, knots)
        case Eventually((lower, upper), child):
            window = _list_knots_between(end + lower, start + upper, knots)
            return max((_measure_at(child, knot, owned, knots) for knot in window), default=-np.inf)
        case Predicate() if formula in owned:
            need, sign = owned[formula], -1.0 if owned[formula].kind == "avoid" else 1.0
            margins = [need.bounds - need.faces @ knot.position for knot in _list_knots_between(start, end, knots)]
            return min((float(m.min() if sign > 0 else (-m).max()) for m in margins), default=-np.inf)
    return -np.inf


def _measure_at(formula: Formula, knot: Knot, owned: dict[Predicate, Requirement], knots: list[Knot]) -> float:
    """Return the margin with which planned positions serve a formula from a knot on; -inf as above."""
    return _measure_throughout(formula, knot.time, knot.time, owned, knots)

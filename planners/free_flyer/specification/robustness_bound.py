"""A robustness that no plan can exceed, computed from geometry alone."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from impact_envs.free_flyer.schema import FreeFlyerScenario, Robot
from impact_envs.stl import Always, And, Distance, Eventually, Formula, Or, Predicate, Until
from planners.free_flyer.specification.negation_normal_form import Release
from planners.free_flyer.specification.requirement import Demands, Requirement, list_held_throughout
from planners.mixed_integer import Model, evaluate
from planners.solvers import solve


def compute_geometric_bound(scenario: FreeFlyerScenario, demands: Demands, solver: str = "highs") -> float:
    """Return a robustness that no plan of any kind can exceed.

    A predicate is bounded by its value at the best place in the world (the inradius of an area to be in, of the part
    that no obstacle takes), and is exact at fixed starts and goals. Operators combine bounds as they combine
    robustness. That a place is bounded by what is avoided at all times as well is right for operators, too: a body at
    a better place is nearer to an obstacle than the bound, which bounds the whole formula.

    Args:
        scenario: world, starts and goals.
        demands: its demands.
        solver: of the largest disc in an area.

    Returns:
        Upper bound of the robustness [m].
    """
    return min([scenario.world.diagonal, *compute_bounds(scenario, demands, solver).values()])


def compute_bounds(scenario: FreeFlyerScenario, demands: Demands, solver: str = "highs") -> dict[str, float]:
    """Return, by conjunct, a robustness that no plan of any kind can exceed [m]; arguments as above."""
    bound = _Bound(scenario, demands, solver)
    return {text: bound.least(formula, 0.0, 0.0) for text, formula in demands.conjuncts.items()}


class _Bound:
    """Bound the least and the greatest robustness of a formula over a time window, both from above."""

    def __init__(self, scenario: FreeFlyerScenario, demands: Demands, solver: str) -> None:
        self.scenario, self.demands, self.solver = scenario, demands, solver
        self._places: dict[Predicate, float] = {}
        throughout = [demands.predicates[part] for part in list_held_throughout(scenario, demands.conjuncts.values())]
        self._avoided = [need for need in (*throughout, *demands.solids) if need.kind == "avoid" and not need.others]

    def least(self, formula: Formula, start: float, end: float) -> float:
        """Return a bound of min over [start, end]; the value at any instant is one, and so is the greatest value."""
        match formula:
            case And(operands):
                return min(self.least(part, start, end) for part in operands)
            case Always((a, b), child):
                return self.least(child, start + a, end + b)
        if start == end:
            return self.greatest(formula, start, end)
        ends = (self.greatest(formula, t, t) for t in (start, end))
        return min(self.greatest(formula, start, end), *ends)

    def greatest(self, formula: Formula, start: float, end: float) -> float:
        """Return a bound of max over [start, end]."""
        match formula:
            case Predicate():
                return self._predicate(formula, start, end)
            case And(operands):
                return min(self.greatest(part, start, end) for part in operands)
            case Or(operands):
                return max(self.greatest(part, start, end) for part in operands)
            case Always((a, b), child):
                core = self.least(child, end + a, start + b) if end + a <= start + b else np.inf
                return min(core, self.greatest(child, start + a, end + b))
            case Eventually((a, b), child):
                return self.greatest(child, start + a, end + b)
            case Until((a, b), left, right):
                core = self.least(left, end, start + a) if end <= start + a else np.inf
                return min(core, self.greatest(left, start, end), self.greatest(right, start + a, end + b))
            case Release((a, b), left, right):
                held = self.greatest(Always((a, b), right), start, end)
                return max(held, self.greatest(left, start, end + b))
        raise TypeError(f"{type(formula).__name__} is not in normal form")

    def _predicate(self, predicate: Predicate, start: float, end: float) -> float:
        """Return the exact value where all bodies are fixed, elsewhere that of the best place."""
        bodies = {name: self.scenario.body(name) for name in predicate.bodies()}
        goals = {name: body.goal for name, body in bodies.items() if isinstance(body, Robot) and body.goal is not None}
        if start == end == 0.0:
            return self._value(predicate, {name: body.start for name, body in bodies.items()})
        if start == end >= self.scenario.horizon and len(goals) == len(bodies):
            return self._value(predicate, goals)
        if predicate not in self._places:
            self._places[predicate] = self._best_place(predicate)
        return self._places[predicate]

    def _value(self, predicate: Predicate, places: dict[str, tuple[float, float]]) -> float:
        sample = {f"{name}.{axis}": place[k] for name, place in places.items() for k, axis in enumerate("xy")}
        return predicate.margin(self.scenario.areas).at(sample)

    def _best_place(self, predicate: Predicate) -> float:
        scenario, need = self.scenario, self.demands.predicates[predicate]
        if need.kind == "stay" and not need.others:
            avoided = [other for other in self._avoided if other.body == need.body]
            return compute_inradius(scenario, need, avoided, self.solver)
        spans = list(zip(scenario.world.lower, scenario.world.upper, strict=True))
        ranges = {f"{name}.{axis}": spans[k] for name in need.bodies for k, axis in enumerate("xy")}
        best = predicate.margin(scenario.areas).range(ranges)[1]
        if isinstance(predicate, Distance) and predicate.is_upper:
            best = predicate.bound - sum(scenario.body(name).radius for name in need.bodies)
        return best


def compute_inradius(
    scenario: FreeFlyerScenario, need: Requirement, avoided: Sequence[Requirement] = (), solver: str = "highs"
) -> float:
    """Return the radius of the largest disc in an area whose middle is in the world, and clear of obstacles [m].

    The disc touches no area to avoid, and a body in its middle no solid obstacle.

    Args:
        scenario: the world.
        need: of one body to be in the area.
        avoided: areas that the body avoids at all times.
        solver: of a linear problem; with areas to avoid in the way, of a mixed-integer one.

    Returns:
        The radius; negative: by so much the area is too small, or too near to obstacles.
    """
    model = Model(f"inradius of {need.text}")
    point = model.vector(np.array(scenario.world.lower), np.array(scenario.world.upper))
    beyond = [face @ point - bound for face, bound in zip(need.faces, need.bounds, strict=True)]
    farthest = max(model.limits(distance)[1] for distance in beyond)
    rho = model.variable(min(-farthest, 0.0), scenario.world.diagonal)
    for distance in beyond:
        model.require(distance + rho)
    model.objective = -rho
    found = solve(model, np.inf, solver=solver)
    place = evaluate(list(point), found.x)
    touching = scenario.body(need.body).radius

    def list_lacks(other: Requirement, place: Any, rho: Any) -> list[list[Any]]:
        faces = [bound - face @ place for face, bound in zip(other.faces, other.bounds, strict=True)]
        kept = ([rho] if other.scored else []) + ([touching] if other.clearance else [])
        return [[face + distance for distance in kept] for face in faces]

    near = [other for other in avoided if min(map(max, list_lacks(other, place, -found.objective))) > 0.0]
    if near:
        # Elsewhere in the area there may be as much room.
        (index,) = rho.coefficients
        model.lower[index] = -scenario.world.diagonal
        for other in avoided:
            model.require_any(list_lacks(other, point, rho))
        found = solve(model, np.inf, solver=solver)
    # An upper bound remains one when it is rounded up.
    return float(np.round(-found.bound + 5e-10, 9))

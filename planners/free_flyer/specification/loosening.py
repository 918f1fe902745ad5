"""A formula that asks for less: areas to be in grow, areas to avoid shrink until they are gone, bounds move."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from impact_envs.errors import InputError
from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.scenario import Region
from impact_envs.stl import Always, And, Distance, Eventually, Formula, In, Linear, Or, Predicate, Until
from planners.free_flyer.specification.negation_normal_form import Release, compute_normal_form
from planners.free_flyer.specification.requirement import Demands, read_demands
from planners.free_flyer.specification.robustness_bound import compute_inradius

INSIDE = 1e-9  # by which a corner may be outside a face that it is on [m]


def list_conjuncts(scenario: FreeFlyerScenario) -> list[Formula]:
    """Return the conjuncts of a scenario's formula as the user wrote them."""
    return list(scenario.specification.conjuncts())


def soften(scenario: FreeFlyerScenario, wall: float) -> tuple[FreeFlyerScenario, Demands]:
    """Return a scenario and its demands, each conjunct of which may be loosened on its own.

    Conjuncts get areas of their own, so that a solid obstacle still stops bodies where the formula asks less of them;
    and every area to avoid knows how deep it is, for it cannot be loosened by more.

    Args:
        scenario: the scenario.
        wall: distance every body keeps from solid obstacles beyond touching [m].
    """
    conjuncts = list_conjuncts(scenario)
    soft = loosen(scenario, [0.0] * len(conjuncts), apart=True)
    demands = read_demands(soft, wall)
    predicates = {
        predicate: replace(need, depth=compute_inradius(soft, need)) if need.kind == "avoid" else need
        for predicate, need in demands.predicates.items()
    }
    parts = [_loosen_conjunct(scenario, formula, number, 0.0, {}) for number, formula in enumerate(conjuncts)]
    named = {str(conjunct): part for conjunct, part in zip(conjuncts, parts, strict=True) if part is not None}
    return soft, replace(demands, conjuncts=named, predicates=predicates)


def loosen(scenario: FreeFlyerScenario, amounts: Sequence[float], apart: bool = False) -> FreeFlyerScenario:
    """Return a scenario whose conjuncts hold wherever those of another one are missed by no more than some amounts.

    Args:
        scenario: with the formula.
        amounts: of each conjunct, in their order [m].
        apart: whether conjuncts that are not loosened get areas of their own, too.

    Raises:
        InputError: nothing is left of the formula.
    """
    regions: dict[str, Any] = {}
    parts: list[Formula] = []
    for number, (conjunct, amount) in enumerate(zip(list_conjuncts(scenario), amounts, strict=True)):
        if amount <= 0.0 and not apart:
            parts.append(conjunct)
            continue
        part = _loosen_conjunct(scenario, conjunct, number, amount, regions)
        parts += [] if part is None else [part]
    if not parts:
        raise InputError(f"{scenario.name}: nothing is left of the formula '{scenario.specification}'")
    formula = parts[0] if len(parts) == 1 else And(tuple(parts))
    fields = {field: getattr(scenario, field) for field in FreeFlyerScenario.model_fields}
    return FreeFlyerScenario(**fields | {"regions": {**scenario.regions, **regions}, "formula": str(formula)})


def _loosen_conjunct(
    scenario: FreeFlyerScenario, conjunct: Formula, number: int, amount: float, regions: dict[str, Any]
) -> Formula | None:
    """Return the normal form of a loosened conjunct; None: it always holds. Its areas are added to the regions."""

    def change(predicate: Predicate) -> Predicate | None:
        match predicate:
            case In(_, area, negated):
                found = _move_faces(scenario.areas[area], -amount if negated else amount)
                if found is None:
                    return None
                name = f"{area}_{number + 1}{'_out' * negated}"
                while name in scenario.areas or name in scenario.bodies:
                    name += "_"
                regions[name] = found
                return replace(predicate, area=name)
            case Distance() | Linear():
                return replace(predicate, bound=predicate.bound + predicate.sign * amount)
        return predicate

    return _rewrite(compute_normal_form(conjunct.expand(scenario.bodies)), change)


def _rewrite(formula: Formula, change: Any) -> Formula | None:
    """Return a formula in normal form with other predicates; None stands for one that always holds."""
    if isinstance(formula, Predicate):
        return change(formula)
    children = [_rewrite(child, change) for child in formula.children]
    left = [child for child in children if child is not None]
    match formula:
        case And():
            return None if not left else left[0] if len(left) == 1 else And(tuple(left))
        case Or():
            return None if len(left) < len(children) else Or(tuple(left))
        case Always() | Eventually():
            return formula.rebuild(left) if left else None
        case Until((lower, _), _, _) if children[1] is None:
            return None if children[0] is None else Always((0.0, lower), children[0])
        case Until(interval, _, _) if children[0] is None:
            return Eventually(interval, left[0])
        case Release() if len(left) < 2:
            return None
    return formula.rebuild(left)


def _move_faces(area: Region, distance: float) -> dict[str, Any] | None:
    """Return an area whose faces are moved outwards by a distance, as a table; None: nothing is left of it."""
    H, b = area.halfspaces()
    moved = np.asarray(b) + distance
    corners: list[np.ndarray] = []
    for i, j in itertools.combinations(range(len(moved)), 2):
        pair = np.array([H[i], H[j]])
        if abs(np.linalg.det(pair)) < INSIDE:
            continue
        corner = np.linalg.solve(pair, moved[[i, j]])
        if (H @ corner <= moved + INSIDE).all() and all(np.abs(corner - c).max() > INSIDE for c in corners):
            corners.append(corner)
    if len(corners) < 3:
        return None
    middle = np.mean(corners, axis=0)
    corners.sort(key=lambda corner: float(np.arctan2(*(corner - middle)[::-1])))
    if area.vertices is None:
        return {"lower": np.min(corners, axis=0).tolist(), "upper": np.max(corners, axis=0).tolist()}
    return {"vertices": [corner.tolist() for corner in corners]}

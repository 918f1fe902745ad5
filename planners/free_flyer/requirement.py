"""What a formula demands of single bodies, in the three forms an event grid can hold."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from impact_envs.errors import InputError
from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.stl import Always, And, Eventually, Formula, In, Linear, Not
from planners.mixed_integer import Model, solve_mixed_integer

FORMS = "it takes conjunctions of F[a,b] and G[a,b] over 'body in area', G[a,b] over 'body not in area'"


@dataclass(frozen=True, eq=False)
class Requirement:
    """Hold one conjunct: a body stays in, avoids or reaches a convex area within a window of time.

    Args:
        kind: "stay" (always inside), "avoid" (always outside), "reach" (inside at some time).
        body: name of the robot or object.
        text: the predicate as it is written, for messages.
        faces: H of the area H p <= b, shape (f, 2).
        bounds: b, shape (f,) [m].
        start: of the window [s].
        end: of the window [s].
        scored: whether it counts into the robustness.
        clearance: distance to keep from the area in any case [m]; avoid only.
        reserve: distance to keep beyond the robustness [m]; avoid only.
    """

    kind: Literal["stay", "avoid", "reach"]
    body: str
    text: str
    faces: np.ndarray
    bounds: np.ndarray
    start: float
    end: float
    scored: bool = True
    clearance: float = 0.0
    reserve: float = 0.0

    def margin(self, rho: float) -> float:
        """Return the distance kept from the area at a robustness [m]; avoid only."""
        return max(self.clearance, rho if self.scored else self.clearance)


def read_requirements(scenario: FreeFlyerScenario, wall: float) -> tuple[Requirement, ...]:
    """Return what the formula and the solid obstacles of a scenario demand.

    Args:
        scenario: with its formula.
        wall: distance every body keeps from solid obstacles beyond touching [m].

    Returns:
        The formula's conjuncts in order, then solid obstacles the formula does not name.

    Raises:
        InputError: a subformula of a form this planner does not support.
    """
    formula = scenario.specification.expand(scenario.bodies)
    needs = list(_conjuncts(scenario, formula, "always", 0.0, 0.0))
    for name, obstacle in scenario.obstacles.items():
        for body in scenario.bodies if obstacle.solid else ():
            inset = scenario.body(body).radius + wall
            text = f"{body} not in {name}"
            same = [i for i, need in enumerate(needs) if need.text == text and _spans(need, scenario)]
            for i in same:
                needs[i] = replace(needs[i], clearance=inset)
            if not same:
                H, b = obstacle.halfspaces()
                window = 0.0, scenario.horizon
                needs.append(Requirement("avoid", body, text, H, b, *window, scored=False, clearance=inset))
    return tuple(needs)


def compute_geometric_bound(scenario: FreeFlyerScenario, needs: Sequence[Requirement]) -> float:
    """Return a robustness that no plan of any kind can exceed.

    The least of: the inradius of every area to be in, and the robustness of the fixed starts and goals.

    Args:
        scenario: world, starts and goals.
        needs: its requirements.

    Returns:
        Upper bound of the robustness [m].
    """
    bounds = [scenario.world.diagonal]
    for need in needs:
        if not need.scored:
            continue
        if need.kind != "avoid":
            bounds.append(_inradius(scenario, need))
        if need.kind != "reach" and need.start == 0.0:
            bounds.append(_robustness_at(need, scenario.body(need.body).start))
        goal = getattr(scenario.body(need.body), "goal", None)
        if need.kind != "reach" and need.end >= scenario.horizon and goal is not None:
            bounds.append(_robustness_at(need, goal))
    return min(bounds)


def _robustness_at(need: Requirement, point: Sequence[float]) -> float:
    inside = float(np.min(need.bounds - need.faces @ np.array(point)))
    return inside if need.kind == "stay" else -inside


def _inradius(scenario: FreeFlyerScenario, need: Requirement) -> float:
    model = Model(f"inradius of {need.text}")
    diagonal = scenario.world.diagonal
    rho = model.variable(-diagonal, diagonal)
    point = model.vector(np.array(scenario.world.lower), np.array(scenario.world.upper))
    for face, bound in zip(need.faces, need.bounds, strict=True):
        model.require(face @ point + rho - bound)
    model.objective = -rho
    # A bound from above stays one when it is rounded up.
    return float(np.round(-solve_mixed_integer(model, 10.0).objective + 5e-10, 9))


def _spans(need: Requirement, scenario: FreeFlyerScenario) -> bool:
    return need.kind == "avoid" and need.start == 0.0 and need.end >= scenario.horizon


def _conjuncts(
    scenario: FreeFlyerScenario, formula: Formula, mode: str, start: float, end: float
) -> Iterator[Requirement]:
    """Open conjunctions and windows; `mode` says whether all or some instants of the window are meant."""
    if isinstance(formula, And) and mode == "always":
        for part in formula.operands:
            yield from _conjuncts(scenario, part, mode, start, end)
    elif isinstance(formula, Always) and mode == "always":
        lower, upper = formula.interval
        yield from _conjuncts(scenario, formula.child, mode, start + lower, end + upper)
    elif isinstance(formula, Eventually) and (mode == "eventually" or start == end):
        lower, upper = formula.interval
        yield from _conjuncts(scenario, formula.child, "eventually", start + lower, end + upper)
    else:
        yield _requirement(scenario, formula, mode, start, end)


def _requirement(scenario: FreeFlyerScenario, formula: Formula, mode: str, start: float, end: float) -> Requirement:
    predicate = formula
    if isinstance(formula, Not) and isinstance(formula.child, In):
        predicate = replace(formula.child, negated=not formula.child.negated)
    area = _area(scenario, predicate)
    if area is None:
        raise InputError(f"{scenario.name}: formula: '{formula}' is not supported by this planner; {FORMS}")
    body, (faces, bounds) = predicate.bodies()[0], area
    negated = isinstance(predicate, In) and predicate.negated
    if mode == "eventually" and (negated or body in scenario.robots):
        wish = f"eventually '{formula}'"
        raise InputError(f"{scenario.name}: formula: {wish} is not supported by this planner; {FORMS}")
    kind: Literal["stay", "avoid", "reach"] = "avoid" if negated else "stay"
    if mode == "eventually" and not start == end == scenario.horizon:
        kind = "reach"
    return Requirement(kind, body, str(predicate), faces, bounds, start, end)


def _area(scenario: FreeFlyerScenario, predicate: Formula) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the half-spaces of a predicate about one body's position, None for any other predicate."""
    if isinstance(predicate, In):
        return scenario.areas[predicate.area].halfspaces()
    if not isinstance(predicate, Linear) or len(predicate.bodies()) != 1:
        return None
    normal = dict.fromkeys(("x", "y"), 0.0)
    for signal, coefficient in predicate.terms:
        name = signal.partition(".")[2]
        if name not in normal:
            return None
        normal[name] = coefficient
    sign = 1.0 if predicate.is_upper else -1.0
    return sign * np.array([[normal["x"], normal["y"]]]), sign * np.array([predicate.bound])

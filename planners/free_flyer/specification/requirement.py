"""What a formula demands of bodies: its normal form, and its predicates as half-planes and distances."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from impact_envs.errors import InputError
from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.stl import Always, And, Distance, Formula, In, Linear, Predicate, Speed
from planners.free_flyer.specification.negation_normal_form import compute_normal_form

SIDES = 16  # of the polygon inside a circle that stands for 'distance <= d'
UNSUPPORTED = "it takes 'in', 'not in', distances and linear comparisons of positions x, y"


@dataclass(frozen=True, eq=False)
class Requirement:
    """Hold what a predicate says about positions, and when it has to hold.

    "stay": H p + sum_i H_i p_i <= b - rho in all rows, where p is the body's position and p_i are those of others.
    "avoid": H p >= b + rho in at least one row. "apart": |p - p_other| >= distance + rho.

    Args:
        kind: one of these.
        body: name of a robot or object.
        text: the predicate as written, for messages.
        faces: H, shape (f, 2).
        bounds: b, shape (f,) [m].
        start: of the window in which it holds at all times [s].
        end: of the window; the start for a single instant [s].
        scored: whether it counts for the robustness.
        clearance: distance to keep from the area at any robustness [m]; avoid only.
        others: other bodies to their H_i; for "apart" the other body, whose H_i has no meaning.
        distance: to keep between the bodies [m]; apart only.
        depth: moved inwards by so much, the area is gone; None where this is not needed [m]; avoid only.
    """

    kind: Literal["stay", "avoid", "apart"]
    body: str
    text: str
    faces: np.ndarray
    bounds: np.ndarray
    start: float = 0.0
    end: float = 0.0
    scored: bool = True
    clearance: float = 0.0
    others: Mapping[str, np.ndarray] = field(default_factory=dict)
    distance: float = 0.0
    depth: float | None = None

    @property
    def bodies(self) -> tuple[str, ...]:
        """Return the names of all its bodies."""
        return (self.body, *self.others)

    def margin(self, rho: float) -> float:
        """Return the distance kept from the area at a robustness [m]; avoid only."""
        return max(self.clearance, rho if self.scored else self.clearance)


@dataclass(frozen=True, eq=False)
class Demands:
    """Hold what a scenario demands of every plan.

    Args:
        conjuncts: conjuncts of the formula as written, to their normal forms without ``all``.
        predicates: predicates of the normal forms, to what they require.
        solids: stay away from solid obstacles at all times, where no conjunct says so; not scored.
        largest: greatest distance by which a plan can miss a predicate [m].
    """

    conjuncts: Mapping[str, Formula]
    predicates: Mapping[Predicate, Requirement]
    solids: tuple[Requirement, ...]
    largest: float


def read_demands(scenario: FreeFlyerScenario, wall: float) -> Demands:
    r"""Return what the formula and the solid obstacles of a scenario demand.

    All operators of the parser are supported. Predicates: ``in`` and ``not in`` (a non-convex area is a disjunction
    of convex ones), linear comparisons of positions of any number of bodies, ``distance(a, b) >= d``, and
    ``distance(a, b) <= d``, which is narrowed to a regular polygon of 16 sides inside the circle: exact along the
    axes, up to 2 % smaller in between. Predicates about velocities and angles are refused, for rho is a length.

    Args:
        scenario: with its formula.
        wall: distance every body keeps from solid obstacles beyond touching [m].

    Returns:
        The demands.

    Raises:
        InputError: a predicate that this planner does not support.
    """
    conjuncts: dict[str, Formula] = {}
    for conjunct in scenario.specification.conjuncts():
        conjuncts[str(conjunct)] = compute_normal_form(conjunct.expand(scenario.bodies))
    nodes = [node for formula in conjuncts.values() for node in formula.walk()]
    predicates = {node: _read_predicate(scenario, node) for node in nodes if isinstance(node, Predicate)}
    named = {str(predicate) for predicate in list_held_throughout(scenario, conjuncts.values())}
    solids = []
    for name, obstacle in scenario.obstacles.items():
        for body in scenario.bodies if obstacle.solid else ():
            # Where the formula names the obstacle, one face gives robustness and clearance.
            predicate = In(body, name, negated=True)
            inset = scenario.body(body).radius + wall
            if predicate in predicates:
                predicates[predicate] = replace(predicates[predicate], clearance=inset)
            if str(predicate) not in named:
                need = replace(_read_predicate(scenario, predicate), scored=False, clearance=inset)
                solids.append(replace(need, end=scenario.horizon))
    return Demands(conjuncts, predicates, tuple(solids), scenario.world.diagonal)


def list_held_throughout(scenario: FreeFlyerScenario, conjuncts: Iterable[Formula]) -> Iterator[Predicate]:
    """Yield the predicates that conjuncts in normal form hold over the whole horizon.

    Args:
        scenario: its horizon.
        conjuncts: of its formula.
    """
    for conjunct in conjuncts:
        yield from _hold_throughout(scenario, conjunct, 0.0, 0.0)


def _hold_throughout(scenario: FreeFlyerScenario, formula: Formula, start: float, end: float) -> Iterator[Predicate]:
    match formula:
        case And(operands):
            for part in operands:
                yield from _hold_throughout(scenario, part, start, end)
        case Always((lower, upper), child):
            yield from _hold_throughout(scenario, child, start + lower, end + upper)
        case Predicate() if start == 0.0 and end >= scenario.horizon:
            yield formula


def _read_predicate(scenario: FreeFlyerScenario, predicate: Predicate) -> Requirement:
    text, nothing = str(predicate), (np.zeros((0, 2)), np.zeros(0))
    match predicate:
        case In(body, area, negated):
            return Requirement("avoid" if negated else "stay", body, text, *scenario.areas[area].halfspaces())
        case Distance(first, second, _, bound) if first != second:
            if not predicate.is_upper:
                return Requirement("apart", first, text, *nothing, others={second: nothing[0]}, distance=bound)
            # Half-planes n d <= (distance - rho) cos(pi / 16), divided by the cosine; corners on the axes.
            angles = 2.0 * np.pi * (np.arange(SIDES) + 0.5) / SIDES
            faces = np.stack([np.cos(angles), np.sin(angles)], axis=1) / np.cos(np.pi / SIDES)
            return Requirement("stay", first, text, -faces, np.full(SIDES, bound), others={second: faces})
        case Linear() if all(signal.partition(".")[2] in ("x", "y") for signal in predicate.signals()):
            return _read_comparison(predicate)
    raise InputError(f"{scenario.name}: formula: '{text}' is not supported by this planner: {_reason(predicate)}")


def _read_comparison(predicate: Linear) -> Requirement:
    sign = 1.0 if predicate.is_upper else -1.0
    normals = {body: np.zeros((1, 2)) for body in predicate.bodies()}
    for signal, coefficient in predicate.terms:
        body, _, axis = signal.partition(".")
        normals[body][0, "xy".index(axis)] = sign * coefficient
    body, *others = normals
    bounds = sign * np.array([predicate.bound])
    rest = {other: normals[other] for other in others}
    return Requirement("stay", body, str(predicate), normals[body], bounds, others=rest)


def _reason(predicate: Predicate) -> str:
    if isinstance(predicate, Distance):
        return f"it is about the distance of {predicate.a} from itself"
    if isinstance(predicate, Speed):
        return f"it is about a speed, and its robustness [m/s] is no length; {UNSUPPORTED}"
    wrong = [signal for signal in predicate.signals() if signal.partition(".")[2] not in ("x", "y")]
    if not wrong:
        return UNSUPPORTED
    return f"{wrong[0]} is no position, and the robustness would be no length; {UNSUPPORTED}"

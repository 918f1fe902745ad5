"""Several objects: who hits what in which order, by local search from the plans of the single objects."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial

from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.stl import Always, And, Formula
from planners.errors import Infeasible, PlanningError
from planners.free_flyer.nominal.effort import (
    QUICK_WISHES,
    WEIGHTS,
    WISHES,
    EffortProblem,
    build_effort_problem,
    read_word,
)
from planners.free_flyer.nominal.event_sequence import Word
from planners.free_flyer.reserves import Reserves
from planners.free_flyer.specification.requirement import Demands

TANGENTS = 5  # perspective cuts per sign while words are compared
GAP = 0.01  # to which words are compared
NODES = 300  # of the search over all words that bounds the effort, if there are at most so many binaries of hits:
FEW = 24
EVALUATIONS, QUICK_EVALUATIONS = 60, 8  # of words, at most


@dataclass(frozen=True)
class WordSearch:
    """Hold what a search over words came to.

    Args:
        words: that have plans, least effort first.
        bound: no word of this length has less effort [m^2/s].
    """

    words: tuple[Word, ...]
    bound: float


def restrict_to_object(scenario: FreeFlyerScenario, name: str) -> FreeFlyerScenario | None:
    """Return the scenario with one object and what the formula asks of it and the robots; None: nothing of it.

    Whatever solves the whole scenario solves this one, so its fewest impacts and its robustness are bounds.

    Args:
        scenario: with several objects.
        name: of the object that stays.
    """
    bodies = {*scenario.robots, name}
    parts = list(_parts_about(scenario.specification.expand(scenario.bodies), bodies))
    if not any(name in part.bodies() for part in parts):
        return None
    formula = parts[0] if len(parts) == 1 else And(tuple(parts))
    fields = {field: getattr(scenario, field) for field in FreeFlyerScenario.model_fields}
    return FreeFlyerScenario(**fields | {"objects": {name: scenario.objects[name]}, "formula": str(formula)})


def _parts_about(formula: Formula, bodies: set[str]) -> Iterator[Formula]:
    if isinstance(formula, And):
        for part in formula.operands:
            yield from _parts_about(part, bodies)
    elif isinstance(formula, Always):
        for part in _parts_about(formula.child, bodies):
            yield Always(formula.interval, part)
    elif set(formula.bodies()) <= bodies:
        yield formula


def search_words(
    scenario: FreeFlyerScenario,
    demands: Demands,
    shape: tuple[int, int],
    rho: float,
    reserves: Reserves,
    seed: Word,
    time_limit: Callable[[], float],
    solver: str = "highs",
    thorough: bool = True,
) -> WordSearch:
    """Search for the words of least effort that keep a robustness.

    Steps exchange two neighbouring impacts or the robot of one. A step whose linear relaxation is not better than
    the best word is not looked at further. Numbers of steps and nodes end the search, not the clock, unless the time
    limit comes first. The bound is that of a search over all words at once, without distances between bodies; where
    there are many words, of its linear relaxation alone.

    Args:
        scenario: what to plan.
        demands: its demands.
        shape: number of impacts, and of pieces per leg.
        rho: robustness to keep [m].
        reserves: what the plan keeps in hand.
        seed: word to start from.
        time_limit: returns the time left [s].
        solver: of mixed-integer models.
        thorough: whether to look on after the first word that has a plan, and to bound the effort.

    Returns:
        The words with plans; none if the search found none.
    """
    bound, found = 0.0, None
    if thorough:
        bound, found = _bound_effort(scenario, demands, shape, rho, reserves, time_limit(), solver)
    starts = [seed] if found is None else [seed, found]
    efforts: dict[Word, float] = {}
    for wish in WISHES if thorough else QUICK_WISHES:

        def measure(word: Word, best: float, wish: tuple[bool, bool] = wish) -> float:
            if word not in efforts:
                build = partial(
                    build_effort_problem, scenario, demands, shape, rho, reserves, time_limit(), wish, word, solver
                )
                efforts[word] = _measure_word(build, best)
            return efforts[word]

        best = min(starts, key=lambda word: measure(word, math.inf))
        if thorough or efforts[best] == math.inf:
            _descend(scenario, best, bound, efforts, measure, time_limit, thorough)
        if min(efforts.values()) < math.inf:
            break
        efforts.clear()
    ranked = sorted((effort, word) for word, effort in efforts.items() if math.isfinite(effort))
    return WordSearch(tuple(word for _, word in ranked), bound)


def _descend(
    scenario: FreeFlyerScenario,
    best: Word,
    bound: float,
    efforts: Mapping[Word, float],
    measure: Callable[[Word, float], float],
    time_limit: Callable[[], float],
    thorough: bool,
) -> None:
    """Step from word to better word until there is none; without any that has a plan, through all neighbours."""
    improving = True
    while improving and efforts[best] > (1.0 + GAP) * bound:
        improving = False
        for word in _neighbours(scenario, best):
            if len(efforts) >= (EVALUATIONS if thorough else QUICK_EVALUATIONS) or time_limit() <= 0.0:
                break
            if measure(word, efforts[best]) < (1.0 - GAP) * efforts[best]:
                best, improving = word, thorough
                break


def _neighbours(scenario: FreeFlyerScenario, word: Word) -> Iterator[Word]:
    for k, (first, second) in enumerate(itertools.pairwise(word)):
        if first[1] != second[1]:
            yield (*word[:k], second, first, *word[k + 2 :])
    for k, (robot, name) in enumerate(word):
        for other in scenario.robots:
            if other != robot:
                yield (*word[:k], (other, name), *word[k + 1 :])


def _bound_effort(
    scenario: FreeFlyerScenario,
    demands: Demands,
    shape: tuple[int, int],
    rho: float,
    reserves: Reserves,
    time_limit: float,
    solver: str,
) -> tuple[float, Word | None]:
    """Return a bound of the effort over all words, without distances, and the best word on the way."""
    try:
        problem = build_effort_problem(
            scenario, demands, shape, rho, reserves, time_limit, WISHES[-1], solver=solver, tangents=2 * TANGENTS
        )
        nodes = NODES if sum(len(hits) for hits in problem.grid.hits) <= FEW else 0
        bound, point = problem.relax(nodes)
    except Infeasible:
        return math.inf, None
    return max(bound, 0.0), read_word(problem.grid, point) if nodes and point is not None else None


def _measure_word(build: Callable[..., EffortProblem], best: float) -> float:
    """Return the least effort of a word; infinite if it has no plan, or none better than the best."""
    try:
        problem = build(tangents=TANGENTS, rounds=1)
        if problem.relax()[0] >= (1.0 - GAP) * best:
            return math.inf
        return problem.solve(WEIGHTS[1]).effort
    except PlanningError:
        return math.inf

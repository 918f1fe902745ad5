"""Several objects: who hits what in which order, by local search from the plans of the single objects."""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.stl import Always, And, Formula
from planners.errors import Infeasible, PlanningError, SolverFailed
from planners.free_flyer.nominal.event_sequence import Word
from planners.free_flyer.nominal.least_cost import CostOptimum, build_cost_problem, read_word
from planners.free_flyer.nominal.task import NominalTask, PlanOptions, Wish
from planners.free_flyer.specification.grid import GridSize

EVERY = 10**9  # more words, rows or nodes than any model has


@dataclass(frozen=True)
class FoundWords:
    """Hold what a search over words came to.

    Args:
        words: that have plans, least path cost first.
        bound: no word of this length costs less [m^2/s].
        events: of the first word, where they were kept.
    """

    words: tuple[Word, ...]
    bound: float
    events: CostOptimum | None = None


def restrict_to_object(scenario: FreeFlyerScenario, name: str) -> FreeFlyerScenario | None:
    """Return the scenario of one object, with what the formula asks of it and the robots; None: it asks nothing of it.

    A solution of the whole scenario solves this one too, so its fewest impacts and its robustness are bounds.

    Args:
        scenario: with several objects.
        name: of the object that is kept.
    """
    bodies = {*scenario.robots, name}
    parts = list(list_parts_about(scenario.specification.expand(scenario.bodies), bodies))
    if not any(name in part.bodies() for part in parts):
        return None
    formula = parts[0] if len(parts) == 1 else And(tuple(parts))
    fields = {field: getattr(scenario, field) for field in FreeFlyerScenario.model_fields}
    return FreeFlyerScenario(**fields | {"objects": {name: scenario.objects[name]}, "formula": str(formula)})


def list_parts_about(formula: Formula, bodies: set[str]) -> Iterator[Formula]:
    """Yield the conjuncts, also those within G, that are about no other bodies."""
    if isinstance(formula, And):
        for part in formula.operands:
            yield from list_parts_about(part, bodies)
    elif isinstance(formula, Always):
        for part in list_parts_about(formula.child, bodies):
            yield Always(formula.interval, part)
    elif set(formula.bodies()) <= bodies:
        yield formula


def search_words(
    task: NominalTask,
    size: GridSize,
    rho: float,
    seed: Word,
    find_time_left: Callable[[], float],
    options: PlanOptions,
    lost: int | None = None,
) -> FoundWords:
    """Search for the words of least path cost that keep a robustness.

    A step exchanges two neighbouring impacts or the robot of one impact. A word whose linear relaxation is not better
    than the best word is not solved. The search ends by its numbers of words and nodes, not by the clock, unless the
    time limit comes first; a thorough one by its work as well, for objects can be moved one after another. The bound
    is that of a search over all words at once, without distances between bodies; where there are many words, that of
    its linear relaxation, unless time is given to prove more.

    Args:
        task: what is asked.
        size: of the grid.
        rho: robustness to keep [m].
        seed: word to start from.
        find_time_left: returns the time left [s].
        options: of the search, and of the path cost.
        lost: greatest number of words while none has a plan; None: as long as any has one.

    Returns:
        The words with plans; empty if the search found none.
    """
    lost = options.search.evaluations if lost is None else lost
    bound, found = 0.0, None
    most = math.inf
    if options.thorough and task.work is not None:
        most = task.work.done + options.search.work
    if options.search.improve:
        bound, found = _bound_cost(task, size, rho, find_time_left(), options)
    starts = [seed] if found is None else [seed, found]
    costs: dict[Word, float] = {}
    for wish in options.cost.wishes:
        search = _Search(task, size, rho, wish, find_time_left, options, most_work=most, most_lost=lost)
        if search.is_out_of_work:
            break
        best = min(starts, key=search.measure)
        if search.is_out_of_work and search.costs[best] == math.inf:
            break
        if options.search.improve or search.costs[best] == math.inf:
            search.descend(best, bound)
        costs = search.costs
        if min(costs.values()) < math.inf or search.is_out_of_work:
            break
    ranked = sorted((cost, word) for word, cost in costs.items() if math.isfinite(cost))
    if ranked and options.search.proof > 0.0:
        every = replace(options, search=replace(options.search, nodes=EVERY, few=EVERY, rows=EVERY))
        bound = max(bound, _bound_cost(replace(task, work=None), size, rho, options.search.proof, every)[0])
    return FoundWords(tuple(word for _, word in ranked), bound)


def lengthen_words(
    task: NominalTask,
    size: GridSize,
    rho: float,
    seed: Word,
    find_time_left: Callable[[], float],
    options: PlanOptions,
) -> FoundWords:
    """Search for words with more impacts than a word that has no plan, so that objects pass each other.

    An object is sent round another one by an impact between its others; these are tried first. The search ends with
    the first few words that have plans.

    Args:
        task: what is asked.
        size: of the grid, with the number of impacts wanted.
        rho: robustness to keep [m].
        seed: word that is lengthened.
        find_time_left: returns the time left [s].
        options: of the search, and of the path cost.

    Returns:
        The words with plans; empty if the search found none. Their cost has no bound.
    """

    def find_time_of_one() -> float:
        return min(options.search.longest, find_time_left())

    search = _Search(task, size, rho, options.cost.wishes[-1], find_time_of_one, options)
    words = {seed}
    for _ in range(size.impacts - len(seed)):
        words = {longer for word in words for longer in _list_longer(task.scenario, word)}
    found: dict[Word, float] = {}
    for word in sorted(words, key=lambda word: (-_count_turns(word, seed), word)):
        if find_time_left() <= 0.0 or len(found) >= options.search.few_longer:
            break
        cost = search.measure(word)
        if cost < math.inf:
            found[word] = cost
    ranked = tuple(sorted(found, key=lambda word: found[word]))
    return FoundWords(ranked, 0.0, search.events[ranked[0]] if ranked else None)


@dataclass
class _Search:
    """Hold the costs of the words tried under one wish; arguments as for `search_words`.

    Args:
        most_work: total work at which the search ends [units of `Work`].
        most_lost: greatest number of words while none has a plan.
        stuck: whether a word could not be decided within the limits of its solution.
    """

    task: NominalTask
    size: GridSize
    rho: float
    wish: Wish
    find_time_left: Callable[[], float]
    options: PlanOptions
    costs: dict[Word, float] = field(default_factory=dict)
    events: dict[Word, CostOptimum] = field(default_factory=dict)
    most_work: float = math.inf
    most_lost: int = 60
    stuck: bool = False

    @property
    def is_out_of_work(self) -> bool:
        """Return whether the work of the search is done, or so much is needed for a word that it will not suffice."""
        if self.stuck and self.options.simple:
            return True
        return self.task.work is not None and self.task.work.done > self.most_work

    def measure(self, word: Word, best: float = math.inf) -> float:
        """Return the least cost of a word; infinite if it has no plan, or none better than the best."""
        if word not in self.costs:
            self.costs[word] = self._solve(word, best)
        return self.costs[word]

    def descend(self, best: Word, bound: float) -> None:
        """Step from word to better word until there is none; as long as no word has a plan, try all neighbours."""
        options, improving = self.options.search, True
        while improving and self.costs[best] > (1.0 + options.gap) * bound:
            improving = False
            for word in list_neighbours(self.task.scenario, best):
                most = options.evaluations if self.costs[best] < math.inf else self.most_lost
                if len(self.costs) >= most or self.find_time_left() <= 0.0 or self.is_out_of_work:
                    break
                if self.measure(word, self.costs[best]) < (1.0 - options.gap) * self.costs[best]:
                    best, improving = word, options.improve
                    break

    def _solve(self, word: Word, best: float) -> float:
        options, limit = self.options.search, self.find_time_left()
        cost = replace(self.options.cost, tangents=options.tangents, rounds=1)
        try:
            problem = build_cost_problem(self.task, self.size, self.rho, self.wish, cost, limit, word)
            problem.nodes = options.word_nodes if self.options.thorough else None
            problem.pauses = options.word_pauses if self.options.simple else None
            if problem.relax()[0] >= (1.0 - options.gap) * best:
                return math.inf
            self.events[word] = problem.solve(options.weight, options.gap)
            return self.events[word].cost
        except SolverFailed:
            self.stuck = True
        except PlanningError:
            pass
        return math.inf


def list_neighbours(scenario: FreeFlyerScenario, word: Word) -> Iterator[Word]:
    """Yield the words with two neighbouring impacts on different objects exchanged, or another robot for one impact.

    Args:
        scenario: its robots.
        word: who hits what.
    """
    for k, (first, second) in enumerate(itertools.pairwise(word)):
        if first[1] != second[1]:
            yield (*word[:k], second, first, *word[k + 2 :])
    for k, (robot, name) in enumerate(word):
        for other in scenario.robots:
            if other != robot:
                yield (*word[:k], (other, name), *word[k + 1 :])


def list_orders(order: Sequence[str]) -> Iterator[tuple[str, ...]]:
    """Yield an order of objects and all others of as many impacts of each, those with fewest exchanges first.

    Args:
        order: name of the object of each impact.
    """
    known = {tuple(order)}
    waiting = deque(known)
    while waiting:
        here = waiting.popleft()
        yield here
        for k, (first, second) in enumerate(itertools.pairwise(here)):
            there = (*here[:k], second, first, *here[k + 2 :])
            if there not in known:
                known.add(there)
                waiting.append(there)


def _bound_cost(
    task: NominalTask, size: GridSize, rho: float, time_limit: float, options: PlanOptions
) -> tuple[float, Word | None]:
    """Return a bound of the cost over all words, without distances, and the best word that its search met."""
    search, wish = options.search, options.cost.wishes[-1]
    cost = replace(options.cost, tangents=2 * search.tangents)
    try:
        problem = build_cost_problem(task, size, rho, wish, cost, time_limit)
        few = sum(len(hits) for hits in problem.grid.hits) <= search.few
        nodes = search.nodes if few and len(problem.grid.model.inequalities) <= search.rows else 0
        bound, point = problem.relax(nodes)
    except Infeasible:
        return math.inf, None
    return max(bound, 0.0), read_word(problem.grid, point) if nodes and point is not None else None


def _list_longer(scenario: FreeFlyerScenario, word: Word) -> Iterator[Word]:
    """Yield the words with one more impact, anywhere, by anybody, on anything."""
    for k, robot, name in itertools.product(range(len(word) + 1), scenario.robots, scenario.objects):
        yield (*word[:k], (robot, name), *word[k:])


def _count_turns(word: Word, seed: Word) -> int:
    """Return how many impacts of a word turn an object in flight, up to as many as it has more than the seed."""
    turns = 0
    for k, (_, name) in enumerate(word):
        before, after = ([struck for _, struck in part] for part in (word[:k], word[k + 1 :]))
        turns += name in before and name in after
    return min(turns, len(word) - len(seed))

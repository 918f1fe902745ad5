"""Any point of a sequence of impacts on several objects, and the order of attempts for several objects."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from impact_envs import load_scenario
from impact_envs.free_flyer.schema import FreeFlyerScenario
from planners.budget import Work
from planners.errors import Infeasible, SolverFailed
from planners.free_flyer.nominal.event_sequence import ANYBODY, own_events
from planners.free_flyer.nominal.ladder import list_attempts
from planners.free_flyer.nominal.several_objects.sequence_search import list_orders
from planners.free_flyer.nominal.several_objects.settled_word import settle_word, settle_words, spread_events
from planners.free_flyer.nominal.task import NominalTask, PlanOptions
from planners.free_flyer.nominal.verdict import Trial
from planners.free_flyer.reserves import Reserves
from planners.free_flyer.specification.grid import GridSize
from planners.free_flyer.specification.requirement import read_demands
from planners.mixed_integer import evaluate
from planners.solvers import solve
from tests.frozen.freeze import get_plan

LEAST = 0.15  # robustness that is kept [m]
NODES = 150


@pytest.fixture(scope="module")
def task() -> NominalTask:
    scenario = load_scenario("exchange").as_believed()
    assert isinstance(scenario, FreeFlyerScenario)
    return NominalTask(scenario, read_demands(scenario, Reserves().wall), Reserves(), work=Work())


def _read_word() -> tuple[tuple[str, str], ...]:
    plan = get_plan("exchange", "nominal")
    assert plan is not None
    return tuple((hit.robot, hit.object) for hit in plan.impacts)


def test_flights_are_straight_and_uniform_while_other_objects_are_hit(task: NominalTask) -> None:
    word = _read_word()
    found = settle_word(task, word, 1, (LEAST, 0.5), 60.0, NODES)
    sequence = found.reduce_cost(LEAST).sequence
    assert sequence.hitters == word
    assert found.rho >= LEAST
    for name, path in sequence.paths.items():
        for a, b in itertools.pairwise(own_events(word, name)):
            for k in range(a + 1, b):
                share = (sequence.times[k] - sequence.times[a]) / (sequence.times[b] - sequence.times[a])
                # Impact times are rounded to control steps.
                assert np.abs(path[a] + share * (path[b] - path[a]) - path[k]).max() < 0.03


def test_the_first_word_that_has_a_point_is_taken(task: NominalTask) -> None:
    word = _read_word()
    impossible = ((word[0][0], "pop"), (word[0][0], "pop"))  # nobody moves the other object
    found = settle_words(task, [impossible, word], 1, (LEAST, 0.5), lambda: 60.0, PlanOptions())
    assert found is not None
    assert len(found.grid.hits) == len(word)
    assert settle_words(task, [impossible], 1, (LEAST, 0.5), lambda: 60.0, PlanOptions()) is None
    assert settle_words(task, [word], 1, (LEAST, 0.5), lambda: 0.0, PlanOptions()) is None


def test_orders_are_all_there_are_the_nearest_ones_first() -> None:
    order = ("p", "q", "p", "q")
    found = list(list_orders(order))
    assert found[0] == order
    assert sorted(found) == sorted(set(itertools.permutations(order)))

    def count_exchanges(other: tuple[str, ...]) -> int:
        places = [[k for k, name in enumerate(one) if name == "p"] for one in (order, other)]
        return sum(abs(a - b) for a, b in zip(*places, strict=True))

    assert [count_exchanges(other) for other in found] == sorted(count_exchanges(other) for other in found)


def test_events_are_spread_as_far_as_the_same_alternatives_allow(task: NominalTask) -> None:
    word = _read_word()
    grid, _ = task.build(GridSize(len(word), 1, passing=True), (LEAST, 0.5), word)
    x = solve(grid.model, 60.0, math.inf).x
    rows, bounds = len(grid.model.inequalities), list(grid.model.lower)
    before, after = evaluate(grid.times, x), spread_events(task, grid, x, 60.0)
    assert np.diff(after).min() >= np.diff(before).min() - 1e-6
    assert (len(grid.model.inequalities), grid.model.lower) == (rows, bounds), "the grid stays as it is"


def test_whoever_hits_an_order_has_a_point(task: NominalTask) -> None:
    word = tuple((ANYBODY, name) for _, name in _read_word())
    found = settle_word(task, word, 1, (LEAST, 0.5), 60.0, 1000)
    assert {robot for robot, _ in found.reduce_cost(LEAST).sequence.hitters} <= set(task.scenario.robots)


def test_several_objects_are_moved_simply_with_all_reserves_before_anything_longer(task: NominalTask) -> None:
    trials: list[Trial] = []
    kinds = []
    for attempt in list_attempts(task, PlanOptions(), trials):
        kinds.append((attempt.few, attempt.simple, attempt.brief, attempt.halvings))
        trials.append(Trial(attempt, SolverFailed("joint", "none found", "more")))
    first = (
        [(True, True, True, k) for k in range(3)]
        + [(True, True, False, k) for k in range(3)]
        + [(True, False, False, k) for k in range(3)]
        + [(False, None, False, k) for k in range(3)]
    )
    assert [kind for kind, _ in itertools.groupby(kinds)][: len(first)] == first


def test_what_an_object_cannot_do_alone_is_not_tried_in_longer_ways(task: NominalTask) -> None:
    trials: list[Trial] = []
    for attempt in list_attempts(task, PlanOptions(), trials):
        trials.append(Trial(attempt, Infeasible("robustness", "no plan", "allow more impacts")))
    assert not any(trial.attempt.simple is False for trial in trials)
    assert any(not trial.attempt.few for trial in trials)

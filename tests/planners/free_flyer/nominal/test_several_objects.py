from functools import cache

import numpy as np
import pytest

from impact_envs.errors import InputError
from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.scenario import load_scenario
from planners import make_plan
from planners.free_flyer.nominal.event_sequence import own_events
from planners.free_flyer.nominal.several_objects.sequence_search import restrict_to_object
from planners.free_flyer.nominal.task import PlanOptions, WordSearchOptions
from planners.plan import Plan
from tests.frozen.freeze import get_plan

IMPACTS = {"relay": 3, "exchange": 4, "crew": 6}
EVERY = pytest.mark.parametrize("name", IMPACTS)


@cache
def _plan(name: str) -> Plan:
    """Return the stored plan; `tests/frozen` holds the planner to it."""
    plan = get_plan(name, "nominal")
    assert plan is not None
    return plan


def _scenario(name: str) -> FreeFlyerScenario:
    scenario = load_scenario(name)
    assert isinstance(scenario, FreeFlyerScenario)
    return scenario


@EVERY
def test_robustness_and_number_of_impacts_are_the_best_possible(name: str) -> None:
    plan = _plan(name)
    assert plan.robustness == pytest.approx(0.5, abs=1e-6)
    assert plan.gap == 0.0
    assert len(plan.impacts) == IMPACTS[name]
    assert plan.validated


@EVERY
def test_bodies_touch_only_at_their_impacts(name: str) -> None:
    scenario, plan = _scenario(name), _plan(name)
    times = np.linspace(0.0, plan.horizon, 6001)
    curves = plan.robots | plan.objects
    bodies = list(curves)
    for i, first in enumerate(bodies):
        for second in bodies[i + 1 :]:
            apart = np.linalg.norm(curves[first].position(times) - curves[second].position(times), axis=1)
            touching = scenario.body(first).radius + scenario.body(second).radius
            own = [hit.time for hit in plan.impacts if (hit.robot, hit.object) == (first, second)]
            away = np.all([np.abs(times - hit) > 5.0 for hit in own], axis=0) if own else np.full(len(times), True)
            assert apart[away].min() > touching + 0.05
            assert apart.min() > touching - 1e-6


@EVERY
def test_objects_change_their_velocity_only_when_they_are_hit(name: str) -> None:
    plan = _plan(name)
    for item, curve in plan.objects.items():
        own = [hit.time for hit in plan.impacts if hit.object == item]
        np.testing.assert_allclose(curve.times, [0.0, *own, plan.horizon])
        assert curve.degree == 1


@EVERY
def test_effort_of_all_words_is_bounded(name: str) -> None:
    plan = _plan(name)
    assert plan.effort_bound is not None
    assert 0.0 < plan.effort_bound <= plan.effort + 1e-6


def test_exchange_is_within_a_tenth_of_the_bound_over_all_words() -> None:
    plan = _plan("exchange")
    assert plan.effort_bound is not None
    assert plan.effort <= 1.1 * plan.effort_bound


def test_time_for_a_proof_brings_the_bound_closer_and_leaves_the_plan() -> None:
    linear = PlanOptions(search=WordSearchOptions(few=0))
    plan, proven = (make_plan("exchange", options=linear, proof=proof) for proof in (0.0, 30.0))
    assert proven.effort == plan.effort
    assert [impact.time for impact in proven.impacts] == [impact.time for impact in plan.impacts]
    assert plan.effort_bound is not None
    assert proven.effort_bound is not None
    assert plan.effort_bound < 0.9 * plan.effort < proven.effort_bound <= plan.effort


@pytest.mark.parametrize(("name", "proof"), [("pong", 10.0), ("exchange", -1.0)])
def test_proofs_are_for_several_objects_and_take_time(name: str, proof: float) -> None:
    with pytest.raises(InputError, match="proof is"):
        make_plan(name, proof=proof)


def test_scenario_of_one_object_keeps_what_the_formula_asks_of_it_and_the_robots() -> None:
    alone = restrict_to_object(_scenario("crew"), "drop")
    assert alone is not None
    assert tuple(alone.objects) == ("drop",)
    assert alone.specification.bodies() == ("drop", "snap", "crackle", "fizz", "bang")
    assert restrict_to_object(_scenario("exchange").override({"formula": "G[100,100] pop in east"}), "plop") is None


def test_object_without_a_task_stays_where_it_is_and_is_not_touched() -> None:
    plan = make_plan(_scenario("exchange").override({"formula": "G[100,100] pop in east"}))
    assert {hit.object for hit in plan.impacts} == {"pop"}
    assert np.ptp(plan.objects["plop"].position(np.linspace(0.0, 100.0, 101)), axis=0).max() == 0.0


def test_own_events_are_both_ends_and_the_hits_of_the_object() -> None:
    word = (("snap", "pop"), ("crackle", "plop"), ("snap", "pop"))
    assert own_events(word, "pop") == [0, 1, 3, 4]
    assert own_events(word, "plop") == [0, 2, 4]
    assert own_events((), "pop") == [0, 1]


@pytest.mark.slow
def test_objects_that_swap_places_on_one_line_pass_each_other() -> None:
    values = {
        "formula": "G[120,120] pop in east & G[120,120] plop in west",
        "horizon": 120.0,
        "world.upper": [8.0, 4.0],
        "robots.snap.start": [0.8, 2.0],
        "robots.snap.goal": [0.8, 2.0],
        "robots.crackle.start": [7.2, 2.0],
        "robots.crackle.goal": [7.2, 2.0],
        "objects.pop.start": [2.0, 2.0],
        "objects.plop.start": [6.0, 2.0],
        "regions.east.lower": [5.5, 1.5],
        "regions.east.upper": [6.5, 2.5],
        "regions.west.lower": [1.5, 1.5],
        "regions.west.upper": [2.5, 2.5],
    }
    plan = make_plan(_scenario("exchange").override(values), time_limit=300.0)
    assert plan.robustness >= 0.25
    assert len(plan.impacts) <= 6
    times = np.linspace(0.0, 120.0, 1201)
    apart = plan.objects["pop"].position(times) - plan.objects["plop"].position(times)
    assert np.linalg.norm(apart, axis=1).min() >= 0.4

"""What a given plan promises is kept: a robust plan is not worth less with the whole expert than with the paper's."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from impact_envs import load_scenario, parallel_env, rollout
from impact_envs.rollout import Episode
from planners import make_expert, make_plan
from planners.free_flyer.belief.options import EXPERT, make_record
from planners.free_flyer.belief.plan_table import make_plan_table, read_tube
from planners.free_flyer.belief.world_memory import make_world_memory
from planners.free_flyer.next_impact.desired_velocity import is_promised
from planners.plan import Plan
from tests.frozen.freeze import get_plan
from tests.planners.free_flyer.plans import load, set_estimate

NAME, SEED = "throw_and_catch", 1_000_000


@cache
def plan_robustly() -> Plan:
    return make_plan(NAME, "impact_uncertainty")


def fly(plan: Plan, variant: str | None, suite: str = "nominal") -> Episode:
    scenario = load_scenario(NAME).suite(suite)
    return rollout(parallel_env(scenario), make_expert(scenario, plan, variant), SEED)


def test_expert_gets_what_a_robust_plan_promises() -> None:
    plan = plan_robustly()
    assert fly(plan, None).robustness > plan.robustness - 0.005
    assert fly(plan, None).robustness > fly(plan, "paper_expert").robustness - 0.005


def test_times_and_places_stay_while_the_plan_promises_success() -> None:
    plan = plan_robustly()
    expert = make_expert(load_scenario(NAME), plan)
    episode = rollout(parallel_env(load_scenario(NAME)), expert, SEED)
    assert episode.reoptimised["same_sequence"] == 0
    for hit, planned in zip(episode.impacts, plan.impacts, strict=True):
        assert abs(hit.time - planned.time) < 0.05
    without = replace(plan, tubes={}, planned_responses=(), responses={}, deviation=None, deviation_bound=None)
    assert fly(without, None).reoptimised["same_sequence"] == 1


@pytest.mark.parametrize(("off", "promised"), [(0.9, True), (1.1, False)])
def test_the_promise_holds_in_the_box(off: float, promised: bool) -> None:
    plan, scenario = plan_robustly(), load(NAME)
    table = make_plan_table(scenario, plan)
    memory = make_world_memory(table, 1)
    last, body = len(plan.impacts) - 1, table.robots
    time = plan.impacts[last].time
    memory.strike["index"][0], memory.clock[0, last], memory.time[0] = last, time, time - 2.0
    half = (table.knot[last]["upper"] - table.knot[last]["lower"]) / 2
    assert (half > 0.01).all()
    place = plan.impacts[last].position + off * half
    set_estimate(memory.filter[0, body, ...], place, np.zeros(2))
    assert is_promised(table, memory, 0, 0) == promised


def test_a_plan_without_boxes_promises_nothing() -> None:
    table = make_plan_table(load(NAME), get_plan(NAME, "nominal"))
    memory = make_world_memory(table, 1)
    assert not is_promised(table, memory, 0, 0)
    assert (table.last == 0.0).all()
    assert make_record(EXPERT)[0]["reoptimise"]


def test_boxes_at_the_knots_are_those_of_the_tube() -> None:
    plan, scenario = plan_robustly(), load(NAME)
    table, tube = make_plan_table(scenario, plan), plan.tubes["pop"]
    times = np.array([*(hit.time for hit in plan.impacts), plan.horizon])
    centre, half = read_tube(tube, times)
    np.testing.assert_allclose(table.knot["lower"], centre - half)
    np.testing.assert_allclose(half[-1], tube.end[-1, 1, :2])
    np.testing.assert_allclose(read_tube(tube, np.array([0.0]))[1][0], tube.start[0, 1, :2], atol=1e-12)

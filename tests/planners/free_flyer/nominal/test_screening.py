"""What is screened out has no plan; what has one is never screened out."""

from __future__ import annotations

from dataclasses import replace

import pytest

from impact_envs.free_flyer.schema import FreeFlyerScenario
from planners.budget import Work
from planners.errors import Infeasible
from planners.free_flyer.nominal.remaining import OPTIONS, RESERVES
from planners.free_flyer.nominal.screening import screen_task
from planners.free_flyer.nominal.task import NominalTask
from planners.free_flyer.specification.requirement import read_demands
from tests.frozen.freeze import get_plan
from tests.planners.free_flyer.plans import load


def make_task(scenario: FreeFlyerScenario, work: Work | None = None) -> NominalTask:
    return NominalTask(scenario, read_demands(scenario, RESERVES.wall), RESERVES, work=work)


@pytest.mark.parametrize("name", ["throw_and_catch", "pong", "relay", "exchange"])
def test_a_task_with_a_plan_passes(name: str) -> None:
    plan = get_plan(name, "nominal")
    assert plan is not None
    screen_task(make_task(load(name)), 9, replace(OPTIONS, expected=len(plan.impacts)))


@pytest.mark.parametrize("name", ["throw_and_catch", "exchange"])
def test_an_object_that_flies_away_for_good_does_not(name: str) -> None:
    scenario, work = load(name, **{"objects.pop.start_velocity": [0.5, 0.5]}), Work()
    with pytest.raises(Infeasible, match="proven infeasible with up to 3 impacts"):
        screen_task(make_task(scenario, work), 3, replace(OPTIONS, expected=2))
    assert work.done < 1000.0

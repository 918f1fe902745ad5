"""What is screened out has no plan; what has one is never screened out."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import pytest

from impact_envs.free_flyer.schema import FreeFlyerScenario
from planners.budget import Work
from planners.errors import Infeasible
from planners.free_flyer.nominal.attempt import Attempt
from planners.free_flyer.nominal.planner import make_free_flyer_plan
from planners.free_flyer.nominal.remaining import OPTIONS, RESERVES
from planners.free_flyer.nominal.screening import find_excluded_object, is_excluded, screen_task
from planners.free_flyer.nominal.task import NominalTask, PlanOptions
from planners.free_flyer.reserves import Reserves
from planners.free_flyer.specification.requirement import read_demands
from planners.free_flyer.specification.robustness_bound import compute_geometric_bound
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


def test_the_least_reserves_ask_no_more_than_those_of_any_attempt() -> None:
    scenario, options = load("pong"), PlanOptions()
    for force in (0.1, 0.4, 5.0):  # thrust limits the legs, at first only, never
        task = replace(make_task(scenario.override({"robots.snap.force_limit": force})), reserves=Reserves())
        robot = task.scenario.robots["snap"]
        least = Attempt((1, 2)).cut_to_least(task, options).reserves
        for halvings, brisk in itertools.product(range(options.halvings + 1), (False, True)):
            tried = Attempt((1, 2), halvings, brisk=brisk).cut_reserves(task, options).reserves
            assert least.cruise(robot) >= tried.cruise(robot)
            assert least.turning(robot) <= tried.turning(robot) * (1.0 + 1e-12)
            assert least.clearance <= tried.clearance
            assert all(a <= b for a, b in zip(least.times(40.0), tried.times(40.0), strict=True))


@pytest.mark.parametrize(("horizon", "excluded"), [(60.0, False), (9.0, True)])
def test_a_task_is_excluded_if_its_time_is_too_short(horizon: float, excluded: bool) -> None:
    formula = f"G[{horizon:g},{horizon:g}] pop in goal"
    scenario = load("throw_and_catch", horizon=horizon, formula=formula)
    least = Attempt((1, 2)).cut_to_least(make_task(scenario), PlanOptions())
    rho = 1e-3, compute_geometric_bound(scenario, least.demands)
    assert is_excluded(least, 2, 3, rho, math.inf) is excluded
    assert not is_excluded(least, 2, 3, rho, 0.0), "no time, no proof"


SOON = "F[0,{}] pop in east & G[100,100] plop in west"  # 5.5 m at 0.3 m/s, once a robot has come up


@pytest.mark.parametrize(("late", "excluded"), [(60, None), (20, "pop")])
def test_an_object_that_has_no_time_even_alone_is_named(late: int, excluded: str | None) -> None:
    scenario = load("exchange", formula=SOON.format(late))
    least = Attempt((1, 2)).cut_to_least(make_task(scenario), PlanOptions())
    assert find_excluded_object(least, 6, 1e-3, math.inf) == excluded
    assert find_excluded_object(least, 6, 1e-3, 0.0) is None, "no time, no proof"


def test_a_whole_task_is_proven_by_one_of_its_objects() -> None:
    work = Work()
    with pytest.raises(Infeasible, match="pop has no plan with up to 9 impacts, not even alone") as told:
        make_free_flyer_plan(load("exchange", formula=SOON.format(24)), work=work, options=PlanOptions(diagnosis=0.0))
    assert "a quarter of the planner's reserves" in told.value.status
    assert work.done < 1e5

"""Random tasks: what is proven infeasible, and what a finer encoding says of it."""

from __future__ import annotations

import pytest

from benchmarks.tasks import AGREES, DISAGREES, confirm_proof, draw_task
from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.scenario import build_scenario
from planners.budget import Work
from planners.errors import Infeasible
from planners.free_flyer.nominal.planner import make_free_flyer_plan
from planners.free_flyer.nominal.task import PlanOptions

BLOCKED = 1_000_014  # an obstacle takes the zone that a robot is to visit
EASY = 1_000_002


def test_a_goal_within_an_obstacle_is_proven_without_a_search() -> None:
    scenario, work = build_scenario(draw_task(BLOCKED)[1], source="test"), Work()
    assert isinstance(scenario, FreeFlyerScenario)
    with pytest.raises(Infeasible, match="proven infeasible with up to 6 impacts, 6 straight pieces"):
        make_free_flyer_plan(scenario, options=PlanOptions(diagnosis=0.0), work=work)
    assert work.done < 1000.0


@pytest.mark.slow
def test_a_finer_encoding_confirms_that_and_finds_plans_where_there_are_some() -> None:
    assert confirm_proof(draw_task(BLOCKED)[1], 20.0) == AGREES
    assert confirm_proof(draw_task(EASY)[1], 60.0) == DISAGREES

"""What attempts without a plan prove."""

import pytest

from impact_envs import load_scenario
from planners.budget import Budget
from planners.errors import Infeasible, PlanningError, SolverFailed
from planners.free_flyer.nominal.attempt import Attempt
from planners.free_flyer.nominal.task import NominalTask
from planners.free_flyer.nominal.verdict import Trial, judge_trials
from planners.free_flyer.reserves import Reserves
from planners.free_flyer.specification.requirement import read_demands

PROOF = Infeasible("robustness", "no plan", "allow more impacts")
MANY, FEW = Attempt((1, 2)), Attempt((1, 2), few=True)


def judge(trials: list[Trial], complete: bool = True) -> PlanningError:
    world = load_scenario("throw_and_catch").as_believed()
    task = NominalTask(world, read_demands(world, Reserves().wall), Reserves())
    return judge_trials(trials, task, 6, Budget(60.0), complete)


@pytest.mark.parametrize(
    ("trials", "proven"),
    [
        ([Trial(MANY, PROOF)], True),
        ([Trial(FEW, SolverFailed("joint", "none found", "more")), Trial(MANY, PROOF)], True),
        ([Trial(FEW, PROOF)], False),  # few impacts prove nothing of many
        ([Trial(MANY, PROOF), Trial(MANY, SolverFailed("grid", "stopped", "more"))], False),
        ([Trial(MANY, PROOF, rho=0.2)], False),  # impacts exist, smooth motions were not found
        ([Trial(FEW, None, rho=0.2), Trial(MANY, PROOF)], False),
    ],
)
def test_infeasible_is_said_only_where_every_attempt_with_all_impacts_proves_it(
    trials: list[Trial], proven: bool
) -> None:
    assert isinstance(judge(trials), Infeasible if proven else SolverFailed)
    assert isinstance(judge(trials, complete=False), SolverFailed)


@pytest.mark.parametrize(("most", "named"), [(6, False), (1, True)])
def test_fewer_impacts_than_usual_are_named_in_the_advice(most: int, named: bool) -> None:
    world = load_scenario("throw_and_catch").as_believed()
    task = NominalTask(world, read_demands(world, Reserves().wall), Reserves())
    told = judge_trials([Trial(MANY, SolverFailed("grid", "time limit", "more"))], task, most, Budget(60.0), False)
    assert ("allow more impacts (--max-impacts 2 or more)" in told.remedy) is named
    assert f"with up to {'1 impact' if named else '6 impacts'}, 2 straight pieces a leg" in told.status

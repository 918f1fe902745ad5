import pytest

from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.scenario import load_scenario
from planners import make_plan
from planners.errors import Infeasible
from planners.free_flyer.nominal.diagnosis import find_relaxation
from planners.free_flyer.nominal.task import NominalTask
from planners.free_flyer.reserves import Reserves
from planners.free_flyer.specification.requirement import read_demands
from planners.mixed_integer import Affine, Model
from planners.solvers import solve


def _relaxation(name: str, values: dict, impacts: int) -> dict[str, float]:
    scenario = load_scenario(name).override(values)
    assert isinstance(scenario, FreeFlyerScenario)
    reserves = Reserves()
    task = NominalTask(scenario, read_demands(scenario, reserves.wall), reserves)
    found = find_relaxation(task, impacts, 1e-3, 30.0)
    return {relaxation.part: relaxation.amount for relaxation in found}


def test_without_impacts_the_goal_is_missed_by_its_distance() -> None:
    found = _relaxation("throw_and_catch", {}, 0)
    assert list(found) == ["G[30,30] pop in goal"]
    assert found["G[30,30] pop in goal"] == pytest.approx(0.5 + 1e-3, abs=1e-6)  # pop at y = 1.5, goal from y = 2


def test_feasible_scenario_needs_no_relaxation() -> None:
    assert _relaxation("throw_and_catch", {}, 2) == {}


def test_contradiction_names_one_of_its_sides() -> None:
    formula = "G[100,100] pop in goal & G[0,100] pop not in goal"
    found = _relaxation("corridor", {"formula": formula}, 2)
    assert set(found) & {"G[100,100] pop in goal", "G[0,100] pop not in goal"}
    assert all(amount <= 0.1 for amount in found.values())


def test_slow_robots_are_named() -> None:
    slow = {"robots.snap.speed_limit": 0.05, "robots.crackle.speed_limit": 0.05}
    assert any(part.startswith("speed of") for part in _relaxation("corridor", slow, 2))


def test_infeasible_plan_says_what_to_loosen() -> None:
    hurried = load_scenario("throw_and_catch").override({"horizon": 13.0, "formula": "G[13,13] pop in goal"})
    with pytest.raises(Infeasible, match=r"a plan exists with 'G\[13,13\] pop in goal' loosened by 0.5 m"):
        make_plan(hurried, max_impacts=2)


def test_loosened_formula_has_a_plan() -> None:
    blocked = {"regions.goal.lower": [0.25, 3.4], "regions.goal.upper": [0.75, 3.44]}
    found = _relaxation("throw_and_catch", blocked, 2)
    amount = found["G[30,30] pop in goal"]
    lower, upper = [0.25 - amount, 3.4 - amount], [0.75 + amount, 3.44 + amount]
    loosened = {"regions.goal.lower": lower, "regions.goal.upper": upper}
    assert make_plan(load_scenario("throw_and_catch").override(loosened)).validated


def test_slack_loosens_all_rows_of_its_part_and_no_rigid_ones() -> None:
    model = Model("parts", elastic=True)
    place, time = model.variable(0.0, 10.0), model.variable(0.0, 10.0, rigid=True)
    with model.part("far", 20.0):
        model.require(8.0 - place)
        model.require(12.0 - place)
        model.require(time * -1.0 + 4.0)
    model.objective = sum(model.slacks.values(), Affine({})) + time
    x = solve(model, 10.0).x
    assert model.slacks["far"].value(x) == pytest.approx(2.0)
    assert time.value(x) == pytest.approx(4.0)

"""A solver that is named is the one that solves: every mixed-integer problem of a planner goes through one door."""

import dataclasses
import re
from typing import Any

import pytest

from impact_envs.scenario import load_scenario
from planners import make_plan
from planners.errors import Infeasible
from planners.free_flyer.robust.task import RobustOptions
from planners.mixed_integer import Model
from planners.solvers import SOLVERS, Limits, Outcome, Squares
from tests.frozen.freeze import get_plan


@pytest.fixture
def solved(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Register the solver "spy", which is HiGHS and lists the problems it gets; HiGHS itself refuses to work."""
    problems: list[str] = []
    highs = SOLVERS["highs"]

    def spy(model: Model, limits: Limits, squares: Squares) -> Outcome:
        problems.append(re.sub(r"\d+", "N", model.name))
        return highs.run(model, limits, squares)

    def refuse(model: Model, limits: Limits, squares: Squares) -> Outcome:
        raise AssertionError(f"{model.name} went to HiGHS, not to the solver that was named")

    monkeypatch.setitem(SOLVERS, "spy", dataclasses.replace(highs, run=spy))
    monkeypatch.setitem(SOLVERS, "highs", dataclasses.replace(highs, run=refuse))
    return problems


@pytest.mark.parametrize("name", ["throw_and_catch", "relay"])
def test_every_stage_of_a_plan_is_solved_by_the_solver_named(name: str, solved: list[str]) -> None:
    plan, frozen = make_plan(name, solver="spy"), get_plan(name, "nominal")
    assert frozen is not None
    assert plan.impacts == frozen.impacts
    assert plan.robots == frozen.robots
    assert set(solved) == {f"event grid of {name} with N impacts", *(p for p in solved if p.startswith("inradius of"))}
    assert any(problem.startswith("inradius of") for problem in solved)


def test_the_relaxation_of_a_task_without_a_plan_is_found_by_the_solver_named(solved: list[str]) -> None:
    hurried = load_scenario("throw_and_catch").override({"horizon": 13.0, "formula": "G[13,13] pop in goal"})
    with pytest.raises(Infeasible, match="loosened by") as error:
        make_plan(hurried, max_impacts=2, solver="spy")
    assert "pop in goal" in error.value.remedy
    assert solved


@pytest.mark.parametrize("options", [{}, {"time_grid": 6}])
def test_every_stage_of_a_robust_plan_is_solved_by_the_solver_named(options: dict[str, Any], solved: list[str]) -> None:
    scenario = load_scenario("throw_and_catch").override({"believed.restitution": 1.0})
    plan = make_plan(scenario, "impact_uncertainty", solver="spy", options=RobustOptions(runs=10), **options)
    assert plan.validated
    grid = "zonotope" if "time_grid" in options else "box"
    assert any(problem.startswith(grid) for problem in solved)
    assert any(problem.startswith("inradius of") for problem in solved)
    assert ("ceiling of throw_and_catch" in solved) == ("time_grid" not in options)

"""A flight is measured against the deviation and the boxes that its plan promises."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest

from impact_envs import InputError, load_scenario, parallel_env, rollout
from impact_envs.rollout import ZeroPolicy
from planners import make_expert, make_plan
from planners.plan import Plan
from tests.frozen.freeze import get_plan
from train.cli.main import main
from train.evaluation.case import check_plan, make_case
from train.evaluation.metrics import find_metrics, measure
from train.free_flyer.plan_metrics import ON_EDGE

NAME = "throw_and_catch"
OWN = ("permissible_deviation", "flown_deviation", "time_in_tube", "outside_tube")


@cache
def plan_robustly() -> Plan:
    return make_plan(NAME, "impact_uncertainty")


def fly(plan: Plan, **world: float) -> dict[str, float | None]:
    scenario = load_scenario(NAME).override({key.replace("_", ".", 1): value for key, value in world.items()})
    episode = rollout(parallel_env(scenario), make_expert(scenario, plan, "paper_expert"), 1)
    return measure(find_metrics("free_flyer"), episode, scenario, plan)


def test_in_the_world_as_believed_a_flight_stays_in_its_tubes() -> None:
    found = fly(plan_robustly())
    assert found["permissible_deviation"] == plan_robustly().deviation
    assert found["flown_deviation"] < 0.2 * plan_robustly().deviation
    assert found["time_in_tube"] == 1.0
    assert found["outside_tube"] <= ON_EDGE


def test_beyond_the_permissible_deviation_it_leaves_them() -> None:
    found = fly(plan_robustly(), true_restitution=0.0)
    assert found["flown_deviation"] > plan_robustly().deviation
    assert found["time_in_tube"] < 1.0
    assert found["outside_tube"] > ON_EDGE


def test_without_tubes_they_are_not_applicable() -> None:
    assert fly(get_plan(NAME, "nominal")) == dict.fromkeys(OWN)
    scenario = load_scenario(NAME).shorten(0.1)
    env = parallel_env(scenario)
    assert measure(find_metrics("free_flyer"), rollout(env, ZeroPolicy(env), 0), scenario) == dict.fromkeys(OWN)


def test_evaluation_takes_a_plan_and_an_objective(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "plan.json"
    plan_robustly().save(file)
    request = ["evaluate", NAME, "--policies", "paper_expert", "--episodes", "1", "--json"]
    assert main([*request, "--plan", str(file), "--out", str(tmp_path / "a")]) == 0
    given = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert main([*request, "--objective", "impact_uncertainty", "--out", str(tmp_path / "b")]) == 0
    made = json.loads(capsys.readouterr().out.splitlines()[-1])
    for result in (given, made):
        assert result["rows"][0]["figures"]["permissible_deviation"]["median"] == pytest.approx(
            plan_robustly().deviation, rel=1e-6
        )
    assert main([*request, "--out", str(tmp_path / "c")]) == 0
    nominal = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert nominal["rows"][0]["figures"]["time_in_tube"] == {"median": None, "p90": None, "max": None, "episodes": 0}
    # Rows of one plan are never continued with another's.
    assert main([*request, "--out", str(tmp_path / "a")]) == 2


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--objective", "robustness"], "leave out --objective"),
        (["--suite", "short"], "the plan lasts 30 s, scenario throw_and_catch lasts 18 s"),
        (["--policies", "zero"], "no expert that follows a plan"),
    ],
)
def test_a_plan_that_does_not_fit_is_one_line_and_leaves_nothing(
    more: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, out = tmp_path / "plan.json", tmp_path / "out"
    get_plan(NAME, "nominal").save(file)
    assert main(["evaluate", NAME, "--episodes", "1", "--plan", str(file), "--out", str(out), *more]) == 2
    said = capsys.readouterr().err.strip()
    assert message in said
    assert "\n" not in said
    assert not out.exists()


def test_a_plan_of_other_bodies_is_refused() -> None:
    case = make_case("corridor")
    with pytest.raises(InputError, match="lasts 30 s"):
        check_plan(replace(case, plan=get_plan(NAME, "nominal")), ["expert"])


def test_several_scenarios_share_no_plan(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["evaluate", NAME, "corridor", "--plan", "plan.json"]) == 2
    assert "is for one scenario" in capsys.readouterr().err

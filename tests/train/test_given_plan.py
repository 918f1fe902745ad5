"""Plans that are given: one for the only scenario, or one for each that is named."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from impact_envs import InputError
from planners.plan import Plan
from tests.frozen.freeze import PLANS
from train.cli.main import main
from train.evaluation.case import make_cases
from train.given_plan import load_plans

FILES = {name: PLANS / f"{name}.json" for name in ("throw_and_catch", "corridor")}
GIVEN = [f"{name}={path}" for name, path in FILES.items()]


def test_each_scenario_gets_the_plan_that_names_it() -> None:
    cases = make_cases([*FILES, "pong"], ["nominal", "hard"])
    plans = load_plans(cases, GIVEN)
    assert {name: plan.to_json() for name, plan in plans.items()} == {
        name: Plan.load(path).to_json() for name, path in FILES.items()
    }


def test_the_only_scenario_needs_no_name(tmp_path: Path) -> None:
    odd = tmp_path / "a=b.json"
    odd.write_bytes(FILES["corridor"].read_bytes())
    cases = make_cases(["corridor"], ["nominal", "hard"])
    assert load_plans(cases, [str(odd)]).keys() == load_plans(cases, [f"corridor={odd}"]).keys() == {"corridor"}


@pytest.mark.parametrize(
    ("texts", "said"),
    [
        ([str(FILES["corridor"])], "is for one scenario, got throw_and_catch, corridor: SCENARIO=PATH each"),
        (["corridor="], "is for one scenario"),
        (["pong=x.json"], "scenario 'pong' is not asked for; choices: throw_and_catch, corridor"),
        ([GIVEN[1], GIVEN[1]], "scenario 'corridor' has a plan already"),
        (["corridor=no_such.json"], "no_such.json: cannot be read"),
        ([f"corridor={FILES['throw_and_catch']}"], "corridor"),
    ],
)
def test_what_names_no_plan_is_refused(texts: list[str], said: str) -> None:
    with pytest.raises(InputError, match=said):
        load_plans(make_cases([*FILES], ["hard"]), texts)


def test_a_plan_of_another_scenario_is_refused_where_there_is_one() -> None:
    with pytest.raises(InputError, match=r"--plan pong=x.json: scenario 'pong' is not asked for; choices: corridor"):
        load_plans(make_cases(["corridor"], ["hard"]), ["pong=x.json"])
    with pytest.raises(InputError, match=r"a/b=x.json: cannot be read"):
        load_plans(make_cases(["corridor"], ["hard"]), ["a/b=x.json"])


def test_bodies_are_renamed_in_one_plan_only() -> None:
    with pytest.raises(InputError, match="--rename a=b: is for one plan, got 2"):
        load_plans(make_cases([*FILES], ["hard"]), GIVEN, ("a=b",))


@pytest.mark.parametrize("command", ["sweep", "evaluate"])
def test_a_sweep_flies_the_given_plans(
    command: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*args: object) -> None:
        raise AssertionError("planned")

    monkeypatch.setattr("train.evaluation.evaluate.make_plan", refuse)
    arguments = [command, *FILES, "--suite", "hard", "--policies", "expert", "--episodes", "1", "--plan", *GIVEN]
    assert main([*arguments, "--json"]) == 0
    assert [row["scenario"] for row in json.loads(capsys.readouterr().out)["rows"]] == [*FILES]
    if command == "sweep":
        assert main([*arguments, "--learn", "tune", "--out", "x"]) == 2
        assert "is for judging" in capsys.readouterr().err

"""``impact plan``: pictures, published files, encodings, solvers."""

import json
from dataclasses import replace

import pytest

from planners.budget import Clock
from planners.plan import Plan
from planners.solvers import installed_solvers
from tests.frozen.freeze import get_plan
from train.cli.main import main
from train.cli.plan import judge_plan


def run(capsys, *arguments):
    code = main(arguments)
    said = capsys.readouterr()
    return code, said.out, said.err


def test_one_plan_is_drawn_stored_and_published_and_the_published_one_runs(capsys, tmp_path):
    picture, folder, stored = tmp_path / "plan.png", tmp_path / "published", tmp_path / "plan.json"
    code, out, err = run(
        capsys,
        "plan",
        "throw_and_catch",
        "--plot",
        str(picture),
        "--published",
        str(folder),
        "--out",
        str(stored),
        "--json",
    )
    assert code == 0, err
    assert json.loads(out)["objective"] == "robustness"
    assert picture.read_bytes().startswith(b"\x89PNG")
    names = sorted(path.name for path in folder.iterdir())
    assert names == [f"plan_throw_and_catch_{body}.csv" for body in ("crackle", "pop", "snap")]
    code, out, err = run(capsys, "run", "throw_and_catch", "--plan", str(folder), "--json")
    assert code == 0, err
    episode = json.loads(out)
    assert episode["success"]
    assert episode["robustness"] == pytest.approx(Plan.load(stored).robustness, abs=0.01)


def test_reference_encoding_finds_the_same_robustness_and_says_that_it_is_not_exact(capsys):
    code, out, err = run(capsys, "plan", "throw_and_catch", "--encoding", "bezier", "--json")
    assert code == 0, err
    plan = json.loads(out)
    assert plan["robustness"] == plan["bound"] == 0.25
    assert not plan["is_exact"]
    assert plan["impact_error"] > 1e-3
    assert "only with equal masses and e = 1" in plan["warning"]


def test_plan_of_several_objects_lists_who_is_hit(capsys):
    code, out, err = run(capsys, "plan", "exchange", "--json")
    assert code == 0, err
    assert {hit["object"] for hit in json.loads(out)["impacts"]} == {"pop", "plop"}


@pytest.mark.parametrize(
    ("gap", "seconds", "said"),
    [
        (0.0, 1.0, "proven: no plan is more robust"),
        (1e-6, 1.0, "proven: no plan is more robust"),
        (0.2, 1.0, "a plan with 0.3 m, no plan has more than 0.5 m: with up to 1 impact and the planner's reserves no"),
        (0.2, 31.0, "a plan with 0.3 m, no plan has more than 0.5 m: the search for more ended with its part of the"),
    ],
)
def test_a_plan_is_judged_by_its_gap_and_time(gap, seconds, said):
    plan = get_plan("throw_and_catch", "nominal")
    given = replace(plan, robustness=0.5 - gap, bound=0.5, gap=gap, solve_seconds=seconds)
    assert judge_plan(given, Clock(), 60.0, 1)["verdict"].startswith(said)


BAD = {
    "picture": (("--plot", "plan.bmp"), [".bmp", ".png", ".svg"]),
    "folder": (("--published", "no/such/folder"), ["no/such"]),
    "grid": (("--time-grid", "6"), ["--time-grid 6", "impact_uncertainty"]),
    "encoding": (("--encoding", "bezier", "--objective", "impact_uncertainty"), ["bezier", "impact_uncertainty"]),
    "bezier out": (("--encoding", "bezier", "--out", "plan.json"), ["bezier", "--out"]),
    "solver": (("--solver", "cplex"), ["cplex", "highs", "scip"]),
    "impacts": (("--max-impacts", "-1"), ["max_impacts", "-1"]),
    "half an impact": (("--max-impacts", "2.5"), ["impact: --max-impacts 2.5: a whole number is needed"]),
    "no number": (("--time-limit", "soon"), ["impact: --time-limit soon: a number is needed"]),
    "weights": (("--weights", "a"), ["impact: --weights a: a number is needed"]),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_options_are_one_line_and_exit_code_2(case, capsys):
    options, words = BAD[case]
    code, out, err = run(capsys, "plan", "throw_and_catch", *options)
    assert (code, out) == (2, "")
    assert len(err.strip().splitlines()) == 1, err
    for word in words:
        assert word in err


@pytest.mark.skipif("scip" in installed_solvers(), reason="SCIP is installed")
@pytest.mark.parametrize("objective", ["robustness", "impact_uncertainty"])
def test_solver_that_is_not_installed_is_named_with_its_package(objective, capsys):
    code, out, err = run(capsys, "plan", "throw_and_catch", "--solver", "scip", "--objective", objective)
    assert (code, out) == (2, "")
    assert "pyscipopt" in err

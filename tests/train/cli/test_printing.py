"""What a person reads: units, four digits, no brackets of Python; files are named; a closed pipe is no fault."""

import re
import subprocess
import sys
import time

import pytest

import impact_envs
from planners.budget import Budget, Progress, watch_planning
from train.cli.main import main
from train.cli.progress import show_planning


def say(capsys, *arguments):
    assert main(arguments) == 0
    return capsys.readouterr()


def value_of(text, name):
    return re.search(rf"^{re.escape(name)}  +(.*)$", text, re.M)[1]


def test_an_episode_is_told_with_units_and_four_digits(capsys):
    said = say(capsys, "run", "throw_and_catch", "--set", "true.restitution=0.5").out
    assert re.fullmatch(r"0\.\d{2,4} m", value_of(said, "robustness"))
    assert value_of(said, "formula satisfied") == "yes"
    assert value_of(said, "effort, sum of |force| dt").endswith(" N s")
    assert value_of(said, "changed values") == "true.restitution 0.5"
    assert value_of(said, "fallbacks") == "none"
    assert value_of(said, "you waited").endswith(" s")
    assert not re.search(r"[{}]|\d\.[1-9]\d{5}", said)
    assert "impulse [N s]" in said
    assert "time [s]" in said
    assert "not applicable" not in said  # measures of plans for uncertain impacts
    assert not re.search(r"e-1[2-9]", said)  # rounding errors of zero


def test_a_plan_has_another_name_for_what_is_another_quantity(capsys):
    said = say(capsys, "plan", "throw_and_catch").out
    assert value_of(said, "path cost, sum of displacement² / duration").endswith(" m²/s")
    assert "effort, sum" not in said
    assert "centre of object [m]" in said
    assert not re.search(r"[{}]|\d\.[1-9]\d{5}", said)


def test_arms_spend_torque(capsys):
    said = say(capsys, "run", "dual_arm_grasp", "--policy", "zero").out
    assert value_of(said, "effort, sum of |force| dt") == "0 N m s"
    assert value_of(said, "box error").endswith(" m")
    assert not value_of(said, "robustness").endswith(" m")  # the least of lengths, torques and times


@pytest.mark.parametrize(("name", "policy", "told"), [("passive", "expert", True), ("passive", "zero", False)])
def test_the_published_outcome_is_explained(capsys, name, policy, told):
    said = say(capsys, "run", f"floating_manipulator_{name}", "--policy", policy).out
    assert value_of(said, "formula satisfied") == "no"
    assert ("published outcome" in said) is told


def test_every_file_is_named(capsys, tmp_path):
    plan, table = tmp_path / "plan.json", tmp_path / "flight.csv"
    said = say(capsys, "plan", "throw_and_catch", "--out", str(plan), "--json").err
    assert said.splitlines() == [f"wrote {plan}"]
    said = say(capsys, "run", "throw_and_catch", "--plan", str(plan), "--save", str(table), "--json").err
    assert f"wrote {table}" in said.splitlines()
    assert all(path.is_file() for path in map(type(plan), re.findall(r"wrote (.*)", said)))


def test_list_describes(capsys):
    said = say(capsys, "list").out
    for name in impact_envs.list_scenarios():
        assert name in said
        assert impact_envs.load_scenario(name).description in said
        assert impact_envs.gym_id(name) in said


def test_version(capsys):
    with pytest.raises(SystemExit) as ended:
        main(("--version",))
    assert not ended.value.code
    assert capsys.readouterr().out == f"impact-envs {impact_envs.__version__}\n"


@pytest.mark.parametrize("form", ["--json", ""])
def test_a_closed_pipe_is_quiet(form):
    command = f"{sys.executable} -m train.cli.main list {form} | true"
    said = subprocess.run(["sh", "-c", command], capture_output=True, text=True)
    assert said.stderr == ""


def test_stages_are_told_to_who_watches():
    told = []
    with watch_planning(lambda budget, stage: told.append((stage, str(budget.progress)))):
        budget = Budget(60.0)
        with budget.stage("robustness"):
            budget.progress.impacts, budget.progress.pieces, budget.progress.bound = 2, 1, 0.5
        with budget.stage("effort"):
            pass
    with budget.stage("nobody watches"):
        pass
    said = "2 impacts, 1 piece a leg, at most 0.5 m"
    assert told == [("robustness", ""), (None, said), ("effort", said), (None, said)]


@pytest.mark.parametrize(
    ("impacts", "pieces", "said"),
    [(0, 1, "no impacts yet, 1 piece a leg"), (1, 2, "1 impact, 2 pieces a leg"), (2, 1, "2 impacts, 1 piece a leg")],
)
def test_one_is_told_as_one_and_none_as_none_yet(impacts, pieces, said):
    assert str(Progress(impacts=impacts, pieces=pieces)) == said


def test_without_a_terminal_a_line_now_and_then_tells_of_a_plan(capsys, monkeypatch):
    monkeypatch.setattr("train.cli.progress.REPORT_PERIOD", 0.05)
    with show_planning():
        budget = Budget(60.0)
        budget.progress.bound = 0.5
        with budget.stage("robustness"):
            time.sleep(0.4)
    told = capsys.readouterr().err.splitlines()
    assert told
    assert all(
        re.fullmatch(r"impact: planning for \d+ s: robustness, at most 0.5 m, (59|60) s left", line) for line in told
    )


def test_help_says_which_domains_are_planned(capsys):
    with pytest.raises(SystemExit):
        main(("plan", "--help"))
    said = capsys.readouterr().out
    assert "free-flyers" in said
    assert "dual_arm, follow no plan" in re.sub(r"[│\s]+", " ", said)

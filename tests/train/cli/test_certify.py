"""``impact certify``, ``impact compare --until`` and ``impact break``: exit codes, results, refusals in one line."""

import json
from pathlib import Path

import pytest

from train.cli.main import main

PLANS = Path(__file__).parents[2] / "frozen" / "plans"


def run(capsys, *arguments):
    code = main([str(argument) for argument in arguments])
    said = capsys.readouterr()
    return code, said.out, said.err


def test_plan_is_confirmed_with_every_margin(capsys):
    code, out, err = run(capsys, "certify", PLANS / "throw_and_catch.json", "--json")
    assert code == 0, err
    result = json.loads(out)
    assert result["confirmed"]
    assert result["refused"] == []
    assert all(check["margin"] >= 0 for check in result["checks"])
    assert result["continuous_robustness"] == pytest.approx([0.25, 0.25], abs=1e-6)


def test_changed_plan_is_refused_with_code_1_and_the_check_is_named(capsys, tmp_path):
    plan = json.loads((PLANS / "throw_and_catch.json").read_text())
    plan["impacts"][0]["object_plus"][1] += 1e-6
    path = tmp_path / "plan.json"
    path.write_text(json.dumps(plan))
    code, out, _ = run(capsys, "certify", path, "--json")
    assert code == 1
    assert json.loads(out)["refused"] == ["velocities in the table of impacts"]


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("deviation", -1),
        ("deviation", "a"),
        ("gap", "small"),
        ("validated", 1),
        ("objective", "fun"),
        ("version", "2"),
        ("tubes", {"pop": 1}),
        ("tubes", {"a": {"times": [], "start": [], "end": []}}),
        ("responses", {"a": 1}),
        ("responses", {"a": []}),
        ("responses", {"snap": []}),
        ("planned_responses", [1]),
    ],
)
def test_malformed_field_makes_no_plan_and_is_named_with_its_value(field, value, capsys, tmp_path):
    plan = json.loads((PLANS / "throw_and_catch.json").read_text())
    path = tmp_path / "plan.json"
    path.write_text(json.dumps(plan | {field: value}))
    code, out, err = run(capsys, "certify", path)
    assert (code, out) == (2, "")
    assert err.startswith(f"impact: plan file {path}: {field}")
    assert len(err.strip().splitlines()) == 1
    assert ("'a'" if isinstance(value, dict) and value.get("a") == [] else "") in err
    if not isinstance(value, dict | list):
        assert f"{field} = {value!r}: " in err


def test_impact_of_an_unknown_robot_names_file_and_robots(capsys, tmp_path):
    plan = json.loads((PLANS / "throw_and_catch.json").read_text())
    robot, plan["impacts"][0]["robot"] = plan["impacts"][0]["robot"], "nobody"
    path = tmp_path / "plan.json"
    path.write_text(json.dumps(plan))
    code, _, err = run(capsys, "certify", path)
    assert code == 2
    assert f"plan file {path}: " in err
    assert "'nobody' is unknown" in err
    assert robot in err.partition("choices: ")[2]


DUEL = ("compare", "zero", "expert", "--until", "decided", "--scenario", "pong")
BAD = {
    "no file": (("certify", "nothing.json"), ["nothing.json", "cannot be read"]),
    "other horizon": (("certify", PLANS / "throw_and_catch_hard.json"), ["spans 18 s", "30 s", "example hard_v0"]),
    "no suite's": (
        ("certify", PLANS / "throw_and_catch.json", "--suite", "hard_v0"),
        ["throw_and_catch.json", "spans 30 s", "18 s", "example nominal"],
    ),
    "other scenario": (("certify", PLANS / "pong.json", "--scenario", "corridor"), ["'pong'", "'corridor'"]),
    "other domain": (("certify", PLANS / "pong.json", "--scenario", "dual_arm_grasp"), ["dual_arm", "certified"]),
    "no scenario": (("compare", "expert", "zero", "--until", "decided"), ["--scenario"]),
    "one policy": (("compare", "expert", "--until", "decided", "--scenario", "pong"), ["two policies", "expert"]),
    "no until": (("compare", "a", "--scenario", "pong"), ["--scenario pong needs --until decided"]),
    "an error": (("compare", "a", "--error", "7"), ["--error 7", "needs --until decided"]),
    "a suite": (("compare", "a", "--suite", "x"), ["--suite x needs --until decided"]),
    "changes": (("compare", "a", "--set", "true.restitution=1"), ["--set true.restitution=1 needs --until decided"]),
    "great error": ((*DUEL, "--error", "2"), ["--error 2: must be above 0 and below 1"]),
    "small share": ((*DUEL, "--least-share", "0.4"), ["--least-share 0.4: must be above 0.5 and below 1"]),
    "negative limit": ((*DUEL, "--limit", "-1"), ["--limit -1: must be above 0"]),
    "great difference": ((*DUEL, "--least-difference", "0.6"), ["--least-difference 0.6", "below --limit 0.5"]),
    "nothing drawn": (("break", "zero", "pong", "--suite", "nominal"), ["nominal", "draws nothing", "restitution, ma"]),
    "oracle": (("break", "oracle", "pong"), ["'oracle'", "choices: expert, ", "zero", "folder"]),
    "order": (("break", "zero", "pong", "--vary", "restitution=0.5,0.1"), ["=0.5,0.1", "LOW", "less than HIGH"]),
    "negative": (("break", "zero", "pong", "--vary", "start=-0.05"), ["start=-0.05", "HALF", "above 0"]),
    "nowhere": (("break", "zero"), ["Missing from impact break: SCENARIO Shipped name or TOML file. (required)\n"]),
    "a folder": (("break", "zero", "pong", "--out", PLANS), [f"--out {PLANS}: is a folder"]),
    "no such number": (("break", "zero", "pong", "--vary", "strat=0.1"), ["--vary strat=0.1", "start"]),
    "no evaluation": (("break", "zero", "pong", "--report", "nowhere"), ["--report nowhere", "impact evaluate"]),
    "starts outside": (("break", "zero", "pong", "--vary", "start=50"), ["could start outside the world"]),
    "a file there": (("break", "zero", "pong", "--out", PLANS / "pong.json"), ["--out", "pong.json: is there already"]),
    "no episodes": (("break", "zero", "pong", "--episodes", "0"), ["--episodes 0"]),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_one_line_and_exit_code_2(case, capsys):
    arguments, words = BAD[case]
    code, out, err = run(capsys, *arguments)
    assert (code, out) == (2, "")
    assert len(err.strip().splitlines()) == 1, err
    for word in words:
        assert word in err


def test_plan_of_a_task_of_ones_own_asks_for_its_file(capsys, tmp_path):
    plan = json.loads((PLANS / "throw_and_catch.json").read_text()) | {"scenario": "my_task"}
    path = tmp_path / "plan.json"
    path.write_text(json.dumps(plan))
    assert run(capsys, "certify", path) == (
        2,
        "",
        f"impact: plan file {path}: scenario 'my_task' is not a shipped one; name its file: --scenario FILE.toml\n",
    )

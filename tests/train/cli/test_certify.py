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


BAD = {
    "no file": (("certify", "nothing.json"), ["nothing.json", "cannot be read"]),
    "other horizon": (("certify", PLANS / "throw_and_catch_hard.json"), ["spans 18 s", "30 s"]),
    "other scenario": (("certify", PLANS / "pong.json", "--scenario", "corridor"), ["'pong'", "'corridor'"]),
    "other domain": (("certify", PLANS / "pong.json", "--scenario", "dual_arm_grasp"), ["dual_arm", "certified"]),
    "no scenario": (("compare", "expert", "zero", "--until", "decided"), ["--scenario"]),
    "one policy": (("compare", "expert", "--until", "decided", "--scenario", "pong"), ["two policies", "expert"]),
    "no until": (("compare", "a", "--scenario", "pong"), ["--until decided"]),
    "nothing drawn": (("break", "zero", "pong", "--suite", "nominal"), ["nominal", "draws nothing"]),
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

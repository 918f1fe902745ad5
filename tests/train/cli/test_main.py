"""What users type does what the interface promises: JSON last and alone, one line and exit code 2 on bad input."""

import json
import os
import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import pytest

from impact_envs import list_scenarios
from train.arguments import Args
from train.cli.main import main


def run(capsys, *arguments):
    code = main(arguments)
    said = capsys.readouterr()
    return code, said.out, said.err


def result(capsys, *arguments):
    code, out, err = run(capsys, *arguments, "--json")
    assert code == 0, err
    assert len(out.splitlines()) == 1
    return json.loads(out)


def test_list_names_every_scenario(capsys):
    listed = result(capsys, "list")["scenarios"]
    assert [entry["name"] for entry in listed] == list(list_scenarios())
    assert {"domain", "gym_id", "horizon", "agents"} <= listed[0].keys()


def test_plan_of_the_corridor_is_proven(capsys, tmp_path):
    out, csv = tmp_path / "plan.json", tmp_path / "samples"
    plan = result(capsys, "plan", "corridor", "--out", str(out), "--csv", str(csv))
    assert plan["robustness"] == plan["bound"] == 0.75
    assert plan["gap"] == 0
    assert plan["validated"]
    assert [hit["robot"] for hit in plan["impacts"]] == ["snap", "crackle"]
    assert json.loads(out.read_text())["scenario"] == "corridor"
    assert sorted(path.name for path in csv.iterdir()) == ["crackle.csv", "plan.impacts.csv", "pop.csv", "snap.csv"]


def test_a_stored_plan_is_run(capsys, tmp_path):
    out = tmp_path / "plan.json"
    plan = result(capsys, "plan", "throw_and_catch", "--out", str(out))
    episode = result(capsys, "run", "throw_and_catch", "--plan", str(out), "--seed", "3")
    assert episode["success"]
    assert episode["robustness"] == pytest.approx(plan["robustness"], abs=0.01)
    assert len(episode["impacts"]) == len(plan["impacts"])
    assert episode["solve_ms"].keys() == {"p50", "p99", "max"}


def test_run_takes_values_and_suites(capsys):
    dead = result(capsys, "run", "throw_and_catch", "--policy", "zero", "--set", "true.restitution=0.5")
    assert not dead["success"]
    assert dead["effort"] == 0.0
    assert result(capsys, "run", "throw_and_catch", "--policy", "random", "--suite", "all")["suite"] == "all"


def test_set_reaches_world_and_expert_and_is_printed(capsys):
    world, expert = "true.restitution=0.5", "expert.retime=false"
    changed = result(capsys, "run", "throw_and_catch", "--set", world, expert)
    assert changed["set"] == {"true.restitution": 0.5, "expert.retime": False}
    plain = result(capsys, "run", "throw_and_catch", "--set", world)
    assert changed["robustness"] != plain["robustness"]


def test_help_and_list_import_no_learner_and_no_tables():
    heavy = ("torch", "stable_baselines3", "pandas", "matplotlib", "scipy.stats", "highspy", "casadi", "cvxpy")
    code = (
        "import sys\nfrom train.cli.main import main\n"
        "for arguments in (['list'], ['train', '--help'], ['--help']):\n"
        "    try:\n        main(arguments)\n    except SystemExit:\n        pass\n"
        f"    print(arguments, [name for name in {heavy} if name in sys.modules], file=sys.stderr)"
    )
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert said.stderr.splitlines() == ["['list'] []", "['train', '--help'] []", "['--help'] []"]


def test_train_takes_every_argument_of_its_script(capsys):
    with pytest.raises(SystemExit):
        main(("train", "--help"))
    shown = capsys.readouterr().out
    for field in fields(Args)[1:]:  # the scenario is positional
        assert f"--{field.name.replace('_', '-')}" in shown


@pytest.mark.slow
def test_run_renders_a_film(capsys, tmp_path):
    film = tmp_path / "throw.gif"
    result(capsys, "run", "throw_and_catch", "--policy", "zero", "--render", str(film))
    assert film.stat().st_size > 10_000


def test_evaluate_and_report(capsys, tmp_path):
    out = tmp_path / "evaluation"
    arguments = ("evaluate", "throw_and_catch", "--policies", "expert", "zero", "--episodes", "2", "--out", str(out))
    table = result(capsys, *arguments)
    assert [row["policy"] for row in table["rows"]] == ["expert", "zero"]
    assert table["rows"][0]["success_rate"] == 1.0
    assert {table["paired"][0]["a"], table["paired"][0]["b"]} == {"expert", "zero"}
    report = result(capsys, "report", str(out))["report"]
    assert "</html>" in Path(report).read_text()


def test_demo_does_the_main_job(capsys, tmp_path, monkeypatch):
    monkeypatch.setattr(os, "cpu_count", lambda: 1)  # workers take longer to start than to play
    for _ in range(2):  # the second one starts afresh
        shown = result(capsys, "demo", "--episodes", "1", "--out", str(tmp_path / "demo"))
    assert {name: plan["gap"] for name, plan in shown["plans"].items()} == {"throw_and_catch": 0, "pong": 0}
    assert len(shown["rows"]) == 2 * 2 * 3
    assert Path(shown["report"]).is_file()
    rates = [(row["policy"], row["success_rate"]) for row in shown["rows"] if row["suite"] == "all"]
    assert sorted(rate for rate in rates if rate[0] in ("expert", "zero")) == 2 * [("expert", 1)] + 2 * [("zero", 0)]


BAD = {
    "rename, no plan": (("evaluate", "throw_and_catch", "--rename", "a=b"), ("--rename needs --plan",)),
    "force, no plan": (("evaluate", "throw_and_catch", "--force"), ("--force needs --plan",)),
    "plan, no expert": (
        ("run", "throw_and_catch", "--policy", "zero", "--plan", "plan.json"),
        ("policy zero has no expert that follows a plan",),
    ),
    "scenario": (("plan", "coridor"), ["coridor", "corridor"]),
    "file": (("plan", "no/such.toml"), ["no/such.toml"]),
    "option": (("plan", "corridor", "--objectve", "robustness"), ["--objectve"]),
    "number": (("run", "corridor", "--seed", "x"), ["--seed x", "a whole number"]),
    "negative seed": (("run", "corridor", "--seed", "-1"), ["seed -1"]),
    "set key": (("run", "corridor", "--set", "true.restitutoin=0.5"), ["restitutoin", "restitution"]),
    "set form": (("run", "corridor", "--set", "true.restitution"), ["KEY=VALUE"]),
    "set digits": (("run", "corridor", "--set", "true.restitution=" + "1" * 5000), ["restitution", "too many digits"]),
    "set depth": (("run", "corridor", "--set", "true.restitution=" + "[" * 5000), ["restitution", "nested too deeply"]),
    "set option": (("run", "corridor", "--set", "expert.retmie=false"), ["expert.retmie", "did you mean 'retime'"]),
    "set option kind": (("evaluate", "corridor", "--set", "expert.retime=3"), ["expert.retime", "3"]),
    "set of no expert": (
        ("run", "corridor", "--policy", "zero", "--set", "expert.retime=false"),
        ["expert.retime", "zero"],
    ),
    "set option of arms": (("run", "dual_arm_grasp", "--set", "expert.retime=false"), ["expert.retime", "controller."]),
    "set option to nothing": (
        ("run", "corridor", "--set", "expert.insertion.wall=nan"),
        ["expert.insertion.wall", "nan"],
    ),
    "set value": (("run", "corridor", "--set", "true.restitution=1.5"), ["true.restitution", "1.5"]),
    "policy": (("run", "corridor", "--policy", "experte"), ["experte", "expert"]),
    "suite": (("evaluate", "corridor", "--suite", "mas"), ["mas", "mass"]),
    "plan file": (("run", "corridor", "--plan", "nope.json"), ["nope.json"]),
    "film": (("run", "corridor", "--render", "film.avi"), ["film.avi", ".mp4", ".png"]),
    "plan folder": (("plan", "corridor", "--out", "no/such/plan.json"), ["no/such"]),
    "report": (("report", "nowhere"), ["nowhere"]),
    "command": (("frobnicate",), ["frobnicate", "plan"]),
    "no option": (("train", "corridor", "--algo", "dqn"), ["--algo"]),
    "training suite": (("train", "corridor", "--suite", "hrad"), ["hrad", "hard"]),
    "training value": (("train", "corridor", "--set", "expert.filtr=false"), ["filtr", "filter"]),
    "training worlds": (("train", "corridor", "--worlds", "12"), ["worlds 12", "group 8"]),
    "plan of arms": (("plan", "dual_arm_grasp"), ["dual_arm_grasp", "no plan", "free_flyer"]),
    "Bezier plan of arms": (("plan", "dual_arm_grasp", "--encoding", "bezier"), ["dual_arm_grasp", "no plan"]),
    "arms with a plan": (("run", "dual_arm_grasp", "--plan", "nope.json"), ["dual_arm_grasp", "no plan"]),
    "variant": (("run", "dual_arm_grasp", "--policy", "no_interim"), ["no_interim", "no_interim_phase"]),
    "box out of reach": (
        ("run", "dual_arm_grasp", "--set", "target={position=[0.9,0.6]}"),
        ["target", "arm_1", "out of reach"],
    ),
    "friction estimate": (("run", "dual_arm_grasp", "--set", "believed.friction=0.7"), ["believed.friction", "0.7"]),
    "negative stiffness": (("run", "dual_arm_grasp", "--set", "pads.stiffness=-1"), ["pads.stiffness", "-1"]),
    "episodes": (("evaluate", "corridor", "--episodes", "0"), ["episodes 0"]),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_one_line_and_exit_code_2(case, capsys):
    arguments, words = BAD[case]
    code, out, err = run(capsys, *arguments)
    assert code == 2
    assert out == ""
    assert len(err.strip().splitlines()) == 1, err
    for word in words:
        assert word in err


def test_a_file_where_a_folder_belongs_is_one_line(capsys, tmp_path):
    file = tmp_path / "file"
    file.write_text("kept")
    for arguments in (
        ("plan", "throw_and_catch", "--csv", str(file)),
        ("demo", "--episodes", "1", "--out", str(file)),
        ("train", "throw_and_catch", "--steps", "4", "--out", str(file)),
        ("evaluate", "throw_and_catch", "--policies", "zero", "--episodes", "1", "--out", str(file)),
    ):
        code, out, err = run(capsys, *arguments)
        assert (code, out) == (2, ""), arguments
        assert str(file) in err.strip().splitlines()[-1]
        assert "Traceback" not in err
    assert file.read_text() == "kept"


def test_demo_leaves_other_evaluations_alone(capsys, tmp_path):
    out = tmp_path / "mine"
    result(capsys, "evaluate", "throw_and_catch", "--policies", "zero", "--episodes", "1", "--out", str(out))
    before = (out / "rows.jsonl").read_bytes()
    code, _, err = run(capsys, "demo", "--episodes", "1", "--out", str(out))
    assert code == 2
    assert "another evaluation" in err
    assert (out / "rows.jsonl").read_bytes() == before


def test_no_plan_is_exit_code_1(capsys):
    scenario = "throw_and_catch"
    from impact_envs import load_scenario
    from planners import Infeasible, make_plan

    with pytest.raises(Infeasible) as caught:
        make_plan(load_scenario(scenario), max_impacts=1)
    assert caught.value.remedy
    code, out, err = run(capsys, "plan", scenario, "--max-impacts", "1")
    assert (code, out) == (1, "")
    assert len(err.strip().splitlines()) == 1


def test_the_command_is_installed():
    said = subprocess.run([sys.executable, "-m", "train.cli.main", "list", "--json"], capture_output=True, text=True)
    assert said.returncode == 0
    assert len(json.loads(said.stdout)["scenarios"]) == len(list_scenarios())


def test_help_ends_quietly_when_its_reader_has_read_enough():
    command = [sys.executable, "-m", "train.cli.main", "evaluate", "--help"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None and process.stderr is not None
        process.stdout.close()  # before anything is printed
        assert (process.stderr.read(), process.wait()) == ("", 0)

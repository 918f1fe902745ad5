"""Runs of a training script: each in its folder, gone on with, read when it has ended, never another's."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import train.residual
import train.tune
from impact_envs import InputError
from train.arguments import Args, TuneArgs
from train.cli.main import main
from train.cli.sweep import Command, list_points
from train.errors import Diverged
from train.launch.local import LocalLauncher
from train.runs import TrainingRun, launch_runs, name_folder

ARGS = Args(scenarios=("throw_and_catch",), steps=3)


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[Args]:
    """Calls of a training script that counts to ``steps``, a checkpoint each, and fails at the second one once."""
    made: list[Args] = []

    def count(args: Args, saved: Any = None) -> dict[str, Any]:
        made.append(args)
        checkpoints = args.out / "checkpoints"
        done = len(list(checkpoints.glob("*"))) if args.resume else 0
        for number in range(done + 1, args.steps + 1):
            (checkpoints / str(number)).mkdir(parents=True)
            (checkpoints / str(number) / "weights").write_text(f"{args.seed} {number}")
            if saved:
                saved()
            if number == 2 and len(made) == 1:
                raise KeyboardInterrupt
        (args.out / "policy.json").write_text(f"{args.seed}")
        return {"eval": {}, "report": {"gain": args.seed / 10}}

    monkeypatch.setattr(train.residual, "main", count)
    monkeypatch.setattr(train.tune, "main", count)
    return made


@pytest.mark.parametrize("shared", [False, True])
def test_a_run_that_was_interrupted_goes_on_and_one_that_ended_is_read(
    shared: bool, calls: list[Args], tmp_path: Path
) -> None:
    out = tmp_path.as_uri() if shared else tmp_path
    runs = [TrainingRun("train", replace(ARGS, seed=seed), name_folder(out, f"seed{seed}")) for seed in (1, 2)]
    with pytest.raises(KeyboardInterrupt):
        launch_runs(LocalLauncher(), runs, progress=False)
    found = launch_runs(LocalLauncher(), runs, progress=False)
    assert [result["report"]["gain"] for result in found] == [0.1, 0.2]
    assert [(args.seed, args.resume) for args in calls] == [(1, False), (1, True), (2, False)]
    assert (tmp_path / "seed2" / "checkpoints" / "3" / "weights").read_text() == "2 3"
    assert (tmp_path / "seed1" / "policy.json").read_text() == "1"
    assert launch_runs(LocalLauncher(), runs, progress=False) == found
    assert len(calls) == 3
    other = replace(runs[0], args=replace(ARGS, seed=1, learning_rate=0.1))
    with pytest.raises(InputError, match=r"seed1: holds a run with learning_rate 0.001, not 0.1"):
        launch_runs(LocalLauncher(), [other], progress=False)


def test_a_policy_that_nobody_here_began_is_not_overwritten(calls: list[Args], tmp_path: Path) -> None:
    (tmp_path / "policy.json").touch()
    run = TrainingRun("tune", TuneArgs(scenarios=("throw_and_catch",)), str(tmp_path))
    with pytest.raises(InputError, match="holds a policy of another command"):
        launch_runs(LocalLauncher(), [run], progress=False)
    assert not calls


def test_seeds_of_the_command_are_runs_of_their_own(
    calls: list[Args], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    calls.append(ARGS)  # so that nothing fails
    arguments = ["train", "throw_and_catch", "--steps", "1", "--seeds", "5", "6", "--out", str(tmp_path), "--json"]
    assert main(arguments) == 0
    rows = json.loads(capsys.readouterr().out)["runs"]
    assert [(row["seed"], row["gain"], row["out"]) for row in rows] == [
        (5, 0.5, str(tmp_path / "seed5")),
        (6, 0.6, str(tmp_path / "seed6")),
    ]
    assert main([*arguments, "--resume"]) == 2
    assert main(["train", "--seeds", "5", "5"]) == 2
    assert "two runs of the same folder" in capsys.readouterr().err


def test_arguments_that_make_no_sense_leave_nothing(tmp_path: Path) -> None:
    for run in (TrainingRun("train", replace(ARGS, seed=-1), ""), TrainingRun("tune", TuneArgs(seed=-1), "")):
        with pytest.raises(InputError, match="seed -1"):
            launch_runs(LocalLauncher(), [replace(run, out=name_folder(tmp_path, run.script))], progress=False)
    run = TrainingRun("train", replace(ARGS, suite=("hrad",)), name_folder(tmp_path, "suite"))
    with pytest.raises(InputError, match="suite 'hrad'"):
        launch_runs(LocalLauncher(), [run], progress=False)
    assert not list(tmp_path.iterdir())


def test_another_run_in_the_scripts_own_folder_is_no_hindrance(
    calls: list[Args], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls.append(ARGS)
    monkeypatch.chdir(tmp_path)
    (ARGS.out / "checkpoints" / "7").mkdir(parents=True)
    launch_runs(LocalLauncher(), [TrainingRun("train", ARGS, name_folder("mine"))], progress=False)
    assert calls[-1].out == tmp_path / "mine"


def test_a_run_that_diverges_ends_all_or_is_told(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def learn(args: Args, saved: Any = None) -> dict[str, Any]:
        if args.seed == 0:
            raise Diverged("no longer finite")
        return {"eval": {"low": 0.5}}

    monkeypatch.setattr(train.residual, "main", learn)
    runs = [TrainingRun("train", replace(ARGS, seed=seed), name_folder(tmp_path, str(seed))) for seed in (0, 1)]
    with pytest.raises(Diverged):
        launch_runs(LocalLauncher(), runs, progress=False)
    found = launch_runs(LocalLauncher(), runs, progress=False, keep_failures=True)
    assert found[0] == {"failure": "no longer finite", "out": str(tmp_path / "0")}
    assert found[1]["eval"] == {"low": 0.5}


def test_a_grid_has_every_combination() -> None:
    points = list_points(["true.restitution=[0.5,0.7]", "expert.tracker=['lqr','mpc']"])
    assert points[1] == (("true.restitution", 0.5), ("expert.tracker", "mpc"))
    assert len(points) == 4
    assert list_points([]) == [()]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--grid", "a=1"], "--grid a=1: expected KEY="),
        (["--grid", "a=[]"], "expected KEY="),
        (["--grid", "a=[1]", "a=[2]"], "--grid a: is given twice"),
        (["--learn", "tune"], "--learn needs --out"),
        (["--learn", "train", "--out", "x", "--grid", "learn.stepz=[1]"], "learn.stepz: the training script has no"),
        (["--learn", "train", "--out", "x", "--grid", "learn.seed=[1]"], "learn.seed: the training script has no"),
        (
            ["--learn", "train", "--out", "x", "--grid", "learn.steps=['a']"],
            "learn.steps=a: Input should be a valid integer",
        ),
        (["--grid", "true.restitutoin=[0.5]"], "restitutoin"),
    ],
)
def test_a_sweep_that_makes_no_sense_is_one_line(
    arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["sweep", "throw_and_catch", *arguments]) == 2
    line = capsys.readouterr().err
    assert said in line
    assert line.count("\n") == 1


def test_without_optuna_one_line_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "optuna", None)
    monkeypatch.delitem(sys.modules, "train.search.proposal", raising=False)
    arguments = ["sweep", "throw_and_catch", "--sample", "true.restitution=0.3,0.9", "--out", str(tmp_path / "out")]
    assert main(arguments) == 2
    said = "impact: optuna is not installed: pip install 'impact-envs[plan,report,sweep]'\n"
    assert capsys.readouterr().err == said
    assert not (tmp_path / "out").exists()


def test_a_sweep_trains_each_point_in_its_folder(calls: list[Args], tmp_path: Path) -> None:
    calls.append(ARGS)
    grid = ("true.restitution=[0.5,0.7]", "learn.hidden=[[8],[8,8]]", "learn.learning_rate=[1]")
    command = Command(
        ("throw_and_catch",), ("hard",), grid, learn="train", seeds=(0, 1), set=("learn.steps=1",), out=str(tmp_path)
    )
    rows = command.run()["runs"]
    assert len(rows) == len({row["out"] for row in rows}) == 8
    last = calls[-1]
    assert (last.set, last.hidden, last.learning_rate) == (("true.restitution=0.7",), (8, 8), 1)
    assert (last.seed, last.steps, last.suite) == (1, 1, ("hard",))


def test_points_of_a_sweep_are_suites_of_one_evaluation(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["throw_and_catch", "--policies", "zero", "--episodes", "2", "--suite", "hard", "--json"]
    grid = ["--grid", "objects.pop.mass=[1.0,2.0]"]
    assert main(["sweep", *arguments, *grid, "--out", str(tmp_path)]) == 0
    rows = json.loads(capsys.readouterr().out)["rows"]
    assert [row["suite"] for row in rows] == ["hard, objects.pop.mass=1.0", "hard, objects.pop.mass=2.0"]
    manifest = json.loads((tmp_path / "manifest.json").read_text())
    assert manifest["set"] == {}
    assert manifest["cases"][1]["changes"]["objects.pop.mass"] == 2.0
    assert len(manifest["cases"][1]["changes"]) > 1

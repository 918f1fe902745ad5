"""`impact sweep --sample`: the same trials for any number of workers and after any end; never on evaluation seeds."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

import train.evaluation.evaluate
import train.residual
from planners.errors import Infeasible
from planners.plan import Plan
from tests.frozen.freeze import PLANS
from tests.train.processes import count_rows, start, wait_until
from train.cli.main import main
from train.cli.sweep import Command
from train.errors import Diverged
from train.evaluation.case import REPORT_SEEDS, TUNING_SEEDS
from train.launch.choice import Launch
from train.search.search import Sampling

pytestmark = pytest.mark.skipif(find_spec("optuna") is None, reason="the extra [sweep] is not installed")

FILES = ("search.json", "trials.csv", "rows.parquet")
SAMPLING = Sampling(("expert.tracker=['lqr','mpc']", "true.restitution=0.3,0.9"), trials=6, together=2)
COMMAND = Command(
    ("throw_and_catch",), ("hard",), policies=("expert",), episodes=25, sampling=SAMPLING, set=("true.drift=0.0",)
)
CODE = """
import sys
from dataclasses import replace
from tests.train.search.test_sweep import COMMAND

if __name__ == "__main__":
    replace(COMMAND, out=sys.argv[1]).run()
"""


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """A search that nobody ended, and its result."""
    out = tmp_path_factory.mktemp("whole")
    return out, replace(COMMAND, out=str(out)).run()


def test_a_search_tells_its_trials_and_the_best_on_other_seeds(whole: tuple[Path, dict[str, Any]]) -> None:
    out, found = whole
    assert len(found["trials"]) == 6
    best = max(found["trials"], key=lambda trial: trial["score"])
    assert (found["best"], found["score"]) == ({key: best[key] for key in found["best"]}, best["score"])
    assert found["maximised"] == "robustness_mean"
    plain, chosen = found["report"]
    assert plain["suite"] == "hard"
    assert f"true.restitution={found['best']['true.restitution']}" in chosen["suite"]
    manifest = json.loads((out / "manifest.json").read_text())
    assert (manifest["seed"], manifest["set"]) == (TUNING_SEEDS, {"true.drift": 0.0})
    assert len(manifest["cases"]) == len({json.dumps(trial) for trial in found["trials"]})
    assert json.loads((out / "report" / "manifest.json").read_text())["seed"] == REPORT_SEEDS


def test_two_workers_and_a_uri_come_to_the_same_trials(whole: tuple[Path, dict[str, Any]], tmp_path: Path) -> None:
    again = replace(COMMAND, out=tmp_path.as_uri(), launch=Launch(workers=2)).run()
    assert {**again, "out": None} == {**whole[1], "out": None}
    for name in FILES:
        assert (tmp_path / name).read_bytes() == (whole[0] / name).read_bytes()


@pytest.mark.skipif(sys.platform != "linux", reason="sends signals")
def test_a_search_that_was_killed_goes_on_to_the_same_trials(
    whole: tuple[Path, dict[str, Any]], tmp_path: Path
) -> None:
    script, out = tmp_path / "script.py", tmp_path / "out"
    script.write_text(CODE)
    run = start(script, out)
    try:
        assert wait_until(lambda: count_rows(out) > 50, 240), run.poll()  # in the second round
    finally:
        run.kill()
        run.communicate()
    assert not (out / "report").exists()
    assert replace(COMMAND, out=str(out)).run() == whole[1]
    for name in FILES:
        assert (out / name).read_bytes() == (whole[0] / name).read_bytes()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--sample", "true.restitution=0.1"], "expected KEY=LOW,HIGH"),
        (["--sample", "true.restitution=0.1,0.2"], "--sample needs --out"),
        (["--trials", "3"], "--trials 3: needs --sample"),
        (
            ["--sample", "true.restitution=0.1,0.2", "--grid", "true.drift=[0.0]"],
            "--sample takes KEY=[VALUE, ...], too",
        ),
        (["--sample", "true.restitutoin=0.1,0.2", "--out", "x"], "did you mean 'restitution'?"),
        (["--sample", "expert.nothing=0.1,0.2", "--out", "x"], "expert.nothing is unknown"),
        (["--sample", "true.drift=0.0,0.1", "--out", "x", "--seed", "2000000"], "never on those that judge"),
        (["--sample", "true.drift=0.0,0.1", "--out", "x", "--seed", "1499900"], "1000000 to 1499999"),
        (["--sample", "true.drift=0.0,0.1", "--out", "x", "--maximise", "low"], "--maximise low: is unknown"),
        (["--sample", "true.drift=0.0,0.1", "--out", "x", "--policies", "random"], "sweep: add --single"),
        (
            ["--sample", "expert.tracker=['lqr','x','mpc']", "--out", "x", "--policies", "expert"],
            "expert.tracker 'x' is unknown; choices: mpc, lqr",
        ),
        (
            ["--learn", "tune", "--sample", "expert.tracker=['lqr','x','mpc']", "--out", "x"],
            "expert.tracker 'x' is unknown",
        ),
        (
            ["--learn", "tune", "--sample", "learn.spread=0.1,0.2", "--seeds", "3", "3", "--out", "x"],
            "a seed, scenario, suite or value is given twice",
        ),
        (["--learn", "train", "--sample", "learn.worst=0.5,2.0", "--out", "x", "--maximise", "x"], "--maximise x: is"),
        (["--learn", "train", "--sample", "learn.learning_rate=0.1,9.0", "--out", "x"], "learning_rate 9: choices"),
        (
            ["--learn", "train", "--sample", "learn.worst=0.5,2.0", "--set", "learn.eval_every=0", "--out", "x"],
            "needs evaluations on tuning seeds",
        ),
    ],
)
def test_a_search_that_makes_no_sense_is_one_line_and_leaves_nothing(
    arguments: list[str],
    said: str,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["sweep", "throw_and_catch", *arguments]) == 2
    line = capsys.readouterr().err
    assert said in line
    assert line.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_a_point_whose_expert_has_no_plan_is_a_trial_that_failed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    most = 0.5

    def plan(scenario: Any, objective: str) -> Plan:
        if scenario.believed.restitution > most:
            raise Infeasible("the plan", "infeasible", "none")
        return Plan.load(PLANS / "throw_and_catch.json")

    monkeypatch.setattr(train.evaluation.evaluate, "make_plan", plan)
    arguments = ["sweep", "throw_and_catch", "--sample", "believed.restitution=0.2,0.9", "--trials", "6", "--json"]
    arguments += ["--episodes", "2", "--policies", "zero", "expert"]
    assert main([*arguments, "--out", str(tmp_path / "some")]) == 0
    found = json.loads(capsys.readouterr().out)
    above = [trial["believed.restitution"] > most for trial in found["trials"]]
    assert 0 < sum(above) < 6
    assert ["the plan" in (trial["failure"] or "") for trial in found["trials"]] == above
    assert found["best"]["believed.restitution"] <= most
    most = 0.0
    assert main([*arguments, "--out", str(tmp_path / "none")]) == 1
    assert "none of 6 trials has a score; the last one: the plan" in capsys.readouterr().err


def test_learning_is_searched_and_what_diverges_is_a_trial_that_failed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    made = list[float]()

    def learn(args: Any, saved: Any = None) -> dict[str, Any]:
        made.append(args.learning_rate)
        if args.learning_rate > 0.01:
            raise Diverged("training diverged")
        low = -abs(args.learning_rate - 1e-3) + (args.seed == 1) * 1.0
        return {"eval": {"low": low, "gain": low, "success_rate": 0.5}, "report": {"gain": 0.25}}

    monkeypatch.setattr(train.residual, "main", learn)
    arguments = ["sweep", "throw_and_catch", "--suite", "hard", "--learn", "train", "--seeds", "0", "1", "--json"]
    arguments += ["--sample", "learn.learning_rate=1e-5,1.0,log", "--trials", "12", "--out", str(tmp_path)]
    assert main(arguments) == 0
    found = json.loads(capsys.readouterr().out)
    diverged = [trial for trial in found["trials"] if trial["failure"]]
    assert diverged
    assert all(trial["learn.learning_rate"] > 0.01 and trial["score"] is None for trial in diverged)
    rate = found["best"]["learn.learning_rate"]
    assert found["score"] == pytest.approx(0.5 - abs(rate - 1e-3))
    assert [(run["seed"], run["gain"]) for run in found["runs"]] == [(0, 0.25), (1, 0.25)]
    calls = len(made)
    assert main(arguments) == 0
    assert json.loads(capsys.readouterr().out)["trials"] == found["trials"]
    assert len(made) == calls  # all is read

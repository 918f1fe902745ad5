"""`impact sweep`: what makes no sense is one line before anything is played; nothing is left out without a word."""

from __future__ import annotations

from pathlib import Path

import pytest

from train.cli.main import main


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--grid", "true.restitution=[0.5,0.5]"], "--grid true.restitution=[...]: 0.5 is given twice"),
        (["throw_and_catch", "--policies", "zero"], "scenario 'throw_and_catch' is given twice"),
        (["--suite", "hard", "hard"], "suite 'hard' is given twice"),
        (["--policies", "zero", "zero"], "policy 'zero' is given twice"),
        (["--learn", "tune", "--seeds", "3", "3"], "a seed, scenario, suite or value is given twice"),
        (["--grid", "expert.tracker=['lqr','lqq','mpc']"], "expert.tracker 'lqq' is unknown; did you mean 'lqr'?"),
        (["--grid", "expert.tracker=['lqr','casadi']"], "expert.tracker 'casadi' follows one world"),
        (["--grid", "expert.tracker=['lqr','lqq']", "--learn", "train"], "expert.tracker 'lqq' is unknown"),
        (["--grid", "learn.worlds=[64,12]", "--learn", "train"], "worlds 12 is not a multiple of group 8"),
        (["--seeds", "3", "4"], "--seeds 3 4: needs --learn, what is trained"),
        (["--learn", "train", "--policies", "zero", "expert"], "--policies zero expert: is for judging"),
        (["--learn", "tune", "--episodes", "3"], "--episodes 3: is for judging"),
        (["--learn", "tune", "--seed", "3"], "--seed 3: is for judging"),
        (["--learn", "train", "--single"], "--single: is for judging"),
        (["--learn", "trian"], "'trian' for argument '--learn'. Expected one of ('train', 'tune')."),
        (["--plan", "pong=plan.json"], "scenario 'pong' is not asked for; choices: throw_and_catch"),
    ],
)
def test_what_makes_no_sense_is_one_line_and_leaves_nothing(
    arguments: list[str],
    said: str,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["sweep", "throw_and_catch", *arguments, "--out", "x"]) == 2
    line = capsys.readouterr().err
    assert said in line
    assert line.count("\n") == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("command", ["sweep", "evaluate"])
def test_rows_of_other_calls_are_kept_and_counted(
    command: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    def call(*changed: str) -> tuple[str, int]:
        arguments = [command, "throw_and_catch", "--policies", "zero", "--episodes", "2", "--out", str(tmp_path)]
        assert main([*arguments, *changed]) == 0
        return capsys.readouterr().err, len((tmp_path / "rows.jsonl").read_text().splitlines())

    said, rows = call()
    assert "keeps" not in said
    assert rows == 2
    said, rows = call("--suite", "hard")
    assert f"{tmp_path}: keeps 2 rows that were not asked for now; they are not in its tables\n" in said
    assert rows == 4
    said, rows = call("--suite", "nominal", "hard")
    assert "keeps" not in said
    assert "evaluating" not in said  # nothing was left to play
    assert rows == 4

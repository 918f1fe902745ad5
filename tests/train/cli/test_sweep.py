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

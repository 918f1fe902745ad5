"""Processes killed at random moments: nothing outlives five seconds, no row is lost, doubled or changed.

``python -m tests.train.test_random_kills`` prints the table of the kills.
"""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from agents.actor import load_policy
from agents.training_state import read_training
from tests.train.processes import count_rows, find_children, is_alive, list_children, start, wait_until
from train.residual import last_checkpoint

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform != "linux", reason="reads /proc and sends signals"),
]

SEED = 21
PATIENCE = 300.0  # for one run on a busy machine [s]
OUTLIVE = 5.0  # longest life of what a killed process leaves behind [s]
EVALUATED, PLANNED = 300, 6
EVALUATE = (
    "import sys; from train.evaluation.evaluate import evaluate\n"
    "if __name__ == '__main__':\n"
    f"    evaluate(['throw_and_catch'], ['zero'], {EVALUATED}, workers=2, out=sys.argv[1], progress=False)\n"
)
# Every episode asks for a new plan; no plan depends on how busy the machine is.
PLAN = f"""
import sys
from dataclasses import replace
from planners.free_flyer.expert import FreeFlyerExpert
from tests.frozen.freeze import get_plan
from train.evaluation.case import make_cases
from train.evaluation.evaluate import evaluate_cases
reset = FreeFlyerExpert.reset
def want(self, seed=None):
    reset(self, seed)
    self.memory.wanted[0] = 3.0
FreeFlyerExpert.reset = want
cases = make_cases(['throw_and_catch'], ['restitution'], {{'expert.background.patience': 300.0}})
cases = [replace(case, plan=get_plan('throw_and_catch', 'nominal')) for case in cases]
evaluate_cases(cases, ['expert'], {PLANNED}, out=sys.argv[1], progress=False)
"""
ITERATIONS = 8
# An episode asks for two corrections, so an iteration answers 128 of them, or a few more.
TRAIN = (
    "-m train.cli.main train throw_and_catch --suite all --worlds 64 --group 4 --hidden 8 --batch 32 --threads 2 "
    f"--steps {128 * ITERATIONS - 64} --eval-every 2 --eval-episodes 40 --report-episodes 0 --no-progress --no-log"
).split()


@dataclass(frozen=True)
class Kill:
    """What was killed, when, and what became of it.

    Attributes:
        what: command and process.
        moment: after its start, or after its first sign of life in the run [s].
        before, after: rows or steps on disk when it was killed, and after everything of it had ended.
        outlived: until the last process had ended [s].
        code: of the command.
    """

    what: str
    moment: float
    before: int
    after: int
    outlived: float
    code: int | None

    def __str__(self) -> str:
        numbers = f"{self.moment:.2f} | {self.before} | {self.after} | {self.outlived:.2f} | {self.code}"
        return f"| {self.what} | {numbers} |"


class Chaos:
    """Kill the processes of a command again and again, and go on with what they left.

    Args:
        folder: for scripts and results.
        rng: decides on the moments.
        tell: called with every kill.
    """

    def __init__(self, folder: Path, rng: random.Random, tell: Callable[[Kill], None] = lambda kill: None) -> None:
        self.folder, self._rng, self._tell = folder, rng, tell
        self.kills: list[Kill] = []

    def make_script(self, name: str, code: str) -> Path:
        """Write a script."""
        path = self.folder / f"{name}.py"
        path.write_text(code)
        return path

    def kill(
        self, what: str, arguments: tuple[Any, ...], count: Any, victim: bytes = b"", longest: float = 8.0
    ) -> None:
        """Start a command and kill it, or a process of its own that has a word in its command line.

        Args:
            what: to be called in the table.
            arguments: of Python.
            count: of what is on disk.
            victim: the word; empty: the command itself, at any moment from its start on or from its first new result.
            longest: last moment [s].

        Returns:
            Whether it was killed; it may have ended before.
        """
        began = count()
        run = start(*arguments)
        try:
            if victim:
                assert wait_until(lambda: find_children(run.pid, victim) or run.poll() is not None, PATIENCE)
            elif self._rng.random() < 0.6:
                wait_until(lambda: count() > began or run.poll() is not None, PATIENCE)
            moment = self._rng.uniform(0.0, longest)
            time.sleep(moment)
            family, before = [run.pid, *list_children(run.pid)], count()
            found = find_children(run.pid, victim) if victim else [run.pid]
            if not found or run.poll() is not None:
                return False
            os.kill(self._rng.choice(found), signal.SIGKILL)
            killed = time.monotonic()
            if victim:  # the command itself goes on, without it
                _, said = run.communicate(timeout=PATIENCE)
                assert run.returncode == 0, said
                killed = time.monotonic()
            assert wait_until(lambda: not any(map(is_alive, family)), OUTLIVE), what
            outlived = time.monotonic() - killed
        finally:
            run.kill()
            run.communicate()
        assert count() >= before >= began
        self.kills.append(Kill(what, moment, before, count(), outlived, run.returncode))
        self._tell(self.kills[-1])
        return True


def read_rows(out: Path) -> list[dict[str, Any]]:
    """Return all episodes of a journal, without measured times."""
    rows = [json.loads(line) for line in (out / "rows.jsonl").read_text().splitlines()]
    timed = ("solve_ms", "wall_seconds")
    return sorted(
        ({key: value for key, value in row.items() if not key.startswith(timed)} for row in rows),
        key=lambda row: row["seed"],
    )


def finish(*arguments: Any) -> None:
    """Run a command to its end."""
    run = start(*arguments)
    _, said = run.communicate(timeout=PATIENCE)
    assert run.returncode == 0, said


def kill_evaluations(chaos: Chaos, parents: int, workers: int) -> None:
    """Kill evaluations, and workers of evaluations, into one folder until it is finished."""
    script, whole, out = chaos.make_script("evaluate", EVALUATE), chaos.folder / "whole", chaos.folder / "out"
    finish(script, whole)
    for what, victim, wanted in (("evaluate: parent", b"", parents), ("evaluate: worker", b"spawn_main", workers)):
        goal = len(chaos.kills) + wanted
        while len(chaos.kills) < goal:
            if victim or count_rows(out) == EVALUATED:
                shutil.rmtree(out, ignore_errors=True)
            if chaos.kill(what, (script, out), lambda: count_rows(out), victim, longest=2.0) and victim:
                assert read_rows(out) == read_rows(whole)
        finish(script, out)
        assert read_rows(out) == read_rows(whole)


def kill_planning(chaos: Chaos, parents: int, planners: int) -> None:
    """Kill evaluations that plan in the background, and their planners."""
    script, whole, out = chaos.make_script("plan", PLAN), chaos.folder / "planned", chaos.folder / "replanned"
    finish(script, whole)
    wanted = read_rows(whole)
    goal = len(chaos.kills) + parents
    while len(chaos.kills) < goal:
        if count_rows(out) == PLANNED:
            shutil.rmtree(out)
        chaos.kill("background planning: parent", (script, out), lambda: count_rows(out))
    finish(script, out)
    assert read_rows(out) == wanted
    goal = len(chaos.kills) + planners
    while len(chaos.kills) < goal:
        shutil.rmtree(out)
        if not chaos.kill("background planning: planner", (script, out), lambda: count_rows(out), b"planning_process"):
            continue
        assert read_rows(out) == wanted  # what a dead planner was asked is asked again


def read_weights(out: Path) -> dict[str, bytes]:
    """Return the tensors that a training left, by their place."""
    return {str(path.relative_to(out)): path.read_bytes() for path in sorted(out.rglob("*.safetensors"))}


def kill_trainings(chaos: Chaos, parents: int) -> None:
    """Kill trainings, and go on with them to the end: they learn what one learns that nobody kills."""
    whole, out = chaos.folder / "learned", chaos.folder / "train"
    finish(*TRAIN, "--out", whole)
    wanted, evaluations = read_weights(whole), read_training(last_checkpoint(whole) or whole).evaluations
    last = int(str(last_checkpoint(whole)).rpartition("/")[2])

    def count() -> int:
        checkpoint = last_checkpoint(out)
        return int(checkpoint.name) if checkpoint else 0

    def make_arguments() -> tuple[Any, ...]:
        return (*TRAIN, "--out", out, *(("--resume",) if last_checkpoint(out) else ()))

    def check_whole() -> None:
        assert read_weights(out) == wanted
        assert read_training(last_checkpoint(out) or out).evaluations == evaluations
        assert not list((out / "checkpoints").glob(".*"))

    goal = len(chaos.kills) + parents
    while len(chaos.kills) < goal:
        if count() == last:
            check_whole()
            shutil.rmtree(out)
        chaos.kill("train: parent", make_arguments(), count, longest=2.0)
        checkpoint = last_checkpoint(out)
        if checkpoint:  # whole, and of its iteration
            assert load_policy(checkpoint)[1].steps == read_training(checkpoint).steps
            assert read_training(checkpoint).iterations == int(checkpoint.name)
    if count() < last:
        finish(*make_arguments())
    check_whole()


def kill_all(chaos: Chaos) -> None:
    """Kill twenty-six times."""
    kill_evaluations(chaos, 6, 4)
    kill_planning(chaos, 3, 3)
    kill_trainings(chaos, 10)


@pytest.mark.parametrize(
    ("kill", "numbers"), [(kill_evaluations, (6, 4)), (kill_planning, (3, 3)), (kill_trainings, (10,))]
)
def test_kills_at_random_moments(tmp_path: Path, kill: Callable[..., None], numbers: tuple[int, ...]) -> None:
    chaos = Chaos(tmp_path, random.Random(SEED))
    kill(chaos, *numbers)
    assert len(chaos.kills) == sum(numbers)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as name:
        kill_all(Chaos(Path(name), random.Random(SEED), lambda kill: print(kill, flush=True)))

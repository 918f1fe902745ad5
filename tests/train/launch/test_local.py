"""Evaluations in processes of this machine: small ones start none; whatever is killed, the same rows."""

from __future__ import annotations

import json
import os
import signal
import sys
from functools import partial
from multiprocessing import spawn
from pathlib import Path

import pytest

from tests.train.processes import (
    count_rows,
    find_children,
    is_alive,
    list_children,
    start,
    wait_until,
)
from train.evaluation.case import TUNING_SEEDS, make_case
from train.evaluation.evaluate import evaluate_cases
from train.evaluation.shard import ShardSizes
from train.launch import local
from train.launch.local import LocalLauncher
from train.launch.workers import _hide_main

EPISODES, SIZE = 300, 10  # of each policy; seeds of a shard
POLICIES = ("zero", "expert")
# Without a guard: workers must not run it.
CODE = f"""
import sys
from train.evaluation.case import make_case
from train.evaluation.evaluate import evaluate_cases
from train.evaluation.shard import ShardSizes
from train.launch.local import LocalLauncher

evaluate_cases(
    [make_case("throw_and_catch", "hard")], {POLICIES}, {EPISODES}, {TUNING_SEEDS}, out=sys.argv[1], progress=False,
    batched=True, launcher=LocalLauncher(2, with_main=False), sizes=ShardSizes(batched={SIZE}),
)
"""


def start_squaring(moments: list[int]) -> object:
    moments.append(os.getpid())
    return lambda task: [task * task]


def test_what_is_done_soon_is_done_here(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(local, "work", None)
    starts: list[int] = []
    launcher = LocalLauncher(2, patience=60.0)
    assert list(launcher.run(partial(start_squaring, starts), range(5))) == [0, 1, 4, 9, 16]  # type: ignore[arg-type]
    assert list(LocalLauncher(2).run(partial(start_squaring, starts), [7])) == [49]  # type: ignore[arg-type]
    assert starts == [os.getpid()] * 2


def test_what_is_left_goes_to_others_when_patience_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    now, sent = [0.0], []

    def work(start: object, tasks: object, workers: int, with_main: bool) -> list[list[str]]:
        sent.append((tasks, workers, with_main))
        return [["sent"]]

    monkeypatch.setattr(local, "work", work)
    monkeypatch.setattr(local.time, "monotonic", lambda: now[0])

    def start_waiting() -> object:
        def wait(task: int) -> list[int]:
            now[0] += 2.0
            return [task]

        return wait

    run = LocalLauncher(3, patience=3.0, with_main=False).run(start_waiting, range(6))  # type: ignore[arg-type]
    assert list(run) == [0, 1, "sent"]
    assert sent == [(range(2, 6), 3, False)]


def test_workers_import_no_script_that_nothing_is_sent_from() -> None:
    main = sys.modules["__main__"]
    with _hide_main():
        asked = spawn.get_preparation_data("worker")
    assert not [name for name in asked if name.startswith("init_main")]
    assert sys.modules["__main__"] is main


@pytest.mark.parametrize(
    ("episodes", "workers", "size"), [(24_000, 1, None), (24_000, 2, 100), (100, 2, 13), (20, 2, 10), (4_000, 64, 16)]
)
def test_few_episodes_are_cut_so_that_all_workers_have_some(episodes: int, workers: int, size: int | None) -> None:
    assert ShardSizes().share(episodes, workers) == size


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc and sends signals")
def test_a_worker_and_the_command_are_killed_and_the_table_has_the_same_bytes(tmp_path: Path) -> None:
    case, out, script = make_case("throw_and_catch", "hard"), tmp_path / "out", tmp_path / "script.py"
    whole = tmp_path / "whole"
    evaluate_cases([case], POLICIES, EPISODES, TUNING_SEEDS, out=whole, progress=False, batched=True)
    script.write_text(CODE)
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
        before = count_rows(out)
        run = start(script, out)
        try:
            assert wait_until(lambda before=before: count_rows(out) > before, 240), run.poll()
            children = list_children(run.pid)
            assert len(children) >= 3  # two workers and multiprocessing's tracker
            for pid in (run.pid, *children) if number == signal.SIGINT else (run.pid,):  # as a terminal sends it
                os.kill(pid, number)
            assert wait_until(lambda children=children: not any(map(is_alive, children)), 5)
            _, said = run.communicate(timeout=5)
        finally:
            run.kill()
        assert run.returncode == (143 if number == signal.SIGTERM else -number)
        assert said.count(b"Traceback") == (number == signal.SIGINT)  # the command's own
        assert before < count_rows(out) < len(POLICIES) * EPISODES
    run = start(script, out)
    try:
        began = count_rows(out)
        assert wait_until(lambda: count_rows(out) > began, 240), run.poll()
        os.kill(find_children(run.pid, b"spawn_main")[0], signal.SIGKILL)
        _, said = run.communicate(timeout=240)
    finally:
        run.kill()
    assert (run.returncode, said) == (0, b"")
    rows = [json.loads(line) for line in (out / "rows.jsonl").read_text().splitlines()]
    keys = [(row["policy"], row["seed"]) for row in rows]
    assert len(keys) == len(set(keys)) == len(POLICIES) * EPISODES
    assert (out / "rows.parquet").read_bytes() == (whole / "rows.parquet").read_bytes()

"""Evaluations that are killed, ended or started twice: nothing is lost, nothing is played twice, nobody stays."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from impact_envs import InputError
from tests.train.processes import (
    ROOT,
    count_rows,
    find_children,
    is_alive,
    list_children,
    start,
    start_dying,
    wait_until,
)
from train.errors import WorkerLost
from train.evaluation.evaluate import evaluate
from train.evaluation.folder_lock import lock_folder
from train.launch.workers import work

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="reads /proc and sends signals")

EPISODES = 40
CODE = (
    "import sys; from train.evaluation.evaluate import evaluate\n"
    "if __name__ == '__main__':\n"
    f"    evaluate(['throw_and_catch'], ['zero'], {EPISODES}, workers=2, out=sys.argv[1], progress=False)\n"
)

# LLVM asks Python twice for each function that it compiles: for stored code, and to store the new code. An exception
# that is raised there is dropped.
COMPILING = """
import os, signal, sys
import llvmlite.binding as llvm
import numba
from train.launch.ending import end_on_sigterm
from train.watch import exit_codes

signal.signal(signal.SIGINT, signal.default_int_handler)  # what a shell starts in the background ignores it
find, calls = llvm.ExecutionEngine._find_module_ptr, []

def find_and_end(engine, pointer):
    calls.append(pointer)
    if len(calls) == int(sys.argv[1]):
        os.kill(os.getpid(), int(sys.argv[2]))
    return find(engine, pointer)

@numba.njit
def double(number):
    return 2 * number

with exit_codes(), end_on_sigterm():
    llvm.ExecutionEngine._find_module_ptr = find_and_end
    try:
        double(1)
        while True:
            pass
    finally:
        print("tidied up")
"""


@pytest.fixture
def script(tmp_path: Path) -> Path:
    path = tmp_path / "script.py"
    path.write_text(CODE)
    return path


def read_rows(out: Path) -> list[dict[str, Any]]:
    rows = [json.loads(line) for line in (out / "rows.jsonl").read_text().splitlines()]
    timed = ("solve_ms", "wall_seconds")
    return sorted(
        ({key: value for key, value in row.items() if not key.startswith(timed)} for row in rows),
        key=lambda row: row["seed"],
    )


@pytest.mark.slow
def test_no_kill_loses_doubles_or_changes_a_row(script: Path, tmp_path: Path) -> None:
    evaluate(["throw_and_catch"], ["zero"], EPISODES, out=tmp_path / "whole", progress=False)
    out = tmp_path / "out"
    for number, wanted, code in ((signal.SIGKILL, 5, -9), (signal.SIGTERM, 15, 143)):
        run = start(script, out)
        try:
            assert wait_until(lambda wanted=wanted: count_rows(out) >= wanted, 120)
            children = list_children(run.pid)
            assert len(children) >= 3  # two workers and multiprocessing's tracker
            run.send_signal(number)
            assert wait_until(lambda children=children: not any(map(is_alive, children)), 5)
            assert run.wait(5) == code
        finally:
            run.kill()
            run.communicate()
        assert count_rows(out) < EPISODES
    run = start(script, out)
    try:
        assert wait_until(lambda: count_rows(out) >= 22, 120)
        os.kill(find_children(run.pid, b"spawn_main")[0], signal.SIGKILL)
        _, said = run.communicate(timeout=120)
    finally:
        run.kill()
    assert run.returncode == 0, said
    assert read_rows(out) == read_rows(tmp_path / "whole")


@pytest.mark.parametrize("call", [1, 2])
@pytest.mark.parametrize(
    ("number", "code", "says"),
    [(signal.SIGTERM, 143, ""), (signal.SIGINT, 130, "interrupted; what was finished is kept\n")],
    ids=["SIGTERM", "SIGINT"],
)
def test_a_signal_while_llvm_calls_python_ends_the_process_without_a_trace(
    call: int, number: int, code: int, says: str
) -> None:
    run = subprocess.run(
        [sys.executable, "-c", COMPILING, str(call), str(int(number))],
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert (run.returncode, run.stdout, run.stderr) == (code, "tidied up\n", says)


def test_a_job_is_done_again_when_its_worker_dies(tmp_path: Path) -> None:
    assert sorted(work(partial(start_dying, 3, tmp_path), range(6), 2)) == [0, 1, 4, 9, 16, 25]


def test_a_job_that_kills_its_workers_is_named(tmp_path: Path) -> None:
    with pytest.raises(WorkerLost, match="2 worker processes ended during 2 ") as caught:
        list(work(partial(start_dying, 2, tmp_path), range(6), 2))
    assert "\n" not in str(caught.value)


@pytest.fixture
def held(tmp_path: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Another process that writes into a folder."""
    code = (
        "import sys; from train.evaluation.folder_lock import lock_folder\n"
        "with lock_folder(sys.argv[1]):\n    print('held', flush=True); sys.stdin.read()\n"
    )
    run = subprocess.Popen(
        [sys.executable, "-c", code, str(tmp_path / "out")],
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    assert run.stdout is not None and run.stdout.readline() == b"held\n"
    yield run
    run.kill()
    run.communicate()


def test_the_second_writer_is_refused_until_the_first_has_ended(tmp_path: Path, held: subprocess.Popen[bytes]) -> None:
    out = tmp_path / "out"
    with pytest.raises(InputError, match=rf"another evaluation or training \(process {held.pid}\) writes here"):
        evaluate(["throw_and_catch"], ["zero"], 1, out=out, progress=False)
    assert [file.name for file in out.iterdir()] == [".lock"]
    held.kill()
    held.wait()
    with lock_folder(out), pytest.raises(InputError, match="another evaluation"), lock_folder(out):
        pass
    with lock_folder(out):
        pass

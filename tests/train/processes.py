"""Processes that tests start and end, and what descends from them; Linux only."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]


def start(*arguments: str | Path) -> subprocess.Popen[bytes]:
    """Start Python with some arguments."""
    environment = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    command = [sys.executable, *map(str, arguments)]
    return subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)


def wait_until(done: Any, seconds: float) -> bool:
    """Return whether something is so before the time is over."""
    deadline = time.monotonic() + seconds
    while not done() and time.monotonic() < deadline:
        time.sleep(0.02)
    return bool(done())


def list_children(pid: int) -> list[int]:
    """Return all that descends from a process, and is no zombie."""
    parents = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            fields = (folder / "stat").read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if fields[0] != "Z":
            parents[int(folder.name)] = int(fields[1])
    found, new = list[int](), [pid]
    while new:
        new = [child for child, parent in parents.items() if parent in new]
        found += new
    return found


def find_children(pid: int, word: bytes) -> list[int]:
    """Return what descends from a process and has a word in its command line."""
    found = []
    for child in list_children(pid):
        try:
            command = Path(f"/proc/{child}/cmdline").read_bytes()
        except OSError:
            continue
        if word in command:
            found.append(child)
    return found


def is_alive(pid: int) -> bool:
    """Return whether a process is there and no zombie."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def count_rows(out: Path) -> int:
    """Return how many episodes of an evaluation are finished."""
    journal = out / "rows.jsonl"
    return journal.read_bytes().count(b"\n") if journal.exists() else 0


def die_at(fatal: int, folder: Path, job: int) -> int:
    """Die of a job; of an odd one only at the first time."""
    if job == fatal and not (folder / "died").exists():
        if fatal % 2:
            (folder / "died").touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return job * job


def start_dying(fatal: int, folder: Path) -> Any:
    """Return what does jobs and dies of one of them; here, where a worker imports little."""
    return partial(die_at, fatal, folder)

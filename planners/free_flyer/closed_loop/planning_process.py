"""Processes that plan what is left of tasks, beside the loop that asks: this module, run as a program, is one of them.

An answer is a function of its question alone: the work of planning is limited, not its time. So which process answers,
and when, changes nothing; a question whose process came to grief is asked again.
"""

from __future__ import annotations

import contextlib
import json
import os
import queue
import subprocess
import sys
import threading
import weakref
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TextIO, cast

from impact_envs.errors import InputError
from impact_envs.free_flyer.schema import FreeFlyerScenario
from planners.budget import Work
from planners.errors import OutOfWork, PlanningError
from planners.free_flyer.nominal.remaining import plan_rest

# Not `python -m`: a folder `planners` in the user's working folder would be taken for ours.
_PROGRAM = f"""
import runpy, sys
sys.path.insert(0, {str(Path(__file__).resolve().parents[3])!r})
runpy.run_module({__name__!r}, run_name="__main__")
"""
ATTEMPTS = 2  # processes that a question may bring to grief


@dataclass(eq=False)
class _Worker:
    """Hold a process, its answers, what ends it, and the numbers it was asked and has not answered."""

    process: subprocess.Popen[str]
    lines: queue.SimpleQueue[str]
    end: weakref.finalize[..., Any]
    asked: list[int] = field(default_factory=list)


class PlanningProcesses:
    """Ask questions of processes that plan, and wait for the answers.

    Processes are started as they are needed. They end with their owner: at the end of the program, when the owner is
    forgotten, and within moments of the owner's violent death. A copy, and what a fork leaves in the child, asks
    processes of its own what is not answered yet.

    Args:
        most: processes at a time; 0: one per core.
        patience: wall time without an answer after which a process is given up [s].
    """

    _workers: list[_Worker]
    _owner: int

    def __init__(self, most: int, patience: float) -> None:
        self._most, self._patience = most or count_cores(), patience
        self._questions: dict[int, str] = {}
        self._griefs: dict[int, int] = {}
        self._answers: dict[int, dict[str, Any]] = {}
        self._disown()

    @property
    def pids(self) -> list[int]:
        """Return the numbers of the processes."""
        return [worker.process.pid for worker in self._workers]

    def ask(self, number: int, question: str) -> None:
        """Ask a question.

        Args:
            number: of the question, unlike all others.
            question: a line of JSON, see `answer_requests`.
        """
        self._questions[number] = question
        self._ask_all()

    def wait_for(self, number: int) -> dict[str, Any]:
        """Return the answer to a question, see `answer_requests`; ``lost_plan`` where process after process failed."""
        while number not in self._answers:
            self._ask_all()
            self._read_answer(next(worker for worker in self._workers if number in worker.asked))
        return self._answers.pop(number)

    def forget(self, number: int) -> None:
        """Give up a question; its answer will be thrown away."""
        for table in (self._questions, self._griefs, self._answers):
            table.pop(number, None)

    def close(self) -> None:
        """End the processes; the next question starts new ones."""
        if self._owner == os.getpid():
            for worker in self._workers:
                worker.end()
        self._workers = []

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name not in ("_workers", "_owner")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._disown()

    def _disown(self) -> None:
        """Begin without a process."""
        self._owner, self._workers = os.getpid(), []

    def _ask_all(self) -> None:
        """Ask what no process was asked yet, in order."""
        if self._owner != os.getpid():  # forked: the processes belong to the parent
            self._disown()
        asked = {number for worker in self._workers for number in worker.asked}
        for number, question in self._questions.items():
            if number not in asked:
                worker = self._choose_worker()
                worker.asked.append(number)
                with contextlib.suppress(OSError, ValueError):  # no process any more: reading will tell
                    stdin = cast(TextIO, worker.process.stdin)
                    stdin.write(question)
                    stdin.flush()

    def _choose_worker(self) -> _Worker:
        """Return the process with least to do; start one if none is idle and there may be more."""
        least = min(self._workers, key=lambda worker: len(worker.asked), default=None)
        if least is not None and (not least.asked or len(self._workers) >= self._most):
            return least
        process = subprocess.Popen(
            [sys.executable, "-c", _PROGRAM], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        lines: queue.SimpleQueue[str] = queue.SimpleQueue()
        thread = threading.Thread(target=_forward, args=(process.stdout, lines), daemon=True)
        thread.start()
        end = weakref.finalize(self, _end_process, process, thread, self._owner)
        self._workers.append(_Worker(process, lines, end))
        return self._workers[-1]

    def _read_answer(self, worker: _Worker) -> None:
        """Take the next answer of a process; where there is none, blame the question it had to answer."""
        try:
            answer = json.loads(worker.lines.get(timeout=self._patience))
        except (queue.Empty, ValueError):  # too late; or the process ended, in the middle of a line maybe
            self._workers.remove(worker)
            worker.end()
            self._blame(worker.asked[0])
            return
        number = answer["number"]
        worker.asked.remove(number)
        if self._questions.pop(number, None) is not None:  # not given up meanwhile
            self._answers[number] = answer

    def _blame(self, number: int) -> None:
        self._griefs[number] = self._griefs.get(number, 0) + 1
        if self._griefs[number] >= ATTEMPTS and self._questions.pop(number, None) is not None:
            self._answers[number] = {"number": number, "plan": None, "failure": "lost_plan"}


def count_cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _end_process(process: subprocess.Popen[str], thread: threading.Thread, owner: int) -> None:
    """End a process, then the thread that reads from it, then close the pipes; a forked child leaves all alone."""
    if os.getpid() != owner:
        return
    process.kill()
    process.wait()
    if thread is not threading.current_thread():  # where the garbage collector may run as well
        thread.join()
    for pipe in (process.stdin, process.stdout):
        with contextlib.suppress(OSError, ValueError):
            cast(TextIO, pipe).close()


def _forward(answers: TextIO, lines: queue.SimpleQueue[str]) -> None:
    """Take a process's answers as they come, so that neither side waits for the other; an empty line is the end."""
    try:
        for line in answers:
            lines.put(line)
    except ValueError:  # closed
        pass
    lines.put("")


def answer_requests(requests: Iterable[str], answers: TextIO) -> None:
    """Plan what is asked for, line by line, until there is no more.

    Args:
        requests: lines {"number", "scenario", "impacts", "work", "nodes"} of JSON, see `plan_rest` and `Work`.
        answers: lines {"number", "plan", "failure"}: plan as JSON text or null; failure: ``no_plan``; ``late_plan``
            where the work did not suffice; null.
    """
    for line in requests:
        request, plan, failure = json.loads(line), None, None
        try:
            scenario = FreeFlyerScenario.model_validate(request["scenario"])
            plan = plan_rest(scenario, request["impacts"], Work(request["work"], request["nodes"])).to_json()
        except (PlanningError, InputError):
            failure = "no_plan"
        except OutOfWork:
            failure = "late_plan"
        answers.write(json.dumps({"number": request["number"], "plan": plan, "failure": failure}) + "\n")
        answers.flush()


def _read_requests() -> Iterator[str]:
    """Return the lines of standard input; when it ends, so does the process, even in the middle of planning."""
    lines: queue.SimpleQueue[str] = queue.SimpleQueue()

    def read() -> None:
        for line in sys.stdin:
            lines.put(line)
        os._exit(0)  # nobody is left to answer

    threading.Thread(target=read, daemon=True).start()
    return iter(lines.get, "")


if __name__ == "__main__":
    answer_requests(_read_requests(), sys.stdout)

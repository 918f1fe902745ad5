"""What the user is told while a command is at work: the planner's stage, and the files that were written."""

from __future__ import annotations

import math
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import Progress, ProgressColumn, SpinnerColumn, Task
from rich.text import Text

from planners.budget import Budget, Clock, use_clock, watch_planning

REPORT_PERIOD = 10.0  # between two lines about planning, where standard error is no terminal [s]


class _TimeLeft(ProgressColumn):
    """Show the time that a budget has left."""

    def render(self, task: Task) -> Text:
        """Return the text of the present moment."""
        budget: Budget = task.fields["budget"]
        return Text(f"{max(budget.left, 0.0):.0f} s left")


class _Stage(ProgressColumn):
    """Show the stage, and what planning has come to."""

    def render(self, task: Task) -> Text:
        """Return the text of the present moment."""
        come_to = str(task.fields["budget"].progress)
        return Text(f"planning: {task.description}{come_to and ', ' + come_to},")


class _Reporter:
    """Write a line about planning now and then, where nothing can be shown in place."""

    def __init__(self) -> None:
        self._stages: list[tuple[Budget, str]] = []
        self._about: Any = None  # whose plan is being made; its budgets tell of the same progress
        self._since = 0.0
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._report, daemon=True)

    def tell(self, budget: Budget, stage: str | None) -> None:
        """Take a stage that begins, or the end of the last one."""
        if stage is None:
            del self._stages[-1:]
            return
        if budget.progress is not self._about:
            self._about, self._since, self._stages = budget.progress, time.monotonic(), []
        self._stages.append((budget, stage))
        if not self._thread.is_alive() and not self._over.is_set():
            self._thread.start()

    def end(self) -> None:
        """Write nothing more."""
        self._over.set()

    def _report(self) -> None:
        while not self._over.wait(REPORT_PERIOD):
            stages = self._stages[-1:]
            # A plan that is made while an episode is flown takes no such time, or is told of by nobody.
            if stages and time.monotonic() - self._since >= REPORT_PERIOD and math.isfinite(stages[0][0].limit):
                budget, stage = stages[0]
                seconds, come_to = time.monotonic() - self._since, str(budget.progress)
                told = f"impact: planning for {seconds:.0f} s: {stage}{come_to and ', ' + come_to}"
                print(f"{told}, {max(budget.left, 0.0):.0f} s left", file=sys.stderr, flush=True)


@contextmanager
def show_planning() -> Iterator[None]:
    """Show stage, size, best, bound and time left of plans made inside: in place on a terminal, else line by line."""
    console = Console(stderr=True)
    if not console.is_terminal:
        reporter = _Reporter()
        try:
            with watch_planning(reporter.tell):
                yield
        finally:
            reporter.end()
        return
    shown: list[Any] = []

    def tell(budget: Budget, stage: str | None) -> None:
        while shown:  # a stage inside another one takes its place
            shown.pop().stop()
        if stage is None:
            return
        columns = (SpinnerColumn(), _Stage(), _TimeLeft())
        display = Progress(*columns, console=console, transient=True)
        display.add_task(stage, total=None, budget=budget)
        display.start()
        shown.append(display)

    try:
        with watch_planning(tell):
            yield
    finally:
        while shown:
            shown.pop().stop()


@contextmanager
def stop_on_interrupt() -> Iterator[Clock]:
    """Have the first Ctrl-C end planning inside with the best plan so far, and the second one end it at once.

    Returns:
        The clock of planning, which tells whether it was stopped.
    """
    clock, before = Clock(), signal.getsignal(signal.SIGINT)

    def stop(number: int, frame: Any) -> None:
        if clock.stopped:
            raise KeyboardInterrupt
        clock.stop()
        # What prints at this moment must not be entered again.
        os.write(2, b"impact: ending with the best plan so far; Ctrl-C again ends at once\n")

    # Jobs that a shell runs in the background ignore Ctrl-C.
    taken = before is signal.default_int_handler and threading.current_thread() is threading.main_thread()
    if taken:
        signal.signal(signal.SIGINT, stop)
    try:
        with use_clock(clock):
            yield clock
    finally:
        if taken:
            signal.signal(signal.SIGINT, before)


def say_kept(others: int, out: Path | str | None) -> None:
    """Say on standard error how many rows of an evaluation's folder its tables leave out, if any."""
    if others:
        kept = f"{out}: keeps {others} rows that were not asked for now; they are not in its tables"
        print(kept, file=sys.stderr, flush=True)


def say_written(*paths: Path | str | None) -> None:
    """Say on standard error which files were written; None stands for a file that was not wanted."""
    for path in paths:
        if path is not None:
            print(f"wrote {path}", file=sys.stderr, flush=True)

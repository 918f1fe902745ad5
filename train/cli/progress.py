"""What the user is told while a command is at work: the planner's stage, and the files that were written."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import Progress, ProgressColumn, SpinnerColumn, Task
from rich.text import Text

from planners.budget import Budget, Clock, use_clock, watch_planning


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


@contextmanager
def show_planning() -> Iterator[None]:
    """Show stage, size, best, bound and time left of plans that are made inside, on a terminal; elsewhere nothing."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield
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

"""What the user is told while a command is at work: the planner's stage, and the files that were written."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import Progress, ProgressColumn, SpinnerColumn, Task, TextColumn
from rich.text import Text

from planners.budget import Budget, watch_planning


class _TimeLeft(ProgressColumn):
    """Show the time that a budget has left."""

    def render(self, task: Task) -> Text:
        """Return the text of the present moment."""
        budget: Budget = task.fields["budget"]
        return Text(f"{max(budget.left, 0.0):.0f} s left")


@contextmanager
def show_planning() -> Iterator[None]:
    """Show stage, bound and time left of plans that are made inside, on a terminal; elsewhere nothing."""
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
        columns = (SpinnerColumn(), TextColumn("planning: {task.description},"), _TimeLeft())
        display = Progress(*columns, console=console, transient=True)
        display.add_task(f"{stage}{budget.news and ', ' + budget.news}", total=None, budget=budget)
        display.start()
        shown.append(display)

    try:
        with watch_planning(tell):
            yield
    finally:
        while shown:
            shown.pop().stop()


def say_written(*paths: Path | str | None) -> None:
    """Say on standard error which files were written; None stands for a file that was not wanted."""
    for path in paths:
        if path is not None:
            print(f"wrote {path}", file=sys.stderr, flush=True)

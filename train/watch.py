"""Show a training run's progress, and run a training script with the exit codes of every command."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

import tyro
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from impact_envs.errors import InputError
from planners.errors import PlanningError
from train.errors import Diverged
from train.launch.ending import keep_interrupts

A = TypeVar("A")


class Watch:
    """A bar and lines above it on standard error.

    Args:
        bar: of rich.
        task: of the bar.
    """

    def __init__(self, bar: Progress, task: Any) -> None:
        self._bar, self._task = bar, task

    def advance(self, steps: int) -> None:
        """Move the bar to a number of corrections answered."""
        self._bar.update(self._task, completed=steps)

    def say(self, line: str) -> None:
        """Write a line above the bar."""
        if not self._bar.disable:
            self._bar.console.print(line, highlight=False, soft_wrap=True)


@contextmanager
def show_progress(total: int, shown: bool, title: str = "training") -> Iterator[Watch]:
    """Show a bar on standard error.

    Args:
        total: corrections, or what else is counted, in the whole run.
        shown: whether anything is shown at all.
        title: of the bar.
    """
    columns = (TextColumn(title), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), disable=not shown) as bar:
        yield Watch(bar, bar.add_task("", total=total))


@contextmanager
def exit_codes() -> Iterator[None]:
    """End the program as `impact` does where what is done within fails.

    One line, and code 2 for bad input, 1 without a plan or for a training that diverged, 130 for Ctrl-C.
    """
    try:
        with keep_interrupts():
            yield
    except InputError as error:
        print(error, file=sys.stderr)
        sys.exit(2)
    except (PlanningError, Diverged) as error:
        print(error, file=sys.stderr)
        sys.exit(1)
    except KeyboardInterrupt:
        print("interrupted; what was finished is kept", file=sys.stderr)
        sys.exit(130)


def run_script(main: Callable[[A], dict[str, Any]], args: type[A]) -> None:
    """Run a training script from the command line and exit as `impact` does.

    Args:
        main: of the script; its result is printed.
        args: class of its arguments.
    """
    with exit_codes():
        print(main(tyro.cli(args)))

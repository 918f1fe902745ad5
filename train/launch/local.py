"""Tasks done on this machine."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from functools import partial
from typing import Any, TypeVar

from train.launch.launcher import Do
from train.launch.workers import work

Task = TypeVar("Task")


class LocalLauncher:
    """Do tasks in this process, or in some of this machine.

    Args:
        workers: processes; 1 works in this one.
    """

    remote = False

    def __init__(self, workers: int = 1) -> None:
        self.workers = workers

    def run(self, start: Callable[[], Do[Task]], tasks: Sequence[Task]) -> Generator[Any]:
        """Do tasks; see Launcher.run."""
        if self.workers == 1 or len(tasks) < 2:
            do = start()
            for task in tasks:
                yield from do(task)
            return
        for results in work(partial(_start_listing, start), tasks, self.workers):
            yield from results


def _start_listing(start: Callable[[], Do[Task]]) -> Callable[[Task], list[Any]]:
    """Return what does a task whole, so that its results can be sent."""
    do = start()
    return lambda task: list(do(task))

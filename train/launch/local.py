"""Tasks done on this machine."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Sequence
from functools import partial
from typing import Any, TypeVar

from train.launch.launcher import Do
from train.launch.workers import work

# A worker takes 1.5 s of processor time until it plays: with less to do than this, one process is as soon done.
PATIENCE = 3.0  # [s]

Task = TypeVar("Task")


class LocalLauncher:
    """Do tasks in this process, or in some of this machine.

    Args:
        workers: processes; 1 works in this one.
        patience: time for which this process works before it starts others [s].
        with_main: whether tasks may come from the user's script, which the others then import.
    """

    remote = False

    def __init__(self, workers: int = 1, patience: float = 0.0, with_main: bool = True) -> None:
        self.workers, self._patience, self._with_main = workers, patience, with_main

    def run(self, start: Callable[[], Do[Task]], tasks: Sequence[Task]) -> Generator[Any]:
        """Do tasks; see Launcher.run."""
        begun, do = time.monotonic(), None
        for place, task in enumerate(tasks):
            left = len(tasks) - place
            if self.workers > 1 and left > 1 and time.monotonic() - begun >= self._patience:
                for results in work(partial(_start_listing, start), tasks[place:], self.workers, self._with_main):
                    yield from results
                return
            do = do or start()
            yield from do(task)


def _start_listing(start: Callable[[], Do[Task]]) -> Callable[[Task], list[Any]]:
    """Return what does a task whole, so that its results can be sent."""
    do = start()
    return lambda task: list(do(task))

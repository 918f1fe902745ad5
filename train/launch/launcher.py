"""Who does tasks: the protocol of launchers."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Sequence
from typing import Any, Protocol, TypeVar

Task = TypeVar("Task")
# Made once in every process that works; takes a task and returns its results.
Do = Callable[[Task], Iterable[Any]]


class Launcher(Protocol):
    """Somebody who does tasks, in whatever order and place; what a task returns must not depend on either.

    Attributes:
        remote: whether tasks may run on other machines, with another working folder.
    """

    remote: bool

    def run(self, start: Callable[[], Do[Task]], tasks: Sequence[Task]) -> Generator[Any]:
        """Do tasks and yield each result of each of them as it comes.

        A task whose process or machine is lost is given to another one. However this generator ends, so does its work.

        Args:
            start: called where work is done; returns what does a task. It, tasks and results are pickled.
            tasks: to be done.

        Raises:
            WorkerLost: a task lost its process too often.
            Exception: what a task raised.
        """

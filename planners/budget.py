"""What planning may take: wall time, or work that is the same on every machine; and what its stages took."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field

from planners.errors import OutOfWork

ROW = 0.2  # work of writing a row and handing it to a solver, over that of an iteration of the simplex method


# Told of every stage that begins, and with None that it ended; it cannot change what is planned.
_WATCHER: ContextVar[Callable[[Budget, str | None], None] | None] = ContextVar("watcher", default=None)


@contextmanager
def watch_planning(tell: Callable[[Budget, str | None], None]) -> Iterator[None]:
    """Have all planning inside, in this thread, told to somebody.

    Args:
        tell: called with the budget and the stage that begins, or None at its end.
    """
    token = _WATCHER.set(tell)
    try:
        yield
    finally:
        _WATCHER.reset(token)


@dataclass
class Budget:
    """Hold the time that planning may take, and measure what its stages take.

    Args:
        limit: wall time of all stages together [s].
        news: what the stages so far found out, for whoever watches.
    """

    limit: float
    start: float = field(default_factory=time.perf_counter)
    stages: dict[str, float] = field(default_factory=dict)
    news: str = ""

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the time spent inside to a stage."""
        start, tell = time.perf_counter(), _WATCHER.get()
        if tell is not None:
            tell(self, name)
        try:
            yield
        finally:
            if tell is not None:
                tell(self, None)
            self.stages[name] = self.stages.get(name, 0.0) + time.perf_counter() - start

    @property
    def elapsed(self) -> float:
        """Return the time since the budget was made [s]."""
        return time.perf_counter() - self.start

    @property
    def left(self) -> float:
        """Return the time left [s]."""
        return self.limit - self.elapsed


@dataclass
class Work:
    """Count what solvers do, and end planning at a limit: the same on every machine, however busy it is.

    A unit is an iteration of the simplex method; some 5,000 to 10,000 take a second.

    Args:
        limit: of all solutions together [units].
        nodes: of branch and bound in each solution; None: any number.
        done: so far [units].
    """

    limit: float = math.inf
    nodes: int | None = None
    done: float = 0.0

    def spend(self, rows: int, iterations: int = 0) -> None:
        """Count a solution.

        Args:
            rows: of its problem.
            iterations: of the simplex method.

        Raises:
            OutOfWork: the limit is passed.
        """
        self.done += ROW * rows + iterations
        if self.done > self.limit:
            raise OutOfWork(f"{self.done:.0f} units of work are done, {self.limit:.0f} are allowed")

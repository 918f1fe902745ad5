"""What planning may take: time by a clock, or work that is the same on every machine; and what its stages took."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field

from planners.errors import OutOfWork

ROW = 0.2  # work of writing a row and handing it to a solver, over that of an iteration of the simplex method
OVER = 1e9  # what a stopped clock shows more: later than every limit [s]


# Told of every stage that begins, and with None that it ended; it cannot change what is planned.
_WATCHER: ContextVar[Callable[[Budget, str | None], None] | None] = ContextVar("watcher", default=None)


@dataclass
class Clock:
    """Measure what limits of time are about; once it is stopped, every limit is over.

    Args:
        read: returns the time [s]; `time.process_time` has planning count its own time on a busy machine.
        stopped: whether planning is to end with the best it has.
    """

    read: Callable[[], float] = time.perf_counter
    stopped: bool = False

    def stop(self) -> None:
        """Have all planning under this clock end with the best it has."""
        self.stopped = True


_CLOCK: ContextVar[Clock] = ContextVar("clock", default=Clock())  # noqa: B039 - nobody stops the default one


@contextmanager
def use_clock(clock: Clock) -> Iterator[None]:
    """Have the limits of all planning inside, in this thread, measured by a clock.

    Args:
        clock: the clock.
    """
    token = _CLOCK.set(clock)
    try:
        yield
    finally:
        _CLOCK.reset(token)


def get_clock() -> Clock:
    """Return the clock that limits are measured by."""
    return _CLOCK.get()


def read_clock() -> float:
    """Return the time that limits are measured by [s]."""
    clock = _CLOCK.get()
    return clock.read() + (OVER if clock.stopped else 0.0)


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


def count_things(number: int, name: str) -> str:
    """Return a number with the name of what is counted."""
    return f"no {name}s yet" if not number else f"{number} {name}{'s' * (number > 1)}"


@dataclass
class Progress:
    """Hold what planning has come to, for whoever watches; lengths in the user's units.

    Args:
        about: what is planned, where it is not yet the whole task.
        impacts: number that is tried now.
        pieces: per leg, that are tried now.
        robustness: of the best impacts found so far [m].
        bound: no plan is known to have more [m].
    """

    about: str = ""
    impacts: int | None = None
    pieces: int | None = None
    robustness: float | None = None
    bound: float | None = None

    def __str__(self) -> str:
        size = ""
        if self.impacts is not None:
            size = f"{count_things(self.impacts, 'impact')}, {count_things(self.pieces or 1, 'piece')} a leg"
        found = "" if self.robustness is None else f"robustness {self.robustness:.4g} m"
        bound = "" if self.bound is None else f"{'of ' if found else ''}at most {self.bound:.4g} m"
        return ", ".join(part for part in (self.about, size, f"{found} {bound}".strip()) if part)


@dataclass
class Budget:
    """Hold the time that planning may take, and measure what its stages take.

    Args:
        limit: time of all stages together [s].
        start: when it was made, by the clock of limits [s].
        begin: when it was made, by the wall's clock [s].
        stages: wall time that each stage has taken [s].
        progress: what planning has come to.
    """

    limit: float
    start: float = field(default_factory=lambda: get_clock().read())
    begin: float = field(default_factory=time.perf_counter)
    stages: dict[str, float] = field(default_factory=dict)
    progress: Progress = field(default_factory=Progress)

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

    def share(self, limit: float) -> Budget:
        """Return a budget of its own that tells of the same progress.

        Args:
            limit: its time [s].
        """
        return Budget(limit, progress=self.progress)

    @property
    def elapsed(self) -> float:
        """Return the time since the budget was made, by the clock of limits [s]."""
        return read_clock() - self.start

    @property
    def seconds(self) -> float:
        """Return the wall time since the budget was made [s]."""
        return time.perf_counter() - self.begin

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

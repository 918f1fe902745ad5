"""The time that planning may take, and what its stages took."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field


@dataclass
class Budget:
    """Hold the time that planning may take, and measure what its stages take.

    Args:
        limit: wall time of all stages together [s].
    """

    limit: float
    start: float = field(default_factory=time.perf_counter)
    stages: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the time spent inside to a stage."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.stages[name] = self.stages.get(name, 0.0) + time.perf_counter() - start

    @property
    def elapsed(self) -> float:
        """Return the time since the budget was made [s]."""
        return time.perf_counter() - self.start

    @property
    def left(self) -> float:
        """Return the time left [s]."""
        return self.limit - self.elapsed

"""Threads that share many worlds."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Any

# Threads that write to rows of one array write to rows this far apart: no two of them to one line of the cache, which
# would go back and forth between the cores. Even a row of one number is then two lines from the next.
APART = 16


class Threads:
    """Threads that share N worlds; a single one is the caller's own. Copies start threads of their own.

    Threads rather than numba.prange, which compiles everything once more.

    Args:
        number: of threads, at most; no more than there are worlds.
        worlds: N.

    Attributes:
        rows: of arrays in which thread i has row i * APART.
    """

    def __init__(self, number: int, worlds: int) -> None:
        self.number, self.worlds = min(number, worlds), worlds
        self.rows = (self.number - 1) * APART + 1
        self._pool: ThreadPoolExecutor | None = None

    def share(self, run: Callable[[int, int, int], object]) -> None:
        """Call ``run(thread, first, end)`` in every thread, with its equal share of the worlds."""
        if self.number == 1:
            run(0, 0, self.worlds)
            return
        ends = [thread * self.worlds // self.number for thread in range(self.number + 1)]
        self.work(lambda thread: run(thread, ends[thread], ends[thread + 1]))

    def work(self, run: Callable[[int], object], stop: Callable[[], object] | None = None) -> None:
        """Call ``run(thread)`` in every thread, and return when all are done.

        Args:
            run: what each thread does.
            stop: called after Ctrl-C or an error; makes threads that still run return soon.
        """
        self._pool = self._pool or ThreadPoolExecutor(self.number)
        running = [self._pool.submit(run, thread) for thread in range(self.number)]
        try:
            for future in running:
                future.result()
        except BaseException:  # nobody may write to the worlds behind whoever resets them
            if stop is not None:
                stop()
            wait(running)
            raise

    def close(self) -> None:
        """Let the threads go; the next work starts new ones."""
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_pool": None}

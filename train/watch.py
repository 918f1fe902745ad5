"""Watch a training run: a bar, the outcome of its episodes in the log, and a stop on request."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from stable_baselines3.common.callbacks import BaseCallback


class EpisodeLog(BaseCallback):
    """Log finished episodes, move the bar, and end learning when asked to.

    Args:
        stopping: set to end after the present step.
        advance: called with the number of corrections answered.
    """

    def __init__(self, stopping: threading.Event, advance: Callable[[int], None]) -> None:
        super().__init__()
        self._stopping, self._advance = stopping, advance

    def _on_step(self) -> bool:
        self._advance(self.num_timesteps)
        for info in self.locals["infos"]:
            if "robustness" in info:
                self.logger.record_mean("episode/robustness", info["robustness"])
                self.logger.record_mean("episode/success", float(info["success"]))
        return not self._stopping.is_set()


@contextmanager
def stop_on_signals() -> Iterator[threading.Event]:
    """Turn the first Ctrl-C or SIGTERM into a request to stop; the second one acts as usual.

    Yields:
        An event, set once a stop is asked for; never outside the main thread, which alone receives signals.
    """
    stopping = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield stopping
        return
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def _stop(number: int, frame: Any) -> None:
        stopping.set()
        signal.signal(number, before[signal.Signals(number)])

    for number in before:
        signal.signal(number, _stop)
    try:
        yield stopping
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def show_progress(total: int, shown: bool) -> Iterator[Callable[[int], None]]:
    """Show a bar on standard error.

    Args:
        total: corrections in the whole run.
        shown: whether there is a bar at all.

    Yields:
        A function to be called with the number of corrections answered.
    """
    columns = (TextColumn("training"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), disable=not shown) as bar:
        task = bar.add_task("", total=total)
        yield lambda steps: bar.update(task, completed=steps)

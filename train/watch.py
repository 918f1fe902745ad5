"""Watch a training run: a bar, its episodes in the log, a stop on request, and an end where it diverges."""

from __future__ import annotations

import signal
import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import torch
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback

from train.evaluation.errors import Diverged


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


def learn(model: BaseAlgorithm, steps: int, callback: BaseCallback | None = None) -> None:
    """Go on learning.

    Args:
        model: to train.
        steps: corrections to answer.
        callback: called at every step.

    Raises:
        Diverged: the weights, or what they predict, are no longer finite.
    """
    try:
        model.learn(steps, callback, log_interval=1, reset_num_timesteps=False)
        finite = all(torch.isfinite(parameter).all() for parameter in model.policy.parameters())
    except ValueError as error:
        frame, _ = list(traceback.walk_tb(error.__traceback__))[-1]
        if not frame.f_globals["__name__"].startswith("torch.distributions"):  # they refuse what is not finite
            raise
        finite = False
    if not finite:
        raise Diverged(
            f"training diverged after {model.num_timesteps} corrections: weights or predictions are not finite; "
            f"try a smaller learning_rate than {model.learning_rate}"
        )


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

"""Worker processes that neither outlive their parent nor take it with them."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from types import ModuleType
from typing import Any, TypeVar

from train.errors import WorkerLost

ATTEMPTS = 2  # a job that ended this many workers is not given to another one

Job = TypeVar("Job")


def work(
    start: Callable[[], Callable[[Job], Any]], jobs: Sequence[Job], workers: int, with_main: bool = True
) -> Generator[Any]:
    """Do jobs in several processes and yield each result as it comes.

    A job whose worker dies is given to another one. However this generator ends, its processes end at once.

    Args:
        start: called in every worker; returns what does a job. Jobs and results are pickled.
        jobs: to be done.
        workers: most processes at a time.
        with_main: whether they import the user's script, where what is sent may come from. One that is not guarded by
            ``if __name__ == "__main__"`` would begin anew in each of them.

    Raises:
        WorkerLost: ATTEMPTS workers died of the same job.
        Exception: what a job raised.
    """
    queue, lost = list(reversed(jobs)), dict[int, int]()
    crew: dict[Connection, tuple[BaseProcess, Job | None]] = {}
    left = len(jobs)
    try:
        while left:
            while len(crew) < min(workers, left):
                ours, made = _start_worker(start, with_main)
                crew[ours] = (made, None)
                _give(crew, ours, queue)
            for ready in wait(list(crew)):
                assert isinstance(ready, Connection)
                process, job = crew[ready]
                try:
                    result, error = ready.recv()
                except (EOFError, OSError):
                    del crew[ready]
                    process.join()
                    if job is not None:  # not one that has done its work
                        _count_loss(lost, job, process)
                        queue.append(job)
                    continue
                if error is not None:
                    raise error
                left -= 1
                _give(crew, ready, queue)
                yield result
    finally:
        for process, _ in crew.values():
            process.kill()
        for process, _ in crew.values():
            process.join()


def end_with_parent() -> None:
    """End this process as soon as its parent has ended, in whatever way and whatever is being computed."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_after, args=(parent.sentinel,), daemon=True).start()


def _start_worker(start: Callable[[], Callable[[Job], Any]], with_main: bool) -> tuple[Connection, BaseProcess]:
    """Start a process and return what talks to it, and itself."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # a core each; libraries read it when they are imported there
    ours, theirs = multiprocessing.Pipe()
    made = multiprocessing.get_context("spawn").Process(target=_serve, args=(theirs, start), daemon=True)
    with _hold_interrupts(), nullcontext() if with_main else _hide_main():
        made.start()
    theirs.close()
    return ours, made


@contextmanager
def _hold_interrupts() -> Iterator[None]:
    """Let Ctrl-C wait, here until the block ends, and for good in processes that are started inside."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    resource_tracker.ensure_running()  # as it starts, it lets Ctrl-C through
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _hide_main() -> Iterator[None]:
    """Have processes that are started inside not import the user's script."""
    main, sys.modules["__main__"] = sys.modules["__main__"], ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = main


def _end_after(sentinel: int) -> None:
    wait([sentinel])
    os._exit(1)


def _give(crew: dict[Connection, tuple[BaseProcess, Job | None]], worker: Connection, queue: list[Job]) -> None:
    """Give a worker its next job; None if there is no more."""
    process, _ = crew[worker]
    job = queue.pop() if queue else None
    crew[worker] = (process, job)
    with suppress(OSError):  # it has ended, which is seen when its answer is read
        worker.send(job)


def _count_loss(lost: dict[int, int], job: Job, process: BaseProcess) -> None:
    lost[id(job)] = lost.get(id(job), 0) + 1
    if lost[id(job)] >= ATTEMPTS:
        raise WorkerLost(
            f"{lost[id(job)]} worker processes ended during {job} (the last with code {process.exitcode}): "
            "killed, or out of memory? what was finished is kept"
        )


def _serve(parent: Connection, start: Callable[[], Callable[[Job], Any]]) -> None:
    # Ctrl-C is the parent's to handle; it ends its workers.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with_parent()
    do = None
    with suppress(EOFError, ConnectionError):  # the parent has ended
        while (job := parent.recv()) is not None:
            try:
                do = do or start()
                answer: tuple[Any, Exception | None] = (do(job), None)
            except Exception as error:
                error.add_note(traceback.format_exc())
                answer = (None, error)
            parent.send(answer)

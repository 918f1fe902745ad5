"""Worker processes that neither outlive their parent nor take it with them."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, TypeVar

from train.errors import WorkerLost

AGAIN = 0.05  # s until a signal whose exception was dropped is sent again: LLVM has mostly come back by then
ATTEMPTS = 2  # a job that ended this many workers is not given to another one

Job = TypeVar("Job")


def work(start: Callable[[], Callable[[Job], Any]], jobs: Sequence[Job], workers: int) -> Generator[Any]:
    """Do jobs in several processes and yield each result as it comes.

    A job whose worker dies is given to another one. However this generator ends, its processes end at once.

    Args:
        start: called in every worker; returns what does a job. Jobs and results are pickled.
        jobs: to be done.
        workers: most processes at a time.

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
                ours, theirs = multiprocessing.Pipe()
                made = multiprocessing.get_context("spawn").Process(target=_serve, args=(theirs, start), daemon=True)
                made.start()
                theirs.close()
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


@contextmanager
def end_on_sigterm() -> Iterator[None]:
    """Let SIGTERM end this process as an exception does, with code 143, unless somebody else handles it.

    Only while episodes are played: a solver at work would keep the exception waiting, and has nothing to tidy up.
    Where Python cannot raise, as in a call of LLVM's back into Python while a function is compiled, the exception is
    dropped: it is raised again soon. What fails after the signal fails because of it.
    """
    main = threading.current_thread() is threading.main_thread()
    if not main or signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL:
        yield
        return

    told, show_dropped = threading.Event(), sys.unraisablehook

    def end(number: int, frame: Any) -> None:
        told.set()
        raise SystemExit(128 + number)

    def raise_again(dropped: sys.UnraisableHookArgs) -> None:
        if not (told.is_set() and issubclass(dropped.exc_type, SystemExit)):
            return show_dropped(dropped)
        timer = threading.Timer(AGAIN, signal_again)
        timer.daemon = True
        timer.start()

    def signal_again() -> None:
        if sys.unraisablehook is raise_again:  # else it has ended, or is about to
            signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGTERM)

    signal.signal(signal.SIGTERM, end)
    sys.unraisablehook = raise_again
    try:
        yield
    except Exception:
        if told.is_set():
            raise SystemExit(128 + signal.SIGTERM) from None
        raise
    finally:
        sys.unraisablehook = show_dropped
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


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
    while (job := parent.recv()) is not None:
        try:
            do = do or start()
            answer: tuple[Any, Exception | None] = (do(job), None)
        except Exception as error:
            error.add_note(traceback.format_exc())
            answer = (None, error)
        parent.send(answer)

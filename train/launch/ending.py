"""Signals that end this process, as exceptions that arrive whatever is being computed.

Where Python cannot raise, as in a call of LLVM's back into Python while a function is compiled, it drops the exception
that a signal's handler raises: the signal is sent again soon. What fails in between fails because of it.
"""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

AGAIN = 0.05  # s until a signal whose exception was dropped is sent again: LLVM has mostly come back by then


@contextmanager
def end_on_sigterm() -> Iterator[None]:
    """Let SIGTERM end this process as an exception does, with code 143, unless somebody else handles it.

    Only while episodes are played: a solver at work would keep the exception waiting, and has nothing to tidy up.
    """
    if not _is_main() or signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL:
        yield
        return

    told = threading.Event()

    def end(number: int, frame: Any) -> None:
        told.set()
        raise SystemExit(128 + number)

    signal.signal(signal.SIGTERM, end)
    try:
        with _send_again(signal.SIGTERM, lambda kind: told.is_set() and issubclass(kind, SystemExit)):
            yield
    except Exception:
        if told.is_set():
            raise SystemExit(128 + signal.SIGTERM) from None
        raise
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


@contextmanager
def keep_interrupts() -> Iterator[None]:
    """Let Ctrl-C arrive as KeyboardInterrupt even where Python drops one."""
    if not _is_main():
        yield
        return

    dropped = threading.Event()

    def is_interrupt(kind: type[BaseException]) -> bool:
        if issubclass(kind, KeyboardInterrupt):
            dropped.set()
            return True
        return False

    try:
        with _send_again(signal.SIGINT, is_interrupt):
            yield
    except Exception:
        if dropped.is_set():
            raise KeyboardInterrupt from None
        raise


def _is_main() -> bool:
    return threading.current_thread() is threading.main_thread()


@contextmanager
def _send_again(number: int, is_ours: Callable[[type[BaseException]], bool]) -> Iterator[None]:
    """Send a signal to the main thread again when Python has dropped what its handler raised.

    Args:
        number: of the signal.
        is_ours: whether an exception of this type, which was dropped, is of that signal.
    """
    over, show_dropped = threading.Event(), sys.unraisablehook

    def raise_again(dropped: sys.UnraisableHookArgs) -> None:
        if not is_ours(dropped.exc_type):
            return show_dropped(dropped)
        timer = threading.Timer(AGAIN, signal_again)
        timer.daemon = True
        timer.start()

    def signal_again() -> None:
        if not over.is_set():
            signal.pthread_kill(threading.main_thread().ident or 0, number)

    sys.unraisablehook = raise_again
    try:
        yield
    finally:
        over.set()
        sys.unraisablehook = show_dropped

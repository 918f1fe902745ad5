"""One source for numba, CUDA and plain Python: how the scalar functions that run every control step are compiled.

Such a function takes numbers, arrays and NamedTuples of them, allocates nothing and raises nothing.
"""

from __future__ import annotations

import logging
import re
import sys
import time
from collections.abc import Callable
from functools import cache, partial
from hashlib import sha256
from pathlib import Path
from types import FunctionType
from typing import Any, TypeVar, cast

import numba
from numba.core import event
from numba.core.dispatcher import Dispatcher

_log = logging.getLogger(__name__)
ROOT = Path(__file__).parents[1]
# Nothing is allocated, so arrays need no reference counts; counting them costs as much as all the rest.
OPTIONS: dict[str, Any] = {"cache": True, "error_model": "numpy", "_nrt": False, "nogil": True}
BETWEEN_LINES = 10.0  # of the progress of a compilation in a log [s]
Function = TypeVar("Function", bound=Callable[..., Any])


def compiled(function: Function) -> Function:
    """Compile a scalar function for the CPU at its first call, and keep the code on disk.

    Floating-point operations are neither reordered nor fused, so that one world and many get the same bits.
    """
    return refresh(numba.njit(**OPTIONS)(function))


def inlined(function: Function) -> Function:
    """Compile a scalar function into each of its callers: passing two dozen arrays costs more than a short function."""
    return refresh(numba.njit(**OPTIONS, forceinline=True)(function))


def refresh(dispatcher: Any) -> Any:
    """Compile anew what is on disk when a file that the function's file imports has changed.

    numba looks at the function's own file only, although what it calls from other files is compiled into it.
    """
    if hasattr(dispatcher, "py_func"):  # not with NUMBA_DISABLE_JIT
        file = dispatcher._cache._cache_file
        file._source_stamp = _read_sources(Path(dispatcher.py_func.__code__.co_filename))
        file._load_index = partial(_load_index, file._load_index)
    return dispatcher


def _load_index(load: Callable[[], dict[Any, Any]]) -> dict[Any, Any]:
    """Return what is on disk of a function; nothing if it was written with types that have another name by now."""
    try:
        return load()
    except (AttributeError, ImportError):
        return {}


@cache
def _read_sources(file: Path) -> bytes:
    """Return the digest of a file of the package and of all files of the package that it imports."""
    seen, todo = dict[Path, str](), [file]
    while todo:
        path = todo.pop()
        if path not in seen and path.is_file():
            seen[path] = text = path.read_text(encoding="utf-8")
            modules = re.findall(r"^from (\w+(?:\.\w+)+) import", text, re.MULTILINE)
            todo += [ROOT.joinpath(*module.split(".")).with_suffix(".py") for module in modules]
    return sha256("".join(seen[path] for path in sorted(seen)).encode()).digest()


def is_compiled(function: Any) -> bool:
    """Return whether a function can run at once, because it ran before or its code is on disk."""
    if not hasattr(function, "py_func"):
        return True
    return bool(function.signatures) or bool(function._cache._cache_file._load_index())


@cache
def announce(function: Any) -> None:
    """Show how far the compilation of a function is during its first call, if it will take long."""
    if not is_compiled(function):
        event.register("numba:compile", Compilation(function))


class Compilation(event.Listener):
    """Count what numba compiles for one function: a bar on a terminal, else lines in the log.

    Args:
        function: whose first call compiles all that it calls.
    """

    def __init__(self, function: Dispatcher) -> None:
        self._function = function
        self._waiting = {called for called in list_calls(function) if not is_compiled(called)}
        self._total = len(self._waiting)
        self._start = self._said = 0.0
        self._bar: Any = None

    def on_start(self, started: Any) -> None:
        """Begin to show when the function itself is compiled."""
        if started.data["dispatcher"] is not self._function or self._start:
            return
        self._start = self._said = time.perf_counter()
        if sys.stderr.isatty():
            self._bar = _make_bar()
            self._bar.add_task("", total=self._total)
            self._bar.start()
        else:
            _log.warning("compiling %d functions for this machine, this once: up to two minutes", self._total)

    def on_end(self, ended: Any) -> None:
        """Count a function; the outermost one is the last."""
        self._waiting.discard(ended.data["dispatcher"])
        if not self._start:
            return
        now, done = time.perf_counter(), self._total - len(self._waiting)
        last = ended.data["dispatcher"] is self._function
        if self._bar:
            self._bar.update(self._bar.task_ids[0], completed=done)
        elif last or now - self._said >= BETWEEN_LINES:
            self._said = now
            _log.warning("compiled %d of %d functions in %.0f s", done, self._total, now - self._start)
        if last:
            event.unregister("numba:compile", self)
            if self._bar:
                self._bar.stop()


def _make_bar() -> Any:
    # Here: most processes find all code on disk.
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("compiling for this machine, this once"), BarColumn(), MofNCompleteColumn())
    return Progress(*columns, TimeElapsedColumn(), console=Console(stderr=True), transient=True)


def list_calls(function: Dispatcher) -> set[Dispatcher]:
    """Return a compiled function and all compiled functions that it calls, directly or not."""
    found, todo = set[Dispatcher](), [function]
    while todo:
        dispatcher = todo.pop()
        if dispatcher not in found:
            found.add(dispatcher)
            code, space = dispatcher.py_func.__code__, dispatcher.py_func.__globals__
            todo += [space[name] for name in code.co_names if isinstance(space.get(name), Dispatcher)]
    return found


def bind(function: Any, *arguments: Any) -> Callable[..., Any]:
    """Return a compiled function's machine code for arguments of these types, after one call with them.

    A call of it looks no types up, which for two dozen arrays of records takes longer than one world's control step.
    The caller answers for the types: they must stay the same.
    """
    function(*arguments)
    if not hasattr(function, "py_func"):  # with NUMBA_DISABLE_JIT
        return cast("Callable[..., Any]", function)
    types = tuple(function.typeof_pyval(argument) for argument in arguments)
    overload = function.overloads.get(types)
    return cast("Callable[..., Any]", overload.entry_point if overload else function)


@cache
def interpret(function: Any) -> Any:
    """Return a compiled function, and all that it calls, as plain Python: a few calls take less than loading code."""
    return retarget(function, lambda plain: plain) if hasattr(function, "py_func") else function


def retarget(function: Any, decorate: Callable[[FunctionType], Any]) -> Any:
    """Compile a function and all compiled functions it calls for another target, from the same source.

    Args:
        function: made by ``compiled``.
        decorate: what to do with each plain Python function: ``lambda f: cuda.jit(f, device=True)`` for a GPU, the
            identity to run uncompiled.

    Returns:
        What ``decorate`` makes of the outermost function.
    """
    done: dict[Dispatcher, Any] = {}

    def visit(dispatcher: Dispatcher) -> Any:
        if dispatcher not in done:
            plain = dispatcher.py_func
            space = dict(plain.__globals__)
            for name in plain.__code__.co_names:
                if isinstance(space.get(name), Dispatcher):
                    space[name] = visit(space[name])
            copy = FunctionType(plain.__code__, space, plain.__name__, plain.__defaults__, plain.__closure__)
            done[dispatcher] = decorate(copy)
        return done[dispatcher]

    return visit(function)

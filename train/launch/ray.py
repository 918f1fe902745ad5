"""Tasks done on a Ray cluster, one core each; one whose process or node is lost is handed out again."""

from __future__ import annotations

import logging
import os
import re
import signal
import socket
import sys
import threading
import time
import uuid
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any, TypeVar

import ray
from ray import exceptions

from impact_envs.errors import InputError
from train.errors import WorkerLost
from train.launch.launcher import Do

# A task that lost this many processes or nodes is given up: more than on one machine, because nodes of a cluster are
# taken away for reasons that no task has to answer for.
ATTEMPTS = 4
QUEUED = 2  # tasks handed to Ray for each core: one that runs, and one that waits there for it
PATIENCE = 5.0  # for a first answer of a cluster [s]
REFRESH = 1.0  # time after which the cluster is asked anew how many cores it has [s]

Task = TypeVar("Task")


class RayLauncher:
    """Do tasks on a Ray cluster.

    Args:
        address: as ray.init takes it; None: what RAY_ADDRESS says, a cluster of this machine, or a new one.
        workers: tasks at a time; None: one for each core of the cluster.

    Raises:
        InputError: the cluster cannot be reached.
    """

    remote = True

    def __init__(self, address: str | None = None, workers: int | None = None) -> None:
        self.workers = workers
        self._ours = not ray.is_initialized()
        if self._ours:
            _connect(address, workers)

    def close(self) -> None:
        """Leave the cluster, and end it if this launcher started it."""
        if self._ours:
            ray.shutdown()

    def run(self, start: Callable[[], Do[Task]], tasks: Sequence[Task]) -> Generator[Any]:
        """Do tasks; see Launcher.run."""
        begin, run = ray.put(start), uuid.uuid4().hex
        remote = ray.remote(num_cpus=1, max_retries=0)(_do)
        waiting, lost = list(reversed(tasks)), dict[int, int]()
        given: dict[Any, Task] = {}
        most, asked = 0, -REFRESH
        try:
            while waiting or given:
                if time.monotonic() - asked > REFRESH:
                    most, asked = self._count_most(), time.monotonic()
                while waiting and len(given) < most:
                    task = waiting.pop()
                    given[remote.remote(run, begin, task)] = task
                ready, _ = ray.wait(list(given), num_returns=1, timeout=REFRESH)
                for one in ready:
                    task = given.pop(one)
                    results = _collect(one)
                    if results is None:
                        _count_loss(lost, task)
                        waiting.append(task)
                        continue
                    yield from results
        finally:
            for one in given:
                with suppress(exceptions.RayError):
                    ray.cancel(one, force=True)

    def _count_most(self) -> int:
        """Return how many tasks Ray is given at a time."""
        return self.workers or max(1, QUEUED * int(ray.cluster_resources().get("CPU", 0)))


def _connect(address: str | None, workers: int | None) -> None:
    """Join a cluster, or start one of this machine.

    Raises:
        InputError: it cannot be reached.
    """
    wanted: dict[str, Any] = {"address": address} if address else {}
    _check_door(address or os.environ.get("RAY_ADDRESS", ""))
    try:
        with _keep_handlers():
            ray.init(
                **wanted, log_to_driver=False, logging_level=logging.ERROR, include_dashboard=None if address else False
            )
    except (ConnectionError, RuntimeError, ValueError, OSError) as error:
        where = f"the Ray cluster at '{address}'" if address else "a Ray cluster"
        reason = next(iter(str(error).splitlines()), type(error).__name__)
        raise InputError(f"{where} cannot be reached: {reason}; start one by `ray start --head`") from None
    if not address and not os.environ.get("RAY_ADDRESS"):
        print(f"{_describe_cluster()}; --address HOST:PORT or RAY_ADDRESS names another", file=sys.stderr)


def _describe_cluster() -> str:
    """Return which cluster was chosen where the user named none."""
    # Ray has no public word for whether this process has started the cluster.
    if getattr(getattr(ray._private.worker, "_global_node", None), "head", False):
        return "no Ray cluster is named or runs here: started one on this machine, which ends with the command"
    return f"no Ray cluster is named: joined the one of this machine, {ray.get_runtime_context().gcs_address}"


def _check_door(address: str) -> None:
    """Raise unless somebody answers at HOST:PORT; Ray itself would try for minutes.

    Raises:
        InputError: nobody does.
    """
    found = re.fullmatch(r"(?P<host>[^/:]+):(?P<port>[0-9]{1,5})", address)
    if found is None:  # auto, ray://, none: Ray says at once, or within seconds
        return
    try:
        socket.create_connection((found["host"], int(found["port"])), PATIENCE).close()
    except (OSError, OverflowError) as error:
        raise InputError(
            f"the Ray cluster at '{address}' cannot be reached: {error}; start one by `ray start --head`"
        ) from None


@contextmanager
def _keep_handlers() -> Iterator[None]:
    """Leave SIGTERM to whom it belonged: Ray takes it."""
    before = signal.getsignal(signal.SIGTERM)
    try:
        yield
    finally:
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGTERM, before)


def _collect(one: Any) -> list[Any] | None:
    """Return a task's results; None if its process, its node or what it returned is lost.

    Raises:
        Exception: what the task raised.
    """
    try:
        results: list[Any] = ray.get(one)
        return results
    except exceptions.RayTaskError as error:
        cause = error.cause
        if isinstance(cause, ModuleNotFoundError):
            raise InputError(f"a node of the Ray cluster cannot work: {cause}; install the same there") from None
        if isinstance(cause, exceptions.RayError):  # what the task needs was lost with a node
            return None
        raise (cause if isinstance(cause, Exception) else error) from None
    except exceptions.RayError:
        return None


def _count_loss(lost: dict[int, int], task: Any) -> None:
    lost[id(task)] = lost.get(id(task), 0) + 1
    if lost[id(task)] >= ATTEMPTS:
        raise WorkerLost(
            f"{lost[id(task)]} Ray processes or nodes were lost during {task}: killed, or out of memory? "
            "what was finished is kept"
        )


# In a process of the cluster: what does the tasks of a run, by the run's name; only the latest run's.
_begun: dict[str, Callable[[Any], Any]] = {}


def _do(run: str, start: Callable[[], Callable[[Any], Any]], task: Any) -> list[Any]:
    """Do a task in a process of the cluster."""
    if run not in _begun:
        _begun.clear()
        _begun[run] = start()
    return list(_begun[run](task))

"""Replan in a background process when the current plan can no longer succeed; the loop goes on meanwhile.

A plan is asked for from the state that is expected DELAY later, and taken over then, in simulated time: what an episode
does does not depend on how fast the machine is, unless the solver comes to its TIME_LIMIT. Where simulated time runs
faster than the solver, the loop waits.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import queue
import subprocess
import sys
import threading
import weakref
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, TextIO, cast

import numpy as np

from impact_envs.errors import InputError
from impact_envs.free_flyer.schema import FreeFlyerScenario
from planners.errors import PlanningError
from planners.free_flyer.belief.estimator import extrapolate_flight
from planners.free_flyer.belief.options import EXPERT, Options
from planners.free_flyer.belief.plan_table import NO_IMPACT, PlanTable, make_plan_table
from planners.free_flyer.belief.world_memory import PAST_PERIOD, WorldMemory
from planners.free_flyer.next_impact.desired_velocity import find_mass
from planners.free_flyer.nominal.remaining import make_remaining_scenario, plan_rest
from planners.free_flyer.tracking.course import evaluate_course
from planners.plan import Plan


@dataclass(frozen=True)
class Request:
    """Hold what a world waits for.

    Attributes:
        number: of the request.
        begin: when the plan is taken over [s].
        scenario: what is left of the task then, in time that starts then.
        question: the line that asks for it.
    """

    number: int
    begin: float
    scenario: FreeFlyerScenario
    question: str


class Background:
    """Ask for new plans and hand them over, world by world.

    The process ends with its owner: at the end of the program, when the owner is forgotten, and within moments of the
    owner's violent death. A copy, and what a fork leaves in the child, asks a process of its own for what is pending.

    Args:
        scenario: the whole task, as believed.
        options: of the closed loop.
    """

    _worker: subprocess.Popen[str] | None
    _end: weakref.finalize[..., Any] | None
    _lines: queue.SimpleQueue[str]
    _unasked: list[Request]

    def __init__(self, scenario: FreeFlyerScenario, options: Options = EXPERT) -> None:
        self._scenario, self._options = scenario, options
        self._pending: dict[int, Request] = {}
        self._asked: dict[int, int] = {}
        self._next: dict[int, float] = {}
        self._answers: dict[int, str | None] = {}
        self._numbers = self._read = 0
        self._disown()

    def forget_world(self, k: int) -> None:
        """Forget what world k has asked for."""
        request = self._pending.pop(k, None)
        self._unasked = [other for other in self._unasked if other is not request]
        self._asked.pop(k, None)
        self._next.pop(k, None)

    def poll_plan(self, table: PlanTable, memory: WorldMemory, k: int) -> PlanTable | None:
        """Return a new table for world k to follow from now on, if there is one; ask for one if it is wanted.

        Args:
            table: what world k follows.
            memory: of all worlds.
            k: world.
        """
        now, request = float(memory.time[k]), self._pending.get(k)
        if request is not None:
            if now < request.begin - 1e-6:
                return None
            del self._pending[k]
            self._allow_next(k, now)
            return self._take_plan(memory, k, request)
        if now >= self._next.get(k, math.inf):
            del self._next[k]
            memory.wanted[k] = math.inf
        elif 0.0 <= memory.wanted[k] <= now and _is_calm(memory, self._options, k, now):
            # No further plan is wanted before this one had time to act.
            memory.wanted[k] = -math.inf
            if table.horizon - now >= self._options.background.least_left:
                self._ask_plan(table, memory, k, now)
        return None

    def find_busy(self, memory: WorldMemory) -> np.ndarray:
        """Return the worlds that `poll_plan` may do something for."""
        busy = (memory.wanted >= 0.0) & (memory.wanted <= memory.time)
        busy[[*self._pending, *self._next]] = True
        return np.flatnonzero(busy)

    def close(self) -> None:
        """End the process."""
        if self._end is not None:
            self._end()
        self._worker = self._end = None

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name not in _OF_PROCESS}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._disown()

    def _disown(self) -> None:
        """Begin without a process; what is pending and not answered yet will be asked again."""
        self._owner = os.getpid()
        self._worker = self._end = None
        self._lines = queue.SimpleQueue()
        pending = sorted(self._pending.values(), key=lambda request: request.number)
        self._unasked = [request for request in pending if request.number > self._read]

    def _allow_next(self, k: int, now: float) -> None:
        if self._asked[k] < self._options.background.most:
            self._next[k] = now + self._options.background.apart

    def _ask_plan(self, table: PlanTable, memory: WorldMemory, k: int, now: float) -> None:
        self._asked[k] = self._asked.get(k, 0) + 1
        begin = round(round((now + self._options.background.delay) / table.period) * table.period, 9)
        try:
            rest = self._make_rest(table, memory, k, now, begin)
        except InputError:
            memory.counts["no_plan"][k] += 1
            self._allow_next(k, now)
            return
        self._numbers += 1
        data = {
            "number": self._numbers,
            "scenario": rest.model_dump(mode="json"),
            "impacts": _count_impacts(table, memory, k),
            "time_limit": self._options.background.time_limit,
        }
        request = Request(self._numbers, begin, rest, json.dumps(data) + "\n")
        self._reach_worker()
        self._pending[k] = request
        self._ask(request)

    def _ask(self, request: Request) -> None:
        stdin = cast(TextIO, cast(Any, self._worker).stdin)
        try:
            stdin.write(request.question)
            stdin.flush()
        except OSError:  # no worker any more; its answer will be missed
            self.close()

    def _make_rest(self, table: PlanTable, memory: WorldMemory, k: int, now: float, begin: float) -> FreeFlyerScenario:
        """Make the scenario that is left at `begin`: objects fly on, robots follow their courses."""
        positions, velocities = {}, {}
        for i, name in enumerate(self._scenario.bodies):
            if i < table.robots:
                motion = evaluate_course(memory.course[k, i], table.breaks, table.coefficients, i, begin)[:4]
            else:
                motion = (*find_mass(memory, k, i, begin), *extrapolate_flight(memory, k, i, begin)[2:])
            positions[name], velocities[name] = np.array(motion[:2]), np.array(motion[2:])
        seen = int(now / PAST_PERIOD + 1e-6) + 1
        times = np.append(PAST_PERIOD * np.arange(seen), begin)
        tracks = {
            name: np.vstack([memory.past[k, :seen, i], positions[name]]) for i, name in enumerate(self._scenario.bodies)
        }
        return make_remaining_scenario(self._scenario, begin, positions, velocities, (times, tracks))

    def _take_plan(self, memory: WorldMemory, k: int, request: Request) -> PlanTable | None:
        answer = self._await_answer(request.number)
        if answer is None:
            memory.counts["no_plan"][k] += 1
            return None
        table = make_plan_table(request.scenario, Plan.from_json(answer), request.begin, self._options.weights)
        if len(table.impact) > memory.clock.shape[1]:
            memory.counts["no_plan"][k] += 1
            return None
        memory.counts["planned_anew"][k] += 1
        return table

    def _await_answer(self, number: int) -> str | None:
        """Return the answer to a request, None if no plan was found or the worker died."""
        if self._unasked or self._owner != os.getpid():
            self._reach_worker()
        while self._read < number:  # answers come in the order of the questions
            try:
                answer = json.loads(self._lines.get())
            except ValueError:  # the worker ended, in the middle of a line maybe: what it was asked is lost
                self._read = self._numbers
                self.close()
                break
            self._read = answer["number"]
            if self._read in {number, *(request.number for request in self._pending.values())}:
                self._answers[self._read] = answer["plan"]
        return self._answers.pop(number, None)

    def _reach_worker(self) -> None:
        """Start the process, and a thread that takes its answers, if there is none; ask what it was not asked yet."""
        if self._owner != os.getpid():  # forked: the worker belongs to the parent
            self._disown()
        if self._worker is None or self._worker.poll() is not None:
            self._worker = worker = subprocess.Popen(
                [sys.executable, "-m", __name__], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
            )
            self._lines = queue.SimpleQueue()
            thread = threading.Thread(target=_forward, args=(worker.stdout, self._lines), daemon=True)
            thread.start()
            self._end = weakref.finalize(self, _end_process, worker, thread, self._owner)
        unasked, self._unasked = self._unasked, []
        for request in unasked:
            self._ask(request)


_OF_PROCESS = ("_owner", "_worker", "_end", "_lines", "_unasked")  # of a Background, and nothing to copy


def _end_process(worker: subprocess.Popen[str], thread: threading.Thread, owner: int) -> None:
    """End a worker, then the thread that reads from it, then close the pipes; a forked child leaves all alone."""
    if os.getpid() != owner:
        return
    worker.kill()
    worker.wait()
    if thread is not threading.current_thread():  # where the garbage collector may run as well
        thread.join()
    for pipe in (worker.stdin, worker.stdout):
        with contextlib.suppress(OSError, ValueError):
            cast(TextIO, pipe).close()


def _forward(answers: TextIO, lines: queue.SimpleQueue[str]) -> None:
    """Take a worker's answers as they come, so that neither side waits for the other; an empty line is the end."""
    try:
        for line in answers:
            lines.put(line)
    except ValueError:  # closed
        pass
    lines.put("")


def _is_calm(memory: WorldMemory, options: Options, k: int, now: float) -> bool:
    """Return whether no impact is near now or when a new plan is taken over."""
    strike = memory.strike[k]
    coming = strike[(strike["index"] != NO_IMPACT) | strike["is_inserted"]]
    settled = (now >= strike["last_contact"] + options.timing.settle).all()
    return bool((coming["time"] > now + options.background.delay + options.background.calm).all() and settled)


def _count_impacts(table: PlanTable, memory: WorldMemory, k: int) -> int:
    left = 0
    for o in range(len(table.first)):
        at = memory.strike[k, o]["index"]
        while at != NO_IMPACT:
            at, left = table.impact[at]["next"], left + 1
    return left


def answer_requests(requests: Iterable[str], answers: TextIO) -> None:
    """Plan what is asked for, line by line, until there is no more.

    Args:
        requests: lines {"number", "scenario", "impacts", "time_limit"} of JSON.
        answers: lines {"number", "plan"}, plan as JSON text or null.
    """
    for line in requests:
        request = json.loads(line)
        try:
            scenario = FreeFlyerScenario.model_validate(request["scenario"])
            plan = plan_rest(scenario, request["impacts"], request["time_limit"]).to_json()
        except (PlanningError, InputError):
            plan = None
        answers.write(json.dumps({"number": request["number"], "plan": plan}) + "\n")
        answers.flush()


def _read_requests() -> Iterator[str]:
    """Return the lines of standard input; when it ends, so does the process, even in the middle of planning."""
    lines: queue.SimpleQueue[str] = queue.SimpleQueue()

    def read() -> None:
        for line in sys.stdin:
            lines.put(line)
        os._exit(0)  # nobody is left to answer

    threading.Thread(target=read, daemon=True).start()
    return iter(lines.get, "")


if __name__ == "__main__":
    answer_requests(_read_requests(), sys.stdout)

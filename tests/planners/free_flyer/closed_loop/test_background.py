"""A new plan is taken over 2 s after it was asked for, in simulated time, whatever its process does."""

from __future__ import annotations

import copy
import gc
import json
import os
import pickle
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from io import StringIO
from pathlib import Path
from types import SimpleNamespace
from typing import Any, TextIO, cast

import numpy as np
import pytest

from impact_envs import InputError, parallel_env, rollout, vector_env
from impact_envs.free_flyer.schema import FreeFlyerScenario
from planners.budget import Work
from planners.errors import Infeasible, OutOfWork
from planners.free_flyer.belief.options import EXPERT, make_record
from planners.free_flyer.belief.plan_table import NO_IMPACT, make_plan_table
from planners.free_flyer.belief.world_memory import COUNTERS, PAST_PERIOD, WorldMemory
from planners.free_flyer.closed_loop import background, planning_process
from planners.free_flyer.closed_loop.background import Background
from planners.free_flyer.closed_loop.planning_process import PlanningProcesses, answer_requests
from planners.free_flyer.closed_loop.world_loop import adopt_world, start_world
from planners.free_flyer.expert import FreeFlyerExpert
from planners.free_flyer.expert_batch import FreeFlyerExpertBatch
from planners.free_flyer.nominal.remaining import plan_rest
from planners.plan import Plan
from tests.frozen.freeze import get_plan
from tests.planners.free_flyer.plans import load, set_fields

OPTIONS = make_record(EXPERT)[0]
TIMING = EXPERT.timing
BACKGROUND = EXPERT.background

SEED = 1_000_000
WANTED = 12.0  # after the first impact of both scenarios, well before the second [s]
Spoil = Callable[[int, dict[str, np.ndarray]], None]


@cache
def plan_of(name: str) -> Plan:
    plan = get_plan(name, "nominal")
    assert plan is not None
    return plan


@cache
def answer(line: str) -> str:
    answers = StringIO()
    answer_requests(StringIO(line), answers)
    return answers.getvalue()


def refuse_request(line: str) -> str:
    return json.dumps({"number": json.loads(line)["number"], "plan": None, "failure": "no_plan"}) + "\n"


class Inline:
    """Stands for the process: answers at once, each question only once per test session."""

    pid = -1
    plan: Callable[[str], str] = staticmethod(answer)

    def __init__(self, *arguments: object, **options: object) -> None:
        self.stdin = self.stdout = self
        self.asked: list[str] = []
        self._lines: queue.SimpleQueue[str] = queue.SimpleQueue()

    def write(self, line: str) -> None:
        self.asked.append(line)
        self._lines.put(type(self).plan(line))

    def flush(self) -> None:
        pass

    def __iter__(self) -> Iterator[str]:
        while line := self._lines.get():
            yield line

    def close(self) -> None:
        pass

    def poll(self) -> int | None:
        return None

    def kill(self) -> None:
        self._lines.put("")

    def wait(self) -> None:
        pass


def replace_worker(monkeypatch: pytest.MonkeyPatch, start: Callable[..., Any]) -> None:
    monkeypatch.setattr(planning_process, "subprocess", SimpleNamespace(Popen=start, PIPE=subprocess.PIPE))


@pytest.fixture
def inline(monkeypatch: pytest.MonkeyPatch) -> None:
    replace_worker(monkeypatch, Inline)


@pytest.fixture
def hopeless(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let no plan be found."""

    class Hopeless(Inline):
        plan = staticmethod(refuse_request)

    replace_worker(monkeypatch, Hopeless)


@pytest.fixture
def expert() -> Iterator[FreeFlyerExpert]:
    made = make_expert("throw_and_catch")
    yield made
    made._background.close()


def make_expert(name: str, world: FreeFlyerScenario | None = None) -> FreeFlyerExpert:
    return FreeFlyerExpert(world or load(name), plan_of(name))


def want(memory: WorldMemory, k: int, times: tuple[float, ...]) -> None:
    """Let world k want a new plan, as `look_ahead` does, at some times."""
    if any(abs(memory.time[k] - time) < 1e-6 for time in times):
        memory.wanted[k] = min(memory.wanted[k], memory.time[k])


class Run:
    """An episode in which new plans are wanted at some times.

    Attributes:
        actions: shape (T, 3 r).
        taken: when the table changed [s].
        wanted: before every step, shape (T,).
        numbers: of requests so far, before every step, shape (T,).
    """

    def __init__(
        self,
        expert: FreeFlyerExpert,
        world: FreeFlyerScenario,
        times: tuple[float, ...] = (WANTED,),
        spoil: Spoil = lambda k, observations: None,
        seed: int = SEED,
        steps: int | None = None,
    ) -> None:
        env, memory = parallel_env(world), expert.memory
        observations, infos = env.reset(seed=seed)
        expert.reset(seed)
        actions, self.taken, wanted, numbers = [], list[float](), [], []
        for k in range(world.steps if steps is None else steps):
            want(memory, 0, times)
            wanted.append(memory.wanted[0])
            numbers.append(expert._background._numbers)
            spoil(k, observations)
            table, now = expert.table, float(memory.time[0])
            chosen = expert.act(observations)
            if expert.table is not table:
                self.taken.append(now)
            actions.append(np.concatenate([chosen[name] for name in world.agents]))
            observations, _, _, _, infos = env.step(chosen)
        self.actions, self.wanted, self.numbers = np.array(actions), np.array(wanted), np.array(numbers)
        self.success = bool(infos["snap"].get("success"))
        self.counts = dict(zip(COUNTERS, memory.counts[0].tolist(), strict=True))


@pytest.mark.parametrize("name", ["throw_and_catch", "pong"])
@pytest.mark.usefixtures("inline")
def test_asked_once_and_taken_over_two_seconds_later(name: str) -> None:
    expert, world = make_expert(name), load(name)
    run = Run(expert, world)
    assert run.taken == pytest.approx([WANTED + BACKGROUND.delay], abs=1e-9)
    assert run.numbers[-1] == 1
    assert (run.counts["planned_anew"], run.counts["no_plan"]) == (1, 0)
    assert run.success
    # Nothing is wanted until the answer had its time.
    times = world.control_period * np.arange(world.steps) - world.control_period  # of the last observation
    waiting = (times > WANTED + 1e-6) & (times < WANTED + BACKGROUND.delay + BACKGROUND.apart + 1e-6)
    assert (run.wanted[waiting] == -np.inf).all()
    assert (run.wanted[times > WANTED + BACKGROUND.delay + BACKGROUND.apart + 0.11] == np.inf).all()
    # The new table is one of the whole episode, in its time.
    assert expert.table.horizon == pytest.approx(world.horizon)
    assert (expert.table.impact["time"] > WANTED + BACKGROUND.delay).all()
    assert expert.table.breaks[:, 0] == pytest.approx(WANTED + BACKGROUND.delay)


@pytest.mark.usefixtures("inline")
def test_nobody_is_asked_where_nothing_is_wanted_or_planning_anew_is_off(expert: FreeFlyerExpert) -> None:
    run = Run(expert, load("throw_and_catch"), ())
    assert (run.taken, run.numbers[-1]) == ([], 0)
    off = FreeFlyerExpert(load("throw_and_catch"), plan_of("throw_and_catch"), options=replace(EXPERT, plan_anew=False))
    assert (Run(off, load("throw_and_catch")).taken, off._background._numbers) == ([], 0)


@pytest.mark.usefixtures("inline")
def test_asked_when_no_impact_is_near(expert: FreeFlyerExpert) -> None:
    """The first impact is at 9.7 s: at 7.5 s it is too near, 1.5 s after it the flight is known."""
    first = plan_of("throw_and_catch").impacts[0].time
    run = Run(expert, load("throw_and_catch"), (7.5,))
    (taken,) = run.taken
    assert first + TIMING.settle + BACKGROUND.delay - 1e-6 <= taken <= first + TIMING.settle + BACKGROUND.delay + 0.3


@pytest.mark.usefixtures("inline")
def test_nobody_is_asked_when_little_is_left(expert: FreeFlyerExpert) -> None:
    late = 30.0 - BACKGROUND.least_left + 0.5
    run = Run(expert, load("throw_and_catch"), (late,))
    assert (run.taken, run.numbers[-1], run.counts["no_plan"]) == ([], 0, 0)
    assert run.wanted[-1] == -np.inf


@pytest.mark.parametrize("answered", [True, False])
def test_asked_twice_at_most_with_time_between(answered: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[float] = []
    expert = make_expert("pong")

    class Counted(Inline):
        def write(self, line: str) -> None:
            asked.append(float(expert.memory.time[0]))
            super().write(line if answered else line.replace('"horizon"', '"horizont"'))

    if not answered:
        Counted.plan = staticmethod(refuse_request)
    replace_worker(monkeypatch, Counted)
    run = Run(expert, load("pong"), tuple(np.arange(WANTED, 90.0, 0.1)))
    assert len(asked) == BACKGROUND.most
    assert asked[0] == pytest.approx(WANTED)
    assert asked[1] >= asked[0] + BACKGROUND.delay + BACKGROUND.apart - 1e-6
    assert len(run.taken) == (BACKGROUND.most if answered else 0)
    assert run.counts["planned_anew" if answered else "no_plan"] == BACKGROUND.most


def refuse(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Let nothing remain to be done; return when it was tried."""
    tried: list[float] = []

    def make_remaining_scenario(scenario: object, now: float, *rest: object) -> None:
        tried.append(now)
        raise InputError("nothing remains")

    monkeypatch.setattr(background, "make_remaining_scenario", make_remaining_scenario)
    return tried


@pytest.mark.usefixtures("inline")
def test_what_cannot_be_asked_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    tried, expert = refuse(monkeypatch), make_expert("pong")
    run = Run(expert, load("pong"))
    assert tried == pytest.approx([WANTED + BACKGROUND.delay])
    assert (run.taken, run.numbers[-1], run.counts["no_plan"]) == ([], 0, 1)
    assert run.success


@pytest.mark.usefixtures("inline")
def test_what_cannot_be_asked_is_not_tried_more_than_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    tried, expert = refuse(monkeypatch), make_expert("pong")
    Run(expert, load("pong"), tuple(np.arange(WANTED, 90.0, 0.1)))
    assert len(tried) == BACKGROUND.most


@pytest.mark.parametrize("name", ["throw_and_catch", "pong"])
def test_same_seed_same_actions_bit_for_bit(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Planned twice by a process, and once by this one."""
    world = load(name).suite("all")
    expert = make_expert(name, world)
    runs = [Run(expert, world) for _ in range(2)]
    assert expert._background._numbers == 2
    expert._background.close()
    replace_worker(monkeypatch, Inline)
    runs.append(Run(make_expert(name, world), world))
    assert runs[0].taken == pytest.approx([WANTED + BACKGROUND.delay])
    for run in runs[1:]:
        np.testing.assert_array_equal(run.actions, runs[0].actions)
        assert (run.taken, run.counts) == (runs[0].taken, runs[0].counts)
    before = round((WANTED + BACKGROUND.delay) / world.control_period)
    without = Run(make_expert(name, world), world, ())
    np.testing.assert_array_equal(without.actions[:before], runs[0].actions[:before])
    assert np.abs(without.actions - runs[0].actions).max() > 1e-3


@pytest.mark.parametrize(("name", "threads"), [("throw_and_catch", 1), ("throw_and_catch", 2), ("pong", 1)])
@pytest.mark.usefixtures("inline")
def test_single_and_batch_agree(name: str, threads: int) -> None:
    """Worlds 0 and 2 are planned anew at different times, world 1 is not."""
    world, count = load(name).suite("all"), 3
    times = ((WANTED,), (), (WANTED + 0.7,))
    vector = vector_env(world, num_envs=count, threads=1)
    batch = FreeFlyerExpertBatch(world, plan_of(name), count, threads=threads)
    joint, _ = vector.reset(seed=SEED)
    runs = [Run(make_expert(name, world), world, times[k], seed=SEED + k) for k in range(count)]
    for step in range(world.steps):
        for k in range(count):
            want(batch.memory, k, times[k])
        actions = batch.act(joint)
        for k, run in enumerate(runs):
            np.testing.assert_allclose(actions[k], run.actions[step], rtol=0, atol=1e-9)
        joint = vector.step(actions)[0]
    for k, run in enumerate(runs):
        assert {name: int(number[k]) for name, number in batch.counts.items()} == run.counts
    assert [run.counts["planned_anew"] for run in runs] == [1, 0, 1]
    batch.close()


def kill_at(expert: FreeFlyerExpert, time: float) -> Spoil:
    def kill(k: int, observations: dict[str, np.ndarray]) -> None:
        if abs(expert.memory.time[0] - time) < 1e-6:
            for pid in expert._background._processes.pids:
                os.kill(pid, signal.SIGKILL)

    return kill


SLOWLY = """
import sys, time
from planners.free_flyer.closed_loop.planning_process import answer_requests
def read():
    for line in sys.stdin:
        time.sleep(1.0)
        yield line
answer_requests(read(), sys.stdout)
"""


def test_how_its_process_fares_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """One is killed while it plans, so that another is asked; one takes a second longer."""
    world, runs = load("throw_and_catch"), []
    for killed_at, code in ((-1.0, None), (WANTED + 0.1, None), (-1.0, SLOWLY)):
        if code:
            speak(monkeypatch, code)
        expert = make_expert("throw_and_catch")
        runs.append(Run(expert, world, (WANTED,), kill_at(expert, killed_at)))
        expert._background.close()
    assert runs[0].counts["planned_anew"] == 1
    for run in runs[1:]:
        assert (run.taken, run.counts) == (runs[0].taken, runs[0].counts)
        np.testing.assert_array_equal(run.actions, runs[0].actions)


@pytest.mark.usefixtures("hopeless")
def test_no_plan_is_counted_and_changes_nothing(expert: FreeFlyerExpert) -> None:
    world = load("throw_and_catch").suite("all")
    run, without = Run(expert, world), Run(make_expert("throw_and_catch"), world, ())
    assert (run.taken, run.counts["no_plan"], run.counts["planned_anew"]) == ([], 1, 0)
    np.testing.assert_array_equal(run.actions, without.actions)


def speak(monkeypatch: pytest.MonkeyPatch, code: str) -> None:
    """Let the process run something else."""
    start = subprocess.Popen
    replace_worker(monkeypatch, lambda arguments, **options: start([sys.executable, "-c", code], **options))


def test_process_that_died_between_two_questions_is_replaced(monkeypatch: pytest.MonkeyPatch) -> None:
    speak(monkeypatch, "import sys\nfor line in sys.stdin: print(line, end='', flush=True)")
    processes, pids = PlanningProcesses(1, patience=60.0), set()
    for number in (1, 2):
        processes.ask(number, json.dumps({"number": number}) + "\n")
        assert processes.wait_for(number) == {"number": number}
        (pid,) = processes.pids
        pids.add(pid)
        os.kill(pid, signal.SIGKILL)
    assert len(pids) == 2
    processes.close()


@pytest.mark.parametrize("code", ["", "import sys; sys.stdin.readline()"])
def test_process_that_ends_without_an_answer_loses_the_plan(
    expert: FreeFlyerExpert, monkeypatch: pytest.MonkeyPatch, code: str
) -> None:
    speak(monkeypatch, code)
    run = Run(expert, load("throw_and_catch"))
    assert (run.taken, run.counts["lost_plan"], run.counts["no_plan"]) == ([], 1, 0)
    assert run.success


@pytest.mark.parametrize("words", ['{"number": 1, "plan": "{', "a word of the solver"])
def test_process_that_dies_within_its_answer_is_no_plan(
    expert: FreeFlyerExpert, monkeypatch: pytest.MonkeyPatch, words: str
) -> None:
    speak(monkeypatch, f"import sys; sys.stdin.readline(); sys.stdout.write({words!r})")
    run = Run(expert, load("throw_and_catch"))
    assert (run.taken, run.counts["lost_plan"], run.counts["no_plan"]) == ([], 1, 0)
    assert run.success


def repeat(memory: WorldMemory, count: int) -> WorldMemory:
    """Return the memory of many worlds that are all like the only one."""
    return WorldMemory(*(np.repeat(table, count, axis=0) for table in memory))


@pytest.mark.parametrize("count", [10, 200])
def test_many_worlds_may_ask_before_the_first_answer_is_read(
    expert: FreeFlyerExpert, monkeypatch: pytest.MonkeyPatch, count: int
) -> None:
    """Questions and answers together are more than pipes hold."""
    speak(
        monkeypatch,
        "import json, sys\n"
        "for line in sys.stdin:\n"
        "    refusal = {'plan': None, 'failure': 'no_plan', 'more': 6000 * ' '}\n"
        "    print(json.dumps({'number': json.loads(line)['number'], **refusal}), flush=True)",
    )
    Run(expert, load("throw_and_catch"), (), steps=round(WANTED / 0.1) + 1)
    memory, asking = repeat(expert.memory, count), Background(load("throw_and_catch"))
    memory.wanted[:] = memory.time
    over = threading.Event()

    def ask() -> None:
        for k in range(count):
            if not over.is_set():
                asking.poll_plan(expert.table, memory, k)

    thread = threading.Thread(target=ask, daemon=True)
    thread.start()
    thread.join(60.0)  # which a busy machine may need
    stuck = thread.is_alive()
    if stuck:
        over.set()
        asking.close()
        thread.join(10.0)
    assert not stuck
    memory.time[:] += BACKGROUND.delay
    for k in range(count):
        assert asking.poll_plan(expert.table, memory, k) is None
    assert (memory.counts["no_plan"] == 1).all()
    asking.close()


@pytest.mark.usefixtures("inline")
def test_question_that_was_given_up_does_no_harm(expert: FreeFlyerExpert) -> None:
    world = load("throw_and_catch").suite("all")
    fresh = Run(make_expert("throw_and_catch"), world, (WANTED + 0.5,), seed=SEED + 1)
    Run(expert, world, steps=round(WANTED / 0.1) + 5)
    assert expert._background._pending
    again = Run(expert, world, (WANTED + 0.5,), seed=SEED + 1)
    np.testing.assert_array_equal(again.actions, fresh.actions)
    assert (again.taken, again.counts) == (fresh.taken, fresh.counts)
    assert len(again.taken) == 1


@pytest.mark.usefixtures("inline")
@pytest.mark.parametrize("asked", [True, False])
def test_batch_forgets_what_was_wanted_before_a_new_episode(asked: bool) -> None:
    """The first episode ends after the question, or where one would be asked next."""
    world, plan = load("throw_and_catch").suite("all"), plan_of("throw_and_catch")
    batch, fresh = (FreeFlyerExpertBatch(world, plan, 1) for _ in range(2))
    vector = vector_env(world, num_envs=1, threads=1)
    joint, _ = vector.reset(seed=SEED)
    for _ in range(round(WANTED / 0.1) + 1 + 5 * asked):
        want(batch.memory, 0, (WANTED,) if asked else ())
        joint = vector.step(batch.act(joint))[0]
    batch.memory.wanted[0] = -np.inf if asked else WANTED
    joint, _ = vector.reset(seed=SEED + 1)
    for _ in range(world.steps):
        actions = batch.act(joint)
        np.testing.assert_array_equal(actions, fresh.act(joint))
        joint = vector.step(actions)[0]
    assert batch.counts["planned_anew"][0] == batch.counts["no_plan"][0] == 0


def exists(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def test_close_leaves_no_process(expert: FreeFlyerExpert) -> None:
    world, plan = load("throw_and_catch"), plan_of("throw_and_catch")
    Run(expert, world, steps=round(WANTED / 0.1) + 5)
    batch, lost = FreeFlyerExpertBatch(world, plan, 1), make_expert("throw_and_catch")
    Run(lost, world, steps=round(WANTED / 0.1) + 5)
    joint, _ = vector_env(world, num_envs=1, threads=1).reset(seed=SEED)
    batch.act(joint)
    batch._background._processes.ask(1, request(1))
    pids = [pid for owner in (expert, batch, lost) for pid in owner._background._processes.pids]
    assert [exists(pid) for pid in pids] == [True] * 3
    expert._background.close()
    batch.close()
    del lost
    gc.collect()
    assert [exists(pid) for pid in pids] == [False] * 3
    expert._background.close()
    batch.close()


def request(number: int, work: float = BACKGROUND.work, **values: object) -> str:
    scenario = load("throw_and_catch").override(values)
    asked = {"number": number, "scenario": scenario.model_dump(mode="json"), "impacts": 2, "work": work, "nodes": 300}
    return json.dumps(asked) + "\n"


def test_requests_are_answered_line_by_line() -> None:
    away = {"objects.pop.start_velocity": [0.5, 0.5]}
    answers = StringIO()
    answer_requests(StringIO(request(3) + request(5, **away)), answers)
    found = [json.loads(line) for line in answers.getvalue().splitlines()]
    assert [line["number"] for line in found] == [3, 5]
    assert (found[1]["plan"], found[1]["failure"]) == (None, "no_plan")
    assert found[0]["failure"] is None
    plan = Plan.from_json(found[0]["plan"])
    assert plan.validated
    assert plan.horizon == 30.0
    assert set(plan.objects) == {"pop"}


def test_no_requests_no_answers() -> None:
    answers = StringIO()
    answer_requests(StringIO(""), answers)
    assert answers.getvalue() == ""


def test_requests_without_an_answer_are_null(monkeypatch: pytest.MonkeyPatch) -> None:
    failures = {"no_plan": (Infeasible("plan", "no", "none"), InputError("no")), "late_plan": (OutOfWork(),)}
    for failure, error in [(failure, error) for failure, errors in failures.items() for error in errors]:

        def fail(*arguments: object, error: Exception = error) -> None:
            raise error

        monkeypatch.setattr(planning_process, "plan_rest", fail)
        answers = StringIO()
        answer_requests(StringIO(request(7)), answers)
        assert json.loads(answers.getvalue()) == {"number": 7, "plan": None, "failure": failure}


def test_a_plan_that_takes_too_much_work_is_late_whatever_the_time() -> None:
    """Half of the work that the plan needs is not enough, one unit more than it needs is."""
    spent = Work()
    plan_rest(FreeFlyerScenario.model_validate(json.loads(request(1))["scenario"]), 2, spent)
    answers = StringIO()
    answer_requests(StringIO(request(1, spent.done / 2) + request(2, spent.done + 1.0)), answers)
    late, found = (json.loads(line) for line in answers.getvalue().splitlines())
    assert (late["plan"], late["failure"]) == (None, "late_plan")
    assert (found["plan"] is None, found["failure"]) == (False, None)


def test_a_late_plan_is_counted_and_the_old_one_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    replace_worker(monkeypatch, Inline)
    hasty = replace(EXPERT, background=replace(BACKGROUND, work=1.0))
    expert = FreeFlyerExpert(load("throw_and_catch"), plan_of("throw_and_catch"), options=hasty)
    run = Run(expert, load("throw_and_catch"))
    assert (run.taken, run.counts["late_plan"], run.counts["no_plan"]) == ([], 1, 0)
    assert run.success


def test_many_processes_give_the_answers_of_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """A slow one among them, too; questions that are given up are thrown away."""
    slow = "if json.loads(line)['number'] % 3 == 0: time.sleep(0.3)"
    reply = "print(json.dumps({'number': json.loads(line)['number'], 'plan': line, 'failure': None}), flush=True)"
    speak(monkeypatch, f"import json, sys, time\nfor line in sys.stdin:\n    {slow}\n    {reply}")
    asked = {number: json.dumps({"number": number, "square": number * number}) + "\n" for number in range(1, 10)}
    for most in (1, 3):
        processes = PlanningProcesses(most, patience=60.0)
        for number, question in asked.items():
            processes.ask(number, question)
        assert len(processes.pids) == most
        processes.forget(4)
        for number in (9, 1, 5, 2, 8, 3, 7, 6):
            assert processes.wait_for(number)["plan"] == asked[number]
        pids = processes.pids
        processes.close()
        assert not any(exists(pid) for pid in pids)


def test_a_silent_process_is_given_up_and_its_question_lost_after_a_second(monkeypatch: pytest.MonkeyPatch) -> None:
    speak(monkeypatch, "import sys; sys.stdin.read()")
    processes = PlanningProcesses(1, patience=0.05)
    processes.ask(1, "{}\n")
    assert processes.wait_for(1) == {"number": 1, "plan": None, "failure": "lost_plan"}
    assert processes.pids == []


class Forced:
    """The expert that wants a new plan."""

    name = "forced"

    def __init__(self, expert: FreeFlyerExpert, *times: float) -> None:
        self._expert, self._times = expert, times

    def reset(self, seed: int) -> None:
        self._expert.reset(seed)

    def act(self, observations: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        want(self._expert.memory, 0, self._times)
        return self._expert.act(observations)

    def diagnostics(self) -> object:
        return self._expert.diagnostics()


@pytest.mark.usefixtures("inline")
@pytest.mark.parametrize(("times", "anew"), [((), 0), ((WANTED,), 1)])
def test_episode_says_how_often_what_is_left_was_optimised(times: tuple[float, ...], anew: int) -> None:
    expert = make_expert("pong")
    episode = rollout(parallel_env(load("pong")), Forced(expert, *times), SEED)  # type: ignore[arg-type]
    counts = dict(zip(COUNTERS, expert.memory.counts[0].tolist(), strict=True))
    assert episode.reoptimised == {"same_sequence": counts["reoptimised"], "free_sequence": anew}
    assert episode.reoptimised["same_sequence"] >= 3
    assert episode.fallbacks == {}


@pytest.mark.usefixtures("inline")
@pytest.mark.parametrize("part", [slice(None), slice(14, 21), slice(-3, None)])
@pytest.mark.parametrize("since", [-1.0, WANTED - 0.5])
def test_rubbish_while_a_plan_is_made_never_raises(expert: FreeFlyerExpert, part: slice, since: float) -> None:
    """Nothing, no object or no time is seen from some time on until after the plan is taken over."""

    def spoil(k: int, observations: dict[str, np.ndarray]) -> None:
        if since <= 0.1 * k <= WANTED + BACKGROUND.delay + 0.5:
            for vector in observations.values():
                vector[part] = np.nan

    run = Run(expert, load("throw_and_catch"), (WANTED,), spoil)
    assert (np.abs(run.actions) <= 1.0).all()
    assert run.counts["planned_anew"] + run.counts["no_plan"] <= 1


@pytest.mark.parametrize("period", [0.1, 0.2, 0.25])
def test_past_is_what_was_seen_every_half_second(period: float, monkeypatch: pytest.MonkeyPatch) -> None:
    world = load("throw_and_catch").override({"control_period": period})
    assert isinstance(world, FreeFlyerScenario)
    found: list[tuple[np.ndarray, dict[str, np.ndarray]]] = []

    def keep(scenario: object, now: float, positions: object, velocities: object, past: Any) -> None:
        found.append(past)
        raise InputError("seen enough")

    monkeypatch.setattr(background, "make_remaining_scenario", keep)
    expert = FreeFlyerExpert(world, plan_of("throw_and_catch"))
    track: list[np.ndarray] = []

    def see(k: int, observations: dict[str, np.ndarray]) -> None:
        track.append(observations["snap"][:2].copy())

    Run(expert, world, (WANTED,), see)
    times, tracks = found[0]
    np.testing.assert_allclose(times, [*np.arange(0.0, WANTED + 0.1, PAST_PERIOD), WANTED + BACKGROUND.delay])
    shown = np.array(track)[np.rint(times[:-1] / period).astype(int)]
    np.testing.assert_allclose(tracks["snap"][:-1], shown, atol=0.05)


@pytest.mark.usefixtures("inline")
def test_adopting_keeps_what_was_learned_and_starting_forgets_it(expert: FreeFlyerExpert) -> None:
    world = load("throw_and_catch").override({"true.restitution": 0.5})
    assert isinstance(world, FreeFlyerScenario)
    Run(expert, world, (), steps=150)
    memory, now, strike = expert.memory, float(expert.memory.time[0]), expert.memory.strike[0, 0]
    set_fields(strike, insertions=3, is_inserted=True)
    kept = (
        "filter",
        "heading",
        "sensor",
        "felt",
        "hit",
        "pair_mean",
        "pair_covariance",
        "velocity_error",
        "past",
        "time",
        "touch",
        "push",
    )
    before = {name: getattr(memory, name).copy() for name in memory._fields}
    counts = dict(zip(COUNTERS, before["counts"][0], strict=True))
    adopt_world(expert.table, memory, OPTIONS, 0)
    for name in kept:
        np.testing.assert_array_equal(getattr(memory, name), before[name], err_msg=name)
    assert strike["index"] == expert.table.first[0]
    assert (strike["insertions"], strike["is_inserted"]) == (0, False)
    assert strike["last_contact"] == strike["optimised_at"] == now - TIMING.settle  # its flight is known already
    assert strike["time"] > now
    after = dict(zip(COUNTERS, memory.counts[0], strict=True))
    assert after == counts | {"replans": counts["replans"] + 2}  # each robot's way into the new plan
    fresh = make_expert("throw_and_catch").memory
    assert not np.array_equal(memory.pair_mean, fresh.pair_mean)
    memory.wanted[0] = 3.0
    start_world(expert.table, memory, OPTIONS, 0)
    for name in ("time", "strike", "hit", "pair_mean", "pair_covariance", "clock", "place", "wanted", "counts", "push"):
        np.testing.assert_array_equal(getattr(memory, name), getattr(fresh, name), err_msg=name)


def test_script_that_begins_later_is_the_same_one_later() -> None:
    world, plan = load("pong"), plan_of("pong")
    early, late = make_plan_table(world, plan), make_plan_table(world, plan, 7.5)
    np.testing.assert_allclose(late.impact["time"], early.impact["time"] + 7.5)
    np.testing.assert_allclose(late.breaks, early.breaks + 7.5)
    for name in ("opens", "closes"):
        np.testing.assert_allclose(late.knot[name], early.knot[name] + 7.5)
    assert late.horizon == early.horizon + 7.5
    np.testing.assert_array_equal(late.coefficients, early.coefficients)
    assert late.impact[-1]["time"] > 0.0
    assert NO_IMPACT not in late.first


def find_process(expert: FreeFlyerExpert) -> Any:
    (worker,) = expert._background._processes._workers
    return worker.process


def flatten(observations: dict[str, np.ndarray]) -> list[bytes]:
    return [values.tobytes() for values in observations.values()]


@pytest.mark.usefixtures("inline")
@pytest.mark.parametrize("make", [copy.deepcopy, lambda thing: pickle.loads(pickle.dumps(thing))])
def test_a_copy_asks_for_what_is_pending(expert: FreeFlyerExpert, make: Callable[[Any], Any]) -> None:
    world, memory, seen = load("throw_and_catch").suite("all"), expert.memory, []
    env = parallel_env(world)
    observations, _ = env.reset(seed=SEED)
    expert.reset(SEED)
    for k in range(world.steps):
        want(memory, 0, (WANTED,))
        if k == round(WANTED / 0.1) + 5:
            assert expert._background._pending
            before = make((expert, env, observations))
            asked = len(find_process(expert).asked)
        observations = env.step(expert.act(observations))[0]
        seen.append(flatten(observations))
    copied, env, observations = before
    for k in range(round(WANTED / 0.1) + 5, world.steps):
        observations = env.step(copied.act(observations))[0]
        assert flatten(observations) == seen[k]
    assert copied.memory.counts["planned_anew"][0] == memory.counts["planned_anew"][0] == 1
    assert find_process(copied).asked == find_process(expert).asked[asked - 1 :]
    copied._background.close()


ENDS = {
    "end": "pass",
    "exit": "sys.exit(0)",
    "error": "raise ValueError('of the user')",
    "cycle": "expert.itself = expert",
    "forgotten": "del expert",
}


@pytest.fixture(scope="module")
def programs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Run a program for each end, with its output and exit code in a folder of that name.

    Importing the planner takes a second: one process does, and becomes each of the programs by a fork.
    """
    folder = tmp_path_factory.mktemp("programs")
    code = f"""
import os, sys
from planners.free_flyer.closed_loop.planning_process import PlanningProcesses
ends = [(name, busy, end) for name, end in {ENDS!r}.items() for busy in (True, False)]
for name, busy, end in ends:
    child = os.fork()
    if child == 0:
        break
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    print(code, file=open(f"{{name}}-{{busy}}.code", "w"))
else:
    sys.exit()
for stream, kind in ((1, "out"), (2, "err")):
    os.dup2(os.open(f"{{name}}-{{busy}}.{{kind}}", os.O_WRONLY | os.O_CREAT), stream)
expert = type("Expert", (), dict())()
expert.processes = PlanningProcesses(1, 60.0)
expert.processes.ask(1, {request(1)!r}) if busy else expert.processes._choose_worker()
print(*expert.processes.pids, flush=True)
exec(end)
"""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    subprocess.run([sys.executable, "-c", code], cwd=folder, env=environment, timeout=300, check=True)
    return folder


@pytest.mark.parametrize("busy", [True, False])
@pytest.mark.parametrize("end", ENDS)
def test_a_program_ends_with_its_own_code(end: str, busy: bool, programs: Path) -> None:
    """Whatever its planning process does when it ends, and however it ends."""
    code, out, err = ((programs / f"{end}-{busy}.{kind}").read_text() for kind in ("code", "out", "err"))
    assert int(code) == (1 if end == "error" else 0), err
    assert ("of the user" in err) if end == "error" else not err
    assert not exists(int(out))


def test_the_process_does_not_outlive_a_killed_owner() -> None:
    """While it plans, too."""
    slow = json.loads(request(1))
    slow |= {"work": 1e9, "scenario": load("crew").model_dump(mode="json"), "impacts": 8}
    code = f"""
import os, signal
from planners.free_flyer.closed_loop.planning_process import PlanningProcesses
processes = PlanningProcesses(1, 60.0)
processes.ask(1, {json.dumps(slow) + chr(10)!r})
print(*processes.pids, flush=True)
input()
"""
    owner = subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    worker = int(cast(TextIO, owner.stdout).readline())
    time.sleep(2.0)  # until it plans
    assert exists(worker)
    owner.kill()
    owner.communicate()
    until = time.monotonic() + 60.0  # it may still be starting, on a busy machine
    while exists(worker) and time.monotonic() < until:
        time.sleep(0.05)
    assert not exists(worker)

"""Planning that is interrupted ends with the best it has, and never with a proof."""

from __future__ import annotations

import signal
import threading

import numpy as np
import pytest

from planners import make_plan
from planners.budget import Budget, Clock, read_clock, use_clock, watch_planning
from planners.errors import Infeasible, SolverFailed
from planners.solvers import solve
from tests.planners.test_budget import make_knapsack
from train.cli.progress import stop_on_interrupt


def test_what_is_stopped_before_it_has_anything_proves_nothing():
    clock = Clock()
    clock.stop()
    with use_clock(clock), pytest.raises(SolverFailed, match="until it was interrupted") as failure:
        make_plan("pong")
    assert not isinstance(failure.value, Infeasible)


def test_impacts_that_were_found_become_a_plan():
    clock = Clock()

    def tell(budget: Budget, stage: str | None) -> None:
        if stage == "smoothing":
            clock.stop()

    with use_clock(clock), watch_planning(tell):
        plan = make_plan("throw_and_catch")
    assert clock.stopped
    assert plan.validated
    assert plan.robustness == pytest.approx(0.25, abs=1e-6)


def test_a_stopped_clock_is_later_than_every_limit():
    clock = Clock()
    with use_clock(clock):
        budget = Budget(1e6)
        assert budget.left > 0.0
        before = read_clock()
        clock.stop()
        assert budget.left < 0.0
        assert Budget(1e6).left < 0.0
        assert read_clock() > before + 1e6
        assert budget.seconds < 60.0
    assert Budget(1e6).left > 0.0


def test_a_solver_looks_at_the_clock_while_it_searches():
    """The clock is an hour later with each reading; the best point so far is kept."""
    hours = iter(range(10**9))
    with use_clock(Clock(lambda: 3600.0 * next(hours))):
        rough = solve(make_knapsack(), 3600.0 * 20, relative_gap=0.0)
    best = solve(make_knapsack(), np.inf)
    assert best.bound <= best.objective <= rough.objective


def test_ctrl_c_stops_once_and_interrupts_twice():
    before = signal.getsignal(signal.SIGINT)
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs ignore it
    try:
        with stop_on_interrupt() as clock:
            signal.raise_signal(signal.SIGINT)
            assert clock.stopped
            with pytest.raises(KeyboardInterrupt):
                signal.raise_signal(signal.SIGINT)
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)


def test_ctrl_c_reaches_python_within_a_solution():
    """Without a handler of its own a search is left at once, not at its end."""
    before = signal.getsignal(signal.SIGINT)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    timer = threading.Timer(0.2, signal.raise_signal, [signal.SIGINT])
    timer.start()
    try:
        with pytest.raises(KeyboardInterrupt):
            solve(make_knapsack(60), 300.0, relative_gap=0.0)
    finally:
        timer.cancel()
        signal.signal(signal.SIGINT, before)

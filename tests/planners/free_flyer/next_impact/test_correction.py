"""A learner's correction scales, turns and shifts an impact as documented, as far as it promises enough."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from impact_envs import load_scenario, parallel_env
from planners.free_flyer.belief.options import EXPERT, Options, make_record
from planners.free_flyer.expert import FreeFlyerExpert
from planners.free_flyer.next_impact.correction import correct_change, move_time, predict_margin
from planners.plan import Plan
from tests.frozen.freeze import get_plan

OPTIONS, SEED = make_record(EXPERT)[0], 1_000_000
WHOLE = replace(EXPERT, filter=False)
NUMBERS = EXPERT.correction
LOUD = (1.0, 1.0, 0.0)


@cache
def plan_of(name: str) -> Plan:
    plan = get_plan(name, "nominal")
    assert plan is not None
    return plan


def run_until_due(name: str, options: Options = EXPERT, number: int = 1) -> tuple[FreeFlyerExpert, int]:
    """Play the expert up to where its number-th correction is due; return it and the object of that."""
    scenario = load_scenario(name)
    env, expert = parallel_env(scenario), FreeFlyerExpert(scenario, plan_of(name), options=options)
    observations, _ = env.reset(seed=SEED)
    expert.observe(observations)
    while True:
        if expert.awaiting_correction:
            number -= 1
            if number == 0:
                return expert, int(expert._due[0])
        observations, *_ = env.step(expert.control())
        expert.observe(observations)


def predict(expert: FreeFlyerExpert, o: int, scale: float, turn: float, shift: float) -> float:
    """Return the margin that a share of a correction promises [m]."""
    time = move_time(expert.table, expert.memory, OPTIONS, 0, o, shift)
    return predict_margin(expert.table, expert.memory, OPTIONS, 0, o, scale, turn, time)


@pytest.mark.parametrize(("scale", "turn"), [(0.0, 0.0), (1.0, 0.0), (-0.5, 0.0), (0.0, 1.0), (0.4, -0.7)])
def test_the_wished_change_is_scaled_and_turned(scale: float, turn: float) -> None:
    change = 0.3 - 0.4j
    found = complex(*correct_change(OPTIONS, scale, turn, change.real, change.imag))
    assert found == pytest.approx(change * np.exp(NUMBERS.scale * scale + 1j * NUMBERS.turn * turn), abs=1e-15)


def read_memory(expert: FreeFlyerExpert) -> dict[str, str]:
    """Return all that an expert remembers, by its name."""
    tables = expert.memory._asdict().items()
    found = {f"{name}.{field}": table[field] for name, table in tables for field in table.dtype.names or ()}
    found |= {name: table for name, table in tables if not table.dtype.names}
    return {name: repr(values.tolist()) for name, values in found.items()}


@pytest.mark.parametrize("name", ["pong", "pingpong", "relay", "corridor"])
def test_a_small_shift_moves_every_impact_by_little(name: str) -> None:
    """However near an impact is: what a policy explores around zero are small changes of the expert."""
    for number in range(1, 1 + len(plan_of(name).impacts)):
        expert, o = run_until_due(name, number=number)
        time = float(expert.memory.strike[0, o]["time"])
        for shift in (-1e-6, 1e-6):
            moved = move_time(expert.table, expert.memory, OPTIONS, 0, o, shift)
            assert abs(moved - time) <= NUMBERS.shift * 1e-6 * (1 + 1e-6)


def test_zero_changes_nothing_but_that_it_was_asked_for() -> None:
    expert, _ = run_until_due("throw_and_catch")
    before = read_memory(expert)
    expert.correct(np.zeros(3))
    after = read_memory(expert)
    assert {name for name in after if after[name] != before[name]} <= {"strike.is_decided", "strike.replanned_at"}


@pytest.mark.parametrize("shift", [-0.5, -0.25, 0.5, 1.0])
def test_a_shift_moves_the_impact_where_nothing_forbids_it(shift: float) -> None:
    expert, o = run_until_due("pong", WHOLE)
    strike = expert.memory.strike[0, o]
    before, index = float(strike["time"]), int(strike["index"])
    expert.correct(np.array([0.0, 0.0, shift]))
    assert strike["time"] == pytest.approx(before + NUMBERS.shift * shift, abs=1e-12)
    assert strike["shift"] == shift
    assert expert.memory.clock[0, index] == strike["time"]
    assert (np.diff(expert.memory.clock[0, : len(expert.plan.impacts)]) > 0.0).all()


def test_a_shift_that_no_robot_can_fly_leaves_the_time() -> None:
    """Two seconds earlier than as soon as possible."""
    expert, o = run_until_due("corridor", WHOLE)
    strike = expert.memory.strike[0, o]
    before = float(strike["time"])
    expert.correct(np.array([0.0, 0.0, -1.0]))
    assert (strike["time"], strike["shift"]) == (before, 0.0)


@pytest.mark.parametrize("name", ["throw_and_catch", "pong", "corridor"])
@pytest.mark.parametrize("shift", np.linspace(-1.0, 1.0, 9).tolist())
def test_an_impact_is_moved_neither_out_of_its_window_nor_onto_another(name: str, shift: float) -> None:
    for number in (1, 2):
        expert, o = run_until_due(name, WHOLE, number)
        strike, now = expert.memory.strike[0, o], float(expert.memory.time[0])
        old, knot = float(strike["time"]), expert.table.knot[int(strike["index"])]
        time = move_time(expert.table, expert.memory, OPTIONS, 0, o, shift)
        assert time == strike["time"] == old or abs(time - old) <= NUMBERS.shift * abs(shift) + 1e-12
        if time != old:
            assert time >= now + NUMBERS.notice
            assert knot["opens"] <= time <= knot["closes"]
            after = expert.table.impact[int(strike["index"])]["next"]
            due = expert.memory.clock[0, after] if after >= 0 else expert.plan.horizon
            assert time <= due - EXPERT.reoptimisation.gap or time < old


@pytest.mark.parametrize("name", ["throw_and_catch", "pong", "corridor"])
@pytest.mark.parametrize("correction", [LOUD, (-1.0, 0.5, 0.0), (1.0, -1.0, 1.0), (0.3, -0.2, 0.5)])
def test_the_greatest_share_that_promises_enough_is_taken(name: str, correction: tuple[float, float, float]) -> None:
    expert, o = run_until_due(name)
    strike = expert.memory.strike[0, o]
    least, before = predict(expert, o, 0.0, 0.0, 0.0) - NUMBERS.margin, float(strike["time"])
    enough = [
        k
        for k in range(1, NUMBERS.shares + 1)
        if predict(expert, o, *(k / NUMBERS.shares * c for c in correction)) >= least
    ]
    share = max(enough, default=0) / NUMBERS.shares
    time = move_time(expert.table, expert.memory, OPTIONS, 0, o, share * correction[2])
    expert.correct(np.array(correction))
    assert (strike["scale"], strike["turn"]) == (share * correction[0], share * correction[1])
    assert strike["time"] == time
    assert strike["shift"] == (share * correction[2] if time != before else 0.0)
    assert expert.diagnostics().fallbacks.get("filtered", 0) == (share < 1.0)


@pytest.mark.parametrize("name", ["throw_and_catch", "pong", "corridor"])
def test_what_is_taken_promises_hardly_less_and_a_loud_correction_is_cut(name: str) -> None:
    expert, o = run_until_due(name)
    own = predict(expert, o, 0.0, 0.0, 0.0)
    assert predict(expert, o, *LOUD) < own - NUMBERS.margin
    expert.correct(np.array(LOUD))
    strike = expert.memory.strike[0, o]
    assert 0.0 < strike["scale"] < 1.0
    assert strike["scale"] == strike["turn"]
    assert (NUMBERS.shares * strike["scale"]).is_integer()
    assert predict(expert, o, *strike[["scale", "turn", "shift"]].tolist()) >= own - NUMBERS.margin
    assert expert.diagnostics().fallbacks["filtered"] == 1


def test_without_the_filter_everything_is_taken_whole() -> None:
    expert, o = run_until_due("pong", WHOLE)
    expert.correct(np.array([1.0, -1.0, 1.0]))
    assert expert.memory.strike[0, o][["scale", "turn", "shift"]].tolist() == (1.0, -1.0, 1.0)
    assert "filtered" not in expert.diagnostics().fallbacks


def test_with_a_wide_margin_too() -> None:
    wide = replace(EXPERT, correction=replace(NUMBERS, margin=100.0))
    expert, o = run_until_due("pong", wide)
    expert.correct(np.array(LOUD))
    assert expert.memory.strike[0, o]["scale"] == 1.0
    assert "filtered" not in expert.diagnostics().fallbacks


def test_a_prediction_changes_nothing() -> None:
    expert, o = run_until_due("pong")
    before = read_memory(expert)
    assert math.isfinite(predict(expert, o, 0.7, -0.7, 1.0))
    assert read_memory(expert) == before

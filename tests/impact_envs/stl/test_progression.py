"""What is left of a formula holds on what comes if and only if the formula holds on all of it."""

import numpy as np
import pytest

from impact_envs.errors import FormulaError
from impact_envs.stl import Formula, Trace, parse, satisfied
from impact_envs.stl.progression import progress_formula

FORMULAS = [
    "G[0,12] a.x <= 1.2",
    "F[0,12] a.x >= 0.9",
    "G[8,8] a.x <= 0.5 & F[2,5] a.y >= 0.3",
    "F[2,4] a.x >= 0.7 | G[6,9] a.y <= 0.6",
    "G[0,6] F[0,4] a.x >= 0.4",
    "G[1,5] F[2,6] a.x >= 0.4",
    "F[0,6] G[0,3] a.x >= 0",
    "a.x <= 1 U[2,9] a.y >= 0.8",
    "F[1,3] (a.x >= 0.3 & F[2,5] a.y >= 0.3)",
    "G[0,5] (a.x >= 0.9 -> F[1,4] a.y >= 0)",
    "not (a.x >= -0.8 U[1,8] a.y >= 0.5)",
    "G[0,3] F[1,5] G[0,2] a.x >= -0.4",
]
PERIOD, SAMPLES = 0.5, 31


def draw(seed: int, count: int = SAMPLES) -> Trace:
    """Return a signal of waves, of which each formula holds now and then."""
    rng, times = np.random.default_rng(seed), PERIOD * np.arange(count)
    waves = [np.sin(rng.uniform(0.3, 1.5) * times + rng.uniform(0, 6.3)) * rng.uniform(0.5, 1.3) for _ in range(2)]
    return Trace({"a.x": waves[0], "a.y": waves[1]}, PERIOD)


def cut(trace: Trace, first: int, last: int) -> Trace:
    return Trace({name: values[first : last + 1] for name, values in trace.signals.items()}, PERIOD)


@pytest.mark.parametrize("text", FORMULAS)
def test_holds_from_now_on_if_and_only_if_it_holds_from_the_start(text: str) -> None:
    formula, outcomes, open_ = parse(text), set(), 0
    for seed in range(25):
        trace = draw(seed)
        whole = bool(satisfied(formula, trace))
        outcomes.add(whole)
        for now in range(0, SAMPLES - 2, 3):
            try:
                left = progress_formula(formula, cut(trace, 0, now))
            except FormulaError:
                continue
            if isinstance(left, Formula):
                open_ += 1
                assert parse(str(left)) == left
                left = bool(satisfied(left, cut(trace, now, SAMPLES - 1)))
            assert left == whole, (seed, now)
    assert outcomes == {True, False}
    assert open_ > 20


def test_says_what_is_left_in_short() -> None:
    trace = Trace({"a.x": np.zeros(21), "a.y": np.ones(21)}, PERIOD)
    for text, left in (
        ("G[0,20] a.x <= 1", "G[0,10] a.x <= 1"),
        ("F[0,20] a.x >= 1", "F[0,10] a.x >= 1"),
        ("F[0,5] a.x >= 1 | F[12,20] a.y >= 2", "F[2,10] a.y >= 2"),
        ("G[12,15] a.x <= 1 & F[0,5] a.y >= 1", "G[2,5] a.x <= 1"),
        ("G[0,12] F[0,4] a.x >= 1", None),
        ("G[8,20] F[0,4] a.x >= 1", "F[0,2] a.x >= 1 & G[0,10] F[0,4] a.x >= 1"),
        ("G[8,20] F[3,4] a.x >= 1", "G[0,12] F[1,2] a.x >= 1"),
        ("a.y >= 1 U[0,15] a.x >= 1", "a.y >= 1 U[0,5] a.x >= 1"),
        ("a.x >= 1 U[0,15] a.x >= 2", None),
    ):
        found = progress_formula(parse(text), trace)
        assert found is False if left is None else str(found) == left, (text, str(found))
    assert progress_formula(parse("F[0,5] a.y >= 1"), trace) is True


def test_a_tolerance_forgives_what_is_within_it() -> None:
    trace = Trace({"a.x": np.full(11, 1.01)}, PERIOD)
    assert progress_formula(parse("G[0,9] a.x <= 1"), trace) is False
    assert str(progress_formula(parse("G[0,9] a.x <= 1"), trace, tolerance=0.02)) == "G[0,4] a.x <= 1"


def test_refuses_what_has_no_short_form() -> None:
    rng = np.random.default_rng(1)
    trace = Trace({"a.x": rng.normal(size=41), "a.y": rng.normal(size=41)}, PERIOD)
    with pytest.raises(FormulaError, match="parts"):
        progress_formula(parse("G[0,20] (a.x >= 0 -> F[10,30] G[0,5] a.y >= 0)"), trace)

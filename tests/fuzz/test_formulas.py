"""Any text is a formula that everything after the parser can take, or is refused in one line."""

import copy
import pickle
import threading

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from impact_envs import load_scenario, vector_env
from impact_envs.errors import FormulaError
from impact_envs.stl import Monitor, Trace, parse, robustness, robustness_signal, satisfied
from impact_envs.stl.parser import DEEPEST, LONGEST
from planners import make_plan
from tests.fuzz.mutations import answered, check, check_finite, mistyped

SCENARIO = load_scenario("throw_and_catch")
NAMES = tuple(f"{body}.{name}" for body in SCENARIO.bodies for name in SCENARIO.signals)
PERIOD, LENGTH = 0.1, 40
TRACE = Trace(
    dict(zip(NAMES, np.sin(np.arange(LENGTH) * 0.1 + np.arange(len(NAMES))[:, None]), strict=True)),
    PERIOD,
    SCENARIO.areas,
    SCENARIO.bodies,
)
TEXTS = (
    "F[0,2] pop in goal & G[0,3] all not in goal",
    "eventually[0:2](pop in goal) and always[0:1](speed(all) <= 0.1)",
    "(pop in goal U[0,1] snap.x + 2*pop.y <= 3) -> not distance(pop, snap) >= 0.4",
    "G[0,1] F[0,1] (-(pop.x - 1)/2 < 3 - pop.y*2 | G[0.5,0.7] 1e-1*pop.vx >= -.5)",
    "! pop in goal -> F[1,2] G[0,1] F[0,0.5] crackle.omega > 0 U[0,1] pop in goal",
)
PIECES = (
    "F[0,1] ",
    "G[0,0] ",
    "!",
    " & ",
    " | ",
    " -> ",
    " U[0,1] ",
    "pop in goal",
    "all",
    "speed(",
    "1e9",
    "1e-300",
    "*pop.x",
)
DEEP = {
    "one kind": "F[0,0.1] " * (DEEPEST - 1) + "pop in goal",
    "alternating": "F[0,0.1] G[0,0.1] " * (DEEPEST // 2 - 1) + "F[0,0.1] pop in goal",
    "negations": "!" * (DEEPEST - 1) + "pop in goal",
    "implications": "pop in goal -> " * (DEEPEST - 1) + "pop in goal",
    "untils": "pop in goal U[0,0.1] " * (DEEPEST - 1) + "pop in goal",
    "junctions": "pop in goal & (pop.x <= 1 | (" * ((DEEPEST - 1) // 2) + "pop in goal" + "))" * ((DEEPEST - 1) // 2),
    "mixed": "F[0,0.1] !G[0,0.1] (pop.x >= 0 -> " * ((DEEPEST - 1) // 4) + "pop in goal" + ")" * ((DEEPEST - 1) // 4),
}


def use(formula, trace=TRACE):
    """Do with a formula all that does not need a scenario of it; return its robustness."""
    assert parse(str(formula)) == formula
    assert pickle.loads(pickle.dumps(formula)) == copy.deepcopy(formula) == formula
    assert repr(formula) and hash(formula) == hash(copy.deepcopy(formula))
    value = robustness(formula, trace)
    check_finite(value, robustness_signal(formula, trace))
    assert bool(satisfied(formula, trace)) == (value > 0) or value == 0
    monitor = Monitor(formula, PERIOD, SCENARIO.areas, SCENARIO.bodies)
    for t in range(len(trace.signals[NAMES[0]])):
        low, high = monitor.update({name: trace.signals[name][t] for name in NAMES})
    assert low == high == value
    return float(value)


def run_in_thread(function):
    """Run a function in a fresh thread with the usual stack, and return its result."""
    results = []

    def run():
        try:
            results.append(function())
        except BaseException as error:
            results.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    if isinstance(results[0], BaseException):
        raise results[0]
    return results[0]


@pytest.mark.parametrize("kind", DEEP)
def test_what_parses_survives_all_that_follows(kind):
    formula = parse(DEEP[kind])
    length = formula.reach(PERIOD) + 1
    signals = {name: np.sin(np.arange(length) * 0.1 + i) for i, name in enumerate(NAMES)}
    trace = Trace(signals, PERIOD, SCENARIO.areas, SCENARIO.bodies)
    assert use(formula, trace) == run_in_thread(lambda: use(parse(DEEP[kind]), trace))


@pytest.mark.parametrize("kind", DEEP)
def test_environments_and_planners_take_the_deepest_formulas(kind):
    scenario = SCENARIO.override({"formula": DEEP[kind]})
    envs = vector_env(scenario, num_envs=2)
    observations, _ = envs.reset(seed=0)
    check_finite(observations, envs.step(envs.action_space.sample())[0])
    envs.close()
    copy.deepcopy(scenario)
    pickle.loads(pickle.dumps(scenario))
    with answered():
        run_in_thread(lambda: make_plan(scenario, time_limit=1.0))


@pytest.mark.parametrize("text", ["F[0,0] " * DEEPEST, "!" * DEEPEST, "!" * 50_000, "pop in goal -> " * DEEPEST])
def test_deeper_formulas_are_refused(text):
    with pytest.raises(FormulaError, match=f"nested more than {DEEPEST} deep"):
        parse(text + "pop in goal")


def test_brackets_and_long_sums_are_not_depth():
    assert parse("(" * 5000 + "pop in goal" + ")" * 5000) == parse("pop in goal")
    assert parse("+".join(["pop.x"] * 5000) + " <= 1") == parse("5000*pop.x <= 1")
    assert use(parse(" & ".join(["pop in goal"] * 3000))) == use(parse("pop in goal"))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (" & ".join(["pop in goal"] * 100_000), [str(LONGEST)]),
        ("pop.x <= 1e400", ["1e400", "too large"]),
        ("pop.x <= 1e10", ["1e10", "too large", "1e+09"]),
        ("1e9*10*pop.x <= 1", ["coefficient", "1e+10"]),
        ("pop.x/1e-300 <= 1", ["coefficient"]),
        ("pop.x <= nan", ["nan"]),
        ("F[2,1] pop in goal", ["[2,1]", "ends before"]),
        ("F[0,1e300] pop in goal", ["1e300", "too large"]),
    ],
)
def test_numbers_and_sizes_have_limits(text, words):
    with pytest.raises(FormulaError) as error:
        parse(text)
    assert str(error.value).isprintable()
    assert len(str(error.value)) < 300
    for word in words:
        assert word in str(error.value)


def check_formula(data):
    text = data.draw(st.sampled_from(TEXTS).flatmap(lambda text: mistyped(text, PIECES)))
    with answered():
        formula = parse(text)
        formula.check_names(SCENARIO.bodies, tuple(SCENARIO.areas), SCENARIO.signals)
        if formula.expand(SCENARIO.bodies).reach(PERIOD) < LENGTH:
            use(formula)


@check(100)
@given(data=st.data())
def test_mistyped_formulas(data):
    check_formula(data)


@pytest.mark.slow
@check(3000)
@given(data=st.data())
def test_many_mistyped_formulas(data):
    check_formula(data)

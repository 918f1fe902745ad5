"""The compiled monitor of many worlds is the definition, to the last bit."""

import os
import subprocess
import sys

import numpy as np
import pytest

from impact_envs.errors import FormulaError, InputError
from impact_envs.scenario import list_scenarios, load_scenario
from impact_envs.stl import And, Monitor, parse
from impact_envs.stl.compiler import compile_formula, describe_parts
from impact_envs.stl.stepper import start_monitor, update_monitor
from impact_envs.stl.verdict import settle_tie
from tests.impact_envs.stl.oracle import Oracle
from tests.impact_envs.stl.samples import (
    AREAS,
    BODIES,
    BOUNDS,
    LIMIT,
    NAMES,
    PERIOD,
    draw_alternation,
    draw_bounds,
    draw_formula,
    draw_join,
    draw_trace,
)


class Worlds:
    """Many worlds under one formula, each beside an oracle of its own."""

    def __init__(self, formula, period, areas, bodies, names, bounds, worlds):
        self.compiled = compile_formula(formula, period, areas, bodies, names, bounds)
        self.memory = np.full((worlds, self.compiled.size), np.nan)
        self.names = names
        self.make_oracle = lambda: Oracle(formula, period, areas, bodies, bounds)
        self.oracles, self.counts = [None] * worlds, [0] * worlds

    def start(self, k):
        start_monitor(self.compiled, self.memory, k)
        self.oracles[k], self.counts[k] = self.make_oracle(), 0

    def update(self, k, samples):
        """Return the interval of the compiled monitor, and that of the oracle."""
        low, high = update_monitor(self.compiled, self.memory, k, self.counts[k], samples)
        got = settle_tie(low), settle_tie(high)
        self.counts[k] += 1
        return got, self.oracles[k].update(dict(zip(self.names, samples[k], strict=True)))


def check_random_formulas(seed, count):
    rng = np.random.default_rng(seed)
    for i in range(count):
        formula = (
            draw_formula(rng, rng.integers(5)),
            draw_alternation(rng, rng.integers(1, 5)),
            draw_join(rng),
        )[i % 3]
        worlds = Worlds(formula, PERIOD, AREAS, BODIES, NAMES, draw_bounds(rng), 1)
        worlds.start(0)
        for sample in draw_trace(rng, worlds.oracles[0].reach + 3):
            got, want = worlds.update(0, sample[None])
            assert got == want, str(formula)


def test_every_conjunct_has_the_interval_that_it_would_have_alone():
    rng = np.random.default_rng(11)
    for _ in range(60):
        parts = [draw_formula(rng, rng.integers(4)) for _ in range(rng.integers(1, 5))]
        formula = And(tuple(parts)) if len(parts) > 1 else parts[0]
        bounds, whole = draw_bounds(rng), len(formula.conjuncts())
        monitor = Monitor(formula, PERIOD, AREAS, BODIES, bounds)
        alone = [Monitor(part, PERIOD, AREAS, BODIES, bounds) for part in formula.conjuncts()]
        for sample in draw_trace(rng, monitor.reach + 2):
            named = dict(zip(NAMES, sample, strict=True))
            low, high = monitor.update(named)
            expected = [part.update(named) for part in alone]
            got = np.reshape(monitor.conjuncts, (whole, 2))
            assert got.tolist() == [list(interval) for interval in expected], str(formula)
            assert tuple(got.min(axis=0)) == (low, high)


def test_a_reached_subgoal_shows_in_its_conjunct_alone():
    monitor = Monitor(
        parse("F[0,1] pop in goal & F[0,1] snap in goal & G[1,1] pop in wall"), 0.1, AREAS, BODIES, BOUNDS
    )
    monitor.update(dict.fromkeys(NAMES, 2.0))
    before = monitor.conjuncts
    inside = dict.fromkeys(NAMES, 2.0) | {"pop.x": 0.5, "pop.y": 0.5}
    whole = monitor.interval
    assert monitor.update(inside) == whole  # says nothing
    after = monitor.conjuncts
    assert (before[0], after[0]) == (-1.0, 0.5)
    assert after[2:] == before[2:]


@pytest.mark.parametrize("name", list_scenarios())
def test_shipped_formulas_on_random_walks(name):
    scenario = load_scenario(name)
    lower, upper = np.array(scenario.world.lower), np.array(scenario.world.upper)
    names = [f"{body}.{signal}" for body in scenario.bodies for signal in scenario.signals]
    bounds = {
        f"{body}.{axis}": (low, high)
        for body in scenario.bodies
        for axis, low, high in zip("xy", lower, upper, strict=True)
    }
    worlds = Worlds(
        scenario.specification, scenario.control_period, scenario.areas, scenario.bodies, names, bounds, worlds=2
    )
    rng = np.random.default_rng(3)
    steps = rng.normal(0.0, 0.05, (scenario.steps + 3, 2, len(scenario.bodies), len(scenario.signals)))
    steps[0, ..., :2] = rng.uniform(lower, upper, (2, len(scenario.bodies), 2))
    walks = np.cumsum(steps, axis=0)
    walks[..., :2] = np.clip(walks[..., :2], lower, upper)
    for k in range(2):
        worlds.start(k)
        widths = []
        for samples in walks.reshape(len(walks), 2, -1):
            (low, high), want = worlds.update(k, samples)
            assert (low, high) == want
            widths.append(high - low)
        assert widths[0] > 0
        assert widths[-1] == 0


def test_random_formulas():
    check_random_formulas(seed=1, count=600)


def test_without_compilation():
    code = subprocess.run(
        [sys.executable, "-W", "error", __file__],
        env={**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": os.pathsep.join(sys.path)},
        check=False,
    ).returncode
    assert code == 0


@pytest.mark.parametrize(
    "text",
    [
        "G[0,1] all in goal & F[0.5,1.5] (pop in wall | snap in wall) & not speed(pop) <= 0.1",
        "G[0,3] F[0,0.5] pop in goal | F[0.2,2] G[0,0.4] F[0.1,0.3] snap not in wall",
        "pop in goal U[0.3,1.2] distance(pop, snap) >= 1 -> F[0,1] G[0,0.4] (snap not in wall U[0,0.3] pop in goal)",
    ],
)
def test_worlds_start_and_restart_on_their_own(text):
    rng = np.random.default_rng(5)
    worlds = Worlds(parse(text), PERIOD, AREAS, BODIES, NAMES, BOUNDS, worlds=3)
    for step in range(60):
        samples = rng.uniform(-LIMIT, LIMIT, (3, len(NAMES)))
        for k in range(3):
            if step == 4 * k or (k, step) in ((1, 12), (0, 45)):
                worlds.start(k)
            if step >= 4 * k:
                got, want = worlds.update(k, samples)
                assert got == want


@pytest.mark.parametrize("unit", [0.2, 1.0])
def test_until_nested_where_its_interval_starts_late(unit):
    """The left side must hold from now on, not only from the interval's start."""
    formula = parse(f"G[0,{unit}] (pop.x >= 0 U[{unit},{2 * unit}] snap.x >= 0)")
    worlds = Worlds(formula, PERIOD, AREAS, BODIES, NAMES, None, worlds=1)
    worlds.start(0)
    rng = np.random.default_rng(6)
    for _ in range(formula.reach(PERIOD) + 1):
        got, want = worlds.update(0, rng.uniform(-LIMIT, LIMIT, (1, len(NAMES))))
        assert got == want
    assert got[0] == got[1]


def test_single_precision_and_strided_views():
    formula = parse(
        "G[0,2] all in goal & (F[0,1] G[0,0.5] snap in wall | pop in goal U[0,1] snap in goal)"
        " & G[0,1] F[0,0.6] G[0,0.4] pop in wall"
    )
    compiled = compile_formula(formula, PERIOD, AREAS, BODIES, NAMES, BOUNDS)
    memory = np.zeros((2, 2 * compiled.size), np.float32)
    samples = np.zeros((len(NAMES), 2), np.float32)
    monitor = Monitor(formula, PERIOD, AREAS, BODIES, BOUNDS)
    start_monitor(compiled, memory[:, ::2], 1)
    rng = np.random.default_rng(7)
    for count in range(monitor.reach + 1):
        samples[:, 1] = rng.uniform(-LIMIT, LIMIT, len(NAMES))
        got = update_monitor(compiled, memory[:, ::2], 1, count, samples.T)
        want = monitor.update(dict(zip(NAMES, samples[:, 1].tolist(), strict=True)))
        np.testing.assert_allclose(got, want, rtol=0, atol=1e-6)
    assert not memory[0].any()
    assert not memory[:, 1::2].any()


@pytest.mark.parametrize(
    "text",
    ["G[0,{0}] all in goal & not F[{0},{0}] (pop in wall & speed(snap) <= 1)", "pop in goal U[1,{0}] snap in goal"],
)
def test_memory_does_not_grow_with_the_horizon(text):
    sizes = {compile_formula(parse(text.format(h)), PERIOD, AREAS, BODIES, NAMES).size for h in (1, 10, 1e4)}
    assert len(sizes) == 1
    assert sizes.pop() <= 2 + 2 * len(describe_parts(parse(text.format(1)), PERIOD, AREAS, BODIES))


def test_memory_of_nested_operators_grows_with_the_inner_ones_only():
    def size(text, outer, inner):
        return compile_formula(parse(text.format(outer, inner)), PERIOD, AREAS, BODIES, NAMES).size

    for text in (
        "G[0,{0}] F[0,{1}] pop in goal",
        "F[0,{0}] G[0,{1}] F[0,1] pop in goal",
        "F[0,{0}] (pop in goal & G[0,{1}] snap in goal)",
        "G[0,{0}] (pop in goal U[0,{1}] snap in goal)",
        "G[0,{0}] (pop in goal -> F[0,{1}] (snap in goal & F[0,{1}] snap in wall))",
    ):
        assert size(text, 1000, 2) == size(text, 100, 2)
        assert size(text, 1000, 20) <= 10 * size(text, 1000, 2)


@pytest.mark.parametrize(
    "text",
    [
        "G[0,20] F[0,10] pop in goal",
        "G[0,20] F[0,10] G[0,5] pop in goal",
        "F[0,20] (pop in goal & G[0,5] snap in goal)",
        "G[0,20] (pop in goal -> not G[1,5] snap in goal)",
        "not F[3,20] (pop in goal & (snap in wall | not (pop in goal U[2,5] snap in goal)))",
        "pop in goal U[0,20] (snap in wall & F[5,5] snap in goal)",
        "G[0,20] (pop in goal -> F[0,5] snap in goal & G[2,9] snap in wall & (pop in wall | F[0,3] pop in goal))",
        "G[0,20] ((pop in goal & F[0,5] snap in goal) | (snap in wall & F[0,5] snap in goal))",
    ],
)
def test_formulas_of_which_no_instant_is_computed_anew(text):
    assert len(compile_formula(parse(text), PERIOD, AREAS, BODIES, NAMES).nodes) == 0


def test_formulas_that_cannot_be_followed():
    with pytest.raises(InputError, match=r"'snap\.y' is missing; .*choices: pop\.x, snap\.x"):
        compile_formula(parse("pop.x + snap.y >= 0"), PERIOD, AREAS, BODIES, ("pop.x", "snap.x"))
    with pytest.raises(InputError, match="looks 10000000000 samples ahead; at most 2147483647"):
        compile_formula(parse("F[0,1e9] pop in goal"), PERIOD, AREAS, BODIES, NAMES)
    with pytest.raises(FormulaError, match="area 'gaol' is unknown"):
        compile_formula(parse("pop in gaol"), PERIOD, AREAS, BODIES, NAMES)
    with pytest.raises(InputError, match="period 0"):
        compile_formula(parse("pop in goal"), 0, AREAS, BODIES, NAMES)


if __name__ == "__main__":  # see test_without_compilation
    assert not hasattr(update_monitor, "py_func")
    check_random_formulas(seed=2, count=60)

"""The compiled monitor of many worlds is the monitor, to the last bit."""

import math
import os
import subprocess
import sys

import numpy as np
import pytest

from impact_envs.errors import FormulaError, InputError
from impact_envs.scenario import list_scenarios, load_scenario
from impact_envs.stl import (
    Always,
    And,
    Distance,
    Eventually,
    Implies,
    In,
    Linear,
    Monitor,
    Not,
    Or,
    Speed,
    Temporal,
    Until,
    parse,
)
from impact_envs.stl.program import make_program, memory_size
from impact_envs.stl.stepper import start_monitor, update_monitor

BODIES = ("pop", "snap")
NAMES = tuple(f"{body}.{name}" for body in BODIES for name in ("x", "y", "vx", "vy"))
LIMIT = 3.0  # of every signal
BOUNDS = dict.fromkeys(NAMES, (-LIMIT, LIMIT))
PERIOD = 0.1


class Area:
    def __init__(self, H, b):
        self.H, self.b = np.array(H), np.array(b)

    def halfspaces(self):
        return self.H, self.b


AREAS = {
    "goal": Area([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]], [1.0, 1.0, 1.0, 0.0]),
    "wall": Area([[0.6, 0.8], [-1.0, 0.0], [0.0, -1.0]], [1.5, 1.0, 1.0]),
}


def draw_predicate(rng):
    body, relation = rng.choice(["pop", "snap", "all"]), rng.choice(["<=", "<", ">=", ">"])
    bound = round(rng.uniform(-LIMIT, LIMIT), rng.integers(3))
    match rng.integers(4):
        case 0:
            return In(body, rng.choice(["goal", "wall"]), bool(rng.integers(2)))
        case 1:
            return Distance("pop", "snap", relation, bound)
        case 2:
            return Speed(body, relation, bound)
        case _:
            names = rng.choice(NAMES, rng.integers(1, 4), replace=False)
            return Linear(tuple((name, rng.choice([-1, 1]) * rng.uniform(0.1, 2)) for name in names), relation, bound)


def draw_formula(rng, depth):
    if depth == 0 or rng.random() < 0.15:
        return draw_predicate(rng)
    first = rng.integers(6) * rng.integers(2)
    interval = (first * PERIOD, (first + rng.integers(9)) * PERIOD)
    parts = [draw_formula(rng, depth - 1) for _ in range(3)]
    match rng.integers(7):
        case 0:
            return Not(parts[0])
        case 1:
            return And(tuple(parts[: rng.integers(2, 4)]))
        case 2:
            return Or(tuple(parts[: rng.integers(2, 4)]))
        case 3:
            return Implies(parts[0], parts[1])
        case 4:
            return Eventually(interval, parts[0])
        case 5:
            return Always(interval, parts[0])
        case _:
            return Until(interval, parts[0], parts[1])


def draw_bounds(rng):
    """Nothing known, everything, or some signals with ends that may be infinite."""
    some = {"pop.x": (-LIMIT, LIMIT), "pop.y": (-1.0, 1.0), "snap.vx": (-math.inf, 2.0)}
    return (None, BOUNDS, some)[rng.integers(3)]


def is_nested(formula, inside=False):
    temporal = isinstance(formula, Temporal)
    return (temporal and inside) or any(is_nested(child, inside or temporal) for child in formula.children)


def draw_trace(rng, length):
    """Whole numbers make ties and zeros."""
    trace = rng.uniform(-LIMIT, LIMIT, (length, len(NAMES)))
    return np.round(trace) if rng.integers(2) else trace


class Worlds:
    """Many worlds under one formula, each beside a monitor of its own."""

    def __init__(self, formula, period, areas, bodies, names, bounds, worlds):
        self.program = make_program(formula, period, areas, bodies, names, bounds)
        self.memory = np.full((worlds, memory_size(self.program)), np.nan)
        self.names = names
        self.make_monitor = lambda: Monitor(formula, period, areas, bodies, bounds)
        self.monitors, self.counts = [None] * worlds, [0] * worlds

    def start(self, k):
        start_monitor(self.program, self.memory, k)
        self.monitors[k], self.counts[k] = self.make_monitor(), 0

    def update(self, k, samples):
        """Return the interval of the program, and that of the monitor."""
        got = update_monitor(self.program, self.memory, k, self.counts[k], samples)
        self.counts[k] += 1
        return got, self.monitors[k].update(dict(zip(self.names, samples[k], strict=True)))


def check_random_formulas(seed, count):
    rng = np.random.default_rng(seed)
    nested = 0
    for _ in range(count):
        formula, bounds = draw_formula(rng, rng.integers(5)), draw_bounds(rng)
        worlds = Worlds(formula, PERIOD, AREAS, BODIES, NAMES, bounds, 1)
        worlds.start(0)
        nested += is_nested(formula)
        for sample in draw_trace(rng, worlds.monitors[0].reach + 3):
            got, want = worlds.update(0, sample[None])
            assert got == want, str(formula)
            if not is_nested(formula):  # numpy leaves open which of two zeros is the greater one
                assert [math.copysign(1, end) for end in got] == [math.copysign(1, end) for end in want], str(formula)
    return nested


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
    assert check_random_formulas(seed=1, count=400) > 80


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
    formula = parse("G[0,2] all in goal & (F[0,1] G[0,0.5] snap in wall | pop in goal U[0,1] snap in goal)")
    program = make_program(formula, PERIOD, AREAS, BODIES, NAMES, BOUNDS)
    size = memory_size(program)
    memory = np.zeros((2, 2 * size), np.float32)
    samples = np.zeros((len(NAMES), 2), np.float32)
    monitor = Monitor(formula, PERIOD, AREAS, BODIES, BOUNDS)
    start_monitor(program, memory[:, ::2], 1)
    rng = np.random.default_rng(7)
    for count in range(monitor.reach + 1):
        samples[:, 1] = rng.uniform(-LIMIT, LIMIT, len(NAMES))
        got = update_monitor(program, memory[:, ::2], 1, count, samples.T)
        want = monitor.update(dict(zip(NAMES, samples[:, 1].tolist(), strict=True)))
        np.testing.assert_allclose(got, want, rtol=0, atol=1e-6)
    assert not memory[0].any()
    assert not memory[:, 1::2].any()


@pytest.mark.parametrize(
    "text",
    ["G[0,{0}] all in goal & not F[{0},{0}] (pop in wall & speed(snap) <= 1)", "pop in goal U[1,{0}] snap in goal"],
)
def test_memory_does_not_grow_with_the_horizon(text):
    sizes = {memory_size(make_program(parse(text.format(h)), PERIOD, AREAS, BODIES, NAMES)) for h in (1, 10, 1e4)}
    assert len(sizes) == 1
    assert sizes.pop() <= 2


def test_memory_of_nested_operators_grows_with_the_inner_ones_only():
    def size(outer, inner):
        return memory_size(make_program(parse(f"G[0,{outer}] F[0,{inner}] pop in goal"), PERIOD, AREAS, BODIES, NAMES))

    assert size(1000, 2) == size(100, 2) <= 4 * 33
    assert size(1000, 20) <= 4 * 257


def test_programs_that_cannot_be():
    with pytest.raises(InputError, match=r"'snap\.y' is missing; .*choices: pop\.x, snap\.x"):
        make_program(parse("pop.x + snap.y >= 0"), PERIOD, AREAS, BODIES, ("pop.x", "snap.x"))
    with pytest.raises(InputError, match="looks 10000000000 samples ahead; at most 2147483647"):
        make_program(parse("F[0,1e9] pop in goal"), PERIOD, AREAS, BODIES, NAMES)
    with pytest.raises(FormulaError, match="area 'gaol' is unknown"):
        make_program(parse("pop in gaol"), PERIOD, AREAS, BODIES, NAMES)
    with pytest.raises(InputError, match="period 0"):
        make_program(parse("pop in goal"), 0, AREAS, BODIES, NAMES)


if __name__ == "__main__":  # see test_without_compilation
    assert not hasattr(update_monitor, "py_func")
    assert check_random_formulas(seed=2, count=60) > 10

"""The online monitor on traces whose possible robustness is known by hand."""

import copy
import math
import pickle

import numpy as np
import pytest

from impact_envs.errors import FormulaError, InputError
from impact_envs.stl import Monitor, parse

INFINITE = (-math.inf, math.inf)


class Box:
    """The square |x| <= 1, |y| <= 1."""

    def halfspaces(self):
        return np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]]), np.ones(4)


AREAS = {"goal": Box()}


def make_monitor(text, bounds=None, period=1.0, bodies=("pop", "snap")):
    return Monitor(parse(text), period, AREAS, bodies, bounds)


def feed(monitor, values):
    return [monitor.update({"pop.x": value}) for value in values]


def test_eventually_rises_and_ends_at_the_best_value():
    assert feed(make_monitor("F[1,3] pop.x >= 0"), [9.0, 1.0, 3.0, 2.0]) == [
        INFINITE,
        (1.0, math.inf),
        (3.0, math.inf),
        (3.0, 3.0),
    ]


def test_always_falls_and_is_decided_by_one_violation():
    monitor = make_monitor("G[0,9] pop.x >= 0")
    assert feed(monitor, [2.0, 1.0]) == [(-math.inf, 2.0), (-math.inf, 1.0)]
    assert monitor.verdict is None
    feed(monitor, [-1.0])
    assert monitor.verdict is False
    assert not monitor.final


def test_bounds_make_the_interval_finite_from_the_start():
    monitor = make_monitor("F[0,5] pop in goal & G[0,5] pop.x <= 2", {"pop.x": (0, 10), "pop.y": (-5, 5)})
    # At best x = 0 scores min(1, 2); at worst x = 10 scores min(-9, -8).
    assert monitor.interval == (-9.0, 1.0)
    assert monitor.update({"pop.x": 0.5, "pop.y": 0.0}) == (-8.0, 1.0)


def test_bounds_decide_what_no_sample_to_come_can_change():
    monitor = make_monitor("G[0,100] pop.x >= 0", {"pop.x": (0.25, 1.0)})
    assert monitor.verdict is True
    assert monitor.interval == (0.25, 1.0)


def test_distance_is_never_negative_even_without_bounds():
    assert make_monitor("distance(pop, snap) >= 0.4").interval == (-0.4, math.inf)
    far = {"pop.x": (0, 1), "pop.y": (0, 0), "snap.x": (4, 6), "snap.y": (-1, 1)}
    low, high = make_monitor("distance(pop, snap) >= 0", far).interval
    assert (low, high) == (3.0, math.sqrt(37))


def test_until_interval():
    monitor = make_monitor("pop.x >= 0 U[1,3] snap.x >= 0", {"pop.x": (-5, 5), "snap.x": (-5, 5)})
    steps = [(4.0, 3.0), (3.0, 1.0), (2.0, 2.0), (5.0, 5.0)]
    intervals = [monitor.update({"pop.x": a, "snap.x": b}) for a, b in steps]
    assert intervals == [(-5, 4), (1, 3), (2, 2), (2, 2)]


@pytest.mark.parametrize(
    ("text", "steps", "intervals"),
    [
        (
            "F[0,2] (pop.x >= 0 & G[0,1] snap.x >= 0)",
            [(3.0, 1.0), (2.0, 4.0), (-1.0, 2.0), (5.0, 3.0)],
            [(-5, 5), (1, 5), (2, 2), (2, 2)],
        ),
        (
            "G[0,1] (pop.x >= 0 U[1,2] snap.x >= 0)",
            [(4.0, 5.0), (3.0, 1.0), (2.0, 2.0), (5.0, 5.0)],
            [(-5, 4), (-5, 3), (2, 2), (2, 2)],
        ),
        (
            "pop.x >= 0 U[0,2] G[0,1] snap.x >= 0",
            [(4.0, 1.0), (3.0, 3.0), (2.0, 2.0), (5.0, 5.0)],
            [(-5, 4), (1, 3), (2, 2), (2, 2)],
        ),
    ],
)
def test_intervals_of_joined_operators(text, steps, intervals):
    monitor = make_monitor(text, {"pop.x": (-5, 5), "snap.x": (-5, 5)})
    assert [monitor.update({"pop.x": a, "snap.x": b}) for a, b in steps] == intervals


def test_nested_operators_are_decided_before_the_end():
    monitor = make_monitor("F[0,8] G[0,2] pop.x >= 0")
    intervals = feed(monitor, [-1.0, 1.0, 2.0, 1.0])
    assert [low for low, _ in intervals] == [-math.inf, -math.inf, -1.0, 1.0]
    assert monitor.verdict is True
    assert not monitor.final


def test_negation_of_an_interval():
    for text in ("not F[0,2] pop.x >= 0", "G[0,2] not pop.x >= 0", "F[0,2] pop.x >= 0 -> pop.x >= 9"):
        monitor = make_monitor(text, {"pop.x": (-5, 5)})
        assert [low <= -3 <= high for low, high in feed(monitor, [-9.0 + 10, 3.0])] == [True, True]
        assert feed(monitor, [0.0]) == [(-3.0, -3.0)]


def test_state_formula_is_decided_by_the_first_sample():
    monitor = make_monitor("pop.x >= 0 & (pop.x <= 5 | not pop.x <= 7)")
    assert feed(monitor, [2.0, -7.0]) == [(2.0, 2.0)] * 2
    assert monitor.final


@pytest.mark.parametrize(
    ("text", "holds"),
    [
        ("F[0,1] pop.x >= 0", True),
        ("F[0,1] pop.x > 0", False),
        ("F[0,1] not pop.x < 0", True),
        ("F[0,1] not pop.x <= 0", False),
        ("F[0,1] (pop.x > 0 | pop.x >= 0)", True),
        ("F[0,1] (pop.x > 0 & pop.x >= 0)", False),
        ("pop.x <= 1 U[0,1] pop.x >= 0", True),
        ("pop.x <= 1 U[0,1] pop.x > 0", False),
        ("F[0,1] G[0,0] F[0,0] pop.x >= 0", True),
        ("F[0,1] (pop.x >= 0 U[0,0] pop.x > 0)", False),
    ],
)
def test_at_exactly_zero_the_predicates_decide(text, holds):
    monitor = make_monitor(text)
    feed(monitor, [-1.0, 0.0])
    assert monitor.final
    assert monitor.interval == (0.0, 0.0)
    assert monitor.verdict is holds


def test_samples_after_the_end_change_nothing():
    for text in ("G[0,2] pop.x >= 0", "G[0,1] F[0,1] pop.x >= 0", "pop.x >= 0 U[0,2] pop.x >= 0"):
        monitor = make_monitor(text)
        feed(monitor, [1.0, 1.0, 1.0])
        assert monitor.final
        assert feed(monitor, [-5.0, 5.0]) == [(1.0, 1.0)] * 2


def test_reset_forgets():
    monitor = make_monitor("G[0,5] pop.x >= 0 & F[0,2] G[0,3] pop.x >= 1", {"pop.x": (-3, 3)})
    start, first = monitor.interval, feed(monitor, [-2.0, 1.0, 0.5])
    monitor.reset()
    assert monitor.interval == start
    assert feed(monitor, [-2.0, 1.0, 0.5]) == first


@pytest.mark.parametrize("clone", [copy.deepcopy, lambda monitor: pickle.loads(pickle.dumps(monitor))])
def test_copies_go_on_alone(clone):
    text = "G[0,5] pop.x >= 0 & F[0,2] G[0,3] pop.x >= 1 & (pop.x <= 9 U[0,4] pop.x >= 0)"
    monitor = make_monitor(text)
    feed(monitor, [1.0, 2.0])
    other = clone(monitor)
    after = feed(monitor, [3.0, -1.0])
    assert feed(other, [3.0, -1.0]) == after


def test_memory_does_not_grow_with_the_samples():
    monitor = make_monitor("G[0,5000] all not in goal & F[0,5000] pop in goal & G[0,4] F[0,9] snap in goal")
    sizes = []
    for k in range(600):
        monitor.update({f"{b}.{axis}": math.sin(k) for b in ("pop", "snap") for axis in "xy"})
        sizes.append(len(pickle.dumps(monitor)))
    assert sizes[-1] <= sizes[50] + 64  # a few numbers may print longer


def test_samples_that_are_none():
    monitor = make_monitor("F[0,3] pop in goal")
    with pytest.raises(InputError, match=r"'pop\.y' is missing; .*choices: pop\.x"):
        monitor.update({"pop.x": 0.0})
    for bad in (math.nan, math.inf):
        with pytest.raises(InputError, match=r"'pop\.y' is (nan|inf); it must be finite"):
            monitor.update({"pop.x": 0.0, "pop.y": bad})
    assert monitor.count == 0


def test_monitors_that_cannot_be():
    with pytest.raises(FormulaError, match="area 'gaol' is unknown; did you mean 'goal'"):
        make_monitor("F[0,3] pop in gaol")
    with pytest.raises(FormulaError, match="contains no sample"):
        make_monitor("F[0.2,0.3] pop in goal")
    with pytest.raises(InputError, match="period 0"):
        make_monitor("pop in goal", period=0)
    with pytest.raises(InputError, match=r"bounds \[2, 1\] of signal 'pop\.x' are empty"):
        make_monitor("pop in goal", {"pop.x": (2, 1)})

"""Objects that are moved one after another."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.tasks import draw_task
from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.scenario import build_scenario
from planners.budget import Work
from planners.free_flyer.frame import find_frame
from planners.free_flyer.nominal.event_sequence import compute_speed_caps, find_own
from planners.free_flyer.nominal.leg_times import Wait
from planners.free_flyer.nominal.several_objects.composition import add_corrections, compose_objects, is_large
from planners.free_flyer.nominal.task import CompositionOptions, NominalTask, PlanOptions
from planners.free_flyer.nominal.word_grid import WordGrid
from planners.free_flyer.reserves import Reserves
from planners.free_flyer.specification.requirement import read_demands

HALF = 0.5  # of an area's width [m]


def _body(start: tuple[float, float], mass: float) -> dict[str, object]:
    return {"start": start, "mass": mass, "inertia": 0.02 * mass, "radius": 0.2, "speed_limit": 0.4}


def _task() -> NominalTask:
    robots = {"left": (1.0, 1.0), "right": (7.0, 1.0)}
    areas = {"a": (2.0, 6.0), "b": (6.0, 6.0)}
    scenario = build_scenario(
        {
            "domain": "free_flyer",
            "name": "two_objects",
            "horizon": 200.0,
            "control_period": 0.1,
            "world": {"lower": (0.0, 0.0), "upper": (8.0, 8.0)},
            "robots": {
                name: _body(start, 10.0) | {"force_limit": 1.0, "torque_limit": 0.5} for name, start in robots.items()
            },
            "objects": {"p": _body((2.0, 3.0), 10.0), "q": _body((6.0, 3.0), 20.0)},
            "regions": {
                name: {"lower": np.subtract(middle, HALF).tolist(), "upper": np.add(middle, HALF).tolist()}
                for name, middle in areas.items()
            },
            "believed": {"restitution": 0.8},
            "formula": "G[200,200] p in a & G[200,200] q in b",
        },
        source="test",
    )
    assert isinstance(scenario, FreeFlyerScenario)
    frame = find_frame(scenario)
    inside = frame.enter(scenario)
    return NominalTask(inside, read_demands(inside, Reserves().wall), Reserves(), work=Work(), frame=frame)


@pytest.fixture(scope="module")
def task() -> NominalTask:
    return _task()


def _compose(task: NominalTask, max_impacts: int = 6) -> WordGrid | None:
    return compose_objects(task, {"p": 2, "q": 2}, max_impacts, 1, (0.2, HALF), lambda: 60.0, PlanOptions())


def test_each_object_is_done_before_the_next_one_and_attains_what_is_asked(task: NominalTask) -> None:
    found = _compose(task)
    assert found is not None
    sequence = found.reduce_cost(0.2).sequence
    struck = [name for name, _ in itertools.groupby(name for _, name in sequence.hitters)]
    assert sorted(struck) == ["p", "q"]
    assert found.rho >= 0.2
    for name, area in (("p", "a"), ("q", "b")):
        middle = 0.5 * np.add(task.scenario.regions[area].lower, task.scenario.regions[area].upper)
        assert np.abs(sequence.paths[name][-1] - middle).max() <= HALF - 0.2 + 1e-5


def test_with_the_alternatives_kept_more_time_between_events_costs_no_search(task: NominalTask) -> None:
    found = _compose(task)
    assert found is not None
    times = found.reduce_cost(0.2).sequence.times
    wait = Wait(1, 2, float(times[2] - times[1]) + 1.0)
    later = add_corrections(found, (wait,), 60.0).reduce_cost(0.2).sequence
    assert later.times[2] - later.times[1] >= wait.seconds - 0.11
    assert later.hitters == found.reduce_cost(0.2).sequence.hitters


def test_no_more_impacts_are_used_than_are_allowed(task: NominalTask) -> None:
    assert _compose(task, 3) is None


def test_an_object_that_moves_at_the_start_is_not_composed(task: NominalTask) -> None:
    moving = task.scenario.objects["p"].model_copy(update={"start_velocity": (0.1, 0.0)})
    objects = task.scenario.objects | {"p": moving}
    other = replace(task, scenario=task.scenario.model_copy(update={"objects": objects}))
    assert _compose(other) is None


def test_a_known_first_throw_may_be_faster_than_any_impact_may(task: NominalTask) -> None:
    word = (("left", "p"), ("right", "p"), ("left", "q"), ("right", "q"))
    blunt = compute_speed_caps(task.scenario, "q", 4, task.reserves, word)
    sharp = compute_speed_caps(task.scenario, "q", 4, task.reserves, word, sharp=True)
    assert find_own(word, "q") == [2, 3]
    assert sharp[3] > blunt[3]
    assert sharp[4] == blunt[4] == 0.0


def test_large_is_what_has_more_alternatives_than_the_limit(task: NominalTask) -> None:
    for limit, large in ((1, True), (10_000, False)):
        options = PlanOptions(compose=CompositionOptions(binaries=limit))
        assert is_large(task, {"p": 2, "q": 2}, 1, options) == large


@pytest.mark.slow
def test_an_object_is_hit_while_another_one_flies_straight() -> None:
    """Two robots have to hit both objects; one object's flight of two minutes leaves no time after it."""
    _, data = draw_task(1_000_031)
    scenario = build_scenario(data, source="test")
    assert isinstance(scenario, FreeFlyerScenario)
    frame = find_frame(scenario)
    inside = frame.enter(scenario)
    task = NominalTask(inside, read_demands(inside, Reserves().wall), Reserves(), work=Work(), frame=frame)
    found = compose_objects(task, {"o1": 2, "o2": 2}, 9, 2, (0.09, 0.5), lambda: 300.0, PlanOptions())
    assert found is not None
    sequence = found.reduce_cost(0.09).sequence
    struck = [name for _, name in sequence.hitters]
    assert struck in (["o1", "o2", "o2", "o1"], ["o2", "o1", "o1", "o2"])
    times, path = sequence.times[1:5], sequence.paths[struck[0]][1:5]
    for k in (1, 2):
        on_line = path[0] + (path[3] - path[0]) * (times[k] - times[0]) / (times[3] - times[0])
        assert np.abs(path[k] - on_line).max() < 0.03  # impact times are rounded to control steps

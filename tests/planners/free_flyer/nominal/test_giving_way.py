"""Two objects whose areas hold each other: one is put aside until the other one has passed."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.scenario import build_scenario
from planners.budget import Work
from planners.free_flyer.nominal.several_objects.composition import compose_objects
from planners.free_flyer.nominal.several_objects.giving_way import give_way
from planners.free_flyer.nominal.task import NominalTask, PlanOptions
from planners.free_flyer.reserves import Reserves
from planners.free_flyer.specification.requirement import read_demands

WAYS = {"left": np.array([[2.0, 2.0], [2.0, 2.0], [6.0, 2.0], [6.0, 2.0]])}
WAYS["right"] = WAYS["left"][::-1]
LEAST = 0.15  # robustness that is kept [m]


def _body(x: float) -> dict[str, object]:
    return {"start": (x, 2.0), "mass": 16.8, "inertia": 0.16, "radius": 0.2, "speed_limit": 0.3}


@pytest.fixture(scope="module")
def task() -> NominalTask:
    """Return a swap on one line."""
    scenario = build_scenario(
        {
            "domain": "free_flyer",
            "name": "swap",
            "formula": "G[120,120] left in east & G[120,120] right in west",
            "horizon": 120.0,
            "control_period": 0.1,
            "world": {"lower": (0.0, 0.0), "upper": (8.0, 4.0)},
            "robots": {
                name: _body(x) | {"goal": (x, 2.0), "force_limit": 1.5, "torque_limit": 0.5}
                for name, x in (("snap", 0.8), ("crackle", 7.2))
            },
            "objects": {"left": _body(2.0), "right": _body(6.0)},
            "regions": {
                name: {"lower": (x - 0.5, 1.5), "upper": (x + 0.5, 2.5)} for name, x in (("west", 2.0), ("east", 6.0))
            },
            "believed": {"restitution": 0.8},
        },
        source="test",
    )
    assert isinstance(scenario, FreeFlyerScenario)
    return NominalTask(scenario, read_demands(scenario, Reserves().wall), Reserves(), work=Work())


def test_objects_one_after_another_cannot_swap(task: NominalTask) -> None:
    assert compose_objects(task, {"left": 2, "right": 2}, 6, 1, (LEAST, 0.5), lambda: 60.0, PlanOptions()) is None


def test_one_object_waits_aside_while_the_other_one_passes(task: NominalTask) -> None:
    found = give_way(task, WAYS, 6, 1, (LEAST, 0.5), lambda: 60.0, PlanOptions())
    assert found is not None
    assert found.rho >= LEAST
    sequence = found.reduce_cost(LEAST).sequence
    struck = [name for name, _ in itertools.groupby(name for _, name in sequence.hitters)]
    assert struck in (["left", "right", "left"], ["right", "left", "right"])
    times = np.linspace(0.0, 120.0, 1201)
    left, right = (
        np.stack([np.interp(times, sequence.times, sequence.paths[name][:, d]) for d in range(2)], axis=1)
        for name in ("left", "right")
    )
    assert np.abs(left[-1] - [6.0, 2.0]).max() <= 0.5 - LEAST + 1e-5
    assert np.abs(right[-1] - [2.0, 2.0]).max() <= 0.5 - LEAST + 1e-5
    assert np.linalg.norm(left - right, axis=1).min() > 0.4


def test_too_few_impacts_let_nothing_give_way(task: NominalTask) -> None:
    assert give_way(task, WAYS, 5, 1, (LEAST, 0.5), lambda: 60.0, PlanOptions()) is None

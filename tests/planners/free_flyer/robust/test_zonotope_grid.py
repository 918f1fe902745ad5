"""The paper's constant grid bears at least the published deviations.

Constants: published repository, impact-robust variants. The published code allows no impact at the last boundary, so
3 segments of growth are left after the last impact: published delta = (half width of the target) / (3 dt).
"""

from typing import Any

import pytest

from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.scenario import build_scenario
from planners.free_flyer.reserves import Reserves
from planners.free_flyer.robust.conditions import Conditions
from planners.free_flyer.robust.deviation_search import maximise_deviation
from planners.free_flyer.robust.task import RobustTask
from planners.free_flyer.specification.requirement import read_demands

NONE = Reserves(speed=1.0, thrust=1.0, first=0.0, gap=0.1, last=0.0, clearance=0.0, wall=0.0, avoid=0.0)
# Robots with start, goal and speed limit; object; target; formula; further areas; segments; greatest final velocity.
CORRIDOR: dict[str, Any] = {
    "horizon": 80.0,
    "world": ([-1.0, 0.0], [3.0, 10.0]),
    "robots": {"snap": ([1.0, 1.0], [1.0, 1.0], 0.3), "crackle": ([1.0, 9.0], [1.0, 9.0], 0.3)},
    "start": [1.0, 2.0],
    "end": ([0.5, 7.5], [1.5, 8.5]),
    "segments": 7,
    "final": 0.05,
}
THROW: dict[str, Any] = {
    "horizon": 30.0,
    "world": ([0.0, -1.5], [4.0, 1.5]),
    "robots": {"crackle": ([0.4, 0.0], [0.4, 0.0], 0.3), "pop": ([3.5, 0.0], [3.5, 0.0], 0.3)},
    "start": [1.2, 0.0],
    "end": ([2.1, -0.4], [2.9, 0.4]),
    "segments": 6,
    "final": 0.1,
}
OBSTACLE: dict[str, Any] = {
    "horizon": 150.0,
    "world": ([0.0, 0.0], [10.0, 10.0]),
    "robots": {"snap": ([9.0, 5.0], [9.0, 1.0], 2.0), "crackle": ([1.0, 7.0], [1.0, 1.0], 2.0)},
    "start": [5.5, 5.0],
    "end": ([4.5, 0.5], [5.5, 1.5]),
    "block": ([2.7, 1.7], [8.0, 4.3]),
    "segments": 5,
    "final": 0.05,
}


def _build(constants: dict[str, Any]) -> FreeFlyerScenario:
    horizon = constants["horizon"]
    formula = f"G[{horizon},{horizon}] item in end"
    obstacles = {}
    if "block" in constants:
        formula += f" & G[0,{horizon}] all not in block"
        obstacles["block"] = {"lower": constants["block"][0], "upper": constants["block"][1]}
    body = {"mass": 16.8, "inertia": 0.16, "radius": 1e-9}
    thrust = {"force_limit": 1e4, "torque_limit": 1.0}
    return build_scenario(
        {
            "domain": "free_flyer",
            "description": "published constants",
            "formula": formula,
            "horizon": horizon,
            "control_period": 0.1,
            "world": {"lower": constants["world"][0], "upper": constants["world"][1]},
            "robots": {
                name: body | thrust | {"start": start, "goal": goal, "speed_limit": fastest}
                for name, (start, goal, fastest) in constants["robots"].items()
            },
            "objects": {"item": body | {"start": constants["start"], "speed_limit": 2.0}},
            "regions": {"end": {"lower": constants["end"][0], "upper": constants["end"][1]}},
            "obstacles": obstacles,
            "believed": {"restitution": 1.0},
        },
        source="published constants",
    )


@pytest.mark.parametrize(
    ("constants", "published", "best"),
    [
        pytest.param(CORRIDOR, 0.5 / (3 * 80 / 7), 0.03125, id="corridor"),
        pytest.param(THROW, 0.4 / (3 * 30 / 6), 0.06, id="throw and catch"),
        pytest.param(OBSTACLE, 0.5 / (3 * 150 / 5), 0.5 / 30, id="obstacle"),
    ],
)
def test_an_impact_at_the_last_boundary_bears_more_than_published(
    constants: dict[str, Any], published: float, best: float
) -> None:
    scenario = _build(constants)
    conditions = Conditions(0.1, constants["final"], (0.0, 0.0), 0.0, points=True)
    task = RobustTask(scenario, read_demands(scenario, 0.0), conditions, NONE, constants["segments"])
    optimum = maximise_deviation(task, 6, 100.0)
    assert optimum.delta == pytest.approx(best, abs=1e-6)
    assert optimum.bound == pytest.approx(optimum.delta, abs=1e-6)
    assert optimum.delta > 1.1 * published

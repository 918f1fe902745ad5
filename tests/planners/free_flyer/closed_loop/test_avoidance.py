"""A robot brakes in time before what it is not to hit, and leaves alone what it is to hit."""

from __future__ import annotations

import numpy as np
import pytest

from impact_envs import load_scenario
from impact_envs.free_flyer.schema import FreeFlyerScenario
from planners import make_plan
from planners.free_flyer.belief.plan_table import END, PlanTable, make_plan_table
from planners.free_flyer.belief.world_memory import AVOIDED, WorldMemory, make_world_memory
from planners.free_flyer.closed_loop.avoidance import keep_off
from planners.free_flyer.tracking.course import IMPACT
from planners.free_flyer.tracking.mpc import FEEDBACK, GAIN, INPUT_LIMIT

PERIOD = 0.1


@pytest.fixture(scope="module")
def table() -> PlanTable:
    scenario = load_scenario("throw_and_catch")
    assert isinstance(scenario, FreeFlyerScenario)
    return make_plan_table(scenario, make_plan(scenario))


def follow_line(table: PlanTable, memory: WorldMemory, limited: bool, crossing: np.ndarray) -> float:
    """Let robot 0 follow a line at .3 m/s that body 1 crosses at .13 m/s; return their least distance [m]."""
    z, y = memory.filter[0, 0], memory.filter[0, 1]
    z[:4], y[:4], memory.filter[0, 2, :2] = (0.0, 0.0, 0.3, 0.0), crossing, (50.0, 50.0)
    pilot, nearest = table.pilot[0], np.inf
    most = pilot[GAIN] * pilot[INPUT_LIMIT]
    for k in range(400):
        a = np.empty(2)
        for axis, (place, speed) in enumerate(((0.03 * k, 0.3), (0.0, 0.0))):
            position, velocity = pilot[FEEDBACK + 2 * axis : FEEDBACK + 2 * axis + 2]
            a[axis] = -pilot[GAIN] * (position * (z[axis] - place) + velocity * (z[2 + axis] - speed))
        a *= min(1.0, most / max(float(np.hypot(*a)), 1e-12))
        if limited:
            a[:] = keep_off(table, memory, 0, 0, END, *a)[:2]
            assert np.hypot(*a) <= most * (1 + 1e-9)
        z[:2] += PERIOD * z[2:4] + PERIOD**2 / 2 * a
        z[2:4] += PERIOD * a
        y[:2] += PERIOD * y[2:4]
        nearest = min(nearest, float(np.hypot(*(z[:2] - y[:2]))))
    return nearest


@pytest.mark.parametrize("crossing", [(3.0, -1.3, 0.0, 0.13), (3.0, 1.4, 0.0, -0.13), (4.0, 0.0, -0.1, 0.0)])
def test_keeps_half_a_metre_from_who_crosses_its_way(table: PlanTable, crossing: tuple[float, ...]) -> None:
    memory = make_world_memory(table, 1)
    memory.course[0, 1, IMPACT] = 1.0  # the other one does not give way
    assert follow_line(table, memory, False, np.array(crossing)) < 0.4
    assert follow_line(table, memory, True, np.array(crossing)) > 0.499
    assert memory.counts[0, AVOIDED] > 0


def test_leaves_a_target_and_what_flies_away_alone(table: PlanTable) -> None:
    memory = make_world_memory(table, 1)
    memory.filter[0, :, :4] = [(0, 0, 0.3, 0), (0, 9, 0, 0), (0.6, 0, 0.0, 0.0)]
    assert keep_off(table, memory, 0, 0, 2, 0.01, 0.02)[:2] == (0.01, 0.02)
    ax, ay, slack = keep_off(table, memory, 0, 0, END, 0.01, 0.02)
    assert ax < -0.05
    assert slack > 0.0  # too near to brake in time: as hard as it can, and it says so
    memory.filter[0, 2, 2] = 0.4
    assert keep_off(table, memory, 0, 0, END, 0.01, 0.02) == (0.01, 0.02, 0.0)
    assert ay <= 0.02

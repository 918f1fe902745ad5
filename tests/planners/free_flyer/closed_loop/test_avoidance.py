"""A robot brakes in time before what it is not to hit, walls among it, and leaves alone what it is to hit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from planners import make_plan
from planners.free_flyer.belief.options import EXPERT, make_record
from planners.free_flyer.belief.plan_table import PlanTable, make_plan_table
from planners.free_flyer.belief.world_memory import WorldMemory, make_world_memory
from planners.free_flyer.closed_loop.avoidance import NO_TARGET, avoid_bodies, hold_barrier
from planners.free_flyer.tracking.mpc import FEEDBACK, GAIN, INPUT_LIMIT
from tests.planners.free_flyer.plans import load, set_estimate
from tests.planners.free_flyer.plans import make_plan as make_resting_plan

OPTIONS = make_record(EXPERT)[0]

PERIOD = 0.1


@pytest.fixture(scope="module")
def table() -> PlanTable:
    scenario = load("throw_and_catch")
    return make_plan_table(scenario, make_plan(scenario))


def follow_line(table: PlanTable, memory: WorldMemory, limited: bool, crossing: np.ndarray) -> float:
    """Let robot 0 follow a line at .3 m/s that body 1 crosses at .13 m/s; return their least distance [m]."""
    z, y = memory.filter[0, 0], memory.filter[0, 1]
    for body, state in enumerate(((0.0, 0.0, 0.3, 0.0), crossing, (50.0, 50.0, 0.0, 0.0))):
        set_estimate(memory.filter[0, body, ...], state[:2], state[2:])
    pilot, nearest = table.pilot[0], np.inf
    most = pilot[GAIN] * pilot[INPUT_LIMIT]
    for k in range(400):
        a = np.empty(2)
        for axis, (place, speed) in enumerate(((0.03 * k, 0.3), (0.0, 0.0))):
            position, velocity = pilot[FEEDBACK + 2 * axis : FEEDBACK + 2 * axis + 2]
            a[axis] = -pilot[GAIN] * (
                position * (z["position"][axis] - place) + velocity * (z["velocity"][axis] - speed)
            )
        a *= min(1.0, most / max(float(np.hypot(*a)), 1e-12))
        if limited:
            a[:] = avoid_bodies(table, memory, OPTIONS, 0, 0, NO_TARGET, *a)[:2]
            assert np.hypot(*a) <= most * (1 + 1e-9)
        z["position"] += PERIOD * z["velocity"] + PERIOD**2 / 2 * a
        z["velocity"] += PERIOD * a
        y["position"] += PERIOD * y["velocity"]
        nearest = min(nearest, float(np.hypot(*(z["position"] - y["position"]))))
    return nearest


@pytest.mark.parametrize("crossing", [(3.0, -1.3, 0.0, 0.13), (3.0, 1.4, 0.0, -0.13), (4.0, 0.0, -0.1, 0.0)])
def test_keeps_half_a_metre_from_who_crosses_its_way(table: PlanTable, crossing: tuple[float, ...]) -> None:
    memory = make_world_memory(table, 1)
    memory.course[0, 1]["ends_in_impact"] = True  # the other one does not give way
    assert follow_line(table, memory, False, np.array(crossing)) < 0.4
    assert follow_line(table, memory, True, np.array(crossing)) > 0.499
    assert memory.counts["avoided"][0] > 0


def test_leaves_a_target_and_what_flies_away_alone(table: PlanTable) -> None:
    memory = make_world_memory(table, 1)
    memory.filter["position"][0] = [(0, 0), (0, 9), (0.6, 0)]
    memory.filter["velocity"][0] = [(0.3, 0), (0, 0), (0, 0)]
    assert avoid_bodies(table, memory, OPTIONS, 0, 0, 2, 0.01, 0.02)[:2] == (0.01, 0.02)
    ax, ay, slack = avoid_bodies(table, memory, OPTIONS, 0, 0, NO_TARGET, 0.01, 0.02)
    assert ax < -0.05
    assert slack > 0.0  # too near to brake in time: as hard as it can, and it says so
    memory.filter["velocity"][0, 2, 0] = 0.4
    assert avoid_bodies(table, memory, OPTIONS, 0, 0, NO_TARGET, 0.01, 0.02) == (0.01, 0.02, 0.0)
    assert ay <= 0.02


def make_crew() -> tuple[PlanTable, WorldMemory]:
    """Return the crew's world of 10 m with a pillar from 4 to 6 m; all bodies but the first robot are far away."""
    scenario = load("crew")
    table = make_plan_table(scenario, make_resting_plan(scenario))
    memory = make_world_memory(table, 1)
    memory.filter["position"][0] = [(60.0 + 5.0 * i, 60.0) for i in range(len(table.body))]
    return table, memory


def drive(wish: tuple[float, float], start: tuple[float, ...], walls: bool = True) -> np.ndarray:
    """Let the first robot push as it wishes for 60 s, as far as it may; return its places, shape (600, 2)."""
    table, memory = make_crew()
    z, places, options = memory.filter[0, 0], [], make_record(replace(EXPERT, walls=walls))[0]
    z["position"], z["velocity"] = start[:2], start[2:]
    for _ in range(600):
        a = np.array(avoid_bodies(table, memory, options, 0, 0, NO_TARGET, *wish)[:2])
        z["position"] += PERIOD * z["velocity"] + PERIOD**2 / 2 * a
        z["velocity"] += PERIOD * a
        places.append(z["position"].copy())
    return np.array(places)


@pytest.mark.parametrize("speed", [0.0, -0.3, -0.4])
def test_robot_driven_at_a_wall_stops_before_it(speed: float) -> None:
    """Its radius is 0.2 m; it stops at the clearance and stays there."""
    places = drive((-0.08, 0.0), (3.0, 8.0, speed, 0.0))
    assert places[:, 0].min() > 0.2
    assert places[-1] == pytest.approx((0.2 + EXPERT.surroundings.clearance, 8.0), abs=1e-3)
    assert drive((-0.08, 0.0), (3.0, 8.0, speed, 0.0), walls=False)[-1, 0] < -9.0


def test_robot_driven_at_a_solid_obstacle_or_into_a_corner_stops_before_it() -> None:
    places = drive((0.05, 0.0), (2.0, 4.5, 0.2, 0.0))
    assert places[-1] == pytest.approx((3.8 - EXPERT.surroundings.clearance, 4.5), abs=1e-3)
    assert places[:, 0].max() < 3.8
    assert drive((-0.05, -0.05), (2.0, 2.0, 0.0, 0.0))[-1] == pytest.approx((0.23, 0.23), abs=2e-3)


def test_place_of_contact_near_a_wall_can_be_reached() -> None:
    """A robot that is to hit something 1 cm off the wall may come there, and need not be able to brake before that."""
    table, memory = make_crew()
    set_estimate(memory.filter[0, 0, ...], (0.35, 5.0), (-0.25, 0.0))
    memory.time[0] = 10.0
    target, wish, strike = table.robots, (-0.01, 0.0), memory.strike[0, 0]

    def avoid(contact: float, time: float, speed: float = 0.26) -> float:
        strike["contact"], strike["time"], strike["robot_minus"] = (contact, 5.0), time, (-speed, 0.0)
        return float(avoid_bodies(table, memory, OPTIONS, 0, 0, target, *wish)[0])

    assert avoid(0.21, 10.3) == -0.01
    assert avoid(0.21, 10.3, 0.1) > 0.05  # faster than the impact needs
    assert avoid(0.21, 12.0) > 0.05  # the wall comes first
    assert avoid(0.1, 10.3) > 0.05  # in the wall: there is no such impact
    assert avoid_bodies(table, memory, OPTIONS, 0, 0, NO_TARGET, *wish)[0] > 0.05


def test_published_barrier_holds_where_the_thrust_is_enough(table: PlanTable) -> None:
    """h'' + 2 h' + h >= 0 of h = d^2 - 0.5^2 keeps a robot that is sent through an object half a metre from it."""
    memory = make_world_memory(table, 1)
    memory.filter["position"][0] = [(-2.0, 0.02), (0, 9), (0, 0)]
    z, y, nearest = memory.filter[0, 0], memory.filter[0, 2], np.inf
    z["velocity"] = (0.08, 0.0)
    for _ in range(600):
        wished = 0.1 * (np.array([0.08, 0.0]) - z["velocity"])
        a = np.array(hold_barrier(table, memory, OPTIONS, 0, 0, NO_TARGET, *wished))
        assert a[2] == 0.0
        d, v = z["position"] - y["position"], z["velocity"] - y["velocity"]
        assert 2 * (v @ v + d @ a[:2]) + 2 * 2 * d @ v + d @ d - 0.25 >= -1e-9
        z["position"] += PERIOD * z["velocity"] + PERIOD**2 / 2 * a[:2]
        z["velocity"] += PERIOD * a[:2]
        nearest = min(nearest, float(np.hypot(*(z["position"] - y["position"]))))
    assert 0.49 < nearest < 0.56
    assert memory.counts["avoided"][0] > 0


def test_published_barrier_leaves_robots_and_the_target_alone(table: PlanTable) -> None:
    memory = make_world_memory(table, 1)
    memory.filter["position"][0] = [(0, 0), (0.45, 0), (-0.45, 0)]
    memory.filter["velocity"][0, 0] = (0.1, 0.0)
    assert hold_barrier(table, memory, OPTIONS, 0, 0, NO_TARGET, 0.0, 0.0)[0] >= 0.0  # off the object, towards a robot
    memory.filter["velocity"][0, 0] = (-0.1, 0.0)
    assert hold_barrier(table, memory, OPTIONS, 0, 0, 2, 0.01, 0.02) == (0.01, 0.02, 0.0)
    assert hold_barrier(table, memory, OPTIONS, 0, 0, NO_TARGET, 0.01, 0.02)[2] > 0.0  # too fast, too near: it says so

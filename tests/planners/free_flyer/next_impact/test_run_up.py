"""A robot that lost its course hits as fast as it can be after a run-up from rest in the room that there is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from planners.free_flyer.belief.options import EXPERT, make_record
from planners.free_flyer.next_impact.replanner import replan_course, solve_strike
from planners.free_flyer.next_impact.run_up import find_run_up_share
from planners.free_flyer.tracking.mpc import GAIN, INPUT_LIMIT
from tests.planners.free_flyer.plans import OPTIONS, K, World, load, make_plan, plan_impact

SNAP, POP, PIP = 0, 4, 5
RADIUS = 0.2
MANY = make_record(replace(EXPERT, reach=replace(EXPERT.reach, steps=200)))[0]


class Wall(World):
    """Snap is to throw pop, at rest at (x, 2), 6 m to the right at 20 s; the left wall of the crew's world is at 0."""

    def __init__(self, x: float) -> None:
        scenario = load("crew")
        hits = [plan_impact(20.0, "snap", "pop", (x, 2.0)), plan_impact(45.0, "snap", "pop", (x + 6.0, 2.0))]
        super().__init__(scenario, make_plan(scenario, hits))
        self.see(POP, (x, 2.0))
        for i, body in enumerate((PIP, PIP + 1)):
            self.see(body, (9.0, 7.0 + i))

    def find_share(self, x: float, speed: float, options: np.void = MANY) -> float:
        place, velocity, change = (x, 2.0), (0.0, 0.0), (speed, 0.0)
        return find_run_up_share(
            self.table, self.memory, options, K, SNAP, 0, place, velocity, change, 2.0 * RADIUS, 1.0
        )

    @property
    def most(self) -> float:
        pilot = self.table.pilot[SNAP]
        return EXPERT.reach.run_up * pilot[GAIN] * pilot[INPUT_LIMIT]


@pytest.mark.parametrize("room", [0.3, 0.5, 0.9])
def test_speed_is_what_the_room_to_the_wall_allows(room: float) -> None:
    x = 3.0 * RADIUS + room
    world = Wall(x)
    fastest = np.sqrt(2.0 * world.most * room)
    assert world.find_share(x, 2.0 * fastest) == pytest.approx(0.5, rel=1e-3)
    assert world.find_share(x, 0.99 * fastest) == 1.0
    assert world.find_share(x, 0.0) == 1.0


def test_object_behind_the_place_leaves_less_room() -> None:
    world = Wall(4.0)
    free = world.find_share(4.0, 10.0)
    world.see(PIP, (2.0, 2.0))
    between = 4.0 - 2.0 * RADIUS - 2.0 - 2.0 * RADIUS  # from snap at the contact to snap at pip
    assert world.find_share(4.0, 10.0) == pytest.approx(np.sqrt(2.0 * world.most * between) / 10.0, rel=1e-3)
    assert world.find_share(4.0, 10.0) < free


def test_few_steps_are_on_the_safe_side() -> None:
    """With eight steps of the distance to the nearest wall the room is never taken for larger than it is."""
    for x in (0.7, 1.0, 2.0):
        world = Wall(x)
        assert 0.0 < world.find_share(x, 5.0, OPTIONS) <= world.find_share(x, 5.0) + 1e-12


def test_robot_off_its_course_hits_more_gently_in_the_same_direction() -> None:
    """Half a metre behind pop is the wall: snap, which is far off its course, can not be as fast there as it should."""
    world = Wall(1.0)
    solve_strike(world.table, world.memory, OPTIONS, K, SNAP, 0, 0.0)
    planned, normal = np.hypot(*world.strike["robot_minus"][0]), world.strike["normal"][0].copy()
    world.see(SNAP, (3.0, 5.0))
    replan_course(world.table, world.memory, OPTIONS, K, SNAP, 0, 0.0)
    assert world.count("lost") == 1
    assert world.strike["is_slowed"][0]
    speed = np.hypot(*world.strike["robot_minus"][0])
    assert speed == pytest.approx(np.sqrt(2.0 * world.most * 0.4), rel=0.02)
    assert speed < 0.9 * planned
    assert world.strike["normal"][0] == pytest.approx(normal, abs=0.2)

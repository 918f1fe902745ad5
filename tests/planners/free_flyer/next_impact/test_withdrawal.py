"""An inserted impact that cannot be is withdrawn; one that came a little early or late was the one that was meant."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from planners.free_flyer.belief.options import EXPERT, VARIANTS, make_record
from planners.free_flyer.belief.world_memory import NO_ROBOT
from planners.free_flyer.next_impact.replanner import may_wait, postpone_impact, replan_course, solve_strike
from planners.free_flyer.next_impact.two_body import Outcome
from tests.planners.free_flyer.plans import K, World, load_open, make_straight_plan, set_fields

OPTIONS = make_record(EXPERT)[0]
HORIZON, HIT, NOW, LEAD = 100.0, 10.0, 12.0, 6.0
SNAP, CRACKLE, POP = range(3)
BAND = "G[0,100] (pop.y <= 0.5 & pop.y >= -0.5)"
THREE = [(HIT, "snap", "pop", (1.0, 0.0)), (30.0, "crackle", "pop", (3.0, 0.0)), (60.0, "snap", "pop", (1.5, 0.0))]


class Loop(World):
    """World 1 of three, in which snap is to hit pop once more at 18 s, before crackle does so at 30 s."""

    def __init__(self, vx: float, robot: tuple[float, float] = (0.5, 0.0)) -> None:
        scenario = load_open(BAND, {"pop": (1.0, 0.0)}, HORIZON)
        super().__init__(scenario, make_straight_plan(scenario, THREE), EXPERT)
        self.contact(SNAP, POP, HIT)
        self.strike = self.strike[0]
        self.see(POP, (1.0 + vx * (NOW - HIT), 0.0), (vx, 0.0))
        self.see(SNAP, robot)
        self.see(CRACKLE, (4.0, 0.0))
        self.memory.time[K] = NOW
        set_fields(self.strike, is_inserted=True, robot=SNAP, time=NOW + LEAD, due=NOW + LEAD, insertions=1)

    def replan(self) -> None:
        replan_course(self.table, self.memory, OPTIONS, K, SNAP, 0, NOW)

    def is_withdrawn(self) -> bool:
        """Return whether the planned impact is the coming one again."""
        planned = self.strike["robot"] == CRACKLE and self.strike["time"] == self.clock[1]
        return bool(planned and not self.strike["is_inserted"]) and self.count("withdrawn") == 1


def test_solvable_one_stands() -> None:
    loop = Loop(vx=0.05)
    loop.replan()
    assert loop.strike["outcome"] == Outcome.EXACT
    assert loop.strike["share"] == pytest.approx(1.0)
    assert loop.strike["is_inserted"]
    assert loop.count("withdrawn") == 0


def test_object_that_flees_faster_than_its_robot_may_fly_is_left_alone() -> None:
    """At 50 mm/s no robot of 40 mm/s pushes it on; the planned impact is the coming one again."""
    loop = Loop(vx=0.05)
    loop.table.body["speed_limit"][SNAP] = 0.04
    solve_strike(loop.table, loop.memory, OPTIONS, K, SNAP, 0, NOW)
    assert loop.strike["outcome"] == Outcome.OUT_OF_REACH
    assert loop.strike["share"] == 0.0
    loop.replan()
    assert loop.is_withdrawn()
    assert not loop.course[SNAP]["ends_in_impact"]


def test_robot_that_lost_its_course_does_not_chase_the_object() -> None:
    """Seven metres behind it snap would need far more than the seconds by which the impact may be put off."""
    loop = Loop(vx=0.05, robot=(-6.0, 0.0))
    solve_strike(loop.table, loop.memory, OPTIONS, K, SNAP, 0, NOW)
    assert not postpone_impact(loop.table, loop.memory, OPTIONS, K, SNAP, 0, NOW)
    assert loop.strike["time"] <= loop.strike["due"] + EXPERT.insertion.delay
    again = Loop(vx=0.05, robot=(-6.0, 0.0))
    again.replan()  # its course begins where the plan has it, which is more than `off_course` away
    assert again.is_withdrawn()


def test_inserted_one_waits_for_seconds_and_never_into_the_next_one() -> None:
    loop = Loop(vx=0.05)
    delay, leg = EXPERT.insertion.delay, EXPERT.insertion.least_leg
    for later, waits in ((delay, True), (delay + 0.1, False)):
        assert may_wait(loop.table, loop.memory, OPTIONS, K, 0, NOW + LEAD + later) == waits
    loop.memory.clock[K, 1] = NOW + LEAD + 1.0 + leg
    for later, waits in ((1.0, True), (1.1, False)):
        assert may_wait(loop.table, loop.memory, OPTIONS, K, 0, NOW + LEAD + later) == waits


def test_planned_one_waits_only_while_the_object_is_where_its_knot_demands_it() -> None:
    """At 25 mm/s sideways since 10 s the object leaves the band of 0.5 m at 30 s."""
    loop = Loop(vx=0.1)
    set_fields(loop.strike, is_inserted=False, robot=CRACKLE, time=25.0, due=25.0)
    loop.see(POP, (1.2, 0.05), (0.1, 0.025))
    for later, waits in ((29.9, True), (30.1, False)):
        assert may_wait(loop.table, loop.memory, OPTIONS, K, 0, later) == waits
    assert not may_wait(loop.table, loop.memory, OPTIONS, K, 0, HORIZON)


@pytest.mark.parametrize(("now", "planned"), [(17.0, True), (15.9, False)])
def test_contact_at_the_time_that_was_meant_is_the_impact_that_was_meant(now: float, planned: bool) -> None:
    """Its robot postponed it from 18 to 21 s, and hits as was meant first: at most 2 s early."""
    loop = Loop(vx=0.05)
    loop.strike["time"] += 3.0
    loop.contact(SNAP, POP, now)
    assert loop.strike["is_inserted"] != planned
    assert loop.count("unplanned_contact") == (0 if planned else 1)


def test_no_impact_is_inserted_that_its_robot_is_too_slow_for() -> None:
    """Pop leaves the band at 50 mm/s, and flies along it at 100 mm/s: robots of 20 mm/s cannot keep up."""
    for limit, inserted in ((0.5, 1), (0.02, 0)):
        loop = Loop(vx=0.1)
        set_fields(loop.strike, is_inserted=False, robot=CRACKLE, time=30.0, due=30.0, insertions=0)
        loop.see(POP, (1.2, 0.03), (0.1, 0.05))
        loop.see(SNAP, (2.0, -1.5))
        loop.see(CRACKLE, (2.0, 1.5))
        loop.table.body["speed_limit"][:POP] = limit
        loop.options = replace(VARIANTS["with_insertion"], retime=False)
        loop.look(NOW)
        assert loop.count("inserted") == inserted


def test_withdrawn_one_leaves_no_robot_waiting() -> None:
    loop = Loop(vx=0.05, robot=(-6.0, 0.0))
    set_fields(loop.strike, index=-1)  # it came after the last planned impact
    loop.replan()
    assert loop.strike["robot"] == NO_ROBOT
    assert loop.strike["time"] == math.inf
    np.testing.assert_array_equal(loop.course["ends_in_impact"], False)

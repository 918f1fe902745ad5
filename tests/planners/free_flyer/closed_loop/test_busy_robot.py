"""An impact is put off until its robot, which has to hit something else before, can be there."""

from __future__ import annotations

import pytest

from planners.bezier import Curve
from planners.free_flyer.belief.options import EXPERT, VARIANTS, make_record
from planners.free_flyer.next_impact.insertion import is_served
from planners.free_flyer.next_impact.reachability import compute_arrival, compute_time
from tests.planners.free_flyer.plans import K, World, load_open, make_plan, plan_impact

OPTIONS = make_record(EXPERT)[0]

HORIZON = 100.0
SNAP, CRACKLE, POP, PIP = range(4)
_, OTHER, CATCH = range(3)  # impacts of the plan, on pop, pip and pop
WAY = 1.5  # of crackle, from pip to pop [m]


class Loop(World):
    """World 1 of three: crackle hits pip at 20 s and, 1.5 m further, pop at 22 s, which snap throws at 10 s."""

    def __init__(self) -> None:
        scenario = load_open("F[0,100] pop.x >= -9", {"pop": (1.0, 0.0), "pip": (3.0, WAY)}, HORIZON)
        impacts = (
            plan_impact(10.0, "snap", "pop", (1.0, 0.0)),
            plan_impact(20.0, "crackle", "pip", (3.0, WAY)),
            plan_impact(22.0, "crackle", "pop", (3.0, 0.0)),
        )
        curves = {"pop": Curve([0.0, HORIZON], [[[1.0, 0.0], [3.0, 0.0]]])}
        super().__init__(scenario, make_plan(scenario, impacts, objects=curves), VARIANTS["with_retiming"])

    def arrival(self, index: int) -> float:
        return float(compute_arrival(self.table, self.memory, OPTIONS, K, index))


@pytest.fixture
def loop() -> Loop:
    return Loop()


def test_impact_is_put_off_until_its_robot_can_be_there(loop: Loop) -> None:
    loop.contact(SNAP, POP, 10.0)
    now, arrival = 10.0 + EXPERT.timing.settle, loop.arrival(CATCH)
    assert arrival == 20.0 + compute_time(loop.table, OPTIONS, CRACKLE, WAY) > 24.0
    loop.see(POP, (1.0 + EXPERT.timing.settle * 2 / 12, 0.0), (2 / 12, 0.0))  # on time
    loop.see(PIP, (3.0, WAY))
    loop.see(CRACKLE, (2.6, WAY))
    loop.look(now)
    assert loop.strike[0]["time"] == loop.clock[CATCH] == pytest.approx(arrival, abs=0.1)
    assert loop.clock[CATCH] >= arrival
    assert loop.clock[OTHER] == 20.0


def test_planned_impact_is_served_when_its_robot_is_free_and_near(loop: Loop) -> None:
    loop.see(CRACKLE, (2.6, WAY))
    arrival = loop.arrival(CATCH)
    for time, served in ((arrival - 0.1, False), (arrival + 0.1, True)):
        assert is_served(loop.table, loop.memory, OPTIONS, K, CATCH, 12.0, time) == served
    loop.see(CRACKLE, (2.6, 30.0))
    assert not is_served(loop.table, loop.memory, OPTIONS, K, CATCH, 12.0, arrival + 0.1)

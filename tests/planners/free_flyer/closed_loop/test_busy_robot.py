"""An impact is put off until its robot, which has to hit something else before, can be there."""

from __future__ import annotations

import numpy as np
import pytest

from impact_envs import load_scenario
from impact_envs.free_flyer.schema import FreeFlyerScenario
from planners.bezier import Curve
from planners.free_flyer.belief.options import VARIANTS
from planners.free_flyer.belief.plan_table import make_plan_table
from planners.free_flyer.belief.world_memory import NOBODY, TIME, make_world_memory
from planners.free_flyer.closed_loop.world_loop import look_ahead, start_world
from planners.free_flyer.next_impact.bookkeeping import SETTLE, take_contact
from planners.free_flyer.next_impact.insertion import is_served
from planners.free_flyer.next_impact.reachability import compute_arrival, compute_time
from planners.free_flyer.next_impact.reoptimisation import make_program
from planners.plan import Plan, PlannedImpact

HORIZON = 100.0
SNAP, CRACKLE, POP, PIP = range(4)
_, OTHER, CATCH = range(3)  # impacts of the plan, on pop, pip and pop
K = 1  # the world that is played, of three
WAY = 1.5  # of crackle, from pip to pop [m]


class Loop:
    """World 1 of three: crackle hits pip at 20 s and, 1.5 m further, pop at 22 s, which snap throws at 10 s."""

    def __init__(self) -> None:
        scenario = load_scenario("throw_and_catch")
        assert isinstance(scenario, FreeFlyerScenario)
        item = scenario.objects["pop"].model_dump() | {"rest": False}
        objects = {"pop": item | {"start": [1.0, 0.0]}, "pip": item | {"start": [3.0, WAY]}}
        world = {"world.lower": [-200, -200], "world.upper": [200, 200], "horizon": HORIZON}
        world["formula"] = "F[0,100] pop.x >= -9"
        self.table = make_plan_table(scenario.override(world | {"objects": objects}), self.make_plan(scenario))
        self.memory = make_world_memory(self.table, 3)
        start_world(self.table, self.memory, VARIANTS["with_retiming"], K)
        self.strike, self.clock = self.memory.strike[K], self.memory.clock[K]

    @staticmethod
    def make_plan(scenario: FreeFlyerScenario) -> Plan:
        zero, normal, numbers = np.zeros(2), np.array([1.0, 0.0]), ("robustness", "bound", "gap", "effort")
        places = {"pop": [[1.0, 0.0], [3.0, 0.0]], "pip": [[3.0, WAY], [3.0, WAY]]}
        impacts = tuple(
            PlannedImpact(time, robot, item, np.array(place), zero, normal, zero, zero, zero, 0.1 * normal)
            for time, robot, item, place in (
                (10.0, "snap", "pop", places["pop"][0]),
                (20.0, "crackle", "pip", places["pip"][0]),
                (22.0, "crackle", "pop", places["pop"][1]),
            )
        )
        return Plan(
            scenario=scenario.name,
            objective="robustness",
            horizon=HORIZON,
            effort_bound=None,
            impacts=impacts,
            robots={name: Curve([0.0, HORIZON], [[body.start]]) for name, body in scenario.robots.items()},
            objects={name: Curve([0.0, HORIZON], [place]) for name, place in places.items()},
            solve_seconds=0.0,
            stage_seconds={},
            validated=False,
            **dict.fromkeys(numbers, 0.0),
        )

    def see(self, body: int, position: tuple[float, float], velocity: tuple[float, float] = (0.0, 0.0)) -> None:
        """Let a body's estimate be exact."""
        self.memory.filter[K, body] = 0.0
        self.memory.filter[K, body, :4] = *position, *velocity

    def arrival(self, index: int) -> float:
        return float(compute_arrival(self.table, self.memory, K, index))


@pytest.fixture
def loop() -> Loop:
    return Loop()


def test_impact_is_put_off_until_its_robot_can_be_there(loop: Loop) -> None:
    loop.memory.touch[K] = NOBODY
    loop.memory.touch[K, SNAP] = POP
    take_contact(loop.table, loop.memory, K, SNAP, 10.0)
    now, arrival = 10.0 + SETTLE, loop.arrival(CATCH)
    assert arrival == 20.0 + compute_time(loop.table, CRACKLE, WAY) > 24.0
    loop.see(POP, (1.0 + SETTLE * 2 / 12, 0.0), (2 / 12, 0.0))  # on time
    loop.see(PIP, (3.0, WAY))
    loop.see(CRACKLE, (2.6, WAY))
    loop.memory.time[K] = now
    look_ahead(loop.table, loop.memory, VARIANTS["with_retiming"], make_program(), 0, K, now)
    assert loop.strike[0, TIME] == loop.clock[CATCH] == pytest.approx(arrival, abs=0.1)
    assert loop.clock[CATCH] >= arrival
    assert loop.clock[OTHER] == 20.0


def test_planned_impact_is_served_when_its_robot_is_free_and_near(loop: Loop) -> None:
    loop.see(CRACKLE, (2.6, WAY))
    arrival = loop.arrival(CATCH)
    for time, served in ((arrival - 0.1, False), (arrival + 0.1, True)):
        assert is_served(loop.table, loop.memory, K, CATCH, 12.0, time) == served
    loop.see(CRACKLE, (2.6, 30.0))
    assert not is_served(loop.table, loop.memory, K, CATCH, 12.0, arrival + 0.1)

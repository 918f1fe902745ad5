"""A first throw has to be strong enough whatever its gain: where the next window closes soon, it comes sooner."""

from __future__ import annotations

import pytest

from impact_envs import load_scenario
from impact_envs.free_flyer.schema import FreeFlyerScenario
from planners.free_flyer.belief.options import EXPERT, make_record
from planners.free_flyer.belief.plan_table import make_plan_table
from planners.free_flyer.next_impact.bookkeeping import find_departure
from tests.frozen.freeze import get_plan
from tests.planners.free_flyer.plans import World

OPTIONS = make_record(EXPERT)[0]


@pytest.mark.parametrize(("suite", "sooner"), [("nominal", False), ("short", True)])
def test_object_leaves_its_window_sooner_where_a_weak_throw_would_come_too_late(suite: str, sooner: bool) -> None:
    """In ping-pong of 36 s the throw of 5.1 s has 6.9 s for 1.25 m; at 4 s pop leaves a window that opens at 4.8 s."""
    plan = get_plan("pingpong", "hard_v0" if sooner else "nominal")
    scenario = load_scenario("pingpong").suite(suite)
    assert plan is not None
    assert isinstance(scenario, FreeFlyerScenario)
    world, timing = World(scenario, plan), EXPERT.timing
    first, second = world.table.knot[:2]
    if not sooner:
        assert world.clock[0] == world.strike[0]["time"] == plan.impacts[0].time
        return
    assert world.clock[0] == world.strike[0]["time"] < plan.impacts[0].time
    # At the speed of such a flight pop is still inside when the window opens, with 0.3 of the depth left.
    inside = first["depth"] - timing.fast * (first["opens"] - world.clock[0])
    assert inside == pytest.approx((1.0 - timing.inside) * first["depth"])
    # A throw that is weaker by a fourth still comes to the nearer edge of the next region before its window closes.
    way = second["position"][0] - first["position"][0]
    speed = 0.75 * way / (world.clock[1] - world.clock[0])
    assert speed * (second["closes"] - world.clock[0]) >= way - second["depth"]


def test_object_that_moves_at_first_is_hit_as_planned() -> None:
    plan, scenario = get_plan("pingpong", "hard_v0"), load_scenario("pingpong").suite("short")
    assert plan is not None
    assert isinstance(scenario, FreeFlyerScenario)
    table = make_plan_table(scenario.as_believed(), plan)
    assert find_departure(table, OPTIONS, 0) < plan.impacts[0].time
    table.body["start_velocity"][2] = (0.01, 0.0)
    assert find_departure(table, OPTIONS, 0) == plan.impacts[0].time

"""Robots that differ: what one of them can do limits its own impacts, not those of others."""

import pytest

from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.physics.impact import compute_mass_fractions
from impact_envs.scenario import load_scenario
from planners.free_flyer.nominal.event_sequence import compute_impact_caps, compute_speed_caps
from planners.free_flyer.nominal.planner import make_free_flyer_plan
from planners.free_flyer.reserves import Reserves
from planners.free_flyer.validation import validate_plan


def _add_light_robot(name: str, place: tuple[float, float]) -> FreeFlyerScenario:
    """Return a shipped scenario with one more robot of 1 kg, which starts and ends at a place."""
    scenario = load_scenario(name)
    assert isinstance(scenario, FreeFlyerScenario)
    robot = next(iter(scenario.robots.values()))
    light = {"start": place, "goal": place, "mass": 1.0, "force_limit": robot.force_limit / robot.mass}
    robots = {**scenario.robots, "idle": robot.model_copy(update=light)}
    return scenario.model_copy(update={"robots": robots})


def test_an_idle_light_robot_costs_no_robustness() -> None:
    scenario = _add_light_robot("obstacle_avoidance", (0.5, 9.5))
    plan = make_free_flyer_plan(scenario)
    assert plan.robustness == pytest.approx(0.5, abs=1e-6)
    assert plan.gap == 0.0
    assert {impact.robot for impact in plan.impacts} == {"snap", "crackle"}
    validate_plan(scenario, plan)


def test_the_speed_of_a_leg_is_what_its_own_robots_can_give() -> None:
    scenario, reserves = _add_light_robot("pong", (0.5, 1.2)), Reserves()
    assert compute_speed_caps(scenario, "pop", 3, reserves) == compute_speed_caps(
        scenario, "pop", 3, reserves, (("snap", "pop"), ("crackle", "pop"), ("snap", "pop"))
    )
    slow = compute_speed_caps(scenario, "pop", 3, reserves, (("snap", "pop"), ("idle", "pop"), ("snap", "pop")))
    fast = compute_impact_caps(scenario, "pop", 3, reserves)["snap"]
    assert slow[1] < fast[0]
    robot, body = scenario.robots["idle"], scenario.objects["pop"]
    m1, m2, m3, m4 = compute_mass_fractions(robot.mass, body.mass, scenario.believed.restitution)
    for before, after in ((slow[1], -slow[2]), (slow[1], slow[2])):
        minus = (after - m4 * before) / m3
        assert max(abs(minus), abs(m1 * minus + m2 * before)) <= reserves.cruise(robot) + 1e-12

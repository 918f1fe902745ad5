"""Plans from moving starts, and of what is left of a task from the middle of its plan."""

from functools import cache

import numpy as np
import pytest

from impact_envs import parallel_env, rollout
from impact_envs.errors import InputError
from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.physics.impact import compute_mass_fractions
from impact_envs.scenario import load_scenario
from planners import make_expert, make_plan
from planners.errors import Infeasible
from planners.free_flyer.nominal.event_sequence import compute_speed_caps
from planners.free_flyer.nominal.remaining import Past, make_remaining_scenario, plan_rest, progress_specification
from planners.free_flyer.reserves import Reserves
from planners.free_flyer.validation import compute_robustness, validate_plan
from planners.plan import Plan
from tests.frozen.freeze import get_plan

AFTER_FIRST = ["throw_and_catch", "corridor", "pong", "pingpong", "relay"]
SLOWER = [pytest.param(name, marks=pytest.mark.slow) for name in ("obstacle_avoidance", "exchange")]


@cache
def _plan(name: str) -> Plan:
    plan = get_plan(name, "nominal")
    assert plan is not None
    return plan


def _scenario(name: str, **values: object) -> FreeFlyerScenario:
    return load_scenario(name).override(values)  # type: ignore[return-value]


def _track(scenario: FreeFlyerScenario, plan: Plan, now: float) -> Past:
    times = scenario.control_period * np.arange(round(now / scenario.control_period) + 1)
    return times, {name: (plan.robots | plan.objects)[name].position(times) for name in scenario.bodies}


def _state(plan: Plan, now: float, rng: np.random.Generator) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Return a state near the plan's: positions within 5 cm, velocities within 10 mm/s per axis."""
    curves = plan.robots | plan.objects
    positions = {name: curve.position(now) + rng.uniform(-0.05, 0.05, 2) for name, curve in curves.items()}
    return positions, {name: curve.velocity(now) + rng.uniform(-0.01, 0.01, 2) for name, curve in curves.items()}


def _drift(velocity: tuple[float, float], **values: object) -> FreeFlyerScenario:
    return _scenario("throw_and_catch", **{"objects.pop.start_velocity": list(velocity)}, **values)


# Moving starts


def test_a_drifting_object_is_caught_in_the_goal() -> None:
    scenario = _drift((0.0, 0.05), **{"robots.crackle.start_velocity": [-0.1, 0.02]})
    plan = make_plan(scenario)
    assert plan.robustness == pytest.approx(0.25, abs=1e-3)
    (catch,) = plan.impacts
    np.testing.assert_allclose(catch.object_minus, [0.0, 0.05], atol=1e-9)
    np.testing.assert_allclose(catch.position, [0.5, 1.5 + 0.05 * catch.time], atol=1e-9)
    np.testing.assert_allclose(plan.robots["crackle"].velocity(0.0), [-0.1, 0.02], atol=1e-9)
    np.testing.assert_allclose(plan.objects["pop"].velocity(30.0, "left"), 0.0, atol=1e-12)
    assert validate_plan(scenario, plan) == pytest.approx(plan.robustness)


def test_a_drifting_object_is_thrown_into_the_goal() -> None:
    scenario = _drift((-0.03, 0.0))
    plan = make_plan(scenario)
    assert plan.robustness == pytest.approx(0.25, abs=1e-3)
    assert len(plan.impacts) == 2
    np.testing.assert_allclose(plan.impacts[0].object_minus, [-0.03, 0.0], atol=1e-9)


def test_the_expert_expects_the_start_velocity() -> None:
    scenario = _drift((-0.03, 0.0))
    expert = make_expert(scenario, make_plan(scenario))
    expert.reset(0)
    np.testing.assert_allclose(expert.memory.filter[0, -1]["velocity"], [-0.03, 0.0], atol=1e-12)


def test_an_object_that_need_not_rest_may_fly_on_and_one_that_must_is_hit() -> None:
    farther = {"regions.goal.lower": [0.25, 3.05], "regions.goal.upper": [0.75, 3.55]}
    flying = make_plan(_drift((0.0, 0.06), **farther, **{"objects.pop.rest": False}))
    assert flying.impacts == ()
    assert flying.robustness == pytest.approx(0.25, abs=1e-6)
    np.testing.assert_allclose(flying.objects["pop"].position(30.0), [0.5, 3.3], atol=1e-9)
    assert len(make_plan(_drift((0.0, 0.06))).impacts) > 0


def test_what_is_slow_enough_counts_as_at_rest() -> None:
    plan = make_plan(_drift((0.0, 0.025)))
    assert plan.impacts == ()
    assert plan.robustness == pytest.approx(0.25, abs=1e-3)


def test_robots_brake_before_the_wall_they_move_towards() -> None:
    values = {"robots.snap.start": [-0.5, 0.5], "robots.snap.start_velocity": [-0.1, 0.0]}
    plan = make_plan(_drift((0.0, 0.05), **values))
    times = np.linspace(0.0, 30.0, 301)
    assert plan.robots["snap"].position(times)[:, 0].min() >= -0.8
    np.testing.assert_allclose(plan.robots["snap"].velocity(0.0), [-0.1, 0.0], atol=1e-9)


def test_speed_caps_leave_robots_within_their_cruise_at_the_first_impact() -> None:
    scenario, reserves = _drift((0.08, -0.04)), Reserves()
    robot, body = scenario.robots["snap"], scenario.objects["pop"]
    m1, m2, m3, m4 = compute_mass_fractions(robot.mass, body.mass, 0.8)
    caps = compute_speed_caps(scenario, "pop", 2, reserves)
    assert caps[0] == 0.08
    for minus, plus in ((0.08, caps[1]), (0.08, -caps[1]), (-0.08, caps[1])):
        robot_minus = (plus - m4 * minus) / m3
        assert max(abs(robot_minus), abs(m1 * robot_minus + m2 * minus)) <= reserves.cruise(robot) + 1e-12


def test_other_planners_refuse_moving_starts() -> None:
    with pytest.raises(InputError, match="start_velocity"):
        make_plan(_drift((0.0, 0.05)), objective="impact_uncertainty")


def test_the_environment_plays_a_plan_from_a_moving_start() -> None:
    scenario = _drift((0.0, 0.05), **{"robots.crackle.start_velocity": [-0.1, 0.02]})
    plan = make_plan(scenario)
    episode = rollout(parallel_env(scenario), make_expert(scenario, plan), 0)
    assert len(episode.impacts) == len(plan.impacts) == 1
    assert episode.robustness == pytest.approx(plan.robustness, abs=0.03)


# What is left of a task


@pytest.mark.parametrize("name", [*AFTER_FIRST, *SLOWER])
def test_the_rest_is_planned_from_near_the_plan_after_its_first_impact(name: str) -> None:
    scenario, plan, rng = _scenario(name), _plan(name), np.random.default_rng(2)
    now = round(plan.impacts[0].time + 0.2, 9)
    arguments = scenario, now, *_state(plan, now, rng), _track(scenario, plan, now)
    rest = make_remaining_scenario(*arguments)
    found = plan_rest(rest, len(plan.impacts) - 1)
    assert found.validated
    assert found.horizon == rest.horizon == pytest.approx(scenario.horizon - now)
    assert set(found.robots) == set(scenario.robots)
    assert validate_plan(rest, found) == found.robustness > 0.05
    for body in scenario.robots:
        np.testing.assert_allclose(found.robots[body].velocity(0.0), rest.robots[body].start_velocity, atol=1e-9)
    again = plan_rest(rest, len(plan.impacts) - 1)
    assert again.impacts == found.impacts
    assert again.robots == found.robots


def test_the_expert_executes_the_rest() -> None:
    scenario, plan, rng = _scenario("pong"), _plan("pong"), np.random.default_rng(2)
    now = round(plan.impacts[0].time + 0.2, 9)
    arguments = scenario, now, *_state(plan, now, rng), _track(scenario, plan, now)
    rest = make_remaining_scenario(*arguments)
    found = plan_rest(rest, 3)
    episode = rollout(parallel_env(rest), make_expert(rest, found), 0)
    assert len(episode.impacts) == len(found.impacts) == 3
    assert episode.robustness == pytest.approx(found.robustness, abs=0.03)


@pytest.mark.parametrize("name", ["throw_and_catch", "pong", "pingpong", "relay", "exchange"])
def test_the_rest_of_the_plan_is_as_good_as_the_plan(name: str) -> None:
    """The past was good, so the formula's rest on the plan's rest has the sign of the formula on the plan."""
    scenario, plan = _scenario(name), _plan(name)
    for share in (0.0, 0.2, 0.5, 0.8, 0.98):
        now = round(round(share * scenario.steps) * scenario.control_period, 9)
        places = {body: curve.position(now) for body, curve in (plan.robots | plan.objects).items()}
        still = {body: np.zeros(2) for body in scenario.bodies}
        past = _track(scenario, plan, now)
        rest = make_remaining_scenario(scenario, now, places, still, past)
        times = np.linspace(0.0, rest.horizon, 5 * rest.steps + 1)
        later = {body: curve.position(now + times) for body, curve in (plan.robots | plan.objects).items()}
        assert compute_robustness(rest, times, later) >= plan.robustness - 1e-2
        # What the plan has still to do is not done without it.
        if share < 0.5:
            held = {body: np.repeat(points[:1], len(times), axis=0) for body, points in later.items()}
            assert compute_robustness(rest, times, held) < 0.0


def test_what_is_served_is_dropped_and_what_cannot_be_mended_too() -> None:
    scenario, plan = _scenario("pong"), _plan("pong")
    now = round(plan.impacts[2].time + 1.0, 9)
    assert [str(part) for part in progress_specification(scenario, now, _track(scenario, plan, now))] == [
        f"G[{100 - now:g},{100 - now:g}] pop in D"
    ]
    corridor = _scenario("corridor")
    times = np.arange(0.0, 20.05, 0.1)
    tracks = {body: np.repeat([corridor.body(body).start], len(times), axis=0) for body in corridor.bodies}
    tracks["pop"] = tracks["pop"] + [0.2, 0.0]
    inside = progress_specification(corridor, 20.0, (times, tracks))
    tracks["pop"][50:60, 0] = 2.3
    left = progress_specification(corridor, 20.0, (times, tracks))
    assert left == inside  # pop was outside for a second, and is back
    tracks["pop"][50:, 0] = 2.3
    outside = progress_specification(corridor, 20.0, (times, tracks))
    assert [str(part) for part in outside] == [
        "G[80,80] pop in goal",
        "G[0,80] snap in corridor",
        "G[0,80] crackle in corridor",
    ]


def test_states_that_an_estimate_has_wrong_by_millimetres_are_put_right() -> None:
    scenario = _scenario("corridor")
    times = np.array([0.0, 20.0])
    places = {"snap": [1.998, 2.0], "crackle": [1.0, 9.803], "pop": [1.85, 2.37]}
    tracks = {body: np.array([place, place]) for body, place in places.items()}
    tracks["snap"] = tracks["snap"] + [0.004, 0.0]
    positions = {body: track[-1] for body, track in tracks.items()}
    velocities = {"snap": np.array([0.0, 0.31]), "crackle": np.zeros(2), "pop": np.array([0.002, -0.002])}
    rest = make_remaining_scenario(scenario, 20.0, positions, velocities, (times, tracks))
    assert rest.robots["snap"].start[0] <= 1.996
    assert rest.robots["crackle"].start[1] == pytest.approx(9.8)
    assert np.hypot(*np.subtract(rest.robots["snap"].start, rest.objects["pop"].start)) >= 0.4
    assert rest.robots["snap"].start_velocity[1] <= 0.3
    assert rest.objects["pop"].start_velocity == (0.0, 0.0)


def test_nothing_left_to_do_is_no_task() -> None:
    scenario = _scenario("throw_and_catch", formula="F[0,5] pop in goal", **{"objects.pop.start": [0.5, 2.2]})
    times = np.array([0.0, 10.0])
    places = {body: np.array(scenario.body(body).start) for body in scenario.bodies}
    still = {body: np.zeros(2) for body in scenario.bodies}
    past = times, {body: np.array([place, place]) for body, place in places.items()}
    plan = plan_rest(make_remaining_scenario(scenario, 10.0, places, still, past))
    assert plan.impacts == ()
    assert plan.horizon == 20.0
    for now in (30.0, 10.03, -1.0):
        with pytest.raises(InputError, match="now"):
            make_remaining_scenario(scenario, now, places, still, past)


def test_an_object_out_of_reach_is_infeasible() -> None:
    scenario, plan = _scenario("throw_and_catch"), _plan("throw_and_catch")
    now = 12.0
    positions, velocities = _state(plan, now, np.random.default_rng(0))
    velocities["pop"] = np.array([0.5, 0.5])
    rest = make_remaining_scenario(scenario, now, positions, velocities, _track(scenario, plan, now))
    with pytest.raises(Infeasible):
        plan_rest(rest)

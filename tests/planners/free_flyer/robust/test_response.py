from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.scenario import load_scenario
from planners.errors import SolverFailed
from planners.free_flyer.reserves import Reserves
from planners.free_flyer.robust.conditions import Conditions
from planners.free_flyer.robust.deviation_search import compute_ceiling, search_deviation
from planners.free_flyer.robust.least_cost import minimise_robust_cost
from planners.free_flyer.robust.monte_carlo import check_responses, draw_deviations, simulate_runs
from planners.free_flyer.robust.planner import make_impact_robust_plan
from planners.free_flyer.robust.response import Responses, compute_returns, compute_weights
from planners.free_flyer.robust.response_smoothing import make_responses
from planners.free_flyer.robust.task import ResponseOptions, RobustOptions, RobustTask
from planners.free_flyer.specification.grid import GridSize
from planners.free_flyer.specification.requirement import read_demands

DELTA, RUNS = 0.012, 60
# The reserves of a prototype's published table: nine tenths of the speed, no time to start and stop, no distances.
BARE = Reserves(speed=0.9, thrust=1.0, turn=1e9, first=2.0, gap=2.0, last=2.0, clearance=0.0, wall=0.0, avoid=0.0)


def _scenario(name: str, **changes: object) -> FreeFlyerScenario:
    scenario = load_scenario(name).as_believed()
    assert isinstance(scenario, FreeFlyerScenario)
    return scenario.model_copy(update=changes)


@cache
def _responses() -> Responses:
    """Throw and catch from a box of 10 cm."""
    scenario, reserves = _scenario("throw_and_catch"), Reserves()
    conditions = Conditions(5.0, initial=(0.05, 0.05), room=0.1)
    calm = replace(reserves, turn=1.5 * reserves.turn, thrust=reserves.thrust / 1.5)
    task = RobustTask(scenario, read_demands(scenario, reserves.wall), conditions, calm)
    events = minimise_robust_cost(task, GridSize(2), DELTA, [], 60.0)
    return make_responses(scenario, events.sequence, events.needs, 0.0, reserves, ResponseOptions())


def _samples(responses: Responses) -> int:
    return round(responses.scenario.horizon / responses.scenario.control_period)


def test_closed_loop_keeps_every_promise() -> None:
    responses = _responses()
    assert check_responses(responses, 0.0, RUNS, 3, _samples(responses)) >= -1e-6


def test_greater_deviations_than_planned_for_are_caught() -> None:
    responses = _responses()
    sequence = replace(responses.sequence, delta=1.2 * DELTA)
    with pytest.raises(SolverFailed, match="the object's box"):
        check_responses(replace(responses, sequence=sequence), 0.0, RUNS, 3, _samples(responses))


def test_more_robustness_than_the_boxes_leave_is_not_promised() -> None:
    responses = _responses()
    with pytest.raises(SolverFailed, match="the formula"):
        check_responses(responses, 0.2, RUNS, 3, _samples(responses))


def test_a_weaker_robot_is_caught() -> None:
    responses = _responses()
    robots = {name: r.model_copy(update={"force_limit": 0.1}) for name, r in responses.scenario.robots.items()}
    weak = replace(responses, scenario=responses.scenario.model_copy(update={"robots": robots}))
    with pytest.raises(SolverFailed, match="force limit"):
        check_responses(weak, 0.0, RUNS, 3, _samples(responses))


def test_robots_meet_the_object_exactly_wherever_it_is() -> None:
    responses, rng = _responses(), np.random.default_rng(1)
    sequence = responses.sequence
    starts = sequence.centers[0] + draw_deviations(1.0, (RUNS, 2), rng) * sequence.halves[0]
    deviations = draw_deviations(DELTA, (RUNS, 2, 2), rng)
    runs = simulate_runs(responses, starts, deviations)
    assert runs.law < 1e-9
    assert runs.contact < 1e-9
    assert (np.abs(deviations[: RUNS // 2]) == DELTA).all()
    # What was wanted is what the impact law gives, but for the deviation.
    for k in range(2):
        wanted = sequence.command(k + 1, runs.positions[:, k])
        np.testing.assert_allclose(runs.velocities[:, k] - deviations[:, k], wanted, atol=1e-9)


def test_discs_touch_and_approach_along_the_line_of_centres() -> None:
    responses = _responses()
    scenario, sequence = responses.scenario, responses.sequence
    runs = simulate_runs(responses, sequence.centers[:1], np.zeros((1, 2, 2)))
    interval = responses.intervals[sequence.hitters[1]][0]
    points = runs.robots[sequence.hitters[1]][0]
    contact = points[interval.event, 0]
    step = responses.times[interval.event] - responses.times[interval.event - 1]
    minus = 5.0 * (contact - points[interval.event - 1, -2]) / step
    offset, relative = runs.positions[0, 1] - contact, minus - runs.velocities[0, 0]
    robot, body = scenario.robots[sequence.hitters[1]], scenario.objects[sequence.object]
    assert np.linalg.norm(offset) == pytest.approx(robot.radius + body.radius, abs=1e-9)
    assert abs(relative[0] * offset[1] - relative[1] * offset[0]) < 1e-9
    assert relative @ offset > 0.0


def test_nobody_answers_what_is_not_known_yet() -> None:
    responses = _responses()
    sequence = responses.sequence
    thrower, catcher = sequence.hitters
    assert thrower != catcher
    # Where the catch will be is known from the throw on.
    known = np.flatnonzero(responses.times == sequence.times[1])[0]
    before, after = responses.points[catcher][:, :known], responses.points[catcher][:, known:]
    np.testing.assert_allclose(before, before[:1].repeat(4, axis=0), atol=1e-9)
    assert np.abs(after - after[:1]).max() > 0.05
    assert responses.intervals[thrower][0].start == 0.0


def test_responses_are_smooth_but_for_own_impacts() -> None:
    responses = _responses()
    for name in responses.scenario.robots:
        jumps = {responses.sequence.times[interval.impact] for interval in responses.intervals[name]}
        for curve in responses.curves(name):
            for time in set(responses.times[1:-1]) - jumps:
                np.testing.assert_allclose(curve.velocity(time, "left"), curve.velocity(time), atol=1e-7)
                np.testing.assert_allclose(curve.acceleration(time, "left"), curve.acceleration(time), atol=1e-6)


def test_shares_of_the_vertices_give_the_position_back() -> None:
    sequence, rng = _responses().sequence, np.random.default_rng(2)
    lower, upper = sequence.boxes[2]
    places = rng.uniform(lower, upper, (20, 2))
    weights = compute_weights(sequence, 2, places)
    corners = np.array([[x, y] for x in (lower[0], upper[0]) for y in (lower[1], upper[1])])
    assert weights.min() >= 0.0
    np.testing.assert_allclose(weights.sum(axis=1), 1.0)
    np.testing.assert_allclose(weights @ corners, places, atol=1e-12)


@pytest.mark.parametrize(("rest", "event"), [(0, 3), (3, 0)])
def test_returns_end_in_unit_position_and_unit_slope(rest: int, event: int) -> None:
    times = np.array([0.0, 1.0, 2.5, 3.0])
    step, slope = compute_returns(times, rest, event)
    end, other = (step[0, 0], step[-1, -1])[:: 1 if event == 0 else -1]
    assert (end, other) == pytest.approx((1.0, 0.0), abs=1e-12)
    h = times[1] - times[0] if event == 0 else times[3] - times[2]
    pair = (slope[0, 1] - slope[0, 0]) if event == 0 else (slope[-1, -1] - slope[-1, -2])
    assert 5.0 * pair / h == pytest.approx(1.0)
    np.testing.assert_allclose(slope[:-1, -1], slope[1:, 0], atol=1e-12)


@pytest.mark.parametrize(("restitution", "mass"), [(1.0, 30.0), (0.47, 8.0)])
def test_any_masses_and_restitution(restitution: float, mass: float) -> None:
    scenario = _scenario("throw_and_catch")
    objects = {name: body.model_copy(update={"mass": mass}) for name, body in scenario.objects.items()}
    believed = scenario.believed.model_copy(update={"restitution": restitution})
    scenario = scenario.model_copy(update={"objects": objects, "believed": believed})
    plan = make_impact_robust_plan(scenario, max_impacts=2, options=RobustOptions(runs=RUNS))
    assert plan.validated
    assert plan.deviation > 0.01


@pytest.mark.parametrize(("restitution", "least", "greatest"), [(0.8, 0.02, 0.05), (0.05, 0.0, 0.01)])
def test_bodies_that_hardly_part_bear_hardly_any_deviation(restitution: float, least: float, greatest: float) -> None:
    scenario = _scenario("throw_and_catch")
    believed = scenario.believed.model_copy(update={"restitution": restitution})
    scenario = scenario.model_copy(update={"believed": believed})
    task = RobustTask(scenario, read_demands(scenario, 0.05), Conditions(5.0), Reserves())
    found, bound = search_deviation(task, GridSize(2), 0.0, 0.05, 0.1, 60.0)
    assert least < found <= bound < greatest


@pytest.mark.parametrize(
    ("name", "gap", "final", "impacts", "delta"),
    [
        ("throw_and_catch", 2.0, 0.1, 2, 0.0711),
        ("throw_and_catch", 5.0, 0.1, 2, 0.0500),
        ("corridor", 2.0, 0.05, 2, 0.0243),
        ("corridor", 2.0, 0.05, 3, 0.0458),
        ("corridor", 2.0, 0.05, 4, 0.0500),
    ],
)
def test_points_give_the_known_deviations(name: str, gap: float, final: float, impacts: int, delta: float) -> None:
    # e = 1, no thrust limit, target of half width 0.5 m in the corridor, as where these numbers come from.
    scenario = _scenario(name)
    bodies = {
        table: {n: b.model_copy(update={"radius": 0.0}) for n, b in getattr(scenario, table).items()}
        for table in ("robots", "objects")
    }
    robots = {n: b.model_copy(update={"force_limit": 1e9}) for n, b in bodies["robots"].items()}
    regions = dict(scenario.regions)
    if name == "corridor":
        regions["goal"] = regions["goal"].model_copy(update={"lower": (0.5, 7.5), "upper": (1.5, 8.5)})
    believed = scenario.believed.model_copy(update={"restitution": 1.0})
    update = {"robots": robots, "objects": bodies["objects"], "regions": regions, "believed": believed}
    scenario = scenario.model_copy(update=update)
    conditions = Conditions(gap, final, points=True, gather=False)
    task = RobustTask(scenario, read_demands(scenario, 0.0), conditions, BARE)
    ceiling = compute_ceiling(task)
    found, bound = search_deviation(task, GridSize(impacts), 0.0, ceiling, 2e-3, 60.0)
    assert found == pytest.approx(delta, abs=1.5e-4)
    assert found <= bound <= found * 1.003

from functools import cache
from typing import Any

import numpy as np
import pytest

from impact_envs.errors import InputError
from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.physics.impact import compute_mass_fractions
from impact_envs.scenario import load_scenario
from planners import make_plan
from planners.errors import Infeasible, SolverFailed
from planners.free_flyer.reserves import Reserves
from planners.free_flyer.robust.conditions import Conditions
from planners.free_flyer.robust.deviation_search import compute_ceiling, maximise_deviation
from planners.free_flyer.robust.least_cost import minimise_robust_cost
from planners.free_flyer.robust.task import RobustOptions, RobustTask
from planners.free_flyer.specification.grid import GridSize
from planners.free_flyer.specification.requirement import read_demands
from planners.mixed_integer import Model, Solution
from planners.plan import Plan
from planners.solvers import solve


@cache
def _plan() -> Plan:
    return make_plan("throw_and_catch", "impact_uncertainty", time_limit=300.0)  # 2 s, but of a busy machine's clock


def _scenario(name: str) -> FreeFlyerScenario:
    scenario = load_scenario(name).as_believed()
    assert isinstance(scenario, FreeFlyerScenario)
    return scenario


def _task(name: str, gap: float, points: bool = True) -> RobustTask:
    scenario, reserves = _scenario(name), Reserves()
    conditions = Conditions(gap, 0.05, (0.0, 0.0), 0.0, points)
    return RobustTask(scenario, read_demands(scenario, reserves.wall), conditions, reserves)


def test_plan_bears_a_deviation_below_its_bound() -> None:
    plan = _plan()
    assert plan.objective == "impact_uncertainty"
    assert plan.validated
    assert plan.deviation is not None
    assert plan.deviation_bound is not None
    assert 0.01 < plan.deviation < plan.deviation_bound
    assert plan.robustness > 0.0


@pytest.mark.slow
def test_the_bound_is_that_of_every_number_of_impacts() -> None:
    """A search whose greater numbers of impacts are cut knows no more than the ceiling, 0.05 m/s in relay."""
    plan = make_plan("relay", "impact_uncertainty", time_limit=300.0)
    assert plan.deviation == pytest.approx(0.01434, abs=1e-4)
    assert plan.deviation_bound == pytest.approx(0.02173, abs=1e-4)  # six impacts count if they bear a fifth more


def test_boxes_grow_by_the_deviation_and_hold_the_nominal_motion() -> None:
    plan = _plan()
    tube, curve = plan.tubes["pop"], plan.objects["pop"]
    np.testing.assert_allclose(tube.start[0, 0, :2], _scenario("throw_and_catch").objects["pop"].start, atol=1e-9)
    for k in range(len(tube.times) - 1):
        for box, time, side in ((tube.start[k], tube.times[k], "right"), (tube.end[k], tube.times[k + 1], "left")):
            assert (np.abs(curve.position(time) - box[0, :2]) <= box[1, :2] + 1e-6).all()
            assert (np.abs(curve.velocity(time, side) - box[0, 2:]) <= box[1, 2:] + 1e-6).all()
    last = tube.end[-1, 1, :2]
    assert (last >= plan.deviation * (tube.times[-1] - tube.times[-2]) - 1e-9).all()


def test_goal_holds_the_last_box() -> None:
    (lower, upper), box = _goal(), _plan().tubes["pop"].end[-1]
    assert (box[0, :2] - box[1, :2] >= lower - 1e-6).all()
    assert (box[0, :2] + box[1, :2] <= upper + 1e-6).all()


def _goal() -> tuple[np.ndarray, np.ndarray]:
    goal = _scenario("throw_and_catch").regions["goal"]
    return np.array(goal.lower), np.array(goal.upper)


def test_nominal_impacts_obey_the_impact_law() -> None:
    scenario, plan = _scenario("throw_and_catch"), _plan()
    for hit in plan.impacts:
        masses = scenario.robots[hit.robot].mass, scenario.objects[hit.object].mass
        m1, m2, m3, m4 = compute_mass_fractions(*masses, scenario.believed.restitution)
        np.testing.assert_allclose(hit.robot_plus, m1 * hit.robot_minus + m2 * hit.object_minus, atol=1e-9)
        np.testing.assert_allclose(hit.object_plus, m3 * hit.robot_minus + m4 * hit.object_minus, atol=1e-9)


def test_every_robot_has_four_responses_from_its_start_within_its_speed_limit() -> None:
    scenario, plan = _scenario("throw_and_catch"), _plan()
    times = np.linspace(0.0, plan.horizon, 3001)
    for name, robot in scenario.robots.items():
        assert len(plan.responses[name]) == 4
        for curve in plan.responses[name]:
            np.testing.assert_allclose(curve.position(0.0), robot.start, atol=1e-6)
            assert np.abs(curve.velocity(times)).max() <= robot.speed_limit + 1e-9


def test_a_longer_gap_leaves_less_deviation() -> None:
    short, long = (maximise_deviation(_task("throw_and_catch", gap), 3, 60.0) for gap in (5.0, 10.0))
    assert long.delta < short.delta
    assert long.delta <= compute_ceiling(_task("throw_and_catch", 10.0)) + 1e-9


def test_scenario_says_gap_and_where_the_object_may_start() -> None:
    values = {"impact_gap": 7.0, "objects.pop.start_uncertainty": [0.02, 0.01]}
    plan = make_plan(load_scenario("throw_and_catch").override(values), "impact_uncertainty")
    times = [*(hit.time for hit in plan.impacts), plan.horizon]
    assert np.diff(times).min() >= 7.0 - 1e-9
    np.testing.assert_allclose(plan.tubes["pop"].start[0, 1, :2], [0.02, 0.01], atol=1e-9)


def test_what_bears_a_deviation_bears_half_of_it() -> None:
    task = _task("throw_and_catch", 5.0)
    optimum = maximise_deviation(task, 3, 60.0)
    solve(task.build(optimum.size, 0.5 * optimum.delta)[0].model, 60.0)


def test_bodies_with_extent_bear_no_more_than_points() -> None:
    points = maximise_deviation(_task("throw_and_catch", 5.0), 3, 60.0)
    discs = maximise_deviation(_task("throw_and_catch", 5.0, points=False), 3, 60.0)
    assert discs.delta <= points.bound * (1.0 + 1e-6)


def test_nothing_bears_more_than_the_ceiling() -> None:
    task = _task("throw_and_catch", 10.0)
    with pytest.raises(Infeasible):
        solve(task.build(GridSize(2), 1.01 * compute_ceiling(task))[0].model, 60.0)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["corridor", "pong"])
def test_longer_tasks_have_plans_that_the_closed_loop_confirms(name: str) -> None:
    plan = make_plan(name, "impact_uncertainty")
    assert plan.validated
    assert plan.deviation is not None
    assert plan.deviation > 0.005


@pytest.mark.parametrize(
    ("name", "options", "word"),
    [
        ("throw_and_catch", {"options": RobustOptions(share=0.0)}, "share"),
        ("throw_and_catch", {"time_grid": 1}, "time_grid"),
        ("throw_and_catch", {"conditions": Conditions(-1.0)}, "gap"),
        ("throw_and_catch", {"max_impacts": 0}, "max_impacts"),
        ("exchange", {}, "one object, got 2"),
    ],
)
def test_bad_options_are_named(name: str, options: dict, word: str) -> None:
    with pytest.raises(InputError, match=word):
        make_plan(name, "impact_uncertainty", **options)


def test_a_search_cut_by_time_claims_no_bound_below_what_the_last_leg_allows(monkeypatch: pytest.MonkeyPatch) -> None:
    task, found = _task("corridor", 5.0), (0.02, 0.021)

    def search(_: RobustTask, size: GridSize, *__: float) -> tuple[float, float]:
        if size.impacts > 2:
            raise SolverFailed("box grid", "time limit reached", "raise the time limit")
        return found

    monkeypatch.setattr("planners.free_flyer.robust.deviation_search.search_deviation", search)
    optimum = maximise_deviation(task, 6, 60.0)
    assert optimum.delta == found[0]
    assert optimum.bound == compute_ceiling(task) > found[1]


def test_where_time_is_too_short_for_cheap_impacts_any_that_bear_the_deviation_are_taken(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    task, size, delta = _task("throw_and_catch", 5.0, points=False), GridSize(2), 0.02

    def stop(model: Model, time_limit: float, *args: Any, **options: Any) -> Solution:
        if model.objective.coefficients and np.isfinite(time_limit):
            raise SolverFailed(model.name, "time limit reached", "raise the time limit")
        return solve(model, time_limit, *args, **options)

    cheap = minimise_robust_cost(task, size, delta, (), 60.0)
    monkeypatch.setattr("planners.free_flyer.robust.least_cost.solve", stop)
    events = minimise_robust_cost(task, size, delta, (), 60.0)
    assert events.bound == 0.0
    assert events.sequence.delta == delta
    assert cheap.bound is not None
    assert events.cost > cheap.bound > 0.0

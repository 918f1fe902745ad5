from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from impact_envs.errors import InputError
from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.scenario import load_scenario
from planners import make_plan
from planners.budget import Budget
from planners.errors import Infeasible, SolverFailed
from planners.free_flyer.nominal.climber import quicken_legs
from planners.free_flyer.nominal.planner import make_free_flyer_plan
from planners.free_flyer.nominal.robustness import RobustnessOptimum
from planners.free_flyer.nominal.task import NominalTask, PlanOptions
from planners.free_flyer.reserves import Reserves
from planners.free_flyer.specification.grid import GridSize
from planners.free_flyer.specification.requirement import read_demands
from planners.plan import Plan
from tests.frozen.freeze import get_plan

BEST = {
    "throw_and_catch": (0.25, 2),
    "corridor": (0.75, 2),
    "pong": (0.25, 4),
    "pingpong": (0.25, 4),
    "obstacle_avoidance": (0.5, 4),
}
EVERY = pytest.mark.parametrize("name", BEST)


@cache
def _plan(name: str) -> Plan:
    """Return the stored plan; `tests/frozen` holds the planner to it."""
    plan = get_plan(name, "nominal")
    assert plan is not None
    return plan


def _scenario(name: str) -> FreeFlyerScenario:
    scenario = load_scenario(name)
    assert isinstance(scenario, FreeFlyerScenario)
    return scenario


@EVERY
def test_robustness_attains_the_bound_of_all_plans(name: str) -> None:
    plan, (rho, impacts) = _plan(name), BEST[name]
    assert plan.robustness == pytest.approx(rho, abs=1e-6)
    assert plan.bound == pytest.approx(rho, abs=1e-6)
    assert plan.gap == 0.0
    assert len(plan.impacts) == impacts
    assert plan.validated
    assert 0.0 < plan.effort_bound <= plan.effort + 1e-6
    assert plan.effort <= 1.01 * plan.effort_bound


def test_out_of_time_for_the_least_effort_the_robust_events_have_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    def late(*_: object) -> None:
        raise SolverFailed("effort", "time limit reached", "raise the time limit")

    monkeypatch.setattr("planners.free_flyer.nominal.finishing.minimise_path_cost", late)
    plan = make_plan("throw_and_catch")
    assert plan.robustness == pytest.approx(0.25, abs=1e-6)
    assert plan.gap == 0.0
    assert plan.validated
    assert plan.effort_bound is None
    assert plan.effort >= _plan("throw_and_catch").effort


@pytest.mark.parametrize("name", ["throw_and_catch", "corridor", "pong"])
def test_fewer_impacts_are_proven_infeasible(name: str) -> None:
    with pytest.raises(Infeasible, match="proven infeasible") as error:
        make_free_flyer_plan(_scenario(name), max_impacts=BEST[name][1] - 1)
    assert name in error.value.problem


@EVERY
def test_impacts_obey_momentum_and_restitution_by_finite_differences(name: str) -> None:
    plan, scenario = _plan(name), _scenario(name)
    for impact in plan.impacts:
        robot, body = scenario.robots[impact.robot], scenario.objects[impact.object]
        r_minus, r_plus = (_difference(plan.robots[impact.robot], impact.time, side) for side in (-1, 1))
        o_minus, o_plus = (_difference(plan.objects[impact.object], impact.time, side) for side in (-1, 1))
        momentum = robot.mass * (r_plus - r_minus) + body.mass * (o_plus - o_minus)
        np.testing.assert_allclose(momentum, 0.0, atol=1e-6 * robot.mass)
        np.testing.assert_allclose(r_plus - o_plus, -0.8 * (r_minus - o_minus), atol=1e-6)
        # Without friction only the normal velocity may change, so the relative velocity must be normal.
        across = np.array([-impact.normal[1], impact.normal[0]])
        assert abs((r_minus - o_minus) @ across) < 1e-6
        assert (r_minus - o_minus) @ impact.normal > 1e-3


def _difference(curve: object, time: float, side: int) -> np.ndarray:
    h = side * 1e-4
    name = "left" if side < 0 else "right"
    here, near, far = (curve.position(time + k * h, name) for k in range(3))  # type: ignore[attr-defined]
    return (4 * near - 3 * here - far) / (2 * h)


@EVERY
def test_bodies_touch_at_impacts_and_nowhere_else(name: str) -> None:
    plan, scenario = _plan(name), _scenario(name)
    times = np.linspace(0.0, plan.horizon, 4001)
    for robot, curve in plan.robots.items():
        own = np.array([impact.time for impact in plan.impacts if impact.robot == robot])
        for impact in plan.impacts:
            if impact.robot == robot:
                np.testing.assert_allclose(curve.position(impact.time), impact.contact, atol=1e-12)
                offset = plan.objects["pop"].position(impact.time) - impact.contact
                np.testing.assert_allclose(offset, 0.4 * impact.normal, atol=1e-12)
        apart = np.linalg.norm(curve.position(times) - plan.objects["pop"].position(times), axis=1)
        assert apart.min() >= 0.4 - 1e-9
        assert apart[np.abs(times[:, None] - own).min(axis=1) > 8.0].min() >= 0.5
    first, second = (plan.robots[robot].position(times) for robot in scenario.robots)
    assert np.linalg.norm(first - second, axis=1).min() >= 0.5


@EVERY
def test_motions_keep_their_limits(name: str) -> None:
    plan, scenario = _plan(name), _scenario(name)
    times = np.linspace(0.0, plan.horizon, 4001)
    for robot, curve in plan.robots.items():
        body = scenario.robots[robot]
        for side in ("left", "right"):
            assert np.abs(curve.velocity(times, side)).max() <= body.speed_limit
            assert np.abs(curve.acceleration(times, side)).max() <= 0.6 * body.force_limit / body.mass + 1e-6
        np.testing.assert_allclose(curve.position(0.0), body.start, atol=1e-12)
        np.testing.assert_allclose(curve.position(plan.horizon), body.goal, atol=1e-12)
        assert not curve.velocity(0.0).any()
        np.testing.assert_allclose(curve.velocity(plan.horizon, "left"), 0.0, atol=1e-12)
    np.testing.assert_allclose(plan.objects["pop"].velocity(plan.horizon, "left"), 0.0, atol=1e-12)


@EVERY
def test_robots_are_smooth_between_their_impacts(name: str) -> None:
    plan = _plan(name)
    for robot, curve in plan.robots.items():
        own = {impact.time for impact in plan.impacts if impact.robot == robot}
        joints = np.array([t for t in curve.times[1:-1] if t not in own])
        for value in (curve.position, curve.velocity, curve.acceleration):
            np.testing.assert_allclose(value(joints, "left"), value(joints, "right"), atol=1e-9)


def test_impacts_leave_the_execution_time() -> None:
    for name in BEST:
        plan = _plan(name)
        times = [impact.time for impact in plan.impacts]
        assert times[0] >= 8.0
        assert np.diff(times).min() >= 5.0
        assert plan.horizon - times[-1] >= 6.0
        steps = np.array(times) / 0.1
        np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)


def test_a_mirrored_task_has_the_mirrored_plan() -> None:
    scenario, plan = _scenario("throw_and_catch"), _plan("throw_and_catch")
    mirrored: dict[str, object] = {"world.lower": [-2.0, -0.75], "world.upper": [1.0, 4.5]}
    mirrored |= {"regions.goal.lower": [-0.75, 2.0], "regions.goal.upper": [-0.25, 2.5]}
    for name in scenario.bodies:
        table = "robots" if name in scenario.robots else "objects"
        for key in ("start", "goal") if name in scenario.robots else ("start",):
            x, y = getattr(scenario.body(name), key)
            mirrored[f"{table}.{name}.{key}"] = [-x, y]
    image = make_plan(scenario.override(mirrored))
    assert image.robustness == pytest.approx(plan.robustness, abs=1e-9)
    assert image.effort == pytest.approx(plan.effort, rel=1e-6)
    times = np.linspace(0.0, plan.horizon, 200)
    for name, curve in (plan.robots | plan.objects).items():
        other = (image.robots | image.objects)[name].position(times)
        np.testing.assert_allclose(other, curve.position(times) * [-1.0, 1.0], atol=1e-4)


@pytest.mark.parametrize("restitution", [0.0, 1.0])
@pytest.mark.parametrize("mass", [8.0, 30.0])
def test_any_restitution_and_mass(restitution: float, mass: float) -> None:
    values = {"believed.restitution": restitution, "objects.pop.mass": mass}
    plan = make_plan(_scenario("throw_and_catch").override(values))
    assert plan.robustness == pytest.approx(0.25, abs=1e-6)
    impact = plan.impacts[0]
    parting = (impact.object_plus - impact.robot_plus) @ impact.normal
    assert parting == pytest.approx(restitution * (impact.robot_minus - impact.object_minus) @ impact.normal)


def test_a_task_with_little_time_takes_from_the_reserves() -> None:
    plan = make_plan(_scenario("throw_and_catch").shorten(0.6))
    assert plan.robustness == pytest.approx(0.25, abs=1e-6)
    assert plan.horizon == 18.0


@pytest.mark.parametrize(
    ("rho", "quick", "thorough", "taken"),
    [(0.14, 0.5, True, True), (0.14, 0.2, True, False), (0.31, 0.5, True, False), (0.14, 0.5, False, False)],
)
def test_margin_of_speed_is_halved_where_it_costs_most_of_the_depth(
    rho: float, quick: float, thorough: bool, taken: bool
) -> None:
    """Of a bound of 0.5 m: from 0.14 to 0.5 m it is worth it, to 0.2 m or from 0.31 m not, nor in a hurry."""
    scenario = _scenario("relay")
    task = NominalTask(scenario, read_demands(scenario, Reserves().wall), Reserves())

    def search(tried: NominalTask, most: int, budget: Budget, options: PlanOptions) -> RobustnessOptimum:
        assert most == 3
        return RobustnessOptimum(GridSize(3, 1), quick, 0.5)

    optimum = RobustnessOptimum(GridSize(3, 1), rho, 0.5)
    found = quicken_legs(task, optimum, search, Budget(10.0), PlanOptions(thorough=thorough))
    assert (found is not None) == taken
    if found is not None:
        assert found[0].reserves == replace(Reserves(), speed=0.5 * (1.0 + Reserves().speed))
        assert found[1].rho == quick


def test_legs_stay_slow_where_no_plan_has_fast_ones() -> None:
    scenario = _scenario("relay")
    task = NominalTask(scenario, read_demands(scenario, Reserves().wall), Reserves())

    def search(*_: object) -> RobustnessOptimum:
        raise Infeasible("plan of relay", "infeasible", "")

    optimum = RobustnessOptimum(GridSize(3, 1), 0.14, 0.5)
    assert quicken_legs(task, optimum, search, Budget(10.0), PlanOptions()) is None


@pytest.mark.slow
def test_relay_with_little_time_is_as_deep_as_with_much() -> None:
    plan = make_plan(_scenario("relay").suite("short"), time_limit=300.0)
    assert plan.robustness == pytest.approx(0.5, abs=1e-6)
    assert len(plan.impacts) == 3


def test_no_impact_where_none_is_needed() -> None:
    at_goal = {"regions.goal.lower": [0.25, 1.25], "regions.goal.upper": [0.75, 1.75]}
    plan = make_plan(_scenario("throw_and_catch").override(at_goal))
    assert plan.impacts == ()
    assert plan.effort == 0.0


def test_three_robots_share_one_object() -> None:
    scenario = _scenario("throw_and_catch")
    data = scenario.model_dump(exclude_unset=True)
    data["robots"]["watcher"] = data["robots"]["snap"] | {"start": [1.5, 0.5], "goal": [1.5, 3.5]}
    plan = make_plan(FreeFlyerScenario.model_validate(data))
    assert plan.robustness == pytest.approx(0.25, abs=1e-6)
    assert set(plan.robots) == {"snap", "crackle", "watcher"}


@pytest.mark.parametrize(
    "values",
    [
        {"regions.goal.lower": [5.0, 2.0], "regions.goal.upper": [5.5, 2.5]},
        {"regions.goal.lower": [0.25, 4.2], "regions.goal.upper": [0.75, 4.45]},
        {"horizon": 5.0, "formula": "G[5,5] pop in goal"},
    ],
)
def test_unreachable_goals_are_infeasible(values: dict) -> None:
    with pytest.raises(Infeasible) as error:
        make_plan(_scenario("throw_and_catch").override(values), max_impacts=3)
    assert "throw_and_catch" in error.value.problem
    assert error.value.status
    assert error.value.remedy


@pytest.mark.parametrize("options", [{"max_impacts": -1}, {"time_limit": 0.0}])
def test_bad_options_are_named(options: dict) -> None:
    with pytest.raises(InputError, match=next(iter(options))):
        make_plan("throw_and_catch", **options)


@pytest.mark.slow
def test_half_of_the_reserves_make_a_late_plan_as_robust_as_its_bound() -> None:
    plan = make_plan(load_scenario("pingpong").suite("short"), time_limit=300.0)
    assert plan.robustness == pytest.approx(plan.bound, abs=1e-4)
    assert plan.bound == pytest.approx(0.25, abs=1e-4)

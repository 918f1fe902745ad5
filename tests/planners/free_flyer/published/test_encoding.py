from functools import cache

import numpy as np
import pytest

from impact_envs.errors import InputError
from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.scenario import load_scenario
from impact_envs.stl import Trace, robustness
from planners.errors import Infeasible, SolverFailed
from planners.free_flyer.published.encoding import BezierPlan, EncodingOptions, make_bezier_plan
from planners.free_flyer.published.encoding_rows import read_clauses
from tests.frozen.freeze import get_plan

# Robustness of the shipped planner, which attains what the areas allow.
RHO = {"throw_and_catch": 0.25, "corridor": 0.75, "pong": 0.25, "obstacle_avoidance": 0.5}
EVERY = pytest.mark.parametrize("name", RHO)


def _scenario(name: str, restitution: float = 0.8, **changes: object) -> FreeFlyerScenario:
    scenario = load_scenario(name).override({"believed.restitution": restitution, **changes})
    assert isinstance(scenario, FreeFlyerScenario)
    return scenario


@cache
def _plan(name: str, restitution: float = 0.8, constant_grid: bool = False) -> BezierPlan:
    return make_bezier_plan(
        _scenario(name, restitution), options=EncodingOptions(constant_grid=constant_grid, separation=False)
    )


@EVERY
def test_robustness_is_what_the_areas_allow(name: str) -> None:
    plan = _plan(name)
    assert plan.rho == pytest.approx(RHO[name], abs=1e-6)
    assert plan.bound == pytest.approx(RHO[name], abs=1e-6)
    assert plan.solve_seconds > 0.0


@pytest.mark.parametrize("name", ["throw_and_catch", "corridor"])
def test_robustness_equals_the_event_grid(name: str) -> None:
    stored = get_plan(name, "nominal")
    assert stored is not None
    assert _plan(name).rho == pytest.approx(stored.robustness, abs=1e-5)


@EVERY
def test_motions_are_at_least_as_robust_as_the_encoding_says(name: str) -> None:
    plan, scenario = _plan(name), _scenario(name)
    step = scenario.control_period
    # Ends of curves, where the encoding looks for "eventually", lie between samples: a fine period meets them.
    times = np.arange(0.0, scenario.horizon + step / 40, step / 20)
    signals: dict[str, np.ndarray] = {}
    for body, points in plan.positions(times).items():
        still = dict.fromkeys(("vx", "vy", "heading", "omega"), np.zeros(len(times)))
        columns = {"x": points[:, 0], "y": points[:, 1], **still}
        signals |= {f"{body}.{signal}": values for signal, values in columns.items()}
    trace = Trace(signals, step / 20, scenario.areas, scenario.bodies)
    assert float(robustness(scenario.specification, trace)) >= plan.rho - 2e-3


@pytest.mark.parametrize("name", ["throw_and_catch", "corridor"])
def test_equal_masses_without_loss_obey_the_impact_law(name: str) -> None:
    plan = _plan(name, restitution=1.0)
    assert plan.is_exact
    assert plan.warning is None
    assert len(plan.impacts) == 2
    assert plan.impact_error < 1e-6
    for impact in plan.impacts:  # the velocities are swapped
        np.testing.assert_allclose(impact.object_plus, impact.robot_minus, atol=1e-6)
        np.testing.assert_allclose(impact.robot_plus, impact.object_minus, atol=1e-6)


@EVERY
def test_loss_breaks_the_impact_law_without_a_constant_grid(name: str) -> None:
    plan, scenario = _plan(name), _scenario(name)
    assert not plan.is_exact
    assert plan.impact_error > 1e-3
    assert f"{plan.impact_error:.3g} m/s" in (plan.warning or "")
    worst = max(plan.impacts, key=lambda impact: impact.error)
    mass = scenario.robots[worst.robot].mass
    momentum = mass * (worst.robot_plus + worst.object_plus - worst.robot_minus - worst.object_minus)
    rebound = worst.robot_plus - worst.object_plus + 0.8 * (worst.robot_minus - worst.object_minus)
    assert max(np.abs(momentum / mass).max(), np.abs(rebound).max()) > 1e-3


@pytest.mark.parametrize("name", ["throw_and_catch", "pong"])
def test_a_constant_grid_obeys_the_impact_law(name: str) -> None:
    plan, scenario = _plan(name, constant_grid=True), _scenario(name)
    assert plan.is_exact
    assert plan.impact_error < 1e-6
    assert plan.rho == pytest.approx(RHO[name], abs=1e-6)
    np.testing.assert_allclose(np.diff(plan.h["pop"]), scenario.horizon / len(plan.h["pop"]))
    for impact in plan.impacts:
        relative = impact.robot_minus - impact.object_minus
        np.testing.assert_allclose(impact.robot_plus - impact.object_plus, -0.8 * relative, atol=1e-6)


def test_curves_of_the_scenario_are_those_of_the_published_code() -> None:
    plan = _plan("pingpong")
    assert {name: len(points) for name, points in plan.r.items()} == {"snap": 4, "crackle": 6, "pop": 7}
    assert {name: len(points) for name, points in _plan("pong", constant_grid=True).r.items()}["pop"] == 6


def test_unequal_masses_are_not_exact_even_without_loss() -> None:
    plan = make_bezier_plan(_scenario("throw_and_catch", 1.0, **{"objects.pop.mass": 8.0}))
    assert not plan.is_exact
    assert plan.impact_error > 1e-3


def test_curves_join_and_keep_their_limits() -> None:
    plan, scenario = _plan("pong"), _scenario("pong")
    hit_at = {(body, round(hit.time, 6)) for hit in plan.impacts for body in (hit.robot, hit.object)}
    for name in scenario.bodies:
        r, h, body = plan.r[name], plan.h[name], scenario.body(name)
        rates = np.diff(h) * (h.shape[1] - 1)
        speeds = np.diff(r, axis=1) * (h.shape[1] - 1) / rates[..., None]
        np.testing.assert_allclose(r[0, 0], body.start, atol=1e-9)
        np.testing.assert_allclose([h[0, 0], h[-1, -1]], [0.0, scenario.horizon], atol=1e-9)
        np.testing.assert_allclose([speeds[0, 0], speeds[-1, -1]], 0.0, atol=1e-6)
        assert np.abs(speeds).max() <= body.speed_limit + 1e-6
        assert rates.min() >= 0.1 - 1e-6
        for k in range(len(r) - 1):
            np.testing.assert_array_equal(r[k, -1], r[k + 1, 0])
            if (name, round(h[k, -1], 6)) not in hit_at:
                np.testing.assert_allclose(speeds[k, -1], speeds[k + 1, 0], atol=1e-5)
    assert len(hit_at) == 2 * len(plan.impacts)


def test_robots_meet_objects_at_impacts() -> None:
    plan = _plan("pong")
    for impact in plan.impacts:
        places = plan.positions(np.array([impact.time]))
        np.testing.assert_allclose(places[impact.robot][0], impact.position, atol=1e-3)
        np.testing.assert_allclose(places[impact.object][0], impact.position, atol=1e-3)


def test_separation_keeps_boxes_of_robots_apart() -> None:
    scenario = _scenario("throw_and_catch", 1.0, **{"robots.crackle.start": [0.5, 0.5], "robots.crackle.goal": None})
    plan = make_bezier_plan(scenario, options=EncodingOptions(separation=True))
    times = np.linspace(0.0, scenario.horizon, 3001)
    places = plan.positions(times)
    assert np.abs(places["snap"] - places["crackle"]).max(axis=1).min() >= 0.4 - 1e-3
    assert plan.rho == pytest.approx(0.25, abs=1e-6)


def test_several_objects() -> None:
    second = {"start": [1.25, 1.5], "mass": 16.8, "inertia": 0.1594, "radius": 0.2, "speed_limit": 0.5}
    changes = {
        "objects.pip": second,
        "formula": "G[30,30] pop in goal & G[30,30] pip in side",
        "regions.side": {"lower": [1.0, 2.0], "upper": [1.5, 2.5]},
    }
    plan = make_bezier_plan(_scenario("throw_and_catch", 1.0, **changes), options=EncodingOptions({"pop": 6}))
    assert plan.rho == pytest.approx(0.25, abs=1e-6)
    assert {impact.object for impact in plan.impacts} == {"pop", "pip"}
    assert plan.impact_error < 1e-6


def test_fewer_impacts_than_a_throw_and_a_catch_are_infeasible() -> None:
    with pytest.raises(Infeasible):
        make_bezier_plan(_scenario("throw_and_catch"), max_impacts=1)
    assert len(make_bezier_plan(_scenario("throw_and_catch"), max_impacts=2).impacts) == 2


def test_too_few_curves_name_what_they_cannot_do() -> None:
    with pytest.raises(Infeasible, match=r"pop in right.*\[18, 20\]"):
        make_bezier_plan(_scenario("pingpong"), options=EncodingOptions({"pop": 7}, constant_grid=True))


def test_highs_refuses_the_quadratic_cost() -> None:
    with pytest.raises(SolverFailed, match="HiGHS takes no quadratic"):
        make_bezier_plan(_scenario("throw_and_catch"), options=EncodingOptions(attenuate=True))


@pytest.mark.parametrize("solver", ["scip", "gurobi"])
def test_attenuation_costs_no_robustness(solver: str) -> None:
    pytest.importorskip({"scip": "pyscipopt", "gurobi": "gurobipy"}[solver])
    scenario = _scenario("throw_and_catch", 1.0)
    options = EncodingOptions(attenuate=True, separation=False)
    plan = make_bezier_plan(scenario, options=options, solver=solver, relative_gap=1e-2)
    assert plan.rho == pytest.approx(0.25, abs=1e-5)
    assert plan.attenuation < 0.01 * _plan("throw_and_catch", 1.0).attenuation
    assert plan.objective == pytest.approx(plan.attenuation - 1e4 * plan.rho, rel=1e-6)
    assert plan.objective_bound <= plan.objective


@pytest.mark.parametrize(
    ("formula", "named"),
    [
        ("G[0,30] (pop in goal | snap in goal)", "pop in goal | snap in goal"),
        ("F[0,30] pop not in goal", "eventually 'pop not in goal'"),
        ("F[0,30] G[0,0] pop in goal", "G[0,0] pop in goal"),
        ("G[0,10] F[0,20] pop in goal", "F[0,20] pop in goal"),
        ("pop in goal U[0,30] snap in goal", "U[0,30]"),
        ("G[0,30] distance(snap, crackle) >= 0.4", "distance(snap, crackle) >= 0.4"),
    ],
)
def test_other_formulas_are_refused_by_name(formula: str, named: str) -> None:
    with pytest.raises(InputError, match="not supported by the Bezier encoding") as error:
        make_bezier_plan(_scenario("throw_and_catch", formula=formula))
    assert named in str(error.value)


def test_solid_obstacles_count_without_the_formula() -> None:
    clauses = read_clauses(_scenario("obstacle_avoidance", formula="F[0,150] pop in goal & G[0,150] pop not in block"))
    found = [(clause.predicate.body, clause.scored) for clause in clauses if clause.predicate.negated]
    assert found == [("pop", True), ("snap", False), ("crackle", False)]


@pytest.mark.parametrize(
    "options",
    [
        {"options": EncodingOptions({"pip": 3})},
        {"options": EncodingOptions(0)},
        {"options": EncodingOptions({"pop": 0})},
        {"max_impacts": -1},
        {"time_limit": 0.0},
        {"relative_gap": -1.0},
        {"solver": "cplex"},
    ],
)
def test_bad_arguments_are_refused(options: dict[str, object]) -> None:
    with pytest.raises(InputError) as error:
        make_bezier_plan(_scenario("throw_and_catch"), **options)  # type: ignore[arg-type]
    assert "\n" not in str(error.value)

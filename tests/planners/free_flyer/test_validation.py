from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.scenario import load_scenario
from planners.bezier import Curve
from planners.errors import SolverFailed
from planners.free_flyer.validation import compute_robustness, validate_plan
from planners.plan import Plan
from tests.frozen.freeze import get_plan


@pytest.fixture(scope="module")
def scenario() -> FreeFlyerScenario:
    return load_scenario("throw_and_catch")  # type: ignore[return-value]


@pytest.fixture(scope="module")
def plan() -> Plan:
    stored = get_plan("throw_and_catch", "nominal")
    assert stored is not None
    return stored


def _shift(curve: Curve, by: float) -> Curve:
    return Curve(curve.times, curve.points + by)


def _slower(plan: Plan) -> Plan:
    """Hit later along the same way: contact is kept, the speed of approach is not."""
    curve = plan.robots["snap"]
    points = curve.points.copy()
    k = int(np.flatnonzero(curve.times == plan.impacts[0].time)[0])
    points[k - 1, 4] = points[k - 1, 5] - 0.9 * (points[k - 1, 5] - points[k - 1, 4])
    return replace(plan, robots=plan.robots | {"snap": Curve(curve.times, points)})


def _impact(plan: Plan, **changes: object) -> Plan:
    return replace(plan, impacts=(replace(plan.impacts[0], **changes), *plan.impacts[1:]))  # type: ignore[arg-type]


def _touch_the_edge(plan: Plan) -> Plan:
    curve = plan.robots["crackle"]
    points = curve.points.copy()
    points[0, 3] += [0.0, 30.0]
    return replace(plan, robots=plan.robots | {"crackle": Curve(curve.times, points)})


TAMPERED: dict[str, Callable[[Plan], Plan]] = {
    "in contact": lambda plan: replace(plan, robots=plan.robots | {"snap": _shift(plan.robots["snap"], 1e-3)}),
    "leaves its curve": lambda plan: replace(plan, objects={"pop": _shift(plan.objects["pop"], 1e-3)}),
    "velocity after": _slower,
    "table": lambda plan: _impact(plan, robot_minus=plan.impacts[0].robot_minus + 1e-4),
    "in contact ": lambda plan: _impact(plan, time=plan.impacts[0].time + 0.1),
    "promised": lambda plan: replace(plan, robustness=plan.robustness + 0.02),
    "limit": _touch_the_edge,
    "spans": lambda plan: _longer(plan),
}


def _longer(plan: Plan) -> Plan:
    curves = {
        name: Curve(np.append(curve.times, 31.0), np.concatenate([curve.points, curve.points[-1:, -1:].repeat(6, 1)]))
        for name, curve in plan.robots.items()
    }
    pop = plan.objects["pop"]
    objects = {"pop": Curve(np.append(pop.times, 31.0), np.concatenate([pop.points, pop.points[-1:]]))}
    return replace(plan, horizon=31.0, robots=curves, objects=objects)


def test_an_honest_plan_passes(scenario: FreeFlyerScenario, plan: Plan) -> None:
    assert validate_plan(scenario, plan) == pytest.approx(0.25, abs=1e-6)


@pytest.mark.parametrize("reason", TAMPERED)
def test_a_tampered_plan_is_rejected(scenario: FreeFlyerScenario, plan: Plan, reason: str) -> None:
    with pytest.raises(SolverFailed, match=reason.strip()):
        validate_plan(scenario, TAMPERED[reason](plan))


def test_other_physics_reject_the_plan(scenario: FreeFlyerScenario, plan: Plan) -> None:
    with pytest.raises(SolverFailed, match="plan check"):
        validate_plan(scenario.override({"believed.restitution": 0.5}), plan)


def test_weaker_thrusters_reject_the_plan(scenario: FreeFlyerScenario, plan: Plan) -> None:
    with pytest.raises(SolverFailed, match="its limit is"):
        validate_plan(scenario.override({"robots.snap.force_limit": 0.1}), plan)


def test_a_robot_in_the_way_rejects_the_plan(scenario: FreeFlyerScenario, plan: Plan) -> None:
    way = scenario.override({"robots.crackle.start": [0.5, 2.0], "robots.crackle.goal": [0.5, 2.0]})
    still = Curve([0.0, 30.0], np.tile([0.5, 2.0], (1, 2, 1)))
    blocked = replace(plan, robots=plan.robots | {"crackle": still}, impacts=plan.impacts[:1])
    with pytest.raises(SolverFailed, match="plan check"):
        validate_plan(way, blocked)


def test_robustness_is_that_of_the_object_at_the_end(scenario: FreeFlyerScenario) -> None:
    times = np.arange(1501) * 0.02
    still = {name: np.tile(scenario.body(name).start, (len(times), 1)) for name in scenario.bodies}
    assert compute_robustness(scenario, times, still) == pytest.approx(-0.5)
    still["pop"] = np.tile([0.4, 2.2], (len(times), 1))
    assert compute_robustness(scenario, times, still) == pytest.approx(0.15)

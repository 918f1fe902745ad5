"""Plans of random scenarios keep every promise in an independent simulation."""

from collections import Counter

import numpy as np
import pytest

from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.scenario import build_scenario
from planners.errors import PlanningError
from planners.free_flyer.nominal.planner import make_free_flyer_plan
from planners.free_flyer.validation import Tolerances, validate_plan
from planners.plan import Plan

TIGHT = Tolerances(position=1e-5, velocity=1e-6, robustness=1e-3)


def draw_scenario(seed: int) -> FreeFlyerScenario:
    """Return a random task: bodies of any mass and size, any restitution, a goal, perhaps a region or obstacle."""
    rng = np.random.default_rng(seed)
    size = rng.uniform([4.0, 3.0], [10.0, 10.0])
    radii = rng.uniform(0.15, 0.3, 3)
    places: list[np.ndarray] = []
    # Robots need room to run up between an object and the wall.
    while len(places) < 3:
        inset = 1.2 if len(places) == 2 else 0.6
        place = rng.uniform(inset, size - inset)
        if all(np.abs(place - other).max() > 1.0 for other in places):
            places.append(place)
    goal = rng.uniform(1.2, size - 1.2)
    horizon = round(rng.uniform(60.0, 150.0), 1)
    wishes = [f"G[{horizon},{horizon}] pop in goal"]
    regions = {"goal": _box(goal, rng.uniform(0.2, 0.6))}
    obstacles = {}
    kind = rng.integers(3)
    if kind == 1:
        regions["via"] = _box(rng.uniform(1.2, size - 1.2), rng.uniform(0.2, 0.6))
        wishes.append(f"F[0,{horizon}] pop in via")
    if kind == 2:
        center, half = rng.uniform(1.0, size - 1.0), rng.uniform(0.2, 0.8)
        clear = [np.abs(place - center).max() > half + 0.6 for place in [*places, goal]]
        if all(clear):
            obstacles["block"] = _box(center, half) | {"solid": True}
            wishes.append(f"G[0,{horizon}] all not in block")

    def body(place: np.ndarray, radius: float) -> dict[str, object]:
        return {
            "start": [round(float(x), 3) for x in place],
            "mass": round(float(rng.uniform(5.0, 40.0)), 2),
            "inertia": 0.2,
            "radius": round(float(radius), 3),
            "speed_limit": 0.3,
        }

    robots = {
        name: body(place, radius) | {"force_limit": round(float(rng.uniform(0.5, 3.0)), 2), "torque_limit": 0.5}
        for name, place, radius in zip(("snap", "crackle"), places, radii, strict=False)
    }
    return build_scenario(
        {
            "domain": "free_flyer",
            "description": "random",
            "formula": " & ".join(wishes),
            "horizon": horizon,
            "control_period": 0.1,
            "world": {"lower": [0.0, 0.0], "upper": [round(float(x), 3) for x in size]},
            "robots": robots,
            "objects": {"pop": body(places[2], radii[2])},
            "regions": regions,
            "obstacles": obstacles,
            "believed": {"restitution": round(float(rng.uniform(0.2, 1.0)), 2)},
        },
        source=f"random {seed}",
    )


def _box(center: np.ndarray, half: float) -> dict[str, object]:
    return {
        "lower": [round(float(x), 3) for x in center - half],
        "upper": [round(float(x), 3) for x in center + half],
    }


def _check(scenario: FreeFlyerScenario, plan: Plan) -> None:
    rho = validate_plan(scenario, plan, TIGHT)
    assert rho == pytest.approx(plan.robustness, abs=1e-7)  # planned in other units, with other tolerances
    assert rho <= plan.bound + 1e-9
    for robot, curve in plan.robots.items():
        times = np.linspace(0.0, plan.horizon, 4001)
        hits = [hit.time for hit in plan.impacts if hit.robot == robot]
        free = np.all([np.abs(times - hit) > 1e-6 for hit in hits], axis=0) if hits else np.full(len(times), True)
        force = scenario.robots[robot].mass * np.linalg.norm(curve.acceleration(times), axis=1)
        assert force[free].max() <= scenario.robots[robot].force_limit
    for hit in plan.impacts:
        robot, item = scenario.robots[hit.robot], scenario.objects[hit.object]
        before = robot.mass * hit.robot_minus + item.mass * hit.object_minus
        after = robot.mass * hit.robot_plus + item.mass * hit.object_plus
        np.testing.assert_allclose(after, before, atol=1e-9)
        parting = hit.robot_plus - hit.object_plus
        approach = hit.robot_minus - hit.object_minus
        np.testing.assert_allclose(parting, -scenario.believed.restitution * approach, atol=1e-9)


def _check_plans(seeds: range, wanted: int) -> Counter[str]:
    """Plan random scenarios until enough have a plan; what the planner gives up is told from what breaks a promise."""
    outcomes: Counter[str] = Counter()
    for seed in seeds:
        scenario = draw_scenario(seed)
        try:
            plan = make_free_flyer_plan(scenario, max_impacts=4)
        except PlanningError as error:
            if error.problem == "plan check":
                raise
            outcomes["given up"] += 1
            continue
        _check(scenario, plan)
        outcomes["planned"] += 1
        if outcomes["planned"] == wanted:
            break
    return outcomes


def test_plans_of_random_scenarios_keep_their_promises() -> None:
    outcomes = _check_plans(range(1000, 1100), 4)
    assert outcomes["planned"] == 4
    assert outcomes["given up"] <= 2


@pytest.mark.slow
def test_plans_of_two_hundred_random_scenarios_keep_their_promises() -> None:
    outcomes = _check_plans(range(5000, 6000), 200)
    assert outcomes["planned"] == 200
    assert outcomes["given up"] <= 20


def test_last_sample_of_a_horizon_that_no_float_holds_is_simulated() -> None:
    scenario = draw_scenario(24)
    assert scenario.horizon / scenario.control_period % 1.0 != 0.0
    _check(scenario, make_free_flyer_plan(scenario, max_impacts=4))

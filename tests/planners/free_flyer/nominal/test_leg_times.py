"""Least times of robots' legs, and plans whose impacts leave their robots enough of it."""

import numpy as np
import pytest
from scipy.optimize import linprog

from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.scenario import build_scenario
from planners.free_flyer.nominal.leg_times import compute_least_time, find_rooms
from planners.free_flyer.nominal.planner import make_free_flyer_plan
from planners.free_flyer.reserves import Reserves
from planners.plan import PlannedImpact

STRENGTH, FASTEST = 0.05, 0.3


def _can_move(distance: float, start: float, end: float, time: float, steps: int = 50) -> bool:
    """Return whether piecewise constant accelerations take a point between two states in so much time."""
    step = time / steps
    rates = step * np.tril(np.ones((steps, steps)))
    moved = step**2 * (steps - np.arange(steps) - 0.5)
    bounds = np.concatenate([np.full(steps, FASTEST - start), np.full(steps, FASTEST + start)])
    found = linprog(
        np.zeros(steps),
        A_ub=np.vstack([rates, -rates]),
        b_ub=bounds,
        A_eq=np.vstack([np.full(steps, step), moved]),
        b_eq=[end - start, distance - start * time],
        bounds=[(-STRENGTH, STRENGTH)] * steps,
    )
    return found.status == 0


@pytest.mark.parametrize("seed", range(8))
def test_least_time_is_what_accelerations_can_just_do(seed: int) -> None:
    distance, start, end = np.random.default_rng(seed).uniform(-1.0, 1.0, 3) * [2.0, 0.25, 0.25]
    time = compute_least_time(distance, start, end, STRENGTH, FASTEST)
    assert _can_move(distance, start, end, 1.03 * time)
    assert not _can_move(distance, start, end, 0.97 * time)


def test_a_leg_from_rest_to_rest_takes_twice_the_root_of_distance_over_strength() -> None:
    assert compute_least_time(0.2, 0.0, 0.0, STRENGTH, FASTEST) == pytest.approx(2.0 * np.sqrt(0.2 / STRENGTH))
    assert compute_least_time(0.0, 0.0, 0.0, STRENGTH, FASTEST) == 0.0


def _box(lower: tuple[float, float], upper: tuple[float, float]) -> dict[str, object]:
    return {"lower": lower, "upper": upper}


def _lone_robot() -> FreeFlyerScenario:
    """Return a task in a small world whose robot has to hit its object three times."""
    body = {"radius": 0.15, "speed_limit": 0.3}
    robot = {"start": (0.43, 2.8), "goal": (0.43, 2.8), "mass": 15.5, "inertia": 0.1744, "force_limit": 1.42}
    return build_scenario(
        {
            "domain": "free_flyer",
            "formula": "F[0,48] G[0,9] pop in dock & G[0,60] (pop in dock -> snap not in zone)",
            "horizon": 60.0,
            "control_period": 0.1,
            "world": _box((0.0, 0.0), (4.0, 4.0)),
            "robots": {"snap": body | robot | {"torque_limit": 0.5}},
            "objects": {"pop": body | {"start": (3.05, 2.7), "mass": 20.6, "inertia": 0.2318}},
            "regions": {"dock": _box((0.662, 1.917), (1.462, 2.717)), "zone": _box((1.981, 0.843), (2.781, 1.643))},
            "believed": {"restitution": 0.36},
        },
        source="lone robot",
    )


@pytest.mark.slow
def test_impacts_too_quick_for_their_robot_are_given_more_time() -> None:
    plan = make_free_flyer_plan(_lone_robot())
    assert plan.robustness >= 0.28
    assert plan.validated


def test_room_is_what_reaching_the_velocity_of_an_impact_takes() -> None:
    """A robot that flies down at v came from v^2 / (2 a) above, and needs as much between itself and the edge."""
    scenario, reserves = _lone_robot(), Reserves()
    robot = scenario.robots["snap"]
    strength = reserves.acceleration(robot)
    way = 0.2**2 / (2.0 * strength)
    nearest = 4.0 - robot.radius - reserves.wall - way
    for place, cramped in ((nearest - 1e-6, False), (nearest + 1e-6, True)):
        impact = PlannedImpact(
            time=10.0,
            robot="snap",
            object="pop",
            position=np.array([2.0, place - 0.3]),
            contact=np.array([2.0, place]),
            normal=np.array([0.0, -1.0]),
            robot_minus=np.array([0.0, -0.2]),
            robot_plus=np.zeros(2),
            object_minus=np.zeros(2),
            object_plus=np.array([0.0, -0.1]),
        )
        rooms = find_rooms(scenario, [impact], reserves, 1.0)
        assert [(room.axis, room.sign) for room in rooms] == [(1, 1.0)] * cramped
        assert all(room.bound == pytest.approx(nearest) for room in rooms)

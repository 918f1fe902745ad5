"""The same task in other units, elsewhere, turned, mirrored, renamed or reordered has the same plan."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest

from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.scenario import build_scenario, load_scenario
from planners.free_flyer.nominal.planner import make_free_flyer_plan
from planners.plan import Plan

FAST = ("throw_and_catch", "pong")
SLOW = ("corridor", "obstacle_avoidance")
POWERS = {  # of length and mass
    "radius": (1, 0),
    "speed_limit": (1, 0),
    "mass": (0, 1),
    "inertia": (2, 1),
    "force_limit": (1, 1),
    "torque_limit": (2, 1),
}
NAMES = pytest.mark.parametrize("name", [*FAST, *(pytest.param(name, marks=pytest.mark.slow) for name in SLOW)])


@dataclass(frozen=True)
class Change:
    """A similarity of the plane, p -> length Q p + shift, and a factor of all masses."""

    length: float = 1.0
    mass: float = 1.0
    shift: tuple[float, float] = (0.0, 0.0)
    turn: tuple[tuple[float, float], tuple[float, float]] = ((1.0, 0.0), (0.0, 1.0))

    def move(self, points: np.ndarray) -> np.ndarray:
        return self.length * points @ np.array(self.turn).T + np.array(self.shift)

    def change(self, scenario: FreeFlyerScenario) -> FreeFlyerScenario:
        data = scenario.model_dump(exclude_unset=True)
        data.pop("suites", None)
        data.pop("true", None)
        for body in (*data["robots"].values(), *data["objects"].values()):
            for key in ("start", "goal"):
                if body.get(key) is not None:
                    body[key] = [float(x) for x in self.move(np.array(body[key]))]
            for key, power in {
                "radius": 1,
                "speed_limit": 1,
                "force_limit": 1,
                "inertia": 2,
                "torque_limit": 2,
            }.items():
                if key in body:
                    body[key] *= self.length**power * (1.0 if key in ("radius", "speed_limit") else self.mass)
            body["mass"] *= self.mass
        areas = (data["world"], *data["regions"].values(), *data.get("obstacles", {}).values())
        for area in areas:
            ends = self.move(np.array([area["lower"], area["upper"]]))
            area["lower"], area["upper"] = ([float(x) for x in end] for end in (ends.min(axis=0), ends.max(axis=0)))
        return build_scenario(data, source=scenario.name)


QUARTER, MIRROR = ((0.0, -1.0), (1.0, 0.0)), ((-1.0, 0.0), (0.0, 1.0))
UNITS = {
    **{f"lengths x {factor:g}": Change(length=factor) for factor in (1e-3, 0.1, 10.0, 1e3)},
    **{f"masses x {factor:g}": Change(mass=factor) for factor in (1e-3, 1e3)},
    "lengths and masses x 1000": Change(length=1e3, mass=1e3),
    "far away": Change(shift=(1000.0, -500.0)),
}
MOVES = {
    "moved": Change(shift=(3.7, -2.2)),
    "turned": Change(turn=QUARTER),
    "mirrored": Change(turn=MIRROR),
}


@cache
def _plan(name: str) -> Plan:
    return make_free_flyer_plan(load_scenario(name))


def _compare(name: str, change: Change, plan: Plan, motion: float) -> None:
    """Compare lengths, relative to the task's, and the robots' motions to a tolerance of their own."""
    base, length = _plan(name), change.length
    assert plan.robustness / length == pytest.approx(base.robustness, abs=1e-6)
    assert plan.bound / length == pytest.approx(base.bound, abs=1e-6)
    assert plan.effort / length**2 == pytest.approx(base.effort, rel=1e-6)
    assert plan.effort_bound / length**2 == pytest.approx(base.effort_bound, rel=1e-6)
    assert plan.effort_bound <= plan.effort * (1.0 + 1e-9)
    for here, there in zip(plan.impacts, base.impacts, strict=True):
        assert (here.robot, here.object) == (there.robot, there.object)
        assert here.time == pytest.approx(there.time, abs=1e-6)
        np.testing.assert_allclose(here.position, change.move(there.position), rtol=1e-6, atol=1e-6 * length)
    times = np.linspace(0.0, base.horizon, 101)
    for robot, curve in base.robots.items():
        expected = change.move(curve.position(times))
        np.testing.assert_allclose(plan.robots[robot].position(times), expected, rtol=1e-6, atol=motion * length)


@NAMES
@pytest.mark.parametrize("how", UNITS)
def test_other_units_and_a_far_origin_give_the_same_plan(name: str, how: str) -> None:
    change = UNITS[how]
    _compare(name, change, make_free_flyer_plan(change.change(load_scenario(name))), 1e-6)


@NAMES
@pytest.mark.parametrize("how", MOVES)
def test_a_moved_turned_or_mirrored_task_has_the_same_plan(name: str, how: str) -> None:
    change = MOVES[how]
    # Smooth motions are optimal to the quadratic program's tolerance, within which round-off moves robots far from
    # all rows by decimetres; impacts and path cost are the same.
    _compare(name, change, make_free_flyer_plan(change.change(load_scenario(name))), 0.5)


def _rename(scenario: FreeFlyerScenario) -> FreeFlyerScenario:
    names = {name: f"z{len(scenario.robots) - k}" for k, name in enumerate(scenario.robots)}
    robots = {names[name]: robot for name, robot in scenario.robots.items()}
    return scenario.override({"robots": {name: robot.model_dump(exclude_unset=True) for name, robot in robots.items()}})


def _reorder(scenario: FreeFlyerScenario) -> FreeFlyerScenario:
    robots = {name: scenario.robots[name].model_dump(exclude_unset=True) for name in reversed(scenario.robots)}
    return scenario.override({"robots": robots})


@NAMES
@pytest.mark.parametrize("change", [_rename, _reorder])
def test_names_and_order_of_robots_do_not_matter(
    name: str, change: Callable[[FreeFlyerScenario], FreeFlyerScenario]
) -> None:
    base, scenario = _plan(name), load_scenario(name)
    changed = change(scenario)
    plan = make_free_flyer_plan(changed)
    starts = {robot.start: robot_name for robot_name, robot in scenario.robots.items()}
    words = [starts[changed.robots[impact.robot].start] for impact in plan.impacts]
    assert words == [impact.robot for impact in base.impacts]
    assert plan.robustness == pytest.approx(base.robustness, abs=1e-6)
    assert plan.bound == pytest.approx(base.bound, abs=1e-6)
    assert plan.effort == pytest.approx(base.effort, rel=1e-6)

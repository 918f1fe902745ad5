"""A robot can be where a quintic within three quarters of its thrust brings it, after what it has to hit before."""

from __future__ import annotations

import math

import numpy as np
import pytest

from impact_envs import load_scenario
from impact_envs.free_flyer.schema import FreeFlyerScenario
from planners.bezier import Curve
from planners.free_flyer.belief.options import EXPERT
from planners.free_flyer.belief.plan_table import END, NORMAL_X, NORMAL_Y, make_plan_table
from planners.free_flyer.belief.world_memory import AGENT, IMPACT_INDEX, INSERTED, TIME, make_world_memory
from planners.free_flyer.closed_loop.world_loop import start_world
from planners.free_flyer.next_impact.reachability import compute_arrival, compute_time, find_contact, is_reachable
from planners.free_flyer.tracking.course import COURSE_SIZE, SINCE, UNTIL, evaluate_course, fit_quintic
from planners.plan import Plan, PlannedImpact

SNAP, CRACKLE, POP, FIZZ = range(4)
HORIZON, K = 100.0, 1
FORCE = {"snap": 1.5, "crackle": 0.6}  # [N]
THRUST = {SNAP: 0.75 * 1.5 / 16.8, CRACKLE: 0.75 * 0.6 / 16.8}  # three quarters of it over the mass [m/s^2]
REACH = 0.4  # from a robot's centre to that of the object it hits [m]
# Impacts: time, robot, object, place, normal.
HITS = (
    (10.0, "snap", "pop", (1.0, 0.0), (1.0, 0.0)),
    (20.0, "snap", "fizz", (6.0, 3.0), (0.0, 1.0)),
    (30.0, "crackle", "pop", (3.0, 0.0), (-0.6, 0.8)),
    (60.0, "snap", "pop", (1.5, -2.0), (0.0, -1.0)),
)


class World:
    """World 1 of three at the beginning of a plan for two robots and two objects."""

    def __init__(self) -> None:
        base = load_scenario("throw_and_catch")
        item = base.objects["pop"].model_dump() | {"rest": False}
        values: dict[str, object] = {"world.lower": [-50, -50], "world.upper": [50, 50], "horizon": HORIZON}
        values["objects"] = {"pop": item | {"start": (1.0, 0.0)}, "fizz": item | {"start": (6.0, 3.0)}}
        values["formula"] = "F[0,100] pop.x >= -9"
        scenario = base.override(values | {f"robots.{name}.force_limit": force for name, force in FORCE.items()})
        assert isinstance(scenario, FreeFlyerScenario)
        self.table = make_plan_table(scenario, make_plan(scenario))
        self.memory = make_world_memory(self.table, 3)
        start_world(self.table, self.memory, EXPERT, K)
        self.strike, self.clock, self.place = (
            table[K] for table in (self.memory.strike, self.memory.clock, self.memory.place)
        )

    def arrive(self, index: int) -> float:
        return float(compute_arrival(self.table, self.memory, K, index))

    def contact(self, index: int) -> np.ndarray:
        return np.array(find_contact(self.table, self.memory, K, index))

    def reaches(self, robot: int, place: tuple[float, float], speed: tuple[float, float], span: float) -> bool:
        return bool(is_reachable(self.table, self.memory, K, robot, *place, *speed, span))


def make_plan(scenario: FreeFlyerScenario) -> Plan:
    """Return a plan in which everything but its impacts rests."""
    zero = np.zeros(2)
    numbers = dict.fromkeys(("robustness", "bound", "gap", "effort", "solve_seconds"), 0.0)
    return Plan(
        scenario=scenario.name,
        objective="robustness",
        horizon=HORIZON,
        effort_bound=None,
        impacts=tuple(
            PlannedImpact(
                time, robot, name, np.array(place), zero, np.array(normal), zero, zero, zero, np.array(normal)
            )
            for time, robot, name, place, normal in HITS
        ),
        robots={name: Curve([0.0, HORIZON], [[body.start]]) for name, body in scenario.robots.items()},
        objects={name: Curve([0.0, HORIZON], [[body.start]]) for name, body in scenario.objects.items()},
        stage_seconds={},
        validated=False,
        **numbers,
    )


@pytest.fixture
def world() -> World:
    return World()


def fly(begin: tuple[float, ...], end: tuple[float, ...], span: float) -> float:
    """Return the greatest acceleration of the quintic course between two motions [m/s^2]."""
    course, still = np.zeros((1, 1, COURSE_SIZE)), np.zeros((1, 1, 6, 2))
    course[0, 0, [SINCE, UNTIL]] = 0.0, span
    fit_quintic(course, 0, 0, (*begin, 0.0, 0.0), (*end, 0.0, 0.0))
    times = np.linspace(0.0, span, 2001)
    motion = [evaluate_course(course, np.array([[0.0, 1.0]]), still, 0, 0, t) for t in times]
    return max(math.hypot(m[4], m[5]) for m in motion)


@pytest.mark.parametrize("robot", [SNAP, CRACKLE])
@pytest.mark.parametrize("way", [0.05, 0.4, 3.0, 25.0])
def test_time_is_that_of_a_quintic_with_three_quarters_of_the_thrust(world: World, robot: int, way: float) -> None:
    span = compute_time(world.table, robot, way)
    angle = 0.7
    end = (0.2 + way * math.cos(angle), -0.3 + way * math.sin(angle), 0.0, 0.0)
    assert fly((0.2, -0.3, 0.0, 0.0), end, span) == pytest.approx(THRUST[robot], rel=1e-5)


def test_time_grows_with_the_root_of_the_way(world: World) -> None:
    assert compute_time(world.table, SNAP, 0.0) == 0.0
    one = compute_time(world.table, SNAP, 1.0)
    assert compute_time(world.table, SNAP, 4.0) == pytest.approx(2.0 * one)
    assert compute_time(world.table, CRACKLE, 1.0) == pytest.approx(one * math.sqrt(1.5 / 0.6))


@pytest.mark.parametrize("index", range(len(HITS)))
def test_contact_is_behind_the_object_against_the_normal(world: World, index: int) -> None:
    world.place[index] += [0.3, -0.2]
    _, _, _, place, normal = HITS[index]
    np.testing.assert_allclose(world.contact(index), np.add(place, [0.3, -0.2]) - REACH * np.array(normal))
    assert world.table.impact[index, [NORMAL_X, NORMAL_Y]].tolist() == list(normal)


def test_robots_with_nothing_to_hit_before_can_be_there_at_any_time(world: World) -> None:
    assert world.arrive(0) == 0.0
    assert world.arrive(2) == 0.0  # the others before it are another robot's


def test_robot_comes_after_its_impact_on_another_object(world: World) -> None:
    for time in (20.0, 23.5):
        world.clock[1] = time
        way = world.contact(3) - world.contact(1)
        after = time + compute_time(world.table, SNAP, float(np.hypot(*way)))
        assert world.arrive(3) == pytest.approx(after)
    way = world.contact(1) - world.contact(0)
    assert world.arrive(1) == pytest.approx(10.0 + compute_time(world.table, SNAP, float(np.hypot(*way))))


def test_latest_of_all_impacts_before_counts(world: World) -> None:
    """pop's own first impact is long done when fizz has been hit, unless it is put off."""
    world.clock[0] = 50.0
    way = world.contact(3) - world.contact(0)
    assert world.arrive(3) == pytest.approx(50.0 + compute_time(world.table, SNAP, float(np.hypot(*way))))
    world.strike[0, IMPACT_INDEX] = 2  # it is done
    way = world.contact(3) - world.contact(1)
    assert world.arrive(3) == pytest.approx(20.0 + compute_time(world.table, SNAP, float(np.hypot(*way))))
    world.strike[1, IMPACT_INDEX] = END
    assert world.arrive(3) == 0.0


def test_impacts_that_come_later_do_not_count(world: World) -> None:
    world.clock[1] = 70.0
    way = world.contact(3) - world.contact(0)
    assert world.arrive(3) == pytest.approx(10.0 + compute_time(world.table, SNAP, float(np.hypot(*way))))


@pytest.mark.parametrize(("robot", "counts"), [(SNAP, True), (CRACKLE, False)])
def test_inserted_impact_counts_where_the_object_will_be(world: World, robot: int, counts: bool) -> None:
    world.memory.time[K] = 40.0
    world.memory.filter[K, FIZZ, :4] = 7.0, 1.0, -0.1, 0.05
    world.strike[0, IMPACT_INDEX], world.strike[1, IMPACT_INDEX] = 3, END
    world.strike[1, [INSERTED, AGENT, TIME]] = 1.0, robot, 50.0
    way = world.contact(3) - [6.0, 1.5]
    after = 50.0 + compute_time(world.table, SNAP, float(np.hypot(*way)))
    assert world.arrive(3) == pytest.approx(after if counts else 0.0)


def test_arrival_is_at_rest_within_the_thrust_from_the_impact_before(world: World) -> None:
    """From the contact before to the next one the robot is there at the arrival, and not a little sooner."""
    world.memory.filter[K, SNAP] = 0.0
    world.memory.filter[K, SNAP, :2] = world.contact(1)
    world.strike[0, IMPACT_INDEX] = 2
    span, place = world.arrive(3) - world.clock[1], tuple(world.contact(3))
    assert world.reaches(SNAP, place, (0.0, 0.0), 1.01 * span)
    assert not world.reaches(SNAP, place, (0.0, 0.0), 0.98 * span)


@pytest.mark.parametrize("seed", range(4))
def test_reachable_at_rest_is_what_there_is_time_for(world: World, seed: int) -> None:
    rng = np.random.default_rng(seed)
    for robot in (SNAP, CRACKLE):
        for _ in range(50):
            begin, way = rng.uniform(-3, 3, 2), rng.uniform(-3, 3, 2)
            world.memory.filter[K, robot] = 0.0
            world.memory.filter[K, robot, :2] = begin
            span = compute_time(world.table, robot, float(np.hypot(*way)))
            place = tuple(begin + way)
            assert world.reaches(robot, place, (0.0, 0.0), 1.001 * span)
            # The compiled one looks at seven instants, at which 97 % of the greatest acceleration is seen.
            assert not world.reaches(robot, place, (0.0, 0.0), 0.98 * span)


def test_reachable_at_speed_if_there_is_time_to_swing(world: World) -> None:
    """Where it is, a robot is with another speed only after it went back and forth, or at once with its own."""
    world.memory.filter[K, SNAP] = 0.0
    assert not world.reaches(SNAP, (0.0, 0.0), (0.2, 0.0), 4.0)
    assert world.reaches(SNAP, (0.0, 0.0), (0.2, 0.0), 20.0)
    assert fly((0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.2, 0.0), 4.0) > THRUST[SNAP]
    assert fly((0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.2, 0.0), 20.0) < THRUST[SNAP]
    world.memory.filter[K, SNAP, 2:4] = 0.2, 0.1
    assert world.reaches(SNAP, (0.8, 0.4), (0.2, 0.1), 4.0)
    assert not world.reaches(CRACKLE, (0.8, 0.4), (0.2, 0.1), 0.5)

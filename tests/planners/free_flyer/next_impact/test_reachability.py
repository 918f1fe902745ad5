"""A robot can be where a quintic within three quarters of its thrust brings it, after what it has to hit before."""

from __future__ import annotations

import math

import numpy as np
import pytest

from planners.free_flyer.belief.options import EXPERT, make_record
from planners.free_flyer.belief.plan_table import NO_IMPACT
from planners.free_flyer.next_impact.reachability import compute_arrival, compute_time, find_contact, is_reachable
from planners.free_flyer.tracking.course import COURSE, evaluate_course, fit_quintic
from tests.planners.free_flyer.plans import K, World, load_open, make_plan, plan_impact, set_fields

OPTIONS = make_record(EXPERT)[0]

SNAP, CRACKLE, POP, FIZZ = range(4)
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


class Start(World):
    """World 1 of three at the beginning of a plan for two robots and two objects, in which only objects are hit."""

    def __init__(self) -> None:
        scenario = load_open("F[0,100] pop.x >= -9", {"pop": (1.0, 0.0), "fizz": (6.0, 3.0)})
        scenario = scenario.override({f"robots.{name}.force_limit": force for name, force in FORCE.items()})
        impacts = (plan_impact(*hit, after=hit[-1]) for hit in HITS)
        super().__init__(scenario, make_plan(scenario, impacts))

    def arrive(self, index: int) -> float:
        return float(compute_arrival(self.table, self.memory, OPTIONS, K, index))

    def find_contact(self, index: int) -> np.ndarray:
        return np.array(find_contact(self.table, self.memory, K, index))

    def reaches(self, robot: int, place: tuple[float, float], speed: tuple[float, float], span: float) -> bool:
        return bool(is_reachable(self.table, self.memory, OPTIONS, K, robot, *place, *speed, span))


@pytest.fixture
def world() -> Start:
    return Start()


def fly(begin: tuple[float, ...], end: tuple[float, ...], span: float) -> float:
    """Return the greatest acceleration of the quintic course between two motions [m/s^2]."""
    course, still = np.zeros((), COURSE)[()], np.zeros((1, 1, 6, 2))
    set_fields(course, since=0.0, until=span)
    fit_quintic(course, (*begin, 0.0, 0.0), (*end, 0.0, 0.0))
    times = np.linspace(0.0, span, 2001)
    motion = [evaluate_course(course, np.array([[0.0, 1.0]]), still, 0, t) for t in times]
    return max(math.hypot(m[4], m[5]) for m in motion)


@pytest.mark.parametrize("robot", [SNAP, CRACKLE])
@pytest.mark.parametrize("way", [0.05, 0.4, 3.0, 25.0])
def test_time_is_that_of_a_quintic_with_three_quarters_of_the_thrust(world: Start, robot: int, way: float) -> None:
    span = compute_time(world.table, OPTIONS, robot, way)
    angle = 0.7
    end = (0.2 + way * math.cos(angle), -0.3 + way * math.sin(angle), 0.0, 0.0)
    assert fly((0.2, -0.3, 0.0, 0.0), end, span) == pytest.approx(THRUST[robot], rel=1e-5)


def test_time_grows_with_the_root_of_the_way(world: Start) -> None:
    assert compute_time(world.table, OPTIONS, SNAP, 0.0) == 0.0
    one = compute_time(world.table, OPTIONS, SNAP, 1.0)
    assert compute_time(world.table, OPTIONS, SNAP, 4.0) == pytest.approx(2.0 * one)
    assert compute_time(world.table, OPTIONS, CRACKLE, 1.0) == pytest.approx(one * math.sqrt(1.5 / 0.6))


@pytest.mark.parametrize("index", range(len(HITS)))
def test_contact_is_behind_the_object_against_the_normal(world: Start, index: int) -> None:
    world.place[index] += [0.3, -0.2]
    _, _, _, place, normal = HITS[index]
    np.testing.assert_allclose(world.find_contact(index), np.add(place, [0.3, -0.2]) - REACH * np.array(normal))
    assert world.table.impact[index]["normal"].tolist() == list(normal)


def test_robots_with_nothing_to_hit_before_can_be_there_at_any_time(world: Start) -> None:
    assert world.arrive(0) == 0.0
    assert world.arrive(2) == 0.0  # the others before it are another robot's


def test_robot_comes_after_its_impact_on_another_object(world: Start) -> None:
    for time in (20.0, 23.5):
        world.clock[1] = time
        way = world.find_contact(3) - world.find_contact(1)
        after = time + compute_time(world.table, OPTIONS, SNAP, float(np.hypot(*way)))
        assert world.arrive(3) == pytest.approx(after)
    way = world.find_contact(1) - world.find_contact(0)
    assert world.arrive(1) == pytest.approx(10.0 + compute_time(world.table, OPTIONS, SNAP, float(np.hypot(*way))))


def test_latest_of_all_impacts_before_counts(world: Start) -> None:
    """pop's own first impact is long done when fizz has been hit, unless it is put off."""
    world.clock[0] = 50.0
    way = world.find_contact(3) - world.find_contact(0)
    assert world.arrive(3) == pytest.approx(50.0 + compute_time(world.table, OPTIONS, SNAP, float(np.hypot(*way))))
    world.strike[0]["index"] = 2  # it is done
    way = world.find_contact(3) - world.find_contact(1)
    assert world.arrive(3) == pytest.approx(20.0 + compute_time(world.table, OPTIONS, SNAP, float(np.hypot(*way))))
    world.strike[1]["index"] = NO_IMPACT
    assert world.arrive(3) == 0.0


def test_impacts_that_come_later_do_not_count(world: Start) -> None:
    world.clock[1] = 70.0
    way = world.find_contact(3) - world.find_contact(0)
    assert world.arrive(3) == pytest.approx(10.0 + compute_time(world.table, OPTIONS, SNAP, float(np.hypot(*way))))


@pytest.mark.parametrize(("robot", "counts"), [(SNAP, True), (CRACKLE, False)])
def test_inserted_impact_counts_where_the_object_will_be(world: Start, robot: int, counts: bool) -> None:
    world.memory.time[K] = 40.0
    world.see(FIZZ, (7.0, 1.0), (-0.1, 0.05))
    world.strike["index"] = 3, NO_IMPACT
    set_fields(world.strike[1], is_inserted=True, robot=robot, time=50.0)
    way = world.find_contact(3) - [6.0, 1.5]
    after = 50.0 + compute_time(world.table, OPTIONS, SNAP, float(np.hypot(*way)))
    assert world.arrive(3) == pytest.approx(after if counts else 0.0)


def test_arrival_is_at_rest_within_the_thrust_from_the_impact_before(world: Start) -> None:
    """From the contact before to the next one the robot is there at the arrival, and not a little sooner."""
    world.see(SNAP, world.find_contact(1))
    world.strike[0]["index"] = 2
    span, place = world.arrive(3) - world.clock[1], tuple(world.find_contact(3))
    assert world.reaches(SNAP, place, (0.0, 0.0), 1.01 * span)
    assert not world.reaches(SNAP, place, (0.0, 0.0), 0.98 * span)


@pytest.mark.parametrize("seed", range(4))
def test_reachable_at_rest_is_what_there_is_time_for(world: Start, seed: int) -> None:
    rng = np.random.default_rng(seed)
    for robot in (SNAP, CRACKLE):
        for _ in range(50):
            begin, way = rng.uniform(-3, 3, 2), rng.uniform(-3, 3, 2)
            world.see(robot, begin)
            span = compute_time(world.table, OPTIONS, robot, float(np.hypot(*way)))
            place = tuple(begin + way)
            assert world.reaches(robot, place, (0.0, 0.0), 1.001 * span)
            # The compiled one looks at seven instants, at which 97 % of the greatest acceleration is seen.
            assert not world.reaches(robot, place, (0.0, 0.0), 0.98 * span)


def test_reachable_at_speed_if_there_is_time_to_swing(world: Start) -> None:
    """Where it is, a robot is with another speed only after it went back and forth, or at once with its own."""
    world.see(SNAP, (0.0, 0.0))
    assert not world.reaches(SNAP, (0.0, 0.0), (0.2, 0.0), 4.0)
    assert world.reaches(SNAP, (0.0, 0.0), (0.2, 0.0), 20.0)
    assert fly((0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.2, 0.0), 4.0) > THRUST[SNAP]
    assert fly((0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.2, 0.0), 20.0) < THRUST[SNAP]
    world.see(SNAP, (0.0, 0.0), (0.2, 0.1))
    assert world.reaches(SNAP, (0.8, 0.4), (0.2, 0.1), 4.0)
    assert not world.reaches(CRACKLE, (0.8, 0.4), (0.2, 0.1), 0.5)

"""Courses go round solid obstacles and stay inside the world; those that are clear stay as they are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from planners.free_flyer.belief.options import EXPERT, make_record
from planners.free_flyer.belief.surroundings import measure_gap
from planners.free_flyer.belief.world_memory import NO_OBJECT
from planners.free_flyer.next_impact.bookkeeping import return_robot
from planners.free_flyer.next_impact.detour import find_corner, go_round, move_clear
from planners.free_flyer.next_impact.replanner import replan_course, turn_off_walls
from planners.free_flyer.tracking.course import evaluate_course, plan_approach
from planners.free_flyer.tracking.mpc import GAIN, INPUT_LIMIT
from tests.planners.free_flyer.plans import K, World, load, make_plan, plan_impact, set_fields

OPTIONS = make_record(EXPERT)[0]
OFF = make_record(replace(EXPERT, walls=False))[0]
SNAP, POP, PIP = 0, 4, 5
RADIUS, MARGIN = 0.2, EXPERT.surroundings.margin
Pair = tuple[float, float]


class Crew(World):
    """World 1 of three of the crew: a pillar from (4, 4) to (6, 6) in a world of 10 m; snap rests at (1, 1)."""

    def __init__(self, place: Pair = (2.5, 2.0), time: float = 20.0) -> None:
        scenario = load("crew")
        super().__init__(scenario, make_plan(scenario, [plan_impact(time, "snap", "pop", place, (0.8, -0.6))]))

    def approach(self, begin: Pair, end: Pair, velocity: Pair, time: float) -> np.ndarray:
        """Plan snap's course to an impact by one quintic, from rest; return its motions every 0.05 s, shape (n, 6)."""
        here = (*begin, 0.0, 0.0, 0.0, 0.0)
        table = self.table
        plan_approach(self.course[SNAP], table.breaks, table.coefficients, SNAP, 0.0, here, end, velocity, time, -1.0)
        return self.read(time)

    def read(self, until: float, now: float = 0.0) -> np.ndarray:
        times = np.linspace(now, until, round((until - now) / 0.05) + 1)
        course, table = self.course[SNAP], self.table
        return np.array([evaluate_course(course, table.breaks, table.coefficients, SNAP, t) for t in times])

    def go_round(self, latest: float = 120.0) -> None:
        go_round(self.table, self.memory, OPTIONS, K, SNAP, NO_OBJECT, 0.0, latest)

    def gaps(self, motions: np.ndarray) -> np.ndarray:
        return np.array([measure_gap(self.table, SNAP, *motion[:2]) for motion in motions])


@pytest.mark.parametrize(
    ("begin", "end", "time"),
    [((2.0, 5.0), (8.0, 5.2), 40.0), ((2.0, 2.5), (8.0, 8.0), 45.0), ((5.0, 3.0), (5.0, 8.0), 60.0)],
)
def test_course_between_both_sides_of_a_block_goes_round(begin: Pair, end: Pair, time: float) -> None:
    crew, velocity = Crew(), (0.1, 0.05)
    straight = crew.approach(begin, end, velocity, time)
    assert crew.gaps(straight).min() < -0.5
    crew.go_round()
    round_it = crew.read(time)
    assert crew.gaps(round_it).min() > 0.02
    assert crew.count("detours") == 1
    assert round_it[0] == pytest.approx((*begin, 0, 0, 0, 0), abs=1e-9)
    assert round_it[-1, :4] == pytest.approx((*end, *velocity), abs=1e-9)
    pilot = crew.table.pilot[SNAP]
    assert np.hypot(*round_it[:, 4:].T).max() < pilot[GAIN] * pilot[INPUT_LIMIT]
    assert np.abs(np.diff(round_it[:, 4:], axis=0)).max() < 0.01  # the acceleration has no step


def test_run_up_stays_inside_the_world() -> None:
    crew = Crew()
    swung = crew.approach((0.3, 8.0), (1.1, 8.0), (0.25, 0.0), 25.0)
    assert crew.gaps(swung).min() < -0.1  # it has much time: it swings out behind its start
    crew.go_round()
    assert crew.gaps(crew.read(25.0)).min() > -1e-3
    assert crew.read(25.0)[-1, :4] == pytest.approx((1.1, 8.0, 0.25, 0.0), abs=1e-9)


@pytest.mark.parametrize("side", [0.05, -0.05])
def test_course_passes_by_what_it_is_to_hit_from_the_other_side(side: float) -> None:
    """Snap comes from the left and is to hit pop, at rest, from the right: the quintic leads through pop."""
    crew = Crew((2.5, 2.0))
    crew.see(POP, (2.5, 2.0))
    strike = crew.memory.strike[K, 0]
    strike["time"], strike["contact"] = 40.0, (2.9, 2.0)
    through = crew.approach((1.2, 2.0 + side), (2.9, 2.0), (-0.1, 0.0), 40.0)
    assert np.hypot(*(through[:, :2] - (2.5, 2.0)).T).min() < 0.3
    go_round(crew.table, crew.memory, OPTIONS, K, SNAP, 0, 0.0, 120.0)
    motions = crew.read(40.0)
    assert np.hypot(*(motions[:, :2] - (2.5, 2.0)).T).min() > 0.4 - EXPERT.surroundings.through - 1e-3
    assert motions[-1, :4] == pytest.approx((2.9, 2.0, -0.1, 0.0), abs=1e-9)


@pytest.mark.parametrize("side", [0.05, -0.05])
def test_course_goes_round_an_object_that_it_does_not_end_at(side: float) -> None:
    """Pip rests in the way to pop: the barrier would stop snap before it."""
    crew = Crew((3.5, 2.0))
    crew.see(POP, (3.5, 2.0))
    crew.see(PIP, (2.3, 2.0 + side))
    strike = crew.memory.strike[K, 0]
    strike["time"], strike["contact"] = 40.0, (3.1, 2.0)
    through = crew.approach((1.2, 2.0), (3.1, 2.0), (0.1, 0.0), 40.0)
    assert np.hypot(*(through[:, :2] - (2.3, 2.0 + side)).T).min() < 0.3
    go_round(crew.table, crew.memory, OPTIONS, K, SNAP, 0, 0.0, 120.0)
    motions = crew.read(40.0)
    assert np.hypot(*(motions[:, :2] - (2.3, 2.0 + side)).T).min() > 2.0 * RADIUS + EXPERT.surroundings.aside - 0.01
    assert motions[-1, :4] == pytest.approx((3.1, 2.0, 0.1, 0.0), abs=1e-9)


def test_impulse_is_turned_until_its_robot_is_in_no_wall() -> None:
    """Pop is 0.58 m off the wall, and straight behind it is no room for snap; 0.3 rad aside there is."""
    crew, change = Crew(), np.array([0.1, 0.0])
    turned = np.array(turn_off_walls(crew.table, OPTIONS, SNAP, POP, 0.585, 5.0, *change))
    angle = np.arctan2(*turned[::-1])
    assert abs(angle) == pytest.approx(0.3)
    assert np.hypot(*turned) == pytest.approx(0.1 * np.cos(0.3))
    assert measure_gap(crew.table, SNAP, 0.585 - 0.4 * np.cos(angle), 5.0) >= 0.0
    for x in (0.61, 0.45, 0.1):  # room enough; too near; in the wall itself
        assert turn_off_walls(crew.table, OPTIONS, SNAP, POP, x, 5.0, *change) == tuple(change)
    assert turn_off_walls(crew.table, OPTIONS, SNAP, POP, 0.5, 5.0, 0.0, 0.0) == (0.0, 0.0)


def test_clear_course_stays_bit_for_bit() -> None:
    crew = Crew()
    for k, body in enumerate((POP, PIP, PIP + 1)):  # no object is in the way either
        crew.see(body, (9.0, 7.0 + k))
    crew.approach((1.0, 2.0), (8.0, 2.5), (0.1, 0.05), 40.0)
    before = crew.course[SNAP].tobytes()
    crew.go_round()
    assert crew.course[SNAP].tobytes() == before
    assert crew.count("detours") == 0


def test_way_back_round_the_pillar_may_take_longer() -> None:
    """Thrown off behind the pillar with 12 s for a quintic back: it takes more, and then rests at the plan's place."""
    crew = Crew(time=100.0)
    crew.see(SNAP, (7.0, 6.5), (-0.05, 0.0))
    return_robot(crew.table, crew.memory, OFF, K, SNAP, 0.0, 0.0)
    assert crew.gaps(crew.read(15.0)).min() < 0.0
    assert crew.course["until"][SNAP] == pytest.approx(12.0)
    return_robot(crew.table, crew.memory, OPTIONS, K, SNAP, 0.0, 0.0)
    assert crew.gaps(crew.read(60.0)).min() > 0.02
    assert 12.0 < crew.course["until"][SNAP] <= 36.0 + 1e-9
    assert crew.read(60.0)[-1, :2] == pytest.approx((1.0, 1.0), abs=1e-9)


def test_corners_and_places_that_are_moved_clear_have_the_margin() -> None:
    crew = Crew()
    for corner in range(4):
        x, y = find_corner(crew.table, SNAP, corner, MARGIN)
        assert np.abs([x - 5.0, y - 5.0]) == pytest.approx([1.0 + RADIUS + MARGIN] * 2)
    for place in ((0.1, 0.1), (4.2, 5.0), (9.9, 5.0), (5.9, 5.95)):
        assert measure_gap(crew.table, SNAP, *move_clear(crew.table, SNAP, *place, MARGIN)) == pytest.approx(MARGIN)
    assert move_clear(crew.table, SNAP, 2.0, 2.0, MARGIN) == (2.0, 2.0)


def replan_drifting(options: np.void, speed: float) -> Crew:
    """Let pop fly to the lower wall, where snap is to hit it at 20 s; plan that course at 4 s."""
    crew = Crew((2.5, 0.9))
    crew.see(SNAP, (2.0, 0.7))
    crew.see(POP, (2.5, 1.9), (0.0, speed))
    for axis, value in enumerate((2.0, 0.7)):
        crew.course[SNAP]["quintic"][0, axis] = value - 1.0
    set_fields(crew.course[SNAP], until=100.0)
    crew.memory.time[K] = 4.0
    replan_course(crew.table, crew.memory, options, K, SNAP, 0, 4.0)
    return crew


def test_object_is_hit_before_it_is_in_the_wall() -> None:
    """At -0.1 m/s pop would be 0.3 m off the wall at the planned time, with no room for snap; it comes earlier."""
    late, early = replan_drifting(OFF, -0.1), replan_drifting(OPTIONS, -0.1)
    assert late.strike["time"][0] == 20.0
    assert 8.0 <= early.strike["time"][0] < 20.0
    contact, time = early.strike["contact"][0], early.strike["time"][0]
    assert measure_gap(early.table, SNAP, *contact) >= 0.0
    assert 1.9 - 0.1 * (time - 4.0) >= RADIUS
    assert early.clock[0] == time


def test_impact_with_room_keeps_its_time_bit_for_bit() -> None:
    on, off = replan_drifting(OPTIONS, -0.01), replan_drifting(OFF, -0.01)
    assert on.strike.tobytes() == off.strike.tobytes()
    assert on.course.tobytes() == off.course.tobytes()

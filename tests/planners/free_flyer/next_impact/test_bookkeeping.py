"""Impacts come in their planned order, missed ones are tried again, and what an impact did is learned from."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from impact_envs.free_flyer.schema import FreeFlyerScenario
from planners.bezier import Curve
from planners.free_flyer.belief.impact_parameters import NOW, compute_gain_spread, compute_pair_gain, find_row
from planners.free_flyer.belief.options import EXPERT, VARIANTS, Options, make_record
from planners.free_flyer.belief.plan_table import NO_IMPACT, make_plan_table
from planners.free_flyer.belief.world_memory import BLANK_STRIKE, NO_OBJECT, UNKNOWN, find_next_event, find_strike
from planners.free_flyer.closed_loop.world_loop import control_world, should_replan
from planners.free_flyer.next_impact.aim import choose_desired_velocity
from planners.free_flyer.next_impact.bookkeeping import (
    find_due,
    learn_from_hits,
    remember_before,
    set_time,
    start_strikes,
    take_misses,
)
from planners.free_flyer.next_impact.desired_velocity import (
    compute_desired_velocity,
    compute_margin,
    compute_room,
    compute_turn,
    find_next_knot,
    find_share,
    hasten_next_knot,
)
from planners.free_flyer.next_impact.replanner import replan_course
from planners.free_flyer.next_impact.two_body import Outcome
from planners.free_flyer.tracking.course import evaluate_course, read_clock
from planners.free_flyer.tracking.mpc import make_workspace
from planners.plan import Plan
from tests.planners.free_flyer import plans
from tests.planners.free_flyer.plans import K, World, load_open, plan_impact, set_fields

OPTIONS = make_record(EXPERT)[0]
REPLANNING = EXPERT.replanning
TIMING = EXPERT.timing
SHORTEST_NOTICE = 4.0  # of an impact after a contact that came late: settled, decided, planned [s]

HORIZON = 100.0
SNAP, CRACKLE, POP, PIP = range(4)
STILL = VARIANTS["with_learning"]  # neither retries nor insertions


def make_scenario(formula: str = "F[0,100] pop.x >= -9") -> FreeFlyerScenario:
    return load_open(formula, {"pop": (0.0, 2.0), "pip": (3.0, 3.0)}, HORIZON)


def make_plan(scenario: FreeFlyerScenario, *impacts: tuple[float, str, str]) -> Plan:
    """Return a plan with impacts (time, robot, object) along x on objects that are at x = time / 10; robots rest."""
    planned = [plan_impact(t, robot, item, (t / 10, 0.0)) for t, robot, item in impacts]
    curve = Curve([0.0, HORIZON], [[[0.0, 0.0], [7.0, 0.0]]])
    return plans.make_plan(scenario, planned, objects=dict.fromkeys(scenario.objects, curve))


class Loop(World):
    """World 1 of three, played step by step."""

    def feel(self, robot: int, approach: float) -> None:
        """Let a robot's contact be one along x of a robot that stops, with exact velocities."""
        felt = self.memory.felt[K, robot]
        set_fields(felt, approach=approach, normal=(1.0, 0.0), free_velocity=(approach, 0.0))
        set_fields(felt, object_variance=0.0, robot_variance=0.0)

    def gain(self, robot: int, item: int) -> float:
        return float(compute_pair_gain(self.memory, K, robot, item))

    def miss(self, now: float) -> None:
        take_misses(self.table, self.memory, make_record(self.options)[0], K, now)

    def indices(self) -> list[int]:
        return self.strike["index"].tolist()

    def see_at(self, now: float, body: int, position: tuple[float, float], velocity: tuple[float, float]) -> None:
        """Let a body's estimate at a time be exact."""
        self.memory.time[K] = now
        self.see(body, position, velocity)


FOUR = ((10, "snap", "pop"), (30, "crackle", "pop"), (40, "snap", "pip"), (60, "snap", "pop"))


@pytest.fixture
def loop() -> Loop:
    scenario = make_scenario()
    return Loop(scenario, make_plan(scenario, *FOUR))


def test_every_object_waits_for_its_own_next_impact(loop: Loop) -> None:
    assert loop.indices() == [0, 2]
    assert loop.strike["robot"].tolist() == [SNAP, SNAP]
    assert find_strike(loop.memory, K, SNAP) == 0
    assert find_strike(loop.memory, K, CRACKLE) == NO_OBJECT  # pop has to be thrown first
    assert find_next_event(loop.table, loop.memory, K, CRACKLE) == (30.0, 30.0, 1)
    loop.contact(SNAP, POP, 10.1)
    assert loop.indices() == [1, 2]
    assert find_strike(loop.memory, K, CRACKLE) == 0
    assert find_strike(loop.memory, K, SNAP) == 1
    loop.contact(CRACKLE, POP, 30.0)
    assert find_next_event(loop.table, loop.memory, K, CRACKLE) == (HORIZON, HORIZON, NO_IMPACT)
    loop.contact(SNAP, PIP, 40.0)
    assert loop.indices() == [3, NO_IMPACT]
    assert loop.strike[1]["time"] == math.inf
    loop.contact(SNAP, POP, 60.0)
    assert loop.indices() == [NO_IMPACT, NO_IMPACT]
    assert loop.count("unplanned_contact") == 0
    assert (loop.memory.strike[::2] == BLANK_STRIKE).all()  # other worlds are left alone


def test_object_flies_to_its_next_knot_or_to_its_end(loop: Loop) -> None:
    knot, time, last = find_next_knot(loop.table, loop.memory, K, 0, False)
    assert (knot, time, last) == (1, 30.0, False)
    np.testing.assert_array_equal(loop.table.knot["position"][knot], [3.0, 0.0])
    knot, time, last = find_next_knot(loop.table, loop.memory, K, 1, False)
    assert (knot, time, last) == (5, HORIZON, True)
    np.testing.assert_array_equal(loop.table.knot["position"][knot], [7.0, 0.0])
    assert find_next_knot(loop.table, loop.memory, K, 0, True) == (0, 10.0, False)  # after one that is inserted


@pytest.mark.parametrize(
    ("robot", "body", "now"),
    [
        (CRACKLE, POP, 10.0),  # wrong robot
        (SNAP, UNKNOWN, 10.0),  # a wall
        (SNAP, CRACKLE, 10.0),  # another robot
        (SNAP, POP, 5.0),  # far too early
    ],
)
def test_contacts_that_are_none_of_the_plan(loop: Loop, robot: int, body: int, now: float) -> None:
    loop.memory.course[K, robot]["ends_in_impact"] = True
    loop.contact(robot, body, now)
    assert loop.indices() == [0, 2]
    assert loop.count("unplanned_contact") == 1
    assert not loop.memory.course[K, robot]["ends_in_impact"]  # it returns to its plan
    assert loop.strike[0]["last_contact"] == (now if body == POP else -math.inf)


def test_impact_a_little_early_is_the_planned_one(loop: Loop) -> None:
    loop.contact(SNAP, POP, 8.1)
    assert loop.indices() == [1, 2]
    assert loop.count("unplanned_contact") == 0


def test_replans_every_half_second_in_the_window(loop: Loop) -> None:
    loop.contact(SNAP, POP, 10.0)
    times = []
    for k in range(350):
        now = 0.1 * k
        if now >= 10.0 and should_replan(loop.table, loop.memory, OPTIONS, K, CRACKLE, 0, now):
            loop.strike[0]["replanned_at"] = now
            times.append(now)
    np.testing.assert_allclose(np.diff(times), 0.5)
    assert times[0] == pytest.approx(11.5)  # 20 s before the impact would be earlier: the object has to settle
    assert 28.5 < times[-1] <= 29.0 + 1e-6


def test_published_code_plans_each_impact_once(loop: Loop) -> None:
    once, times = make_record(VARIANTS["one_replan"])[0], []
    for k in range(100):
        if should_replan(loop.table, loop.memory, once, K, SNAP, 0, 0.1 * k):
            loop.strike[0]["replanned_at"] = 0.1 * k
            times.append(0.1 * k)
    assert times == [0.0]


def test_correction_is_due_once_per_impact(loop: Loop) -> None:
    assert find_due(loop.table, loop.memory, OPTIONS, K, 10 - TIMING.decision_lead - 0.1) == NO_OBJECT
    assert find_due(loop.table, loop.memory, OPTIONS, K, 10 - TIMING.decision_lead) == 0
    loop.strike[0]["is_decided"] = True
    assert find_due(loop.table, loop.memory, OPTIONS, K, 9.0) == NO_OBJECT
    loop.contact(SNAP, POP, 23.0)  # late
    # It would be due at 22 s, but the object is not yet seen well.
    assert find_due(loop.table, loop.memory, OPTIONS, K, 23.0 + TIMING.decision_settle - 0.1) == NO_OBJECT
    assert find_due(loop.table, loop.memory, OPTIONS, K, 23.0 + TIMING.decision_settle) == 0


def test_late_impact_leaves_notice_for_the_next_one_and_time_for_the_rest(loop: Loop) -> None:
    loop.contact(SNAP, POP, 29.0)
    late = 29.0 + SHORTEST_NOTICE
    assert loop.strike[0]["time"] == loop.clock[1] == pytest.approx(late)
    assert loop.clock[3] == pytest.approx(late + 30 * (HORIZON - late) / 70)  # 30 of the 70 s that were left
    assert loop.clock[2] == 40.0  # other objects keep their times


def test_impact_at_its_time_moves_no_other(loop: Loop) -> None:
    loop.contact(SNAP, POP, 10.0)
    np.testing.assert_array_equal(loop.clock, [10, 30, 40, 60])


def test_robots_clocks_follow_the_expected_times(loop: Loop) -> None:
    """A robot that follows its plan is where the plan has it at an impact when the impact is expected."""
    loop.contact(SNAP, POP, 29.0)
    time, planned, index = find_next_event(loop.table, loop.memory, K, CRACKLE)
    assert (time, planned, index) == (29.0 + SHORTEST_NOTICE, 30.0, 1)
    assert read_clock(loop.course[CRACKLE], time) == pytest.approx(planned)
    assert loop.course[CRACKLE]["stop"] == planned


def test_later_impacts_stay_in_their_windows() -> None:
    scenario = make_scenario("F[8,12] pop.x >= 0.9 & F[28,35] pop.x >= 2.9 & G[100,100] pop.x <= 99")
    loop = Loop(scenario, make_plan(scenario, (10, "snap", "pop"), (30, "crackle", "pop"), (60, "snap", "pop")))
    set_time(loop.table, loop.memory, K, 0, 0, 50.0)
    np.testing.assert_allclose(loop.clock, [50, 50, 50 + (60 - 10) * 50 / 90])  # closed at 35, but not before the first
    loop = Loop(scenario, make_plan(scenario, (10, "snap", "pop"), (30, "crackle", "pop"), (60, "snap", "pop")))
    set_time(loop.table, loop.memory, K, 0, 0, 24.0)
    np.testing.assert_allclose(loop.clock[:2], [24, 35])


@pytest.mark.parametrize("time", [8.5, 10.0])
def test_first_impact_is_expected_as_planned_in_its_window(time: float) -> None:
    scenario = make_scenario("F[8,10] pop.x >= 0.8")
    assert Loop(scenario, make_plan(scenario, (time, "snap", "pop"))).strike[0]["time"] == time


@pytest.mark.parametrize(
    ("opens", "closes", "way", "expected"),
    [
        (20, 32, 2.1, 10 + TIMING.haste * 22),
        (28, 32, 2.1, 28),  # not before the window opens
        (20, 32, 4.0, 10 + 4.0 / TIMING.fast),  # no faster than that
        (20, 32, 9.0, 31),  # nor later than planned
        (20, 60, 2.1, 31),
        (20, 100, 2.1, 31),  # closes with the task
    ],
)
def test_flight_into_a_closing_window_is_begun_fast_enough_for_a_weak_throw(
    opens: float, closes: float, way: float, expected: float
) -> None:
    """The object is planned to be hit at 10 s and, that far away, at 31 s."""
    scenario = make_scenario(f"F[{opens},{closes}] pop.x >= 3")
    plan = make_plan(scenario, (10, "snap", "pop"), (31, "crackle", "pop"))
    second = replace(plan.impacts[1], position=np.array([1.0 + way, 0.0]))
    loop = Loop(scenario, replace(plan, impacts=(plan.impacts[0], second)))
    np.testing.assert_allclose(loop.clock, [10, expected])


@pytest.mark.parametrize(
    ("closes", "expected"),
    [
        (22.0, 10 + TIMING.haste * 12 / 0.5),  # a throw that is weaker by a fifth is half-way at 22 s
        (12.0, 10 + 1.0 / TIMING.fast / 0.5),  # no faster than that
        (40.0, 31.0),  # nor later than planned
    ],
)
def test_flight_through_a_place_that_has_to_be_passed_in_time_is_fast_enough_for_a_weak_throw(
    closes: float, expected: float
) -> None:
    """The object is planned to be hit at 10 s and at 31 s, 2 m away; what is half-way has to be passed."""
    scenario = make_scenario()
    loop = Loop(scenario, make_plan(scenario, (10, "snap", "pop"), (31, "crackle", "pop")))
    set_fields(loop.table.knot[0], via_share=0.5, via=(2.0, 0.0), via_closes=closes)
    start_strikes(loop.table, loop.memory, OPTIONS, K, 0.0)
    np.testing.assert_allclose(loop.clock, [10, expected])


def test_missed_impact_is_tried_again_then_given_up(loop: Loop) -> None:
    now = 10.0
    for k in range(TIMING.retries):
        loop.miss(now + TIMING.patience - 0.1)
        assert loop.count("retry") == k
        loop.miss(now + TIMING.patience + 0.1)
        assert loop.count("retry") == k + 1
        now += TIMING.patience + 0.1 + TIMING.retry_in
        assert loop.strike[0]["time"] == pytest.approx(now)
        assert loop.strike[0]["replanned_at"] == -math.inf  # the course is planned anew
    assert loop.count("give_up") == 0
    loop.miss(now + TIMING.patience + 0.1)
    assert loop.indices() == [1, 2]
    assert (loop.count("retry"), loop.count("give_up")) == (TIMING.retries, 1)


def test_variants_without_retiming_give_up_at_once(loop: Loop) -> None:
    loop.options = STILL
    loop.miss(10 + TIMING.patience + 0.1)
    assert loop.indices() == [1, 2]
    assert (loop.count("retry"), loop.count("give_up")) == (0, 1)


@pytest.mark.parametrize("outcome", [Outcome.NOT_NEEDED, Outcome.OUT_OF_REACH])
def test_needless_or_hopeless_impact_is_not_tried_again(loop: Loop, outcome: Outcome) -> None:
    set_fields(loop.strike[0], is_solved=True, outcome=outcome)
    loop.miss(10 + TIMING.patience + 0.1)
    assert (loop.count("retry"), loop.count("give_up")) == (0, 1)


def test_no_second_try_after_the_horizon() -> None:
    scenario = make_scenario()
    loop = Loop(scenario, make_plan(scenario, (95.0, "snap", "pop")))
    loop.miss(97.0)
    assert loop.indices() == [NO_IMPACT, NO_IMPACT]
    assert loop.count("retry") == 0


def test_after_an_inserted_impact_the_planned_one_is_still_to_come(loop: Loop) -> None:
    set_fields(loop.strike[0], is_inserted=True, robot=CRACKLE, time=5.0)
    loop.contact(CRACKLE, POP, 5.0)
    assert loop.indices() == [0, 2]
    assert not loop.strike[0]["is_inserted"]
    assert loop.strike[0]["robot"] == SNAP
    assert loop.strike[0]["time"] == 10.0
    set_fields(loop.strike[0], is_inserted=True, robot=CRACKLE, time=7.0)
    loop.miss(7.0 + TIMING.patience + 0.1)  # an inserted one is not tried again
    assert loop.indices() == [0, 2]
    assert (loop.count("retry"), loop.count("give_up")) == (0, 1)


def test_what_was_learned_waits_for_the_velocity_and_ends_with_the_next_contact(loop: Loop) -> None:
    """The robot approaches at 0.1 m/s, which is believed to give 0.09 m/s; it gives 0.07."""
    set_fields(loop.strike[0], is_solved=True, change=0.08, normal=(1.0, 0.0))  # the expert asked for 0.08 m/s
    loop.see_at(10.0, POP, (0, 0), (0.01, 0.02))
    remember_before(loop.table, loop.memory, K)
    loop.feel(SNAP, 0.1)
    loop.contact(SNAP, POP, 10.0)
    before = compute_gain_spread(loop.memory, OPTIONS, K, SNAP, 0)
    for now, speed in ((10.9, 0.5), (11.0, 0.07)):
        loop.see_at(now, POP, (0, 0), (0.01 + speed, 0.02))
        learn_from_hits(loop.table, loop.memory, OPTIONS, K, now)
        if now < 11.0:
            assert not loop.hit[0]["is_seen"]
            assert loop.gain(SNAP, 0) == pytest.approx(0.9)
    assert np.hypot(*loop.hit[0]["observed"]) == pytest.approx(0.07 / 0.08)
    assert loop.hit[0]["seen"] == 1
    assert loop.gain(SNAP, 0) == pytest.approx(0.7, abs=0.02)  # what is seen counts more than what was believed
    assert compute_gain_spread(loop.memory, OPTIONS, K, SNAP, 0) < 0.4 * before
    learned = loop.gain(SNAP, 0)
    loop.contact(CRACKLE, POP, 13.0)  # not the planned time: a disturbance
    loop.see_at(15.0, POP, (0, 0), (0.3, 0.0))
    learn_from_hits(loop.table, loop.memory, OPTIONS, K, 15.0)
    assert np.hypot(*loop.hit[0]["observed"]) == pytest.approx(0.07 / 0.08)
    assert loop.gain(SNAP, 0) == learned


def test_what_something_else_does_later_is_not_blamed_on_the_impact(loop: Loop) -> None:
    """Another object runs into this one ten seconds after the hit: no robot feels it."""
    set_fields(loop.strike[0], is_solved=True, change=0.09)
    loop.see_at(10.0, POP, (0, 0), (0.0, 0.0))
    remember_before(loop.table, loop.memory, K)
    loop.feel(SNAP, 0.1)
    loop.contact(SNAP, POP, 10.0)
    loop.see_at(12.0, POP, (0, 0), (0.07, 0.0))
    learn_from_hits(loop.table, loop.memory, OPTIONS, K, 12.0)
    learned = loop.gain(SNAP, 0)
    for now, speed in ((20.0, -0.1), (20.5, -0.1), (30.0, 0.07)):
        loop.see_at(now, POP, (0, 0), (speed, 0.0))
        learn_from_hits(loop.table, loop.memory, OPTIONS, K, now)
        assert not loop.hit[0]["is_pending"]
        assert loop.gain(SNAP, 0) == pytest.approx(learned, abs=1e-9)


def test_drift_is_not_blamed_on_the_impact(loop: Loop) -> None:
    set_fields(loop.strike[0], is_solved=True, change=0.09)
    loop.see_at(10.0, POP, (0, 0), (0.0, 0.0))
    remember_before(loop.table, loop.memory, K)
    loop.feel(SNAP, 0.1)
    loop.contact(SNAP, POP, 10.0)
    flight = 2.0 + loop.table.period  # from the last look before the contact
    loop.see_at(12.0, POP, (0, 0), (0.09 + flight * 1e-3, flight * 5e-3))
    loop.memory.filter[K, POP]["drift"] = 1e-3, 5e-3
    learn_from_hits(loop.table, loop.memory, OPTIONS, K, 12.0)
    assert loop.gain(SNAP, 0) == pytest.approx(0.9, abs=1e-6)
    assert loop.hit[0]["before"][0] == 0.0


def test_variants_without_learning_keep_what_is_believed(loop: Loop) -> None:
    set_fields(loop.strike[0], is_solved=True, change=0.09, normal=(1.0, 0.0))
    loop.feel(SNAP, 0.1)
    loop.contact(SNAP, POP, 10.0)
    loop.see_at(12.0, POP, (0, 0), (0.05, 0.0))
    learn_from_hits(loop.table, loop.memory, make_record(VARIANTS["paper_expert"])[0], K, 12.0)
    assert loop.gain(SNAP, 0) == pytest.approx(0.9, abs=1e-12)
    assert np.hypot(*loop.hit[0]["observed"]) == pytest.approx(0.05 / 0.09)  # it is seen all the same, for learners


def test_desired_velocity_leads_to_the_target_under_drift() -> None:
    position, target, drift, L = np.array([1.0, 2.0]), np.array([2.0, 1.5]), np.array([5e-4, -1e-3]), 20.0
    velocity = np.array(compute_desired_velocity(*position, *target, L, *drift, 0.3))
    np.testing.assert_allclose(position + L * velocity + drift * L * L / 2, target, atol=1e-13)
    fast = np.array(compute_desired_velocity(*position, *target, 1.0, *drift, 0.3))
    assert np.abs(fast).max() == pytest.approx(0.3)
    assert fast[0] / fast[1] == pytest.approx((1.0 - 2.5e-4) / (-0.5 + 5e-4))  # the direction stays


def test_aims_at_the_next_knot(loop: Loop) -> None:
    loop.see_at(2.0, POP, (0.5, 1.0), (0.01, 0.0))
    wish = np.array(choose_desired_velocity(loop.table, loop.memory, OPTIONS, K, 0))
    np.testing.assert_allclose(wish, ([3.0, 0.0] - np.array([0.58, 1.0])) / 20.0, atol=1e-12)


GOAL = "G[100,100] (pop.x >= 4 & pop.x <= 10 & pop.y >= -3 & pop.y <= 3)"  # the plan's end (7, 0) is 3 m deep


def last_aim(
    now: float, time: float, position: tuple[float, float], options: Options = EXPERT, speed: float = 0.0
) -> np.ndarray:
    """Return where the object ends after its last impact at a time, which finds it at a position, flying along x."""
    scenario = make_scenario(GOAL)
    loop = Loop(scenario, make_plan(scenario, (10, "snap", "pop")), options)
    assert loop.table.knot[1]["depth"] == 3.0
    loop.see_at(now, POP, (position[0] - speed * (time - now), position[1]), (speed, 0.0))
    set_time(loop.table, loop.memory, K, 0, 0, time)
    wish = np.array(choose_desired_velocity(loop.table, loop.memory, make_record(options)[0], K, 0))
    return np.array(position) + (HORIZON - time) * wish


def test_last_impact_goes_to_the_end_where_there_is_time() -> None:
    np.testing.assert_allclose(last_aim(10.0, 20.0, (1.0, 1.0)), [7.0, 0.0], atol=1e-9)


def test_last_impact_is_gentle_where_there_is_little_time() -> None:
    """It goes just deep enough; the paper's goes all the way and so faster."""
    end = last_aim(90.0, 94.0, (5.0, 0.5))
    assert 4.0 + EXPERT.aim.deep_enough * 3.0 <= end[0] < 6.3
    paper = last_aim(90.0, 94.0, (5.0, 0.5), VARIANTS["paper_expert"])
    assert paper[0] > end[0] + 0.5


def test_last_impact_stops_the_object_where_it_is_deep_enough() -> None:
    np.testing.assert_allclose(last_aim(90.0, 94.0, (6.5, -0.2), speed=-0.05), [6.5, -0.2], atol=1e-9)


def test_share_of_the_way_that_is_deep_enough() -> None:
    scenario = make_scenario(GOAL)
    table = make_plan_table(scenario, make_plan(scenario, (10, "snap", "pop")))
    deep = EXPERT.aim.deep_enough * 3.0
    share = find_share(table, OPTIONS, 1, 3.0, 2.0, 7.0, 0.0)
    x, y = 3.0 + share * 4.0, 2.0 - share * 2.0
    assert min(x - 4.0, 3.0 - abs(y)) == pytest.approx(deep)
    assert find_share(table, OPTIONS, 1, 6.9, 0.1, 7.0, 0.0) == 0.0
    assert compute_margin(table, 1, 5.0, 1.0) == 1.0
    assert compute_margin(table, 1, 3.0, 1.0) == -1.0
    assert compute_margin(table, 0, 3.0, 1.0) == math.inf


def test_room_is_that_of_the_robot_behind_the_object() -> None:
    """To push pop along x, its robot has to stand 0.4 m before it."""
    scenario = make_scenario("G[0,100] (snap.x >= 0.3 & snap.y <= 1.5) & F[0,100] pop.x >= -9")
    loop = Loop(scenario, make_plan(scenario, (10, "snap", "pop")))
    loop.see_at(5.0, POP, (1.0, 1.0), (0.0, 0.0))
    assert compute_room(loop.table, loop.memory, K, 0, SNAP, 10.0, 0.1, 0.0) == pytest.approx(0.3)
    assert compute_room(loop.table, loop.memory, K, 0, SNAP, 10.0, 0.0, -0.1) == pytest.approx(0.1)
    assert compute_room(loop.table, loop.memory, K, 0, CRACKLE, 10.0, 0.0, -0.1) > 100.0  # only the world's walls


def test_turn_is_the_cosine_to_the_planned_normal(loop: Loop) -> None:
    loop.see_at(5.0, POP, (0.5, 1.0), (0.05, 0.0))
    for angle in (0.0, 0.5, 2.0, math.pi):
        wish = 0.05 + 0.1 * math.cos(angle), 0.1 * math.sin(angle)
        assert compute_turn(loop.table, loop.memory, K, 0, *wish) == pytest.approx(math.cos(angle))


def test_drift_makes_the_next_flight_short_enough_to_stay_near_the_straight_way(loop: Loop) -> None:
    loop.see_at(5.0, POP, (1.0, 0.0), (0.0, 0.0))
    hasten_next_knot(loop.table, loop.memory, OPTIONS, K, 0)
    assert loop.clock[1] == 30.0
    loop.memory.filter[K, POP]["drift"][1] = 0.02
    hasten_next_knot(loop.table, loop.memory, OPTIONS, K, 0)
    # a L^2 / 8 = BEND says L = 10 s; the object is 0.75 m (drift since 5 s: 0.25 m) and 2 m away from its knot
    way = math.hypot(2.0, 0.25)
    assert loop.clock[1] == pytest.approx(10.0 + max(math.sqrt(8 * EXPERT.aim.bend / 0.02), way / EXPERT.aim.cruise))
    assert loop.clock[1] < 30.0


def test_replan_leads_the_robot_behind_the_object_with_the_speed_that_is_needed(loop: Loop) -> None:
    loop.see_at(2.0, POP, (1.0, 0.5), (0.0, 0.0))
    loop.see_at(2.0, SNAP, (0.0, 0.5), (0.0, 0.0))
    replan_course(loop.table, loop.memory, OPTIONS, K, SNAP, 0, 2.0)
    wish = (np.array([3.0, 0.0]) - [1.0, 0.5]) / 20.0
    normal, factor = wish / np.linalg.norm(wish), 0.9
    strike = loop.strike[0]
    np.testing.assert_allclose(strike["contact"], np.array([1.0, 0.5]) - 0.4 * normal, atol=1e-12)
    np.testing.assert_allclose(strike["robot_minus"], np.linalg.norm(wish) / factor * normal, atol=1e-12)
    assert loop.course[SNAP]["ends_in_impact"]
    assert (loop.count("replans"), loop.count("lost")) == (1, 0)
    # A restitution that was learned changes the approach, not the aim.
    loop.memory.pair_mean[K, NOW, find_row(loop.memory, SNAP, 0)] = 0.4
    replan_course(loop.table, loop.memory, OPTIONS, K, SNAP, 0, 2.0)
    np.testing.assert_allclose(strike["robot_minus"], np.linalg.norm(wish) / 0.7 * normal, atol=1e-12)


@pytest.mark.parametrize(
    ("speed", "steady"),
    [
        (0.01, REPLANNING.steady),
        (0.02, REPLANNING.steady_way / 0.02 - REPLANNING.quick),
        (0.1, 0.0),
    ],
)
def test_gentle_hit_comes_at_constant_speed(loop: Loop, speed: float, steady: float) -> None:
    """The object rests so far from its next place that it needs 0.9 times that approach speed."""
    loop.see_at(2.0, POP, (3.0 - 0.9 * speed * 20.0, 0.0), (0.0, 0.0))
    loop.see_at(2.0, SNAP, (0.0, 0.5), (0.0, 0.0))  # where its plan rests
    replan_course(loop.table, loop.memory, OPTIONS, K, SNAP, 0, 2.0)
    course, contact = loop.course[SNAP], loop.strike[0]["contact"]
    assert loop.count("lost") == 0
    assert course["until"] == pytest.approx(10.0 - steady)
    for ahead in np.linspace(0.0, steady, 5):
        motion = evaluate_course(course, loop.table.breaks, loop.table.coefficients, SNAP, 10.0 - ahead)
        np.testing.assert_allclose(motion[:4], [contact[0] - ahead * speed, contact[1], speed, 0.0], atol=1e-9)


def test_robot_that_was_lost_starts_from_where_it_is(loop: Loop) -> None:
    loop.see_at(2.0, POP, (1.0, 0.5), (0.0, 0.0))
    loop.see_at(2.0, SNAP, (0.0, 2.5), (0.01, 0.0))  # its plan rests at (0, 0.5)
    replan_course(loop.table, loop.memory, OPTIONS, K, SNAP, 0, 2.0)
    assert loop.count("lost") == 1


def test_robot_does_not_set_off_to_a_later_impact_before_an_earlier_one() -> None:
    """Crackle's next impact is on pip, although pop waits for crackle's later one."""
    scenario = make_scenario()
    loop = Loop(scenario, make_plan(scenario, (10, "crackle", "pip"), (20, "crackle", "pop")))
    workspace, actions = make_workspace(), np.zeros((3, 2, 3))
    loop.memory.time[K] = 5.0
    control_world(loop.table, loop.memory, OPTIONS, workspace, 0, K, actions)
    assert loop.strike["is_solved"].tolist() == [False, True]
    assert loop.course["ends_in_impact"].tolist() == [False, True]
    assert np.isfinite(actions[K]).all()


def test_velocity_before_a_contact_is_that_of_the_step_before(loop: Loop) -> None:
    loop.see_at(9.9, POP, (0, 0), (0.03, 0.01))
    remember_before(loop.table, loop.memory, K)
    loop.see_at(10.0, POP, (0, 0), (0.2, 0.1))
    loop.strike[0]["is_solved"] = True
    loop.contact(SNAP, POP, 10.0)
    np.testing.assert_array_equal(loop.hit[0]["latest"], [0.03, 0.01])
    np.testing.assert_array_equal(loop.hit[0]["before"], [0.03, 0.01])


def test_plan_without_impacts_is_followed_to_its_end() -> None:
    scenario = make_scenario()
    loop = Loop(scenario, make_plan(scenario))
    assert loop.indices() == [NO_IMPACT, NO_IMPACT]
    loop.miss(50.0)
    loop.contact(SNAP, POP, 50.0)
    assert (loop.count("give_up"), loop.count("unplanned_contact")) == (0, 1)

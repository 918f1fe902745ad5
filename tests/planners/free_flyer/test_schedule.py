"""Impacts come in the planned order, are decided once, missed with patience and given up at last."""

from __future__ import annotations

import math

import numpy as np
import pytest

from planners.bezier import Curve
from planners.free_flyer.schedule import RETRIES, Schedule, Strike
from planners.free_flyer.two_body import solve_two_body_impact
from planners.plan import Plan, PlannedImpact

HORIZON = 100.0
STILL = np.zeros(2)


def make_plan(*impacts: tuple[float, str, str]) -> Plan:
    """Return a plan with impacts (time, robot, object); object "pop" is at x = time."""
    zero = np.zeros(2)
    planned = tuple(
        PlannedImpact(time, robot, item, np.array([time, 0.0]), zero, np.array([1.0, 0.0]), zero, zero, zero, zero)
        for time, robot, item in impacts
    )
    robots = {robot: Curve([0.0, HORIZON], [[[0.0, 0.0]]]) for robot in ("snap", "crackle")}
    objects = {item: Curve([0.0, HORIZON], [[[0.0, 0.0], [7.0, 0.0]]]) for item in ("pop", "pip")}
    numbers = dict.fromkeys(("robustness", "bound", "gap", "effort", "solve_seconds"), 0.0)
    return Plan(
        scenario="two",
        objective="robustness",
        horizon=HORIZON,
        effort_bound=None,
        impacts=planned,
        robots=robots,
        objects=objects,
        stage_seconds={},
        validated=False,
        **numbers,
    )


@pytest.fixture
def schedule() -> Schedule:
    return Schedule(make_plan((10, "snap", "pop"), (30, "crackle", "pop"), (40, "snap", "pip"), (60, "snap", "pop")))


def coming(schedule: Schedule, robot: str) -> Strike:
    strike = schedule.strike_of(robot)
    assert strike is not None
    return strike


def test_every_object_waits_for_its_own_next_impact(schedule: Schedule) -> None:
    assert {name: strike.index for name, strike in schedule.strikes.items()} == {"pop": 0, "pip": 2}
    assert coming(schedule, "snap").index == 0
    assert schedule.strike_of("crackle") is None  # pop has to be thrown first
    assert schedule.next_impact("crackle") == (30, 30)
    assert schedule.take_contact("snap", "pop", 10.1, STILL) is not None
    assert coming(schedule, "crackle").index == 1
    assert coming(schedule, "snap").index == 2
    schedule.take_contact("crackle", "pop", 30.0, STILL)
    assert schedule.next_impact("crackle") == (HORIZON, HORIZON)
    schedule.take_contact("snap", "pip", 40.0, STILL)
    assert not schedule.is_last(Strike(schedule.plan.impacts[1], 1, 30.0))
    assert schedule.is_last(coming(schedule, "snap"))


def test_target_is_the_next_knot_or_the_end(schedule: Schedule) -> None:
    position, time = schedule.target(schedule.strikes["pop"])
    np.testing.assert_array_equal(position, [30.0, 0.0])
    assert time == 30.0
    position, time = schedule.target(schedule.strikes["pip"])
    np.testing.assert_array_equal(position, [7.0, 0.0])
    assert time == HORIZON


def test_contacts_that_are_none_of_the_plan(schedule: Schedule) -> None:
    assert schedule.take_contact("crackle", "pop", 10.0, STILL) is None  # wrong robot
    assert schedule.take_contact("snap", "", 10.0, STILL) is None  # a wall
    assert schedule.take_contact("snap", "crackle", 10.0, STILL) is None
    assert schedule.take_contact("snap", "pop", 5.0, STILL) is None  # far too early
    assert schedule.strikes["pop"].index == 0
    assert schedule.last_contact == {"pop": 5.0, "pip": -math.inf}


def test_replans_every_half_second_in_the_window(schedule: Schedule) -> None:
    schedule.take_contact("snap", "pop", 10.0, STILL)
    strike, times = coming(schedule, "crackle"), []
    for k in range(350):
        now = 0.1 * k
        if now >= 10.0 and schedule.should_replan(strike, now):
            strike.replanned = now
            times.append(now)
    np.testing.assert_allclose(np.diff(times), 0.5)
    assert times[0] == pytest.approx(11.5)  # 20 s before the impact would be earlier: the object has to settle
    assert 28.5 < times[-1] <= 29.0 + 1e-6


def test_correction_is_due_once_per_impact(schedule: Schedule) -> None:
    assert schedule.find_due(1.9) is None
    strike = schedule.find_due(2.0)
    assert strike is schedule.strikes["pop"]
    strike.decided = True
    assert schedule.find_due(9.0) is None
    schedule.take_contact("snap", "pop", 21.0, STILL)  # late
    assert schedule.find_due(23.4) is None  # 22 s, but the object is not yet seen well
    assert schedule.find_due(23.5) is schedule.strikes["pop"]


def test_late_impact_leaves_notice_for_the_next_one(schedule: Schedule) -> None:
    schedule.take_contact("snap", "pop", 29.0, STILL)
    assert schedule.strikes["pop"].time == pytest.approx(33.0)


def test_missed_impact_is_tried_again_then_given_up(schedule: Schedule) -> None:
    now = 10.0
    for k in range(RETRIES):
        assert schedule.take_misses(now + 1.4) == []
        ((strike, again),) = schedule.take_misses(now + 1.6)
        assert again
        assert strike.misses == k + 1
        now += 1.6 + 5.0
        assert strike.time == pytest.approx(now)
    ((_, again),) = schedule.take_misses(now + 1.6)
    assert not again
    assert schedule.strikes["pop"].index == 1


def test_needless_impact_is_not_tried_again(schedule: Schedule) -> None:
    same = (0.1, 0.0)
    schedule.strikes["pop"].solution = solve_two_body_impact(
        (0.0, 0.0), same, same, same, (1.0, 0.0), 1.0, 1.0, 0.8, 0.4, 0.3
    )
    assert schedule.take_misses(11.6)[0][1] is False


def test_no_second_try_after_the_horizon() -> None:
    schedule = Schedule(make_plan((95.0, "snap", "pop")))
    assert schedule.take_misses(97.0)[0][1] is False
    assert schedule.strikes == {}


def test_observed_ratio_waits_for_the_velocity_and_ends_with_the_next_contact(schedule: Schedule) -> None:
    schedule.strikes["pop"].solution = solve_two_body_impact(
        (0.0, 0.0), (0.0, 0.0), (0.1, 0.0), (0.0, 0.0), (1.0, 0.0), 1.0, 1.0, 0.8, 0.4, 0.3
    )
    schedule.take_contact("snap", "pop", 10.0, STILL)
    for now, speed in ((10.9, 0.5), (11.0, 0.07), (12.0, 0.08)):
        schedule.observe_hits({"pop": np.array([speed, 0.0])}, now)
        assert schedule.ratios("pop") == ([] if now < 11.0 else [pytest.approx(speed / 0.1)])
    schedule.take_contact("crackle", "pop", 13.0, STILL)  # not the planned time: a disturbance
    schedule.observe_hits({"pop": np.array([0.3, 0.0])}, 15.0)
    assert schedule.ratios("pop") == [pytest.approx(0.8)]
    assert schedule.ratios("pip") == []

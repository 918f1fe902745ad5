"""In which order attempts are made, what brief ones leave open, and tasks that only they give time for."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.scenario import build_scenario
from planners.budget import Budget, Clock, use_clock, watch_planning
from planners.errors import Infeasible, SolverFailed
from planners.free_flyer.nominal.event_grid import build_event_grid
from planners.free_flyer.nominal.ladder import list_attempts
from planners.free_flyer.nominal.planner import make_free_flyer_plan
from planners.free_flyer.nominal.robustness import maximise_robustness
from planners.free_flyer.nominal.task import NominalTask, PlanOptions
from planners.free_flyer.nominal.verdict import Trial
from planners.free_flyer.reserves import Reserves
from planners.free_flyer.specification.requirement import read_demands
from planners.mixed_integer import evaluate
from tests.planners.free_flyer.plans import load

UNDECIDED = SolverFailed("robustness", "undecided", "raise the time limit")
PROOF = Infeasible("robustness", "no plan", "allow more impacts")


def _body(start: tuple[float, float], **more: Any) -> dict[str, Any]:
    return {"start": start, "mass": 16.8, "inertia": 0.336, "radius": 0.2, "speed_limit": 0.3} | more


def _robot(start: tuple[float, float], thrust: float) -> dict[str, Any]:
    return _body(start, force_limit=thrust, torque_limit=0.5)


def _box(x: float, y: float) -> dict[str, Any]:
    return {"lower": (x - 0.5, y - 0.5), "upper": (x + 0.5, y + 0.5)}


def make_patrol() -> FreeFlyerScenario:
    """A box is to be in both of two areas again and again, for which two robots throw it to each other."""
    data = {
        "domain": "free_flyer",
        "formula": "G[0,60] (F[0,40] box in A & F[0,40] box in B)",
        "horizon": 100.0,
        "control_period": 0.1,
        "world": {"lower": (0.0, 0.0), "upper": (6.0, 3.0)},
        "robots": {"ann": _robot((0.6, 1.5), 1.5), "bob": _robot((5.4, 1.5), 1.5)},
        "objects": {"box": _body((2.0, 1.5))},
        "regions": {"A": _box(2.0, 1.5), "B": _box(4.0, 1.5)},
        "believed": {"restitution": 0.8},
    }
    scenario = build_scenario(data, source="patrol")
    assert isinstance(scenario, FreeFlyerScenario)
    return scenario


def make_dock() -> FreeFlyerScenario:
    """One robot throws a ball from beside it, overtakes it and stops it."""
    data = {
        "domain": "free_flyer",
        "formula": "F[0,18] ball in dock",
        "horizon": 60.0,
        "control_period": 0.1,
        "world": {"lower": (0.0, 0.0), "upper": (8.0, 4.0)},
        "robots": {"ann": _robot((1.55, 2.0), 3.0)},
        "objects": {"ball": _body((2.0, 2.0))},
        "regions": {"dock": _box(5.5, 2.0)},
        "believed": {"restitution": 0.8},
    }
    scenario = build_scenario(data, source="dock")
    assert isinstance(scenario, FreeFlyerScenario)
    return scenario


def make_task(scenario: FreeFlyerScenario) -> NominalTask:
    return NominalTask(scenario, read_demands(scenario, Reserves().wall), Reserves())


def test_one_object_is_tried_briefly_with_all_reserves_before_longer() -> None:
    trials: list[Trial] = []
    made = []
    for attempt in list_attempts(make_task(load("throw_and_catch")), PlanOptions(), trials):
        made.append((attempt.brief, attempt.halvings, attempt.pieces))
        trials.append(Trial(attempt, UNDECIDED, rho=0.1))
    brief, full = [(True, k, (1, 2)) for k in range(3)], [(False, k, (1, 2)) for k in range(3)]
    slanted = [(True, k, (2, 3)) for k in (2, 1, 0)]
    assert made[:9] == [*brief, *slanted, *full]
    assert not any(one[0] for one in made[9:])


def test_what_a_brief_attempt_has_proven_is_not_tried_again() -> None:
    trials: list[Trial] = []
    made = []
    for attempt in list_attempts(make_task(load("throw_and_catch")), PlanOptions(), trials):
        made.append((attempt.brief, attempt.halvings, attempt.pieces))
        trials.append(Trial(attempt, PROOF if attempt.brief and not attempt.halvings else UNDECIDED))
    assert (True, 0, (1, 2)) in made
    assert (False, 0, (1, 2)) not in made
    assert (False, 1, (1, 2)) in made


def test_robots_that_are_faster_later_come_after_less_reserves_of_several_objects() -> None:
    trials: list[Trial] = []
    made = []
    for attempt in list_attempts(make_task(load("exchange")), PlanOptions(), trials):
        made.append(attempt)
        trials.append(Trial(attempt, UNDECIDED))
    simple = [(attempt.brief, attempt.halvings, attempt.brisk) for attempt in made if attempt.simple]
    assert simple[:6] == [(brief, halvings, False) for brief in (True, False) for halvings in range(3)]
    assert all(brisk for _, _, brisk in simple[6:])


def test_numbers_of_impacts_that_a_few_pauses_leave_open_are_no_proof() -> None:
    """No plan has two impacts or fewer; three have plans, which the solver needs some 2,000 pauses to tell."""
    task, options = make_task(make_patrol()), PlanOptions(pieces=(1,), pauses=0)
    with pytest.raises(Infeasible):
        maximise_robustness(task, 2, Budget(60.0), options)
    with pytest.raises(SolverFailed, match="undecided after 0 pauses"):
        maximise_robustness(task, 3, Budget(60.0), options)


def test_a_limit_that_is_not_reached_changes_nothing() -> None:
    task, options = make_task(load("throw_and_catch")), PlanOptions()
    free = maximise_robustness(task, 4, Budget(60.0), options)
    limited = maximise_robustness(task, 4, Budget(60.0), replace(options, pauses=options.brief_pauses))
    assert free.complete
    assert limited.complete
    assert (limited.rho, limited.size, limited.bound) == (free.rho, free.size, free.bound)
    assert free.events is not None
    assert limited.events is not None
    np.testing.assert_array_equal(limited.events.sequence.times, free.events.sequence.times)


@pytest.mark.slow
def test_a_patrol_is_planned() -> None:
    with use_clock(Clock(time.process_time)):
        plan = make_free_flyer_plan(make_patrol())
    assert plan.validated
    assert plan.robustness >= 0.3  # of 0.5
    assert [impact.robot for impact in plan.impacts] == ["ann", "bob", "ann", "bob"]


@pytest.mark.slow
def test_a_ball_that_has_to_be_overtaken_within_a_tight_deadline_is_planned() -> None:
    with use_clock(Clock(time.process_time)):
        plan = make_free_flyer_plan(make_dock())
    assert plan.validated
    assert plan.robustness > 0.03  # of 0.5, for the run-up takes time that the grid does not know of


@pytest.mark.slow
def test_impacts_without_smooth_motions_become_a_plan_of_less_reserves_once_planning_is_interrupted() -> None:
    """With three impacts and all reserves the patrol has no smooth motions that a few seconds find."""
    clock = Clock(time.process_time)
    stopped: list[float] = []

    def tell(budget: Budget, stage: str | None) -> None:
        if stage == "smoothing" and not stopped:
            stopped.append(time.process_time())
            clock.stop()

    with use_clock(clock), watch_planning(tell):
        plan = make_free_flyer_plan(make_patrol(), max_impacts=3)
    assert plan.validated
    assert len(plan.impacts) == 3
    assert time.process_time() - stopped[0] < 20.0


@pytest.mark.slow
def test_a_robot_throws_an_object_stops_it_and_is_back_in_time() -> None:
    """Pieces of equal length leave it too late: it must be out of the object's way before it goes back."""
    task = make_dock().override(
        {
            "formula": "G[50,60] ann in left & F[0,60] ball in right",
            "robots.ann.start": (1.0, 1.0),
            "robots.ann.force_limit": 1.5,
            "objects.ball.start": (3.0, 2.0),
            "regions": {"left": _box(1.0, 1.0), "right": _box(6.5, 2.0)},
        }
    )
    with use_clock(Clock(time.process_time)):
        plan = make_free_flyer_plan(task)
    assert plan.validated
    assert plan.robustness > 0.1


def test_legs_beside_a_resting_object_may_have_pieces_of_different_lengths() -> None:
    task = make_task(make_dock().override({"formula": "G[55,60] ann in dock"}))
    grid = build_event_grid(task.scenario, 2, (1e-3, 0.5), task.reserves, pieces=3, free=True)
    steps = np.diff(evaluate(grid.times, np.sqrt(np.arange(len(grid.model.lower), dtype=float))))
    assert np.ptp(steps[:3]) > 0.1  # any numbers tell which times are variables of their own
    assert np.ptp(steps[6:]) > 0.1
    np.testing.assert_allclose(steps[3:6], steps[3])

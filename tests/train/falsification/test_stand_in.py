"""A stand-in searches; what is reported are failures of the policy itself."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from impact_envs.errors import InputError
from planners.free_flyer.closed_loop.planning_process import PlanningProcesses
from planners.plan import Plan
from tests.train.falsification.test_break import TUNING, Hill
from train.evaluation.case import make_case
from train.falsification.arena import Arena
from train.falsification.counterexample import find_counterexamples
from train.falsification.search import SearchOptions, search_failures
from train.falsification.stand_in import ReplayOptions, make_stand_in, replay_failures

PONG = Plan.load(Path(__file__).parents[2] / "frozen" / "plans" / "pong.json")
KEPT = {"expert.plan_anew": False}


def test_only_failures_of_the_policy_itself_are_found():
    """It is a little better than its stand-in, so the mildest worlds in which that fails are none of its own."""
    policy, stand_in = Hill(least=1.2), Hill(least=1.0)
    played = search_failures(stand_in, 0, SearchOptions("random", episodes=640))
    own = replay_failures(policy, stand_in, played, 1, ReplayOptions(each=200))
    assert 0 < np.sum(~own.success) < len(own.success)
    assert not own.success[(own.places[:, :2].sum(axis=1) > 1.2)].any()
    (one,) = find_counterexamples(policy, own, 1, np.arange(4))
    assert one.robustness == pytest.approx(1.2 - one.places[:2].sum())
    assert -0.05 < one.robustness < 0.0  # as mild as the policy itself still fails


def test_a_policy_that_never_fails_has_no_counterexamples():
    policy, stand_in = Hill(least=3.0), Hill(least=1.0)
    played = search_failures(stand_in, 0, SearchOptions("random", episodes=640))
    own = replay_failures(policy, stand_in, played, 3)
    assert own.success.all()
    assert find_counterexamples(policy, own, 3, np.arange(4)) == []
    nothing = replay_failures(policy, policy, search_failures(policy, 0, SearchOptions("random", episodes=64)), 3)
    assert len(nothing.success) == 0


def test_without_a_new_plan_the_episode_is_the_stand_ins_bit_for_bit(monkeypatch):
    """Of the eight one asks for one: no process answers here, and what it would have said is "no plan"."""
    asked = []
    monkeypatch.setattr(PlanningProcesses, "ask", lambda self, number, question: asked.append(number))
    answer = {"plan": None, "failure": "no_plan"}
    monkeypatch.setattr(PlanningProcesses, "wait_for", lambda self, number: answer)
    case = replace(make_case("pong", "hard"), plan=PONG)
    arena = Arena(case, "expert", 8)
    places, seeds = np.random.default_rng(1).random((8, len(arena.names))), TUNING + np.arange(8)
    stand_in = Arena(make_stand_in(case, "expert", KEPT), "expert", 8)
    own, cheap = (one.play(places, seeds) for one in (arena, stand_in))
    arena.close()
    stand_in.close()
    assert asked
    np.testing.assert_array_equal(own.robustness, cheap.robustness)


@pytest.mark.parametrize(
    ("policy", "settings", "words"),
    [
        ("expert", {"true.restitution": 0.5}, "--stand-in true.restitution"),
        ("expert", {"expert.plan_anwe": False}, "plan_anew"),
        ("zero", KEPT, "has no expert"),
    ],
)
def test_what_is_no_stand_in_is_refused(policy, settings, words):
    with pytest.raises(InputError, match=words):
        make_stand_in(make_case("pong", "hard"), policy, settings)

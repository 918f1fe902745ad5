"""Episodes are what they were: numbers everywhere, every bit with the recorded libraries, of plans on one processor."""

import copy
import dataclasses
import time

import gymnasium
import pytest

from impact_envs import list_scenarios
from planners import make_plan
from planners.budget import Clock, use_clock
from tests.frozen.freeze import (
    find_difference,
    get_id,
    get_plan,
    is_same_system,
    label,
    list_cases,
    play,
    read,
    read_fingerprint,
)

CASES = [case for scenario in list_scenarios() for case in list_cases(scenario)]
FROZEN = read()
SAME_SYSTEM = is_same_system(FROZEN["fingerprint"])
SAME_MACHINE = FROZEN["fingerprint"] == read_fingerprint()  # plans come from solvers that look at the processor


@pytest.mark.parametrize("case", CASES, ids=lambda case: "-".join(map(str, case)))
def test_episode_is_as_it_was(case):
    name = get_id(case[0], case[2])
    assert name in FROZEN["episodes"], f"{name} is new: python -m tests.frozen.freeze"
    difference = find_difference(play(case), FROZEN["episodes"][name][label(case)], SAME_SYSTEM)
    assert difference is None, f"{name} changed; raise its version in impact_envs/__init__.py: {difference}"


def test_every_registered_id_is_frozen():
    registered = {name for name in gymnasium.registry if name.startswith("impact_envs/")}
    assert registered == {name for name in FROZEN["episodes"] if name.startswith("impact_envs/")}


def test_a_changed_bit_and_a_changed_number_are_found():
    episode = next(iter(next(iter(FROZEN["episodes"].values())).values()))
    digest, number = copy.deepcopy(episode), copy.deepcopy(episode)
    digest["digest"] = "0" + digest["digest"][1:] if digest["digest"][0] != "0" else "1" + digest["digest"][1:]
    number["numbers"][0] += 1e-6
    assert find_difference(episode, episode, True) is None
    assert "digest" in find_difference(digest, episode, True)
    assert find_difference(digest, episode, False) is None
    assert "number 0" in find_difference(number, episode, False)


@pytest.mark.parametrize("scenario", [name for name in list_scenarios() if get_plan(name, "nominal")])
def test_plan_is_as_it_was(scenario):
    # Limits of time are those of this process: other work on the machine takes nothing away.
    with use_clock(Clock(time.process_time)):
        frozen, plan = get_plan(scenario, "nominal"), make_plan(scenario)
    assert [(hit.robot, hit.object) for hit in plan.impacts] == [(hit.robot, hit.object) for hit in frozen.impacts]
    assert plan.robustness == pytest.approx(frozen.robustness, abs=1e-6)
    assert plan.bound == pytest.approx(frozen.bound, abs=1e-6)
    if SAME_MACHINE:
        timeless = {"solve_seconds": 0.0, "stage_seconds": {}}
        assert dataclasses.replace(plan, **timeless).to_json() == dataclasses.replace(frozen, **timeless).to_json()

"""One verdict for one episode: single, joint and many worlds, and the rollout say the same."""

import numpy as np
import pytest

from impact_envs import JointEnv, load_scenario, parallel_env, rollout, vector_env
from impact_envs.rollout import ZeroPolicy
from impact_envs.stl import Trace, robustness, satisfied

AT_EDGE = {"objects.pop.start": [1.0, 2.0], "regions.edge": {"lower": [1.0, 1.0], "upper": [2.0, 3.0]}}


def make(formula, **changes):
    base = load_scenario("throw_and_catch")
    return base.override({**AT_EDGE, "horizon": 5.0, "formula": formula, **changes})


def verdicts(scenario, max_cycles=None):
    """Return robustness and success as every door tells them."""
    joint = JointEnv(scenario, max_cycles=max_cycles)
    joint.reset(seed=0)
    over = False
    while not over:
        *_, over, info = joint.step(np.zeros(6))
    found = [(info["robustness"], info["success"])]
    envs = vector_env(scenario, 2, max_cycles=max_cycles, threads=1)
    envs.reset(seed=0)
    over = np.zeros(2, bool)
    while not over.any():
        *_, over, infos = envs.step(np.zeros((2, 6)))
    found += zip(infos["robustness"].tolist(), infos["success"].tolist(), strict=True)
    env = parallel_env(scenario, max_cycles=max_cycles)
    episode = rollout(env, ZeroPolicy(env), 0)
    found.append((episode.robustness, episode.success))
    assert isinstance(episode.success, bool)
    return found, episode


@pytest.mark.parametrize(
    ("formula", "value", "success"),
    [
        ("G[0,5] pop.x <= 1", 0.0, True),
        ("G[0,5] pop.x < 1", 0.0, False),
        ("G[0,5] pop.x >= 1", 0.0, True),
        ("G[0,5] pop.x > 1", 0.0, False),
        ("G[0,5] not pop.x > 1", 0.0, True),
        ("G[0,5] speed(pop) <= 0", 0.0, True),
        ("G[0,5] speed(pop) < 0", 0.0, False),
        ("F[0,5] pop in edge", 0.0, True),
        ("G[0,5] pop not in edge", 0.0, False),
        ("F[0,3] G[0,2] pop.x <= 1", 0.0, True),
        ("F[0,3] G[0,2] pop.x < 1", 0.0, False),
        ("pop.x <= 1 U[0,5] pop.x >= 1", 0.0, True),
        ("pop.x < 1 U[0,5] pop.x >= 1", 0.0, False),
        ("G[0,5] (pop.x < 1 | pop.x >= 1)", 0.0, True),
        ("G[0,5] (pop.x <= 1 & pop.x > 1)", 0.0, False),
        ("G[0,5] 1000*pop.x >= 100", 900.0, True),
        ("G[0,5] 1000*pop.x <= 100", -900.0, False),
    ],
)
def test_every_door_tells_one_verdict(formula, value, success):
    scenario = make(formula)
    found, episode = verdicts(scenario)
    assert found == [(value, success)] * len(found)
    trace = Trace(episode.signals, episode.period, scenario.areas, scenario.bodies)
    assert float(robustness(scenario.specification, trace)) == value
    assert bool(satisfied(scenario.specification, trace)) is success
    assert not any(np.signbit(each) and each == 0 for each, _ in found)


@pytest.mark.parametrize(
    ("formula", "value", "success"),
    [
        ("F[0,5] pop.x >= 1", 0.0, True),  # certain from the first sample
        ("F[0,5] pop.x > 1", 0.0, False),  # never, as long as it rests; not certain either
        ("G[0,5] pop.x <= 1", None, False),  # it may still go wrong
        ("F[0,5] 1000*pop.x >= 100", 900.0, True),
    ],
)
def test_cut_episodes_say_what_is_certain(formula, value, success):
    found, _ = verdicts(make(formula), max_cycles=3)
    assert found == [found[0]] * len(found)
    assert found[0][1] is success
    assert found[0][0] < 0 if value is None else found[0][0] == value


def test_nothing_known_is_minus_the_diagonal():
    scenario = make("G[0,5] speed(pop) <= 0.1")
    found, _ = verdicts(scenario, max_cycles=3)
    assert found == [(-scenario.world.diagonal, False)] * len(found)

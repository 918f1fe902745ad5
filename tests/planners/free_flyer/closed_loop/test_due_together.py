"""Two objects whose corrections are due in the same control period both get theirs, one after the other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from agents import ResidualEnv, ResidualPolicy
from impact_envs import parallel_env, rollout
from impact_envs.errors import InputError
from impact_envs.free_flyer.schema import FreeFlyerScenario
from planners.free_flyer.belief.options import EXPERT
from planners.free_flyer.expert import FreeFlyerExpert
from planners.plan import Plan
from tests.planners.free_flyer.plans import load_open, make_straight_plan

SEED = 1_000_000
HIT = 20.0  # of both objects [s]
DUE = HIT - EXPERT.timing.decision_lead  # [s]


@pytest.fixture(scope="module")
def world() -> FreeFlyerScenario:
    starts = {"snap": (-2.0, 2.0), "crackle": (-2.0, -2.0)}
    scenario = load_open("F[0,40] pop.x >= 0.5", {"pop": (0.0, 2.0), "plop": (0.0, -2.0)}, horizon=40.0)
    return scenario.override({f"robots.{name}.{key}": at for name, at in starts.items() for key in ("start", "goal")})


@pytest.fixture(scope="module")
def plan(world: FreeFlyerScenario) -> Plan:
    """Both objects are pushed along x at the same time."""
    hits = [(HIT, "snap", "pop", (0.0, 2.0)), (HIT, "crackle", "plop", (0.0, -2.0))]
    later = [(35.0, "snap", "pop", (1.5, 2.0)), (36.0, "crackle", "plop", (1.5, -2.0))]
    return make_straight_plan(world, [*hits, *later])


def run_until_due(world: FreeFlyerScenario, expert: FreeFlyerExpert) -> None:
    """Play without any correction up to and including the observation in which the first is due."""
    env = parallel_env(world)
    observations, _ = env.reset(seed=SEED)
    expert.reset(SEED)
    expert.observe(observations)
    while not expert.awaiting_correction:
        observations, *_ = env.step(expert.control())
        expert.observe(observations)


def test_both_are_asked_for_and_both_take_effect(world: FreeFlyerScenario, plan: Plan) -> None:
    expert = FreeFlyerExpert(world, plan, options=replace(EXPERT, filter=False))
    run_until_due(world, expert)
    assert expert.memory.time[0] == pytest.approx(DUE)
    strikes, seen = expert.memory.strike[0], []
    for correction in ((0.5, -0.25, 0.0), (-1.0, 0.75, 0.0)):
        assert expert.awaiting_correction
        seen.append(expert.features())
        expert.correct(np.array(correction))
    assert not expert.awaiting_correction
    with pytest.raises(InputError, match="no correction is awaited now"):
        expert.correct(np.zeros(3))
    assert [tuple(pair) for pair in strikes[["scale", "turn"]].tolist()] == [(0.5, -0.25), (-1.0, 0.75)]
    assert [int(np.argmax(features[:6])) for features in seen] == [0, 1]  # the impacts of the plan
    expert.control()
    assert strikes["is_decided"].all()
    assert not expert.awaiting_correction


def test_one_answer_leaves_the_other_at_zero(world: FreeFlyerScenario, plan: Plan) -> None:
    expert = FreeFlyerExpert(world, plan)
    run_until_due(world, expert)
    expert.correct(np.array([0.5, 0.5, 0.5]))
    expert.control()
    assert not expert.awaiting_correction
    strikes = expert.memory.strike[0]
    assert strikes["is_decided"].all()
    assert strikes["scale"].tolist() == [0.5, 0.0]


@pytest.mark.parametrize("answer", [0.0, np.nan])
def test_zeros_and_what_is_no_number_are_the_expert_bit_for_bit(
    world: FreeFlyerScenario, plan: Plan, answer: float
) -> None:
    env, expert = parallel_env(world), FreeFlyerExpert(world, plan)
    policy = ResidualPolicy(FreeFlyerExpert(world, plan), lambda features: np.full(3, answer))
    plain, corrected = rollout(env, expert, SEED), rollout(env, policy, SEED)
    for agent in world.agents:
        np.testing.assert_array_equal(plain.actions[agent], corrected.actions[agent])
    unanswered = corrected.fallbacks.get("no_correction", 0)
    assert unanswered == (0 if answer == 0.0 else 4)


def test_the_residual_environment_has_a_step_for_each(world: FreeFlyerScenario, plan: Plan) -> None:
    """The step between the two takes no time and earns nothing."""
    env = ResidualEnv(world, plan=plan)
    _, info = env.reset(seed=SEED)
    before, steps, over = info["control_steps"], [], False
    while not over:
        _, reward, terminated, truncated, info = env.step(np.zeros(3))
        over = terminated or truncated
        steps.append((info["control_steps"], reward))
    assert before == round(DUE / world.control_period)
    assert steps[0][0] == 0
    assert sum(length for length, _ in steps) + before == world.steps
    assert len(steps) == len(plan.impacts)

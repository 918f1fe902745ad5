"""World k of a batch acts as the expert of one world does, to rounding, over whole episodes and into the next."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from impact_envs import InputError, list_scenarios, load_scenario, parallel_env, vector_env
from impact_envs.env import ImpactEnv
from impact_envs.free_flyer.schema import FreeFlyerScenario
from planners.free_flyer.belief.options import EXPERT
from planners.free_flyer.belief.world_memory import COUNTERS
from planners.free_flyer.expert import FreeFlyerExpert
from planners.free_flyer.expert_batch import FreeFlyerExpertBatch
from planners.plan import Plan
from tests.frozen.freeze import get_plan
from tests.planners.free_flyer.plans import load

SEED = 1_000_000
TUNING = 40  # seeds
LEAST = 0.97  # share of them that succeed with everything disturbed


@cache
def plan_of(name: str) -> Plan:
    plan = get_plan(name, "nominal")
    assert plan is not None
    return plan


def start(env: ImpactEnv, expert: FreeFlyerExpert, seed: int | None) -> dict[str, np.ndarray]:
    expert.reset(0)
    return env.reset(seed=seed)[0]


def flatten(scenario: FreeFlyerScenario, actions: dict[str, np.ndarray]) -> np.ndarray:
    return np.concatenate([actions[name] for name in scenario.agents])


@pytest.mark.parametrize(
    ("name", "suite", "steps"),
    [
        ("throw_and_catch", "nominal", 300),
        ("throw_and_catch", "all", 300),
        ("pong", "nominal", 350),
        ("pong", "all", 350),
    ],
)
def test_single_and_batch_agree(name: str, suite: str, steps: int) -> None:
    world, plan, count = load(name).suite(suite), plan_of(name), 3
    vector, batch = vector_env(world, num_envs=count, threads=1), FreeFlyerExpertBatch(world, plan, count)
    pairs = [(parallel_env(world), FreeFlyerExpert(world, plan)) for _ in range(count)]
    seen = [start(env, expert, SEED + k) for k, (env, expert) in enumerate(pairs)]
    joint, _ = vector.reset(seed=SEED)
    for _ in range(steps):
        actions = batch.act(joint)
        for k, (env, expert) in enumerate(pairs):
            alone = expert.act(seen[k])
            np.testing.assert_allclose(actions[k], flatten(world, alone), rtol=0, atol=1e-9)
            seen[k] = env.step(alone)[0]
        joint = vector.step(actions)[0]
    for k, (_, expert) in enumerate(pairs):
        assert [int(batch.counts[counter][k]) for counter in COUNTERS] == list(expert.memory.counts[0].tolist())
    assert all(count > 0 for count in batch.counts["replans"])


@pytest.mark.parametrize(("name", "suite"), [("pong", "all"), ("exchange", "nominal")])
def test_corrections_of_a_batch_are_those_of_single_experts(name: str, suite: str) -> None:
    """Features, actions and when a correction is due, bit for bit; two objects may be due in one period."""
    world, plan, count = load(name).suite(suite), plan_of(name), 3
    vector, batch = vector_env(world, num_envs=count, threads=1), FreeFlyerExpertBatch(world, plan, count)
    pairs = [(parallel_env(world), FreeFlyerExpert(world, plan)) for _ in range(count)]
    seen = [start(env, expert, SEED + k) for k, (env, expert) in enumerate(pairs)]
    joint, rng, answered = vector.reset(seed=SEED)[0], np.random.default_rng(0), 0
    for _ in range(420):  # corrections put impacts off
        due = batch.observe(joint)
        for (_, expert), observations in zip(pairs, seen, strict=True):
            expert.observe(observations)
        while due.any():
            features, corrections = batch.features(), rng.uniform(-1.0, 1.0, (count, 3))
            for k in np.flatnonzero(due).tolist():
                np.testing.assert_array_equal(features[k], pairs[k][1].features())
                pairs[k][1].correct(corrections[k])
            answered += int(due.sum())
            due = batch.correct(due, corrections[due])
            assert [expert.awaiting_correction for _, expert in pairs] == due.tolist()
        actions = batch.control()
        for k, (env, expert) in enumerate(pairs):
            alone = expert.control()
            np.testing.assert_array_equal(actions[k], flatten(world, alone))
            seen[k] = env.step(alone)[0]
        joint = vector.step(actions)[0]
    assert answered >= 2 * count


def test_corrections_nobody_awaits_are_refused() -> None:
    world, plan = load("throw_and_catch"), plan_of("throw_and_catch")
    batch, vector = FreeFlyerExpertBatch(world, plan, 2), vector_env(world, num_envs=2, threads=1)
    joint, both = vector.reset(seed=SEED)[0], np.ones(2, bool)
    while not batch.observe(joint).any():
        joint = vector.step(batch.control())[0]
    for corrections, words in (
        (np.zeros(3), r"corrections of shape \(3,\): finite numbers of shape \(2, 3\) are needed"),
        (np.full((2, 3), np.inf), r"correction of world 0 must be 3 finite numbers, got \[inf inf inf\]"),
    ):
        with pytest.raises(InputError, match=words):
            batch.correct(both, corrections)
    batch.control()
    with pytest.raises(InputError, match="world 0 awaits no correction now"):
        batch.correct(both, np.zeros((2, 3)))


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_agrees_after_an_autoreset(mode: str) -> None:
    """Episodes are cut at 12 s, just after the throw; the second one starts with nothing remembered."""
    world, plan, cycles = load("throw_and_catch").suite("all"), plan_of("throw_and_catch"), 120
    vector = vector_env(world, num_envs=2, threads=1, max_cycles=cycles, autoreset_mode=mode)
    batch, env = FreeFlyerExpertBatch(world, plan, 2), parallel_env(world, max_cycles=cycles)
    expert = FreeFlyerExpert(world, plan)
    joint, _ = vector.reset(seed=SEED)
    for seed in (SEED + 1, None):  # the generator goes on
        seen = start(env, expert, seed)
        for _ in range(cycles):
            actions, alone = batch.act(joint), expert.act(seen)
            np.testing.assert_allclose(actions[1], flatten(world, alone), rtol=0, atol=1e-9)
            seen, (joint, *_) = env.step(alone)[0], vector.step(actions)
        if mode == "NextStep":
            joint = vector.step(batch.act(joint))[0]  # this one only starts the next episode


def test_threads_change_nothing() -> None:
    world, plan, count = load("throw_and_catch").suite("all"), plan_of("throw_and_catch"), 5
    one, two = (FreeFlyerExpertBatch(world, plan, count, threads=threads) for threads in (1, 2))
    vector = vector_env(world, num_envs=count, threads=1)
    joint, _ = vector.reset(seed=SEED)
    for _ in range(250):
        actions = one.act(joint)
        np.testing.assert_array_equal(two.act(joint), actions)
        joint = vector.step(actions)[0]
    for counter in COUNTERS:
        np.testing.assert_array_equal(one.counts[counter], two.counts[counter])


def test_threads_solve_in_places_of_their_own() -> None:
    """Where limits bind, every thread needs its own scratch; more threads than worlds are not an error."""
    world, plan, count = load("throw_and_catch"), plan_of("throw_and_catch"), 7
    one, many = (FreeFlyerExpertBatch(world, plan, count, threads=threads) for threads in (1, 16))
    vector, rng = vector_env(world, num_envs=count, threads=1), np.random.default_rng(0)
    joint, _ = vector.reset(seed=SEED)
    for _ in range(30):
        joint = joint.copy()
        joint[:, :2] += rng.normal(size=(count, 2))
        np.testing.assert_array_equal(many.act(joint), one.act(joint))
        joint = vector.step(np.zeros((count, 6)))[0]


def test_worlds_do_not_know_each_other() -> None:
    world, plan = load("throw_and_catch").suite("all"), plan_of("throw_and_catch")
    first, both = FreeFlyerExpertBatch(world, plan, 1), FreeFlyerExpertBatch(world, plan, 2)
    vector = vector_env(world, num_envs=1, threads=1)
    joint, _ = vector.reset(seed=SEED)
    for _ in range(150):
        actions = first.act(joint)
        rubbish = np.full_like(joint, np.nan)
        np.testing.assert_array_equal(both.act(np.concatenate([rubbish, joint]))[1], actions[0])
        joint = vector.step(actions)[0]


@pytest.mark.slow  # worlds of float32 are compiled apart: half a minute
def test_takes_single_precision_observations() -> None:
    world, plan = load("throw_and_catch"), plan_of("throw_and_catch")
    vector = vector_env(world, num_envs=2, threads=1, dtype="float32")
    batch = FreeFlyerExpertBatch(world, plan, 2)
    joint, _ = vector.reset(seed=SEED)
    for _ in range(world.steps):
        joint, _, _, _, infos = vector.step(batch.act(joint))
    assert infos["success"].all()


@pytest.mark.parametrize("shape", [(3, 26), (2, 25), (26,)])
def test_observations_of_another_shape_are_refused_in_one_line(shape: tuple[int, ...]) -> None:
    batch = FreeFlyerExpertBatch(load("throw_and_catch"), plan_of("throw_and_catch"), 2)
    with pytest.raises(
        InputError, match=r"observations have shape \(.*\), float64; real numbers of shape \(2, 26\) are needed"
    ) as refusal:
        batch.act(np.zeros(shape))
    assert "\n" not in str(refusal.value)


def test_bad_variant_and_plan_are_refused() -> None:
    with pytest.raises(InputError, match=r"variant 'none' is unknown.*paper_expert"):
        FreeFlyerExpertBatch(load("throw_and_catch"), plan_of("throw_and_catch"), 2, "none")
    with pytest.raises(InputError, match="lasts 30 s, scenario pong lasts 100 s"):
        FreeFlyerExpertBatch(load("pong"), plan_of("throw_and_catch"), 2)


def test_variants_and_options_are_those_of_the_single_expert() -> None:
    world, plan = load("throw_and_catch").suite("restitution"), plan_of("throw_and_catch")
    vector = vector_env(world, num_envs=1, threads=1)
    joint, _ = vector.reset(seed=SEED)
    batches = [
        FreeFlyerExpertBatch(world, plan, 1, "paper_expert"),
        FreeFlyerExpertBatch(world, plan, 1, options=replace(EXPERT, tracker="lqr")),
    ]
    singles = [
        FreeFlyerExpert(world, plan, "paper_expert"),
        FreeFlyerExpert(world, plan, options=replace(EXPERT, tracker="lqr")),
    ]
    env = parallel_env(world)
    seen = env.reset(seed=SEED)[0]
    for expert in singles:
        expert.reset(SEED)
    for _ in range(150):
        actions = [batch.act(joint) for batch in batches]
        alone = [flatten(world, expert.act(seen)) for expert in singles]
        np.testing.assert_allclose(np.concatenate(actions), alone, rtol=0, atol=1e-9)
        joint, seen = (
            vector.step(actions[0])[0],
            env.step(dict(zip(world.agents, alone[0].reshape(2, 3), strict=True)))[0],
        )
    assert np.abs(alone[0] - alone[1]).max() > 1e-6


@pytest.mark.parametrize("name", [name for name in list_scenarios() if load_scenario(name).domain == "free_flyer"])
def test_nothing_is_inserted_retried_or_lost_where_the_world_is_as_believed(name: str) -> None:
    scenario, plan = load(name), plan_of(name)
    success, counts = evaluate(scenario, plan, None, 1)
    assert success == 1.0
    assert {counter for counter, number in counts.items() if number} <= {"replans", "retimed", "reoptimised", "avoided"}
    # After every impact of an object but its last one, what is left is optimised.
    assert counts["reoptimised"] == len(plan.impacts) - len({impact.object for impact in plan.impacts})


@pytest.mark.parametrize("name", ["throw_and_catch", "corridor", "pong", "obstacle_avoidance"])
def test_expert_succeeds_with_everything_disturbed(name: str) -> None:
    world, plan = load(name).suite("all"), plan_of(name)
    assert evaluate(world, plan, None, TUNING)[0] >= LEAST


@pytest.mark.parametrize("name", ["corridor", "pong"])
def test_papers_replanner_succeeds_less_often(name: str) -> None:
    world, plan = load(name).suite("all"), plan_of(name)
    assert evaluate(world, plan, "paper_expert", TUNING)[0] < LEAST - 0.3


def evaluate(world: FreeFlyerScenario, plan: Plan, variant: str | None, count: int) -> tuple[float, dict[str, int]]:
    """Return the share of successes over tuning seeds, and what was counted in all of them."""
    vector, batch = vector_env(world, num_envs=count, threads=1), FreeFlyerExpertBatch(world, plan, count, variant)
    joint, _ = vector.reset(seed=SEED)
    for _ in range(world.steps):
        joint, _, _, over, infos = vector.step(batch.act(joint))
    assert over.all()
    return float(infos["success"].mean()), {name: int(number.sum()) for name, number in batch.counts.items()}

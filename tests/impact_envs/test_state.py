"""What critics and oracles may see: states, and in a second form the drawn physics and what the formula remembers."""

import numpy as np
import pytest

from agents import ResidualVectorEnv
from agents.vec_env import ImpactVecEnv
from impact_envs import ResetNeeded, list_scenarios, load_scenario, parallel_env, vector_env
from impact_envs.rollout import RandomPolicy
from impact_envs.stl import parse
from impact_envs.stl.compiler import describe_parts
from tests.frozen.freeze import get_plan

SEED = 11
SUITES = ("nominal", "all", "hard")


@pytest.mark.parametrize("name", list_scenarios())
def test_every_element_of_the_state_has_a_name(name: str) -> None:
    env = parallel_env(load_scenario(name).suite("all"))
    with pytest.raises(ResetNeeded):
        env.state(secrets=True)
    env.reset(seed=SEED)
    env.step(RandomPolicy(env).act({agent: np.zeros(1) for agent in env.agents}))
    for secrets in (False, True):
        layout, state = env.state_layout(secrets), env.state(secrets)
        assert state.shape == (layout.size,)
        assert np.isfinite(state).all()
        assert len(layout.describe().splitlines()) == layout.size
    assert env.state_space.contains(env.state())
    np.testing.assert_array_equal(env.state(True)[: len(env.state())], env.state())


@pytest.mark.parametrize("name", list_scenarios())
def test_secrets_are_the_draws_of_the_seed(name: str) -> None:
    env = parallel_env(load_scenario(name).suite("all"))
    layout, found = env.state_layout(secrets=True), []
    for seed in (SEED, SEED, SEED + 1):
        env.reset(seed=seed)
        found.append(env.state(secrets=True))
    np.testing.assert_array_equal(found[0], found[1])
    drawn = np.concatenate(
        [found[0][layout[field]] != found[2][layout[field]] for field in layout.fields if "true" in field]
    )
    assert drawn.any()


@pytest.mark.parametrize("suite", SUITES)
@pytest.mark.parametrize(
    "name", ["throw_and_catch", "corridor", "exchange", "floating_manipulator_thrusters", "dual_arm_grasp"]
)
def test_world_k_of_many_knows_what_the_single_environment_does(name: str, suite: str) -> None:
    scenario, count = load_scenario(name).suite(suite), 3
    worlds, singles = vector_env(scenario, count, threads=1), [parallel_env(scenario) for _ in range(count)]
    worlds.reset(seed=SEED)
    for k, env in enumerate(singles):
        env.reset(seed=SEED + k)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (25, *worlds.action_space.shape))
    for sample in actions:
        for secrets in (False, True):
            np.testing.assert_array_equal(worlds.state(secrets), [env.state(secrets) for env in singles])
        worlds.step(sample)
        for env, row in zip(singles, sample, strict=True):
            sizes = [env.action_space(agent).shape[0] for agent in env.agents]
            env.step(dict(zip(env.agents, np.split(row, np.cumsum(sizes)[:-1]), strict=True)))
    assert worlds.state_layout(True).fields == singles[0].state_layout(True).fields


def test_what_a_formula_remembers_tells_which_goals_are_reached() -> None:
    """pong = F B & F C & G[T,T] D & ...: the whole interval says nothing of B before the end, its part does."""
    scenario = load_scenario("pong")
    names = describe_parts(scenario.specification, scenario.control_period, scenario.areas, scenario.bodies)
    env = parallel_env(scenario)
    env.reset(seed=SEED)
    layout = env.state_layout(secrets=True)
    before = env.state(secrets=True)[layout["formula so far"]].reshape(-1, 2)
    assert len(before) == len(names) >= 3
    assert all(name.startswith(("eventually[", "always[")) for name in names)
    assert (before[:, 0] <= before[:, 1]).all()
    assert env.bounds[0] <= env.bounds[1] == before[:, 1].min()


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("F[0,2] a.x >= 1 & G[0,4] a.y <= 2", ("eventually[0,2] of a.x", "always[0,4] of a.y")),
        ("not (a.x >= 0 U[1,2] a.y >= 0) | a.x >= 1", ("not until[1,2] of a.x, a.y", "at time 0, of a.x")),
    ],
)
def test_parts_are_named_by_operator_interval_and_signals(text: str, names: tuple[str, ...]) -> None:
    assert describe_parts(parse(text), 0.1, {}, ("a",)) == names


def test_sb3_and_residual_worlds_have_it_too() -> None:
    scenario = load_scenario("throw_and_catch").suite("all")
    one, envs = (
        vector_env(scenario, 2, threads=1),
        ImpactVecEnv(scenario, 2, per_robot=True, dtype="float64", threads=1),
    )
    one.reset(seed=SEED)
    envs.seed(SEED)
    envs.reset()
    np.testing.assert_array_equal(envs.state(True), np.repeat(one.state(True), 2, axis=0))
    residual = ResidualVectorEnv("throw_and_catch", 2, "all", get_plan("throw_and_catch", "all"), threads=1)
    with pytest.raises(ResetNeeded):
        residual.state()
    residual.reset(seed=SEED)
    layout = residual.state_layout(secrets=True)
    for field in layout.fields:
        if field.startswith("true"):
            np.testing.assert_array_equal(residual.state(True)[:, layout[field]], one.state(True)[:, layout[field]])

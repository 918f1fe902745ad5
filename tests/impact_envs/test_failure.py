"""A simulation that cannot go on ends its episode: named, counted, unsuccessful, with finite observations."""

import copy
import pickle

import numpy as np
import pytest

from impact_envs import load_scenario, parallel_env, rollout, vector_env
from impact_envs.interface.failure import NotFinite, TooManyEvents, check_finite
from impact_envs.rollout import ZeroPolicy

DISCS = load_scenario("throw_and_catch").override({"horizon": 5.0, "formula": "F[0,5] pop in goal"})


def lose(env, body):
    """Give a body of an environment's model an infinite speed."""
    states = env.model.state()
    states[env.scenario.bodies.index(body), 2] = np.inf
    env.model.set_state(states)


def test_the_first_body_that_is_not_finite_is_named():
    states = np.zeros((3, 6))
    check_finite(states, ("a", "b", "c"))
    states[1:, 2] = np.nan
    with pytest.raises(NotFinite, match="state of b is not finite"):
        check_finite(states, ("a", "b", "c"))


@pytest.mark.parametrize("failure", [NotFinite("b"), TooManyEvents(7), TooManyEvents(7, "b")])
def test_a_copied_failure_says_the_same(failure):
    for copied in (copy.deepcopy(failure), pickle.loads(pickle.dumps(failure))):
        assert (type(copied), str(copied)) == (type(failure), str(failure))


@pytest.mark.parametrize("scenario", [DISCS, DISCS.override({"engine": "pymunk"})], ids=["exact", "pymunk"])
def test_a_lost_body_ends_the_episode(scenario):
    env = parallel_env(scenario)
    env.reset(seed=0)
    still = {agent: np.zeros(3) for agent in env.agents}
    before, *_ = env.step(still)
    lose(env, "pop")
    observations, rewards, terminated, truncated, infos = env.step(still)
    info, lowest = infos["snap"], -scenario.world.diagonal
    assert all(terminated.values())
    assert not any(truncated.values())
    assert info["failure"] == "state of pop is not finite"
    assert (info["success"], info["robustness"], info["overflow"]) == (False, lowest, 0)
    assert all(np.isfinite(observation).all() for observation in observations.values())
    assert np.isfinite(env.state()).all()
    assert all(np.isfinite(reward) and reward < 0 for reward in rewards.values())
    assert not env.agents
    env.reset(seed=0)
    assert np.array_equal(env.step(still)[0]["snap"], before["snap"])


def test_an_episode_says_why_it_failed():
    env = parallel_env(DISCS)

    def spoil(env):
        if env.steps == 3:
            lose(env, "pop")

    episode = rollout(env, ZeroPolicy(env), 0, on_step=spoil)
    assert len(episode.times) == 5
    assert episode.failure == "state of pop is not finite"
    assert (episode.success, episode.robustness) == (False, -DISCS.world.diagonal)
    assert all(np.isfinite(values).all() for values in episode.signals.values())
    assert rollout(env, ZeroPolicy(env), 0).failure == ""


@pytest.mark.parametrize("name", ["dual_arm_grasp", "floating_manipulator_thrusters"])
def test_arms_that_are_lost_end_the_episode(name):
    env = parallel_env(name)
    env.reset(seed=0)
    if name == "dual_arm_grasp":
        env.model._worlds[0]["state"][24 + 3] = np.nan
    else:
        env.model._v[-3] = np.nan
    still = {agent: np.zeros(env.action_space(agent).shape) for agent in env.agents}
    observations, _, terminated, _, infos = env.step(still)
    agent = env.possible_agents[0]
    assert terminated[agent]
    assert infos[agent]["failure"].endswith(" is not finite")
    assert all(np.isfinite(observation).all() for observation in observations.values())


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_a_lost_world_ends_as_a_lost_environment_and_starts_again(mode):
    worlds = vector_env(DISCS, 2, autoreset_mode=mode, threads=1)
    worlds.reset(seed=0)
    env = parallel_env(DISCS)
    env.reset(seed=1)
    still = np.zeros(worlds.action_space.shape)
    worlds.step(still)
    single = {agent: np.zeros(3) for agent in env.agents}
    env.step(single)
    pop = DISCS.bodies.index("pop")
    worlds.batch._worlds.state[1, pop, 2] = np.inf
    lose(env, "pop")
    observations, rewards, terminated, truncated, infos = worlds.step(still)
    _, expected, _, _, told = env.step(single)
    assert terminated.tolist() == [False, True]
    assert not truncated.any()
    assert infos["failure"].tolist() == ["", told["snap"]["failure"]]
    assert infos["_failure"].tolist() == [False, True]
    assert (infos["robustness"][1], infos["success"][1]) == (told["snap"]["robustness"], False)
    assert rewards[1] == sum(expected.values())
    ending = infos["final_obs"] if mode == "SameStep" else observations
    assert np.array_equal(ending[1], env.task.observe_jointly(env.time, env.conjuncts))
    observations, _, terminated, *_ = worlds.step(still)
    assert np.isfinite(observations).all()
    assert not terminated.any()

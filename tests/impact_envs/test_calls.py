"""Calls out of order and wrong arguments: one line that says what was wrong, and nothing has happened."""

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import TimeAwareObservation

from agents.residual import ResidualEnv
from impact_envs import JointEnv, gym_id, load_scenario, parallel_env, vector_env
from impact_envs.errors import InputError, ResetNeeded

# One scenario of each domain.
DOMAINS = ("throw_and_catch", "floating_manipulator_thrusters", "dual_arm_grasp")
DISCS = DOMAINS[0]


def make_parallel(name):
    return parallel_env(name, render_mode="rgb_array", max_cycles=2)


def zeros(env):
    return {agent: np.zeros(env.action_space(agent).shape) for agent in env.possible_agents}


def check_line(error, kind=InputError):
    assert isinstance(error.value, kind)
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 300


@pytest.mark.parametrize("name", DOMAINS)
@pytest.mark.parametrize(
    ("call", "do"),
    [
        ("step", lambda env: env.step(zeros(env))),
        ("render", lambda env: env.render()),
        ("state", lambda env: env.state()),
        ("time", lambda env: env.time),
    ],
)
def test_calls_before_reset(name, call, do):
    with pytest.raises(gymnasium.error.ResetNeeded, match=f"^{call} before reset: call reset first$") as error:
        do(make_parallel(name))
    check_line(error)


@pytest.mark.parametrize("name", DOMAINS)
def test_after_the_end_only_a_step_is_refused(name):
    for env in (make_parallel(name), JointEnv(name, max_cycles=2, render_mode="rgb_array")):
        actions = zeros(env) if hasattr(env, "possible_agents") else np.zeros(env.action_space.shape)
        env.reset(seed=0)
        env.step(actions)
        env.step(actions)
        for wrong in (actions, {}) if isinstance(actions, dict) else (actions,):
            with pytest.raises(ResetNeeded, match=r"^step after the end of the episode: call reset first$"):
                env.step(wrong)
        assert env.render().ndim == 3
        env.reset()
        env.step(actions)


def test_many_worlds_say_the_same():
    for mode in AutoresetMode:
        envs = vector_env(DISCS, 2, autoreset_mode=mode, max_cycles=1, render_mode="rgb_array", threads=1)
        actions = np.zeros(envs.action_space.shape)
        with pytest.raises(ResetNeeded, match=r"^step before reset: call reset first$"):
            envs.step(actions)
        with pytest.raises(ResetNeeded, match=r"^render before reset: call reset first$"):
            envs.render()
        envs.reset(seed=0)
        envs.step(actions)
        if mode is AutoresetMode.DISABLED:
            with pytest.raises(ResetNeeded, match=r"^step after the end of the episode of world 0: reset it"):
                envs.step(actions)


WRONG = {
    "none": None,
    "text": "abc",
    "dict": {},
    "numbers as text": ["1", "2", "3"],
    "complex": np.zeros(3, complex),
    "ragged": [[1.0], [1.0, 2.0], 3.0],
    "nan": np.array([0.0, np.nan, 0.0]),
    "inf": np.array([0.0, 0.0, np.inf]),
    "objects": [None, None, None],
    "short": np.zeros(2),
    "scalar": 0.0,
    "empty": np.zeros(0),
    "row": np.zeros((1, 3)),
}


@pytest.mark.parametrize("name", DOMAINS)
@pytest.mark.parametrize("kind", [*WRONG, "no dict", "none at all", "missing", "unknown"])
def test_wrong_actions_leave_the_world_where_it_was(name, kind):
    env, twin = parallel_env(name), parallel_env(name)
    actions, last = zeros(env), env.possible_agents[-1]
    for each in (env, twin):
        each.reset(seed=0)
    if kind in WRONG:
        actions[last] = WRONG[kind]
    elif kind in ("no dict", "none at all"):
        actions = np.zeros(3) if kind == "no dict" else None
    elif kind == "missing":
        del actions[last]
    else:
        actions["nobody"] = np.zeros(3)
    with pytest.raises(InputError, match="action") as error:
        env.step(actions)
    check_line(error)
    assert env.time == 0.0
    for each in (env, twin):
        each.step(zeros(env))
    assert np.array_equal(env.state(), twin.state())


@pytest.mark.parametrize("name", DOMAINS)
def test_lists_and_whole_numbers_are_actions(name):
    env, twin = parallel_env(name), parallel_env(name)
    for each, kind in ((env, list), (twin, np.array)):
        each.reset(seed=0)
        each.step({agent: kind([1] * len(zero)) for agent, zero in zeros(env).items()})
    assert np.array_equal(env.state(), twin.state())


@pytest.mark.parametrize("kind", WRONG)
@pytest.mark.parametrize("name", DOMAINS)
def test_one_agent_for_all_refuses_them_too(name, kind):
    env = JointEnv(name)
    env.reset(seed=0)
    action = WRONG[kind]
    if kind in ("nan", "inf"):
        action = np.append(np.zeros(env.action_space.shape[0] - 3), action)
    with pytest.raises(InputError, match="action") as error:
        env.step(action)
    check_line(error)
    assert env.parallel.time == 0.0


@pytest.mark.parametrize("kind", WRONG)
def test_many_worlds_refuse_them_too(kind):
    envs = vector_env(DISCS, 1, threads=1)
    envs.reset(seed=0)
    action = WRONG[kind]
    if kind in ("nan", "inf", "complex"):
        action = np.append(np.zeros(3), action)[None]
    with pytest.raises(InputError, match="action") as error:
        envs.step(action)
    check_line(error)
    assert envs.batch.steps[0] == 0


@pytest.mark.parametrize("number", [0, -1, 2.5, 5.0, "5", True, np.nan, [5]])
@pytest.mark.parametrize(
    ("what", "make"),
    [
        ("max_cycles", lambda number: parallel_env(DISCS, max_cycles=number)),
        ("max_cycles", lambda number: JointEnv(DISCS, max_cycles=number)),
        ("max_cycles", lambda number: ResidualEnv(DISCS, max_cycles=number)),
        ("max_cycles", lambda number: vector_env(DISCS, max_cycles=number)),
        ("max_episode_steps", lambda number: vector_env(DISCS, max_episode_steps=number)),
        ("num_envs", lambda number: vector_env(DISCS, num_envs=number)),
        ("threads", lambda number: vector_env(DISCS, threads=number)),
    ],
)
def test_counts_are_whole_numbers_from_one(what, make, number):
    with pytest.raises(InputError, match=rf"^{what} = .*: a whole number from 1 is needed$") as error:
        make(number)
    check_line(error)


@pytest.mark.parametrize("seed", [-1, 0.5, 3.0, 2**63, 10**30, True, "1", np.int64(-1), np.nan])
def test_seeds_are_whole_numbers_from_zero(seed):
    for env in (parallel_env(DISCS), JointEnv(DISCS), vector_env(DISCS)):
        with pytest.raises(InputError, match=r"seed.* = .*: a whole number from 0 to 2\*\*63 - 1 is needed") as error:
            env.reset(seed=seed)
        check_line(error)


def test_numpy_seeds_are_seeds():
    for make in (parallel_env, JointEnv, vector_env):
        env, twin = make(load_scenario(DISCS).suite("all")), make(load_scenario(DISCS).suite("all"))
        env.reset(seed=np.int64(5))
        twin.reset(seed=5)
        states = [each.batch.states if make is vector_env else each.unwrapped for each in (env, twin)]
        if make is not vector_env:
            states = [getattr(each, "parallel", each).task._measured for each in states]
        assert np.array_equal(*states)


def test_gymnasium_finds_the_horizon_and_cuts_where_asked():
    env = TimeAwareObservation(gymnasium.make(gym_id(DISCS)))
    assert env.unwrapped.spec.max_episode_steps == load_scenario(DISCS).steps
    env.close()
    env = gymnasium.make(gym_id(DISCS), max_cycles=2)
    env.reset(seed=0)
    assert not env.step(np.zeros(6))[3]
    *_, over, info = env.step(np.zeros(6))
    assert over
    assert {"robustness", "success"} <= set(info)
    again = gymnasium.make(env.unwrapped.spec)  # with TimeLimit, which cuts at the same step
    again.reset(seed=0)
    again.step(np.zeros(6))
    *_, over, info = again.step(np.zeros(6))
    assert over
    assert {"robustness", "success"} <= set(info)


def test_make_vec_takes_what_gymnasium_gives():
    envs = gymnasium.make_vec(gym_id(DISCS), num_envs=2, render_mode="rgb_array", max_episode_steps=2)
    envs.reset(seed=0)
    images = envs.render()
    assert len(images) == 2
    assert all(image.dtype == np.uint8 and image.ndim == 3 for image in images)
    assert not envs.step(np.zeros((2, 6)))[3].any()
    *_, over, infos = envs.step(np.zeros((2, 6)))
    assert over.all()
    assert infos["_success"].all()
    envs.close()
    with pytest.raises(InputError, match="render_mode 'human' is unknown; choices: rgb_array"):
        vector_env(DISCS, render_mode="human")
    with pytest.raises(InputError, match="give only one"):
        vector_env(DISCS, max_cycles=2, max_episode_steps=3)


@pytest.mark.parametrize(
    ("what", "do"),
    [
        ("render_mode 'ansi' is unknown", lambda: parallel_env(DISCS, render_mode="ansi")),
        ("render_mode '5' is unknown", lambda: JointEnv(DISCS, render_mode=5)),
        ("agent 'nobody' is unknown", lambda: parallel_env(DISCS).action_space("nobody")),
        ("agent 'nobody' is unknown", lambda: parallel_env(DISCS).observation_space("nobody")),
        ("dtype '.*float32.*' is unknown", lambda: vector_env(DISCS, dtype=np.float32)),
        ("device '5' is unknown", lambda: vector_env(DISCS, device=5)),
        ("options = 5", lambda: vector_env(DISCS).reset(options=5)),
        ("suite 'None' is unknown", lambda: load_scenario(DISCS).suite(None)),
        ("suite .* is unknown", lambda: load_scenario(DISCS).suite([])),
        ("override", lambda: load_scenario(DISCS).override(None)),
        ("override", lambda: load_scenario(DISCS).override({1: 2})),
    ],
)
def test_names_of_another_type_are_unknown_names(what, do):
    with pytest.raises(InputError, match=what) as error:
        do()
    check_line(error)


def test_tensors_that_want_gradients_are_no_actions():
    torch = pytest.importorskip("torch")
    env = JointEnv(DISCS)
    env.reset(seed=0)
    with pytest.raises(InputError, match="action = ") as error:
        env.step(torch.zeros(6, requires_grad=True))
    check_line(error)
    assert env.parallel.time == 0.0

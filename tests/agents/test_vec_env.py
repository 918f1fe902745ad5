"""Stable-Baselines3 sees the same worlds as JointEnv and ImpactEnv, and an end that is a truncation."""

import numpy as np
import pytest
import torch
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

from agents.residual_vector import ResidualVectorEnv
from agents.vec_env import ImpactVecEnv, ResidualVecEnv
from impact_envs import JointEnv, load_scenario, parallel_env
from impact_envs.errors import InputError
from tests.frozen.freeze import get_plan

SCENARIO = load_scenario("throw_and_catch").suite("all")
WORLDS, CYCLES, STEPS, SEED = 3, 7, 24, 5
ROBOTS = SCENARIO.agents
FLOAT32 = pytest.mark.slow  # compiled apart from float64: half a minute


@pytest.fixture(autouse=True)
def _one_thread():
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def make_envs(worlds=WORLDS, per_robot=False, dtype="float64", cycles=CYCLES, seed=SEED):
    envs = ImpactVecEnv(SCENARIO, worlds, per_robot, cycles, dtype, threads=1)
    if seed is not None:
        envs.seed(seed)
    return envs


def make_model(algorithm, envs, **options):
    model = algorithm("MlpPolicy", envs, policy_kwargs={"net_arch": [16]}, device="cpu", seed=0, **options)
    model.set_logger(Logger(None, []))  # SB3's own makes a folder in the temporary directory
    return model


def draw_actions(worlds=WORLDS, steps=STEPS):
    shape = (steps, worlds, 3 * len(ROBOTS))
    return np.random.default_rng(0).uniform(-1.0, 1.0, shape).astype(np.float32)


def test_joint_mode_is_joint_env_world_by_world_across_episodes():
    envs = make_envs()
    singles = [Monitor(JointEnv(SCENARIO, max_cycles=CYCLES)) for _ in range(WORLDS)]
    firsts = [env.reset(seed=SEED + k)[0] for k, env in enumerate(singles)]
    assert np.array_equal(envs.reset(), firsts)
    ends = 0
    for actions in draw_actions():
        observations, rewards, ended, infos = envs.step(actions)
        for k, env in enumerate(singles):
            expected, reward, _, truncated, info = env.step(actions[k])
            assert rewards[k] == reward
            assert ended[k] == truncated
            if not truncated:
                assert infos[k] == {}
                assert np.array_equal(observations[k], expected)
                continue
            ends += 1
            assert np.array_equal(infos[k]["terminal_observation"], expected)
            assert np.array_equal(observations[k], env.reset()[0])
            assert infos[k]["episode"].keys() == info["episode"].keys()
            assert all(infos[k]["episode"][name] == info["episode"][name] for name in "rl")
            assert infos[k]["robustness"] == info["robustness"]
            assert infos[k]["success"] is infos[k]["is_success"] is info["success"]
    assert ends == WORLDS * (STEPS // CYCLES)


def test_per_robot_mode_is_impact_env_robot_by_robot_across_episodes():
    envs = make_envs(per_robot=True)
    assert envs.num_envs == WORLDS * len(ROBOTS)
    singles = [parallel_env(SCENARIO, max_cycles=CYCLES) for _ in range(WORLDS)]
    assert envs.observation_space == singles[0].observation_space(ROBOTS[0])
    assert envs.action_space == singles[0].action_space(ROBOTS[0])
    first = [env.reset(seed=SEED + w)[0][robot] for w, env in enumerate(singles) for robot in ROBOTS]
    assert np.array_equal(envs.reset(), first)
    returns = np.zeros(envs.num_envs)
    for step, actions in enumerate(draw_actions(), start=1):
        rows = actions.reshape(envs.num_envs, 3)
        observations, rewards, ended, infos = envs.step(rows)
        assert ended.tolist() == [step % CYCLES == 0] * envs.num_envs
        returns += rewards
        for w, env in enumerate(singles):
            last, expected_rewards, _, _, ends = env.step(
                {r: a.reshape(3) for r, a in zip(ROBOTS, np.split(actions[w], len(ROBOTS)), strict=True)}
            )
            now = last if env.agents else env.reset()[0]
            for i, robot in enumerate(ROBOTS):
                k = w * len(ROBOTS) + i
                assert rewards[k] == expected_rewards[robot]
                assert np.array_equal(observations[k], now[robot])
                if ended[k]:
                    assert np.array_equal(infos[k]["terminal_observation"], last[robot])
                    assert infos[k]["robustness"] == ends[robot]["robustness"]
                    assert infos[k]["episode"]["r"] == pytest.approx(returns[k], abs=1e-6)
                    assert infos[k]["episode"]["l"] == CYCLES
        returns[ended] = 0.0


def test_per_robot_rewards_add_up_to_the_joint_reward():
    joint, shared = make_envs(), make_envs(per_robot=True)
    joint.reset()
    shared.reset()
    for actions in draw_actions():
        together = joint.step(actions)[1]
        apart = shared.step(actions.reshape(-1, 3))[1].reshape(WORLDS, len(ROBOTS))
        assert np.allclose(apart.sum(axis=1), together, rtol=0, atol=1e-12)


@pytest.mark.parametrize("per_robot", [False, True])
def test_an_end_is_a_truncation_whose_observation_is_the_last_one(per_robot):
    envs = make_envs(per_robot=per_robot)
    envs.reset()
    for step in range(1, CYCLES + 1):
        observations, _, ended, infos = envs.step(np.ones((envs.num_envs, *envs.action_space.shape), np.float32))
        assert ended.all() == ended.any() == (step == CYCLES)
    assert all(info["TimeLimit.truncated"] is True for info in infos)
    for first, info in zip(observations, infos, strict=True):
        last = info["terminal_observation"]
        assert last[-3] == pytest.approx(CYCLES * SCENARIO.control_period / SCENARIO.horizon)
        assert first[-3] == 0.0
        assert envs.observation_space.contains(last)


@pytest.mark.parametrize("per_robot", [False, True])
def test_at_the_horizon_the_formula_is_decided_and_nothing_is_bootstrapped(per_robot):
    world = SCENARIO.shorten(0.02)
    envs, value = ImpactVecEnv(world, WORLDS, per_robot, dtype="float64", threads=1), 10.0
    model = make_model(PPO, envs, n_steps=world.steps, batch_size=world.steps, n_epochs=1, gamma=0.5)
    torch.nn.init.zeros_(model.policy.value_net.weight)
    torch.nn.init.constant_(model.policy.value_net.bias, value)
    model.learn(world.steps * envs.num_envs)
    returns = [info["r"] for info in model.ep_info_buffer]
    assert len(returns) == envs.num_envs
    assert np.allclose(model.rollout_buffer.rewards.sum(axis=0), returns, rtol=0, atol=1e-5)


@pytest.mark.parametrize("per_robot", [False, True])
def test_ppo_adds_the_value_of_the_last_observation_to_a_truncated_return(per_robot):
    envs, value = make_envs(per_robot=per_robot), 10.0
    model = make_model(PPO, envs, n_steps=CYCLES, batch_size=CYCLES, n_epochs=1, gamma=0.5)
    torch.nn.init.zeros_(model.policy.value_net.weight)
    torch.nn.init.constant_(model.policy.value_net.bias, value)
    model.learn(CYCLES * envs.num_envs)
    returns = [info["r"] for info in model.ep_info_buffer]
    assert len(returns) == envs.num_envs
    assert np.allclose(model.rollout_buffer.rewards.sum(axis=0), np.add(returns, 0.5 * value), rtol=0, atol=1e-5)


def test_sac_stores_the_last_observation_and_no_termination():
    envs = make_envs()
    model = make_model(SAC, envs, learning_starts=10**6, buffer_size=300)
    model.learn(WORLDS * (CYCLES + 1))
    buffer = model.replay_buffer
    assert buffer.dones[CYCLES - 1].all()
    assert buffer.timeouts[CYCLES - 1].all()
    assert not buffer.sample(200).dones.any()
    fraction = CYCLES * SCENARIO.control_period / SCENARIO.horizon
    assert np.allclose(buffer.next_observations[CYCLES - 1, :, -3], fraction)
    assert np.all(buffer.observations[CYCLES, :, -3] == 0.0)


@pytest.mark.parametrize(
    ("algorithm", "per_robot", "dtype"),
    [
        (PPO, False, "float64"),
        (SAC, True, "float64"),
        pytest.param(PPO, True, "float32", marks=FLOAT32),
        pytest.param(SAC, False, "float32", marks=FLOAT32),
    ],
)
def test_learners_train_predict_and_come_back_from_disk(algorithm, per_robot, dtype, tmp_path):
    envs = VecNormalize(make_envs(8, per_robot, dtype, cycles=20))
    short = {"n_steps": 16, "batch_size": 64} if algorithm is PPO else {"learning_starts": 100, "buffer_size": 2000}
    model = make_model(algorithm, envs, **short)
    before = {name: tensor.clone() for name, tensor in model.policy.state_dict().items()}
    model.learn(640)
    moved = [name for name, tensor in model.policy.state_dict().items() if not torch.equal(tensor, before[name])]
    assert moved
    assert all(torch.isfinite(tensor).all() for tensor in model.policy.state_dict().values())
    assert len(model.ep_info_buffer) == len(model.ep_success_buffer) > 0
    assert {info["l"] for info in model.ep_info_buffer} == {20}
    model.save(tmp_path / "model")
    envs.save(str(tmp_path / "features"))
    fresh = VecNormalize.load(str(tmp_path / "features"), make_envs(2, per_robot, dtype, seed=77))
    again = algorithm.load(tmp_path / "model", env=fresh, device="cpu")
    observations = fresh.reset()
    actions, _ = again.predict(observations, deterministic=True)
    assert actions.shape == (fresh.num_envs, *fresh.action_space.shape)
    assert np.array_equal(actions, model.predict(observations, deterministic=True)[0])
    assert np.isfinite(fresh.step(actions)[0]).all()


def test_normalize_shows_the_learner_a_normalized_last_observation():
    plain, envs = make_envs(), VecNormalize(make_envs(), norm_reward=False)
    plain.reset()
    envs.reset()
    for actions in draw_actions(steps=CYCLES):
        infos = plain.step(actions)[-1]
        normalized = envs.step(actions)[-1]
    for mine, theirs in zip(infos, normalized, strict=True):
        assert np.allclose(envs.normalize_obs(mine["terminal_observation"]), theirs["terminal_observation"])
        assert theirs["TimeLimit.truncated"]


def test_evaluation_counts_returns_as_the_worlds_do():
    envs = make_envs()
    model = make_model(PPO, make_envs(seed=None), n_steps=8, batch_size=8)
    mine, lengths = evaluate_policy(model, envs, 2 * WORLDS, return_episode_rewards=True)
    assert lengths == [CYCLES] * (2 * WORLDS)
    single, expected = JointEnv(SCENARIO, max_cycles=CYCLES), []
    for k in range(WORLDS):
        observation, total = single.reset(seed=SEED + k)[0], 0.0
        for _ in range(CYCLES):
            observation, reward, *_ = single.step(model.predict(observation, deterministic=True)[0])
            total += reward
        expected.append(total)
    assert mine[:WORLDS] == pytest.approx(expected, abs=2e-6)


def test_seeds_are_of_worlds_and_hold_for_one_reset():
    envs = make_envs(per_robot=True, seed=None)
    assert envs.seed(9) == [9, 9, 10, 10, 11, 11]
    first = envs.reset()
    second = envs.reset()
    assert not np.array_equal(first, second)
    envs.seed(9)
    assert np.array_equal(envs.reset(), first)
    assert np.array_equal(envs.reset(), second)
    assert envs.seed(None) != envs.seed(None)


def test_a_reset_forgets_the_unfinished_episode():
    envs = make_envs()
    envs.reset()
    actions = draw_actions()
    envs.step(actions[0])
    envs.reset()
    for row in actions[:CYCLES]:
        infos = envs.step(row)[-1]
    assert [info["episode"]["l"] for info in infos] == [CYCLES] * WORLDS


def test_only_the_worlds_whose_episode_ended_tell_of_it():
    envs = make_envs(per_robot=True)
    envs.reset()
    actions = draw_actions().reshape(STEPS, -1, 3)
    for row in actions[:3]:
        envs.step(row)
    envs.worlds.reset(options={"reset_mask": np.array([False, True, False])})
    for row in actions[3:CYCLES]:
        _, _, ended, infos = envs.step(row)
    assert ended.tolist() == [True, True, False, False, True, True]
    assert [bool(info) for info in infos] == ended.tolist()


def test_arrays_are_fresh_at_every_step():
    envs = make_envs(per_robot=True)
    kept = [envs.reset()]
    copies = [kept[0].copy()]
    for actions in draw_actions():
        observations, rewards, ended, infos = envs.step(actions.reshape(-1, 3))
        kept += [observations, rewards, ended, *(info["terminal_observation"] for info in infos if info)]
        copies = [*copies, *(array.copy() for array in kept[len(copies) :])]
    assert all(np.array_equal(array, copy) for array, copy in zip(kept, copies, strict=True))


@FLOAT32
def test_float32_follows_float64():
    double, single = make_envs(cycles=100), make_envs(cycles=100, dtype="float32")
    assert single.observation_space.dtype == np.float32
    assert np.allclose(double.reset(), single.reset(), rtol=0, atol=1e-6)
    for actions in draw_actions():
        wide, narrow = double.step(actions), single.step(actions)
        assert narrow[0].dtype == np.float32
        assert np.allclose(wide[0], narrow[0], rtol=0, atol=1e-4)
        assert np.allclose(wide[1], narrow[1], rtol=0, atol=1e-4)


def test_what_all_worlds_share_is_told_and_what_no_world_has_is_refused():
    envs = make_envs(per_robot=True)
    assert envs.get_attr("scenario", [0, 3]) == [SCENARIO] * 2
    assert envs.get_attr("observation_space") == [envs.observation_space] * envs.num_envs
    assert envs.get_attr("render_mode", 1) == [None]
    assert not envs.has_attr("model")
    assert envs.env_is_wrapped(Monitor) == [True] * envs.num_envs
    assert envs.env_is_wrapped(VecMonitor, 0) == [False]
    with pytest.raises(AttributeError, match=r"'scenari'.*did you mean 'scenario'"):
        envs.get_attr("scenari")
    with pytest.raises(InputError, match="max_cycles"):
        envs.set_attr("max_cycles", 3)
    with pytest.raises(InputError, match="render"):
        envs.env_method("render")
    with pytest.raises(InputError, match="reset_mask"):
        envs.set_options({"reset_mask": [True]})
    envs.set_options({})
    envs.close()


def test_bad_actions_are_refused_and_nothing_is_stepped():
    envs, twin = make_envs(), make_envs()
    with pytest.raises(InputError, match="reset"):
        envs.step(np.zeros((WORLDS, 6), np.float32))
    with pytest.raises(InputError, match="step_async"):
        envs.step_wait()
    envs.reset()
    twin.reset()
    with pytest.raises(InputError, match=r"\(6, 3\)"):
        envs.step(np.zeros((6, 3), np.float32))
    with pytest.raises(InputError, match="different lengths"):
        envs.step([[0.0] * 6, *[[0.0]] * (WORLDS - 1)])
    with pytest.raises(InputError, match="real numbers"):
        envs.step(np.full((WORLDS, 6), "a"))
    actions = draw_actions()[0]
    wrong = actions.copy()
    wrong[2, 4] = np.nan
    with pytest.raises(InputError, match=f"{ROBOTS[1]} in world 2"):
        envs.step(wrong)
    assert np.array_equal(envs.step(actions)[0], twin.step(actions)[0])
    with pytest.raises(InputError, match="num_envs = 0"):
        make_envs(0)


def test_residual_worlds_are_the_vector_environments_step_by_step():
    """Ends at the horizon are decided, a cut by `max_cycles` is not; lengths are in control periods."""
    plan = get_plan("throw_and_catch", "all")
    for cycles in (None, 120):
        envs = ResidualVecEnv("throw_and_catch", WORLDS, "all", plan, max_cycles=cycles, threads=1)
        worlds = ResidualVectorEnv("throw_and_catch", WORLDS, "all", plan, None, "SameStep", cycles, threads=1)
        envs.seed(SEED)
        assert np.array_equal(envs.reset(), worlds.reset(seed=SEED)[0])
        ended, returns = np.zeros(WORLDS, bool), np.zeros(WORLDS)
        while not ended.any():
            corrections = np.full((WORLDS, 3), 0.2, np.float32)
            features, rewards, ended, infos = envs.step(corrections)
            expected, theirs, _, over, last = worlds.step(corrections)
            returns += rewards
            assert np.array_equal(features, expected)
            assert np.array_equal(rewards, theirs)
            assert np.array_equal(ended, over)
        for k in np.flatnonzero(ended):
            assert np.array_equal(infos[k]["terminal_observation"], last["final_obs"][k])
            assert infos[k]["TimeLimit.truncated"] is (cycles is not None)
            assert infos[k]["episode"]["l"] == (cycles or SCENARIO.steps)
            assert infos[k]["episode"]["r"] == pytest.approx(returns[k], abs=1e-6)
            assert infos[k]["robustness"] == last["robustness"][k]


def test_ppo_learns_on_residual_worlds():
    plan = get_plan("throw_and_catch", "all")
    envs = ResidualVecEnv("throw_and_catch", 8, "all", plan, {"plan_anew": False}, threads=1)
    model = make_model(PPO, VecNormalize(envs, gamma=1.0), n_steps=8, batch_size=32, gamma=1.0)
    model.learn(128)
    assert model.num_timesteps == 128
    assert {info["l"] for info in model.ep_info_buffer} == {SCENARIO.steps}
    assert all(torch.isfinite(tensor).all() for tensor in model.policy.state_dict().values())

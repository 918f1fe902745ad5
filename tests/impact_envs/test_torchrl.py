"""TorchRL's door: its checker, its groups, and the same worlds as everywhere, bit for bit."""

import numpy as np
import pytest

from impact_envs import list_scenarios, load_scenario, parallel_env

pytest.importorskip("torchrl", reason="impact-envs[torchrl] is not installed")
torch = pytest.importorskip("torch")

from torchrl.envs.utils import check_env_specs, step_mdp  # noqa: E402

from impact_envs.torchrl import ImpactTorchEnv  # noqa: E402


@pytest.mark.parametrize("name", list_scenarios())
def test_torchrl_checker(name):
    env = ImpactTorchEnv(name, 3, max_cycles=8, state=True, threads=1)
    check_env_specs(env)
    assert sorted(agent for members in env.group_map.values() for agent in members) == sorted(
        load_scenario(name).agents
    )
    env.close()


def test_robots_that_are_alike_share_a_group_and_others_do_not():
    assert ImpactTorchEnv("crew", 1).group_map == {"agents": ["snap", "crackle", "fizz", "bang"]}
    assert ImpactTorchEnv("floating_manipulator_thrusters", 1).group_map == {"arm": ["arm"], "base": ["base"]}
    assert ImpactTorchEnv("floating_manipulator", 1).group_map == {"arm": ["arm"]}
    env = ImpactTorchEnv("corridor", 2, group_map={"a": ["crackle"], "b": ["snap"]})
    check_env_specs(env)


@pytest.mark.parametrize("groups", [None, {"b": ["crackle"], "a": ["snap"]}])
def test_worlds_are_those_of_the_single_environment(groups):
    env = ImpactTorchEnv("corridor", 2, group_map=groups, dtype="float64", threads=1, suite="all")
    env.set_seed(1_000_005)
    tensordict = env.reset()
    single = parallel_env(load_scenario("corridor").suite("all"))
    observations, _ = single.reset(seed=1_000_006)
    agents = single.possible_agents
    rng = np.random.default_rng(0)
    for _ in range(20):
        for group, members in env.group_map.items():
            seen = tensordict[group, "observation"][1]
            assert all(np.array_equal(row.numpy(), observations[name]) for row, name in zip(seen, members, strict=True))
        actions = {name: rng.uniform(-1, 1, 3).astype(np.float32) for name in agents}
        for group, members in env.group_map.items():
            chosen = torch.from_numpy(np.stack([actions[name] for name in members]))
            tensordict[group, "action"] = chosen.expand(2, *chosen.shape).clone()
        tensordict = env.step(tensordict)
        observations, rewards, *_ = single.step(actions)
        for group, members in env.group_map.items():
            earned = tensordict["next", group, "reward"][1, :, 0].tolist()
            assert earned == pytest.approx([rewards[name] for name in members], rel=1e-6)
        tensordict = step_mdp(tensordict)


def test_worlds_that_ended_start_again_alone():
    env = ImpactTorchEnv("throw_and_catch", 3, max_cycles=4, threads=1)
    rollout = env.rollout(10, break_when_any_done=False)
    ends = rollout["next", "truncated"][..., 0].tolist()
    assert ends == [[False, False, False, True] * 2 + [False, False]] * 3
    assert rollout["next", "info", "is_success"].dtype == torch.bool
    chosen = torch.tensor([[True], [False], [False]])
    tensordict = env.rollout(2)[:, -1]["next"]
    after = env.reset(tensordict.set("_reset", chosen))
    clock = after["agents", "observation"][:, 0, -3]
    assert (clock == 0).tolist() == [True, False, False]


@pytest.mark.slow
def test_engine_is_far_faster_than_the_wrapper():
    from time import process_time

    from torchrl.envs.libs.pettingzoo import PettingZooWrapper

    def measure(env, steps, worlds):
        env.rollout(5)
        start = process_time()
        env.rollout(steps)
        return worlds * steps / (process_time() - start)

    batch = measure(ImpactTorchEnv("corridor", 1024, threads=1), 100, 1024)
    wrapper = PettingZooWrapper(parallel_env("corridor"), group_map={"agents": ["snap", "crackle"]})
    assert batch > 20 * measure(wrapper, 100, 1)


def test_benchmarl_trains(tmp_path):
    reason = "BenchMARL is not installed, or not one for this TorchRL"
    pytest.importorskip("benchmarl", reason=reason, exc_type=ImportError)
    from benchmarl.algorithms import MappoConfig
    from benchmarl.experiment import Experiment, ExperimentConfig
    from benchmarl.models.mlp import MlpConfig

    from impact_envs.benchmarl import make_task

    config = ExperimentConfig.get_from_yaml()
    config.save_folder, config.loggers, config.evaluation, config.create_json = str(tmp_path), [], False, False
    config.on_policy_n_envs_per_worker, config.on_policy_collected_frames_per_batch = 8, 160
    config.on_policy_minibatch_size, config.on_policy_n_minibatch_iters = 80, 1
    config.max_n_iters, config.checkpoint_interval = 2, 0
    experiment = Experiment(
        task=make_task("corridor", max_cycles=20, threads=1),
        algorithm_config=MappoConfig.get_from_yaml(),
        model_config=MlpConfig.get_from_yaml(),
        critic_model_config=MlpConfig.get_from_yaml(),
        seed=0,
        config=config,
    )
    experiment.run()
    assert experiment.total_frames == 320

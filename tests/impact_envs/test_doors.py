"""Handles that libraries look for: PettingZoo's registry, lengths, tasks in words, success at every step."""

import re
import sys
from importlib import import_module
from pathlib import Path

import gymnasium
import numpy as np
import pettingzoo
import pytest
from pettingzoo.test import parallel_api_test

from impact_envs import gym_id, list_scenarios, load_scenario, parallel_env, vector_env
from impact_envs.stl.verdict import compute_outcome, judge

PAGE = Path(__file__).parents[2] / "docs" / "doors.md"
VARIED = ("throw_and_catch", "floating_manipulator_thrusters", "dual_arm_grasp")


@pytest.mark.parametrize("name", list_scenarios())
def test_pettingzoo_makes_every_scenario(name):
    env = pettingzoo.make("parallel", gym_id(name), max_cycles=5)
    parallel_api_test(env, num_cycles=5)
    assert env.possible_agents == list(load_scenario(name).agents)
    turns = pettingzoo.make("aec", gym_id(name), max_cycles=2)
    turns.reset(seed=0)
    assert turns.agent_selection == env.possible_agents[0]


@pytest.mark.parametrize("name", list_scenarios())
def test_the_task_is_told_in_words_with_its_length(name):
    env, scenario = gymnasium.make(gym_id(name)), load_scenario(name)
    assert env.unwrapped._max_episode_steps == env.spec.max_episode_steps == scenario.steps
    assert (env.unwrapped.task, env.unwrapped.task_description) == (name, scenario.description)
    assert scenario.description


def test_success_is_told_as_soon_as_nothing_can_undo_it():
    """An object that starts where it has to be once has won at the start; one that has to stay there has not."""
    scenario = load_scenario("throw_and_catch")
    x, y = (float(v) for v in scenario.objects["pop"].start)
    there = f"pop.x >= {x - 0.1} & pop.x <= {x + 0.1} & pop.y >= {y - 0.1} & pop.y <= {y + 0.1}"
    for operator, first in (("F", True), ("G", False)):
        changed = scenario.override({"formula": f"{operator}[0,1] ({there})", "horizon": 2.0})
        env = parallel_env(changed)
        _, infos = env.reset(seed=0)
        told = [next(iter(infos.values()))["is_success"]]
        while env.agents:
            *_, infos = env.step({agent: np.zeros(3) for agent in env.agents})
            told.append(next(iter(infos.values()))["is_success"])
        assert told[0] is first
        assert told[-1] is True
        assert told == sorted(told)
        assert next(iter(infos.values()))["success"] is True


@pytest.mark.parametrize("name", VARIED)
@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_many_worlds_tell_success_as_one_does(name, mode):
    cycles, rng = 12, np.random.default_rng(0)
    envs = vector_env(name, 2, autoreset_mode=mode, max_cycles=cycles)
    alone = [parallel_env(name, max_cycles=cycles) for _ in range(2)]
    _, infos = envs.reset(seed=3)
    first = [next(iter(env.reset(seed=3 + k)[1].values()))["is_success"] for k, env in enumerate(alone)]
    assert infos["is_success"].tolist() == first
    for step in range(cycles):
        actions = rng.uniform(-1, 1, envs.action_space.shape)
        *_, infos = envs.step(actions)
        told = []
        for row, env in zip(actions, alone, strict=True):
            parts = np.split(row, len(env.possible_agents))
            *_, info = env.step(dict(zip(env.possible_agents, parts, strict=True)))
            told.append(next(iter(info.values()))["is_success"])
        last = infos.get("final_info", infos)
        assert last["is_success"].tolist() == told
        assert infos["_is_success"].all()
        assert ("final_info" in infos) == (mode == "SameStep" and step == cycles - 1)
    assert (last["success"] == last["is_success"]).all()


def test_a_cut_episode_says_what_is_certain():
    env = parallel_env("corridor", max_cycles=3)
    env.reset(seed=0)
    for _ in range(3):
        *_, infos = env.step({agent: np.zeros(3) for agent in env.agents})
    info = next(iter(infos.values()))
    assert info["is_success"] is info["success"] is judge(compute_outcome(*env.monitor.ends, 1e9))[1]


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_residual_ids_tell_success_too(mode):
    env = gymnasium.make(gym_id("throw_and_catch", residual=True))
    _, info = env.reset(seed=5)
    envs = gymnasium.make_vec(gym_id("throw_and_catch", residual=True), num_envs=1, autoreset_mode=mode)
    _, infos = envs.reset(seed=[5])
    over = False
    while True:
        assert infos["is_success"].tolist() == [info["is_success"]]
        if over:
            break
        *_, terminated, truncated, info = env.step(np.zeros(env.action_space.shape))
        *_, infos = envs.step(np.zeros(envs.action_space.shape))
        over = terminated or truncated
        infos = infos["final_info"] if over and mode == "SameStep" else infos
    assert info["is_success"] is info["success"] is True


@pytest.mark.slow
@pytest.mark.parametrize(("needed", "printed"), [("torchrl", "torch.Size([64, 20, 2, 25])"), ("ray tree", "200")])
def test_the_page_does_what_it_says(needed, printed, capsys):
    for library in needed.split():
        pytest.importorskip(library, reason=f"{library} is not installed, see docs/doors.md")
    (block,) = re.findall(rf"```python {needed}\n(.*?)```", PAGE.read_text(), re.S)
    exec(compile(block, str(PAGE), "exec"), {})
    assert printed in capsys.readouterr().out


def test_a_benchmarl_that_cannot_be_imported_is_one_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "benchmarl.environments.common", None)
    monkeypatch.delitem(sys.modules, "impact_envs.benchmarl", raising=False)
    with pytest.raises(ImportError, match="BenchMARL is missing or does not fit the TorchRL"):
        import_module("impact_envs.benchmarl")

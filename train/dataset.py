"""Datasets of flights in Minari's format, for learning from what an expert did; needs ``impact-envs[learn]``."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from impact_envs import __version__, gym_id
from impact_envs.env import ImpactEnv
from impact_envs.errors import InputError, check_count
from impact_envs.joint import JointEnv
from impact_envs.rollout import Policy, rollout
from impact_envs.scenario import Scenario, list_scenarios, load_scenario
from impact_envs.stream import check_seed
from train.evaluation.player import make_policy

CHUNK = 50  # episodes that are held in memory before they are written
TOLD = ("robustness_lower", "robustness_upper", "is_success")  # infos that are kept, of every step


class _Rounded:
    """A policy whose actions are rounded to what the action space holds, so that a replay is the same episode.

    Args:
        policy: that acts.
    """

    def __init__(self, policy: Policy) -> None:
        self._policy, self.name = policy, policy.name
        self.reset, self.diagnostics = policy.reset, policy.diagnostics

    def act(self, observations: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Return each agent's action, in float32's numbers."""
        actions = self._policy.act(observations)
        return {name: np.clip(np.asarray(u, np.float32), -1.0, 1.0).astype(float) for name, u in actions.items()}


def write_dataset(
    scenario: str | Path | Scenario,
    episodes: int,
    policy: str = "expert",
    suite: str = "nominal",
    seed: int = 0,
    name: str | None = None,
    out: str | Path | None = None,
) -> dict[str, Any]:
    """Fly episodes and write them as a Minari dataset; one agent acts for all, as JointEnv.

    Args:
        scenario: a shipped name, the path of a TOML file, or a Scenario.
        episodes: how many.
        policy: name, as player.make_policy takes it.
        suite: mismatch suite of the true world.
        seed: of the first episode; the others follow. Training seeds are below 1,000,000.
        name: of the dataset; default ``impact_envs/SCENARIO/POLICY-v0``.
        out: folder of Minari's datasets; default: Minari's own, ``MINARI_DATASETS_PATH``.

    Returns:
        ``dataset`` (its name), ``folder``, ``episodes``, ``steps``, ``success_rate``.

    Raises:
        InputError: a bad argument, or there is a dataset of this name.
        PlanningError: the expert found no plan.
    """
    import minari

    check_count("episodes", episodes)
    check_seed(seed + episodes - 1, "seed of the last episode")
    loaded = load_scenario(scenario).suite(suite)
    if out is not None and Path(out).exists() and not Path(out).is_dir():
        raise InputError(f"--out {out}: is a file; it takes a folder")
    name = name or f"impact_envs/{loaded.name}/{Path(policy).stem.replace(':', '_')}-v0"
    try:
        minari.dataset.minari_dataset.parse_dataset_id(name)
    except ValueError as error:
        raise InputError(f"--name {name}: {error}") from None
    except TypeError:  # Minari reads a version that is missing as a number
        raise InputError(f"--name {name}: has no version; {name}-v0 has one") from None
    folder = Path(out).absolute() / name if out is not None else Path(minari.storage.get_dataset_path(name))
    if folder.exists():
        raise InputError(f"dataset {name}: is there already, in {folder}; give another --name, such as NAME-v1")
    env = _make_env(loaded, suite)
    player, successes, dataset, steps = make_policy(policy, loaded), 0, None, 0
    if out is not None:
        os.environ["MINARI_DATASETS_PATH"] = str(Path(out).absolute())  # where Minari writes; it makes the folder
    for buffers in _fly(env.unwrapped.parallel, player, range(seed, seed + episodes)):
        if dataset is None:
            dataset = _create(name, buffers, env, loaded, policy, suite)
        else:
            dataset.storage.update_episodes(buffers)
        successes += sum(bool(buffer.infos["is_success"][-1]) for buffer in buffers)
        steps += sum(len(buffer.rewards) for buffer in buffers)
    return {
        "dataset": name,
        "folder": str(folder),
        "episodes": episodes,
        "steps": steps,
        "success_rate": successes / episodes,
    }


def _make_env(scenario: Scenario, suite: str) -> Any:
    """Return the environment that is written down as where the data come from, if Gymnasium can make it again."""
    if scenario.name in list_scenarios() and load_scenario(scenario.name).suite(suite) == scenario:
        return gymnasium.make(gym_id(scenario.name), suite=suite)
    return JointEnv(scenario)


def _fly(env: ImpactEnv, policy: Policy, seeds: range) -> Iterator[list[Any]]:
    """Yield the episodes in chunks, as Minari's buffers."""
    from minari.data_collector import EpisodeBuffer

    buffers: list[Any] = []
    for number, seed in enumerate(seeds):
        observations: list[np.ndarray] = []
        told: list[Mapping[str, Any]] = []

        def watch(shown: ImpactEnv) -> None:
            observations.append(shown.task.observe_jointly(shown.time, shown.bounds))  # noqa: B023  # called at once
            told.append(shown.infos)  # noqa: B023

        episode = rollout(env, _Rounded(policy), seed, on_step=watch)
        length = len(observations) - 1
        ends = np.arange(1, length + 1) == length
        failed = bool(episode.failure)
        buffers.append(
            EpisodeBuffer(
                id=number,
                seed=seed,
                observations=np.array(observations),
                actions=np.concatenate([episode.actions[a] for a in env.possible_agents], axis=1).astype(np.float32),
                rewards=np.sum([episode.rewards[a] for a in env.possible_agents], axis=0),
                terminations=ends & failed,
                truncations=ends & (not failed),
                infos={key: np.array([info[key] for info in told]) for key in TOLD},
            )
        )
        if len(buffers) == CHUNK or number + 1 == len(seeds):
            yield buffers
            buffers = []


def _create(name: str, buffers: list[Any], env: Any, scenario: Scenario, policy: str, suite: str) -> Any:
    import minari

    parallel = env.unwrapped.parallel
    sizes = [parallel.action_space(agent).shape[0] for agent in parallel.possible_agents]
    ends = np.cumsum([0, *sizes]).tolist()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that nobody is named as the author
        dataset = minari.create_dataset_from_buffers(
            name,
            buffers,
            env=env if env.spec is not None else None,
            observation_space=env.observation_space,
            action_space=env.action_space,
            algorithm_name=policy,
            description=f"{scenario.description} Formula: {scenario.formula.strip()}. Suite {suite}.",
            data_format="hdf5",
            requirements=[f"impact-envs=={__version__}"],
        )
    dataset.storage.update_metadata(
        {
            "suite": suite,
            "formula": scenario.formula.strip(),
            "control_period": scenario.control_period,
            "actions_of": {a: ends[k : k + 2] for k, a in enumerate(parallel.possible_agents)},
            "elements": parallel.task.joint_layout.describe().splitlines(),
        }
    )
    return dataset

"""This engine through its doors, as benchmarks/engine.py times it: a setting and a batch size give an Episode."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from impact_envs import load_scenario, parallel_env, vector_env
from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.free_flyer.step import STEP, run_tuples

SEED = 0
STRIDE = 17  # world k's actions at step t are row k + STRIDE t of one table: little memory, and its own at every step


class Setting(NamedTuple):
    """What all methods step.

    Attributes:
        name: robots + objects.
        scenario: that has them.
        robots, objects: how many.
        hold: control periods that each random action is held.
    """

    name: str
    scenario: str
    robots: int
    objects: int
    hold: int = 1


class Episode(NamedTuple):
    """How to start all worlds anew, and how to step them."""

    reset: Callable[[], Any]
    run: Callable[[int], None]


def make_rows(batch: int, width: int, steps: int, lowest: float = -1.0) -> np.ndarray:
    """Return random numbers, uniform up to 1, for all worlds and steps, shape (batch + STRIDE (steps - 1), width)."""
    rows = np.random.default_rng(SEED).uniform(lowest, 1.0, (batch + STRIDE * (steps - 1), width))
    return rows.astype(np.float32)


def cut(rows: Any, batch: int, steps: int, hold: int) -> list[Any]:
    """Return the worlds' rows at each step."""
    firsts = [STRIDE * (t // hold) for t in range(steps)]
    return [rows[first : first + batch] for first in firsts]


def make_vector(setting: Setting, batch: int, steps: int, threads: int) -> Episode:
    """Step through ``vector_env``."""
    envs = vector_env(setting.scenario, num_envs=batch, threads=threads)
    actions = cut(make_rows(batch, 3 * setting.robots, steps), batch, steps, setting.hold)

    def run(count: int) -> None:
        for action in actions[:count]:
            envs.step(action)

    return Episode(partial(envs.reset, seed=SEED), run)


def make_compiled(setting: Setting, batch: int, steps: int) -> Episode:
    """Call the compiled step of the whole task as the batch does, with nothing round it."""
    envs = vector_env(setting.scenario, num_envs=batch, threads=1)
    inner: Any = envs.batch
    rows = make_rows(batch, 3 * setting.robots, steps).astype(float).reshape(-1, setting.robots, 3)
    actions, todo = cut(rows, batch, steps, setting.hold), np.full(batch, STEP)
    arrays = (*inner.arrays, tuple(inner.make_output(False)))

    def run(count: int) -> None:
        for action in actions[:count]:
            run_tuples(*arrays, action, todo, 0, 0, batch)

    return Episode(partial(envs.reset, seed=SEED), run)


def make_gpu(setting: Setting, batch: int, steps: int) -> Episode:
    """Step the same compiled functions on a GPU, with actions and results there.

    Raises:
        InputError: there is none.
    """
    import torch

    from impact_envs.free_flyer.gpu import GpuBatch

    worlds = GpuBatch(load_discs(setting.scenario), batch, dtype=np.float32)
    rows = torch.from_numpy(make_rows(batch, 3 * setting.robots, steps)).to(worlds.device)
    actions = cut(rows.reshape(-1, setting.robots, 3), batch, steps, setting.hold)
    output = worlds.make_output(False)

    def reset() -> None:
        worlds.seed(np.arange(batch), np.arange(SEED, SEED + batch))
        worlds.start(np.ones(batch, bool), output)

    def run(count: int) -> None:
        for action in actions[:count]:
            worlds.step(action, output)
        if worlds.device.type == "cuda":
            torch.cuda.synchronize()

    return Episode(reset, run)


def make_pettingzoo(setting: Setting, batch: int, steps: int, engine: str) -> Episode:
    """Step our single PettingZoo environments on one engine, one after another."""
    scenario = load_scenario(setting.scenario).override({"engine": engine})
    envs = [parallel_env(scenario) for _ in range(batch)]
    rows = make_rows(batch, 3 * setting.robots, steps).reshape(-1, setting.robots, 3)
    return loop_over(envs, [dict(zip(scenario.agents, row, strict=True)) for row in rows], steps, setting.hold)


def loop_over(envs: list[Any], rows: list[dict[str, np.ndarray]], steps: int, hold: int) -> Episode:
    """Step single environments one after another."""
    actions = cut(rows, len(envs), steps, hold)

    def reset() -> None:
        for k, env in enumerate(envs):
            env.reset(seed=SEED + k)

    def run(count: int) -> None:
        for action in actions[:count]:
            for env, act in zip(envs, action, strict=True):
                env.step(act)

    return Episode(reset, run)


def load_discs(name: str) -> FreeFlyerScenario:
    """Return a shipped scenario of free-flyers."""
    scenario = load_scenario(name)
    assert isinstance(scenario, FreeFlyerScenario)
    return scenario


def count_impacts(setting: Setting, batch: int, steps: int) -> dict[str, Any]:
    """Return impacts per env-step of ours in the same episodes, and control periods whose events were cut short."""
    envs = vector_env(setting.scenario, num_envs=batch)
    actions = cut(make_rows(batch, 3 * setting.robots, steps), batch, steps, setting.hold)
    envs.reset(seed=SEED)
    infos = [envs.step(action)[4] for action in actions]
    impacts = sum(int(info["impacts"].sum()) for info in infos)
    return {
        "setting": setting.name,
        "impacts per env-step": float(f"{impacts / (batch * steps):.2g}"),
        "worlds with impacts": float(f"{np.mean(sum(info['impacts'] for info in infos) > 0):.2g}"),
        "overflow": int(infos[-1]["overflow"].sum()),
    }

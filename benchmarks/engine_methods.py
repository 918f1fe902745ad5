"""What benchmarks/engine.py times: this engine through its doors, and its peers, which are optional packages.

    pip install vmas mpe2

A method is made for a setting and a batch size with all actions drawn; it gives an Episode.
"""

from __future__ import annotations

import contextlib
import importlib
import io
import os
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from impact_envs import load_scenario, parallel_env, vector_env
from impact_envs.errors import InputError
from impact_envs.free_flyer.step import STEP, run_range

INSTALL = "pip install vmas mpe2"
SEED = 0
STRIDE = 17  # world k's actions at step t are row k + STRIDE t of one table: little memory, and its own at every step
SUBSTEPS = 10  # of bare pymunk in a control period


class Setting(NamedTuple):
    """How many robots and objects, and the scenario that has them."""

    name: str
    scenario: str
    robots: int
    objects: int


class Episode(NamedTuple):
    """How to start all worlds anew, and how to step them."""

    reset: Callable[[], Any]
    run: Callable[[int], None]


class Method(NamedTuple):
    """A way to step worlds.

    Attributes:
        name: in tables.
        make: of setting, batch size and number of steps; raises ImportError without its package.
        largest: batch size that is measured.
        wall: its rate counts wall time, for several threads do the work.
        note: what its step includes, and how its physics differ from ours.
    """

    name: str
    make: Callable[[Setting, int, int], Episode]
    largest: int
    wall: bool
    note: str


COMPILED, VECTOR, PETTINGZOO = "ours, compiled step", "ours, vector_env", "ours, PettingZoo"
VMAS, PYMUNK, SPREAD = "VMAS transport", "pymunk model, PettingZoo", "simple_spread, PettingZoo"
BARE_PYMUNK = "pymunk, bare"
SETTINGS = (Setting("2+1", "corridor", 2, 1), Setting("4+3", "crew", 4, 3))


def make_rows(batch: int, width: int, steps: int, lowest: float = -1.0) -> np.ndarray:
    """Return random numbers, uniform up to 1, for all worlds and steps, shape (batch + STRIDE (steps - 1), width)."""
    rows = np.random.default_rng(SEED).uniform(lowest, 1.0, (batch + STRIDE * (steps - 1), width))
    return rows.astype(np.float32)


def cut(rows: Any, batch: int, steps: int) -> list[Any]:
    """Return the worlds' rows at each step."""
    return [rows[STRIDE * t : STRIDE * t + batch] for t in range(steps)]


def make_vector(setting: Setting, batch: int, steps: int, threads: int) -> Episode:
    """Step through ``vector_env``."""
    envs = vector_env(setting.scenario, num_envs=batch, threads=threads)
    actions = cut(make_rows(batch, 3 * setting.robots, steps), batch, steps)

    def run(count: int) -> None:
        for action in actions[:count]:
            envs.step(action)

    return Episode(partial(envs.reset, seed=SEED), run)


def make_compiled(setting: Setting, batch: int, steps: int) -> Episode:
    """Call the compiled step of the whole task as the batch does, with nothing round it."""
    envs = vector_env(setting.scenario, num_envs=batch, threads=1)
    inner: Any = envs.batch
    rows = make_rows(batch, 3 * setting.robots, steps).astype(float).reshape(-1, setting.robots, 3)
    actions, todo = cut(rows, batch, steps), np.full(batch, STEP)
    shared = (inner._arena, inner._worlds, inner._scratch, inner._log, inner._program, inner._sensing, inner._rules)
    output = inner.make_output(False)

    def run(count: int) -> None:
        for action in actions[:count]:
            run_range(*shared, inner._memory, output, action, todo, 0, 0, batch)

    return Episode(partial(envs.reset, seed=SEED), run)


def make_pettingzoo(setting: Setting, batch: int, steps: int, engine: str) -> Episode:
    """Step our single PettingZoo environments on one engine, one after another."""
    scenario = load_scenario(setting.scenario).override({"engine": engine})
    envs = [parallel_env(scenario) for _ in range(batch)]
    rows = make_rows(batch, 3 * setting.robots, steps).reshape(-1, setting.robots, 3)
    return _loop(envs, [dict(zip(scenario.agents, row, strict=True)) for row in rows], steps)


def make_pymunk(setting: Setting, batch: int, steps: int) -> Episode:
    """Step bare pymunk spaces with our bodies, limits and walls, one after another."""
    import pymunk

    scenario: Any = load_scenario(setting.scenario)
    robots = list(scenario.robots.values())
    limits = np.array([(robot.force_limit, robot.force_limit, robot.torque_limit) for robot in robots])
    rows = make_rows(batch, 3 * setting.robots, steps).reshape(-1, setting.robots, 3) * limits
    actions = cut(rows.tolist(), batch, steps)
    worlds: list[tuple[pymunk.Space, list[pymunk.Body]]] = []

    def reset() -> None:
        worlds[:] = [_make_space(scenario) for _ in range(batch)]

    def run(count: int) -> None:
        for action in actions[:count]:
            for (space, bodies), controls in zip(worlds, action, strict=True):
                for _ in range(SUBSTEPS):
                    for body, (fx, fy, torque) in zip(bodies, controls, strict=False):
                        body.apply_force_at_local_point((fx, fy))
                        body.torque = torque
                    space.step(scenario.control_period / SUBSTEPS)

    return Episode(reset, run)


def _make_space(scenario: Any) -> tuple[Any, list[Any]]:
    import pymunk

    space, bodies = pymunk.Space(), []
    for table in map(scenario.body, scenario.bodies):
        body = pymunk.Body(table.mass, table.inertia)
        body.position, body.angle = table.start, table.heading
        bodies.append(body)
        space.add(body, pymunk.Circle(body, table.radius))
    (x0, y0), (x1, y1) = scenario.world.lower, scenario.world.upper
    corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
    walls = zip(corners, [*corners[1:], corners[0]], strict=True)
    space.add(*(pymunk.Segment(space.static_body, a, b, 0.0) for a, b in walls))
    for area in scenario.obstacles.values():
        if area.solid:
            space.add(pymunk.Poly(space.static_body, area.corners))
    for shape in space.shapes:
        shape.elasticity = scenario.believed.restitution**0.5  # pymunk multiplies the two
    return space, bodies


def make_simple_spread(setting: Setting, batch: int, steps: int) -> Episode:
    """Step PettingZoo's ``simple_spread`` of mpe2 with as many agents as we have robots, one world after another."""
    module = import_peer("mpe2.simple_spread_v3")
    envs = [module.parallel_env(N=setting.robots, continuous_actions=True, max_cycles=10**9) for _ in range(batch)]
    rows = make_rows(batch, 5 * setting.robots, steps, lowest=0.0).reshape(-1, setting.robots, 5)
    return _loop(envs, [dict(zip(envs[0].possible_agents, row, strict=True)) for row in rows], steps)


def _loop(envs: list[Any], rows: list[dict[str, np.ndarray]], steps: int) -> Episode:
    actions = cut(rows, len(envs), steps)

    def reset() -> None:
        for k, env in enumerate(envs):
            env.reset(seed=SEED + k)

    def run(count: int) -> None:
        for action in actions[:count]:
            for env, act in zip(envs, action, strict=True):
                env.step(act)

    return Episode(reset, run)


def make_vmas(setting: Setting, batch: int, steps: int) -> Episode:
    """Step VMAS's ``transport`` with as many agents and packages as we have robots and objects."""
    vmas = import_peer("vmas")
    import torch

    torch.set_num_threads(1)
    env = vmas.make_env(
        "transport",
        num_envs=batch,
        device="cpu",
        continuous_actions=True,
        n_agents=setting.robots,
        n_packages=setting.objects,
    )
    rows = make_rows(batch, 2 * setting.robots, steps).reshape(-1, setting.robots, 2)
    agents = [cut(torch.tensor(rows[:, i]), batch, steps) for i in range(setting.robots)]
    actions = [list(action) for action in zip(*agents, strict=True)]

    def run(count: int) -> None:
        for action in actions[:count]:
            env.step(action)

    return Episode(partial(env.reset, seed=SEED), run)


def import_peer(module: str) -> Any:
    """Import a peer without the notices it prints.

    Raises:
        ImportError: it, or what it needs, is not installed.
    """
    with contextlib.redirect_stderr(io.StringIO()):
        return importlib.import_module(module)


def make_methods(looped: int, largest: int) -> tuple[Method, ...]:
    """Return all methods in the order in which they take turns.

    Args:
        looped: largest batch of what loops over worlds in Python.
        largest: of all others.
    """
    cores = len(os.sched_getaffinity(0))
    ours = "physics, joint observation, reward, STL robustness"
    spread = (
        "mpe2: physics, observations, reward. Other physics: soft penalty contacts of robots, Euler steps of 0.1 s, "
        "nothing to move, no walls, no formula; actions in [0, 1]"
    )
    return (
        Method(COMPILED, make_compiled, largest, False, f"one call of the compiled function: {ours}"),
        Method(BARE_PYMUNK, make_pymunk, looped, False, f"physics alone, {SUBSTEPS} substeps, impacts to the substep"),
        Method(VECTOR, partial(make_vector, threads=1), largest, False, f"{ours}, infos; one thread"),
        Method(
            VMAS,
            make_vmas,
            largest,
            False,
            "physics, observations, reward; torch float32, one thread. Other physics: contacts are penalty forces in "
            "one step of 0.1 s, no restitution; boxes as packages, drag, no walls; no formula",
        ),
        Method(f"{VECTOR}, {cores} cores", partial(make_vector, threads=cores), largest, True, "the same; wall time"),
        Method(PETTINGZOO, partial(make_pettingzoo, engine="exact"), 1, False, f"{ours}, each robot's observation"),
        Method(
            PYMUNK,
            partial(make_pettingzoo, engine="pymunk"),
            looped,
            False,
            "the same environment on our model in Python that splits control periods at impacts and leaves lasting "
            "contacts to pymunk",
        ),
        Method(SPREAD, make_simple_spread, looped, False, spread),
    )


def check_settings(names: tuple[str, ...]) -> list[Setting]:
    """Return the settings of these names.

    Raises:
        InputError: one is unknown.
    """
    known = {setting.name: setting for setting in SETTINGS}
    for name in names:
        if name not in known:
            raise InputError(f"setting '{name}' is unknown; choices: {', '.join(known)}")
    return [known[name] for name in names]

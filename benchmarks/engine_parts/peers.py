"""The peers of benchmarks/engine.py, as it times them; VMAS and mpe2 are optional packages."""

from __future__ import annotations

import contextlib
import importlib
import io
from functools import partial
from typing import Any

import numpy as np
from engine_parts.ours import SEED, Episode, Setting, cut, load_discs, loop_over, make_rows

INSTALL = "pip install vmas mpe2"
SUBSTEPS = 10  # of bare pymunk in a control period


def make_pymunk(setting: Setting, batch: int, steps: int) -> Episode:
    """Step bare pymunk spaces with our bodies, limits and walls, one after another."""
    import pymunk

    scenario = load_discs(setting.scenario)
    robots = list(scenario.robots.values())
    limits = np.array([(robot.force_limit, robot.force_limit, robot.torque_limit) for robot in robots])
    rows = make_rows(batch, 3 * setting.robots, steps).reshape(-1, setting.robots, 3) * limits
    actions = cut(rows.tolist(), batch, steps, setting.hold)
    worlds: list[tuple[pymunk.Space, list[pymunk.Body]]] = []

    def reset() -> None:
        worlds[:] = [make_space(scenario) for _ in range(batch)]

    def run(count: int) -> None:
        for action in actions[:count]:
            for (space, bodies), controls in zip(worlds, action, strict=True):
                for _ in range(SUBSTEPS):
                    for body, (fx, fy, torque) in zip(bodies, controls, strict=False):
                        body.apply_force_at_local_point((fx, fy))
                        body.torque = torque
                    space.step(scenario.control_period / SUBSTEPS)

    return Episode(reset, run)


def make_space(scenario: Any) -> tuple[Any, list[Any]]:
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
    return loop_over(envs, [dict(zip(envs[0].possible_agents, row, strict=True)) for row in rows], steps, setting.hold)


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
    agents = [cut(torch.tensor(rows[:, i]), batch, steps, setting.hold) for i in range(setting.robots)]
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

"""How time and memory of a world grow with bodies, and with nothing else: a yard with the same room for each body."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Iterable
from statistics import median
from typing import Any

import numpy as np

from impact_envs import Scenario, load_scenario, vector_env

SIZES = ((2, 1), (4, 3), (8, 7), (16, 15))  # robots, objects
WORLDS = 1024
SPACING = 2.0  # [m]


def make_yard(robots: int, objects: int) -> Scenario:
    """Return the bodies of ``crew``, as many as asked for, on a square grid between walls."""
    crew: Any = load_scenario("crew")
    side = math.ceil(math.sqrt(robots + objects))
    places = [(SPACING * (x + 0.5), SPACING * (y + 0.5)) for y, x in itertools.product(range(side), repeat=2)]
    robot = crew.robots["snap"].model_dump(exclude={"start", "goal"})
    body = crew.objects["pop"].model_dump(exclude={"start"})
    upper = [SPACING * side, SPACING * side]
    return crew.override(
        {
            "formula": "G[0,120] all in yard",
            "world": {"lower": [0.0, 0.0], "upper": upper},
            "regions": {"yard": {"lower": [0.0, 0.0], "upper": upper}},
            "obstacles": {},
            "robots": {f"robot{i}": robot | {"start": places[i], "goal": places[i]} for i in range(robots)},
            "objects": {f"object{i}": body | {"start": places[robots + i]} for i in range(objects)},
        }
    )


def count_bytes(arrays: Iterable[np.ndarray]) -> int:
    """Return the bytes of arrays, of which some may be views of others."""
    sizes: dict[int, int] = {}
    for array in arrays:
        address = array.__array_interface__["data"][0]
        sizes[address] = max(sizes.get(address, 0), array.nbytes)
    return sum(sizes.values())


def measure_memory(scenario: str | Scenario) -> dict[str, int]:
    """Return the bytes per world of what a batch keeps, and of the joint observation, which it does not."""
    sizes = {}
    names: tuple[Any, ...] = ("float64", "float32")
    for dtype in names:
        envs = vector_env(scenario, num_envs=WORLDS, threads=1, dtype=dtype)
        inner: Any = envs.batch
        kept = count_bytes((*inner._worlds, *inner._memory, inner._todo))
        sizes[f"bytes per world, {dtype}"] = round(kept / WORLDS)
        sizes[f"joint observation, {dtype}"] = round(inner.make_output(False).joint.nbytes / WORLDS)
    return sizes


def measure_growth(steps: int, repeats: int) -> list[dict[str, Any]]:
    """Return time and memory of a world over the number of bodies.

    Args:
        steps: control periods from reset.
        repeats: over whose times of the processor the median is taken.
    """
    rows = []
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (steps, WORLDS, 3 * SIZES[-1][0]))
    for robots, objects in SIZES:
        yard = make_yard(robots, objects)
        envs, seconds = vector_env(yard, num_envs=WORLDS, threads=1), []
        for _ in range(repeats + 1):  # the first one warms up
            envs.reset(seed=0)
            start = time.process_time()
            for action in actions:
                envs.step(action[:, : 3 * robots])
            seconds.append(time.process_time() - start)
        each = median(seconds[1:]) / (steps * WORLDS) * 1e6
        rows.append({"bodies": f"{robots}+{objects}", "us per env-step": f"{each:.3g}"} | measure_memory(yard))
    return rows

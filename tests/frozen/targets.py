"""Episodes of every domain by batch, as digests: what must not depend on which instructions the compiler may use.

`python -m tests.frozen.targets ACTIONS.npz` prints them as JSON, of the target that NUMBA_CPU_NAME and
NUMBA_CPU_FEATURES name. Every further function would be compiled for each target, so worlds are played by batch alone
(one equals many bit for bit by other tests), and by one expert, that of free-flyers; in the other domains actions are
those of the file.
"""

from __future__ import annotations

import hashlib
import json
import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from impact_envs import load_scenario
from impact_envs.domain import find_part
from planners import make_expert_batch
from tests.frozen.freeze import get_plan

# One scenario of each domain, in a suite that draws everything.
EXPERT = "throw_and_catch"
FOLLOWED = ("floating_manipulator_thrusters", "dual_arm_grasp")
SUITE = "all"
SEEDS = (1, 2)  # of the training range
KEPT = {EXPERT: {"plan_anew": False}}  # planning is done by solvers that numba does not compile


class Played(NamedTuple):
    """Hold some episodes: a digest of all that was done and measured, the actions, and how many impacts there were."""

    digest: str
    actions: np.ndarray
    impacts: int


def play(scenario: str, actions: np.ndarray | None = None) -> Played:
    """Play episodes.

    Args:
        scenario: shipped name.
        actions: to follow, shape (steps, worlds, ...); None: the expert's.
    """
    world, count = load_scenario(scenario).suite(SUITE), len(SEEDS)
    batch = find_part("impact_envs", world.domain, "BATCH")(world, count, None, threads=1)
    expert: Any = None
    if actions is None:
        expert = make_expert_batch(world, count, get_plan(scenario, SUITE), None, KEPT.get(scenario))
    output, digest, impacts, done = batch.make_output(agents=False), hashlib.sha256(), 0, []
    batch.seed(np.arange(count), np.array(SEEDS))
    batch.start(np.ones(count, bool), output)
    for step in range(world.steps - 1):  # the last one starts anew
        chosen = expert.act(output.joint) if actions is None else actions[step]
        done.append(np.array(chosen.reshape(count, *batch.action_shape), dtype="<f8"))
        batch.step(done[-1], output, None)
        impacts += int(batch.impacts.sum())
        for table in (done[-1], output.joint):
            digest.update(np.ascontiguousarray(table, dtype="<f8").tobytes())
    for one in (expert, batch):
        if one is not None:
            one.close()
    return Played(digest.hexdigest(), np.array(done), impacts)


def main(path: Path) -> None:
    """Print the digests of episodes; actions that are followed come from a file."""
    with np.load(path) as actions:
        digests = {name: play(name, actions[name]).digest for name in FOLLOWED}
    print(json.dumps({EXPERT: play(EXPERT).digest, **digests}))
    print(f"{time.process_time():.0f} s of CPU", file=sys.stderr)


if __name__ == "__main__":
    main(Path(sys.argv[1]))

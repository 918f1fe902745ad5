"""Episodes of every domain by batch, as digests: what must not depend on which instructions the compiler may use.

`python -m tests.frozen.targets` prints them as JSON, of the target that NUMBA_CPU_NAME and NUMBA_CPU_FEATURES name.
Worlds and experts by batch alone: other functions would have to be compiled too, which takes minutes for each target,
and one world equals many bit for bit by other tests.
"""

from __future__ import annotations

import hashlib
import json
import sys
import time
from typing import Any

import numpy as np

from impact_envs import load_scenario
from impact_envs.domain import find_part
from planners import make_expert_batch
from tests.frozen.freeze import get_plan

# One scenario of each domain, in a suite that draws everything.
SCENARIOS = ("throw_and_catch", "floating_manipulator_thrusters", "dual_arm_grasp")
SUITE = "all"
SEEDS = (1, 2)  # of the training range
KEPT = {"throw_and_catch": {"plan_anew": False}}  # planning is done by solvers that numba does not compile


def digest_episodes(scenario: str) -> dict[str, Any]:
    """Return the digest of every action and measurement of some episodes, and how many impacts there were."""
    world = load_scenario(scenario).suite(SUITE)
    count = len(SEEDS)
    batch = find_part("impact_envs", world.domain, "BATCH")(world, count, None, threads=1)
    experts = make_expert_batch(world, count, get_plan(scenario, SUITE), None, KEPT.get(scenario))
    output, digest, impacts = batch.make_output(agents=False), hashlib.sha256(), 0
    batch.seed(np.arange(count), np.array(SEEDS))
    batch.start(np.ones(count, bool), output)
    for _ in range(world.steps - 1):  # the last one starts anew
        actions = experts.act(output.joint)
        batch.step(actions.reshape(count, *batch.action_shape), output, None)
        impacts += int(batch.impacts.sum())
        for table in (actions, output.joint):
            digest.update(np.ascontiguousarray(table, dtype="<f8").tobytes())
    experts.close()
    batch.close()
    return {"digest": digest.hexdigest(), "impacts": impacts}


def digest_all() -> dict[str, dict[str, Any]]:
    """Return the digests of all scenarios."""
    return {scenario: digest_episodes(scenario) for scenario in SCENARIOS}


if __name__ == "__main__":
    print(json.dumps(digest_all()))
    print(f"{time.process_time():.0f} s of CPU", file=sys.stderr)

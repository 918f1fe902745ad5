"""Compile what many tests run before the tests start, every function in one process only.

numba compiles a function at its first call and keeps the code on disk. In a fresh clone the workers of a parallel run
would all compile the same functions at the same time. `python -m tests.compilation NAME` runs one of the `JOBS`.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from agents import ResidualVectorEnv
from agents.dual_arm.decision_loop import run_until_due as decide_for_arms
from agents.floating_manipulator.decision_loop import run_until_due as decide_for_manipulators
from agents.free_flyer.decision_loop import run_until_due
from impact_envs import parallel_env, rollout, vector_env
from impact_envs.compiled import is_compiled
from impact_envs.dual_arm.plant import advance_state as advance_arms
from impact_envs.floating_manipulator.events import advance_to_event as advance_manipulator
from impact_envs.free_flyer.engine import step_alone
from impact_envs.free_flyer.step import run_tuples
from impact_envs.rollout import ZeroPolicy
from planners import make_expert
from planners.dual_arm.world_loop import run_experts as run_arms_experts
from planners.floating_manipulator.world_loop import run_experts as run_manipulators
from planners.free_flyer.closed_loop.world_loop import run_experts

ROOT = Path(__file__).parents[1]


def compile_free_flyers_expert() -> None:
    """Act once, on observations that say nothing; and decide once."""
    env, expert = parallel_env("throw_and_catch"), make_expert("throw_and_catch")
    expert.reset(0)
    expert.act({agent: np.zeros(env.observation_space(agent).shape) for agent in env.possible_agents})
    ResidualVectorEnv("throw_and_catch", 1, plan=expert.plan, max_cycles=1, threads=1).reset(seed=0)


def compile_vector_environment() -> None:
    """Start one world; float32 is compiled apart, by slow tests."""
    vector_env("throw_and_catch", 1, threads=1).reset(seed=0)


def compile_engine_and_arms() -> None:
    """Fly for one period; grasp for one, start one world of many, and decide once."""
    env = parallel_env("throw_and_catch", max_cycles=1)
    rollout(env, ZeroPolicy(env), 0)
    compile_domain("dual_arm_grasp")


def compile_manipulators() -> None:
    """Reach for one period, start one world of many, also with an observation for each robot, and decide once."""
    from agents.vec_env import ImpactVecEnv  # imported here: it brings torch

    name = "floating_manipulator_thrusters"
    compile_domain(name)
    ImpactVecEnv(name, 1, per_robot=True, max_cycles=1, dtype="float64", threads=1).reset()


def compile_domain(name: str) -> None:
    """Call what plays a scenario of one world and of many, and what decides in many."""
    rollout(parallel_env(name, max_cycles=1), make_expert(name), 0)
    vector_env(name, 1, threads=1).reset(seed=0)
    ResidualVectorEnv(name, 1, max_cycles=1, threads=1).reset(seed=0)


# Name to what compiles, and the functions that tell whether it has; the longest first.
JOBS: dict[str, tuple[Callable[[], None], tuple[Callable[..., object], ...]]] = {
    "free-flyers' expert": (compile_free_flyers_expert, (run_experts, run_until_due)),
    "manipulators": (compile_manipulators, (advance_manipulator, run_manipulators, decide_for_manipulators)),
    "vector environment": (compile_vector_environment, (run_tuples,)),
    "engine and arms": (compile_engine_and_arms, (step_alone, advance_arms, run_arms_experts, decide_for_arms)),
}


def compile_what_is_missing(processes: int) -> None:
    """Run the jobs whose functions are not on disk, in several processes, and say so.

    Args:
        processes: that run at the same time.
    """
    missing = [name for name, (_, functions) in JOBS.items() if not all(map(is_compiled, functions))]
    if not missing:
        return
    start = time.perf_counter()
    print(f"compiling once, on {processes} cores: {', '.join(missing)} (about a minute)", flush=True)
    with ThreadPoolExecutor(processes) as pool:
        list(pool.map(lambda name: subprocess.run([sys.executable, "-m", __name__, name], cwd=ROOT), missing))
    print(f"compiled in {time.perf_counter() - start:.0f} s", flush=True)


if __name__ == "__main__":
    JOBS[sys.argv[1]][0]()

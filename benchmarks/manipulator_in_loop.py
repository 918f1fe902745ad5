"""Time the floating manipulator's closed loop, physics to robustness and expert: many worlds, one, and by users' doors.

    OMP_NUM_THREADS=1 python benchmarks/manipulator_in_loop.py --repeats 3 --out manipulator_in_loop.json

All in one run, taking turns, one thread, CPU time, whole episodes, medians.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from typing import Any

import tyro
from expert_in_loop import describe_machine, format_load, print_table

from impact_envs import parallel_env, rollout, vector_env
from impact_envs.errors import InputError
from impact_envs.floating_manipulator.schema import FloatingManipulatorScenario
from impact_envs.scenario import load_scenario
from planners import make_expert, make_expert_batch
from train.watch import exit_codes

BATCH, ONE, DOORS = "batch", "vector_env of one world", "parallel_env, rollout"
# Least that is asked, in seconds of the world per second of CPU.
REALTIME = {BATCH: 300.0, DOORS: 100.0}
SEED = 1_000_000  # of the tuning range


@dataclass
class Args:
    """Time the closed loop of floating manipulators."""

    scenario: str = "floating_manipulator_thrusters"
    """Shipped name or TOML file."""
    suite: str = "nominal"
    """How the true physics differ from the believed ones."""
    batch: int = 200
    """Number of worlds."""
    repeats: int = 3
    """Rounds over all loops."""
    out: Path | None = None
    """Write every measurement here as JSON."""


@dataclass(frozen=True)
class Run:
    """Hold one timed repeat: CPU time of all, and of the expert alone [s]."""

    loop: str
    worlds: int
    steps: int
    cpu_seconds: float
    expert_seconds: float


def main(args: Args) -> dict[str, Any]:
    """Measure, print the table, and return what the JSON file holds."""
    if min(args.repeats, args.batch) < 1:
        raise InputError("repeats and batch must be positive")
    scenario = load_scenario(args.scenario).suite(args.suite)
    if not isinstance(scenario, FloatingManipulatorScenario):
        raise InputError(f"{args.scenario}: domain {scenario.domain}; choices: floating_manipulator")
    machine = describe_machine()
    loops = [make_batch(BATCH, scenario, args.batch), make_batch(ONE, scenario, 1), make_doors(scenario)]
    runs = [loop() for _ in range(args.repeats) for loop in loops]
    machine["load after"] = format_load()
    rows = [make_row(scenario, name, [run for run in runs if run.loop == name]) for name in (BATCH, ONE, DOORS)]
    print(", ".join(f"{key} {value}" for key, value in machine.items()), end="\n\n")
    print_table(f"{scenario.name}, whole episodes of {scenario.horizon:g} s, one core", rows)
    record = {"args": asdict(args), "machine": machine, "rows": rows, "runs": [asdict(run) for run in runs]}
    if args.out:
        args.out.write_text(json.dumps(record, indent=1, default=str))
    return record


def make_batch(name: str, scenario: FloatingManipulatorScenario, worlds: int) -> Callable[[], Run]:
    """Return the loop of worlds in one thread."""
    envs, expert = (
        vector_env(scenario, worlds, threads=1, autoreset_mode="Disabled"),
        make_expert_batch(scenario, worlds),
    )

    def run() -> Run:
        observations, _ = envs.reset(seed=SEED)
        begin, acting = time.process_time(), 0.0
        for _ in range(scenario.steps):
            before = time.process_time()
            actions = expert.act(observations)
            acting += time.process_time() - before
            observations = envs.step(actions)[0]
        return Run(name, worlds, scenario.steps, time.process_time() - begin, acting)

    return run


def make_doors(scenario: FloatingManipulatorScenario) -> Callable[[], Run]:
    """Return the loop of one world that records an Episode."""
    env, expert = parallel_env(scenario), make_expert(scenario)

    def run() -> Run:
        begin = time.process_time()
        episode = rollout(env, expert, SEED)
        return Run(DOORS, 1, scenario.steps, time.process_time() - begin, float(episode.solve_seconds.sum()))

    return run


def make_row(scenario: FloatingManipulatorScenario, name: str, runs: list[Run]) -> dict[str, Any]:
    """Return what one loop takes, and what is asked."""
    per_world = [run.cpu_seconds / run.worlds for run in runs]
    cpu, period = median(per_world), scenario.control_period
    asked, rate = REALTIME.get(name), runs[0].steps * period / cpu
    return {
        "loop": name,
        "worlds": runs[0].worlds,
        "CPU of an episode [s]": cpu,
        "spread": (max(per_world) - min(per_world)) / (2 * cpu),
        "env-steps/s": runs[0].steps / cpu,
        "expert's share": median(run.expert_seconds / run.cpu_seconds for run in runs),
        "x realtime": rate,
        "asked": f">= {asked:g}" if asked else "",
        "met": "" if asked is None else "yes" if rate >= asked else "no",
    }


if __name__ == "__main__":
    with exit_codes():
        main(tyro.cli(Args))

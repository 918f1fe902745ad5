"""Time what a learner of corrections gets: decisions and control periods a second, one world at a time and many.

    OMP_NUM_THREADS=1 python benchmarks/training.py --scenario pong --suite hard --repeats 3

All ways in one run, taking turns; CPU time of all threads. The first way is how training ran before: ResidualEnv, one
world after the other in one process. `bare` is the compiled loop alone, answered with zeros, without features, infos
and rewards: what is lost between the two is Python's. Ctrl-C prints what is measured.
"""

from __future__ import annotations

import json
import resource
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import tyro
from expert_in_loop import describe_machine, format_load, print_table

from agents import ResidualEnv, ResidualVectorEnv
from agents.vec_env import ResidualVecEnv
from impact_envs.errors import InputError
from impact_envs.scenario import Scenario, load_scenario
from planners import has_planner, list_options, make_expert, make_plan
from planners.plan import Plan
from train.watch import exit_codes

SINGLE, BARE = "ResidualEnv, one world", "bare compiled loop, 1 thread"


@dataclass
class Args:
    """Time training environments."""

    scenario: str = "pong"
    """Shipped name or TOML file."""
    suite: str = "hard"
    """Mismatch suite of the true worlds."""
    worlds: int = 256
    """Worlds of the ways that have many."""
    decisions: int = 8
    """Decisions of every world in a repeat."""
    repeats: int = 3
    """Rounds over all ways."""
    tracker: str | None = None
    """What follows the courses of free-flyers; default: the expert's."""
    out: Path | None = None
    """Write every measurement here as JSON."""


@dataclass(frozen=True)
class Run:
    """One timed repeat."""

    way: str
    decisions: int
    periods: int
    cpu_seconds: float
    seconds: float


def main(args: Args) -> dict[str, Any]:
    """Measure, print the table, and return what the JSON file holds."""
    for name in ("worlds", "decisions", "repeats"):
        if getattr(args, name) < 1:
            raise InputError(f"{name} {getattr(args, name)} is too small; choices: 1, 2, ...")
    machine, ways, runs = describe_machine(), make_ways(args), list[Run]()
    try:
        for _ in range(args.repeats):
            for way, play in ways.items():
                runs.append(time_way(way, play))
    except KeyboardInterrupt:
        print(f"stopped after {len(runs)} measurements", file=sys.stderr)
    rows, machine["load after"] = make_rows(runs), format_load()
    print(", ".join(f"{key} {value}" for key, value in machine.items()), end="\n\n")
    print_table(f"{args.scenario} x {args.suite}, {args.worlds} worlds: medians", rows)
    record = {"args": asdict(args), "machine": machine, "rows": rows, "runs": [asdict(run) for run in runs]}
    if args.out:
        args.out.write_text(json.dumps(record, indent=1, default=str) + "\n", encoding="utf-8")
    return record


def make_ways(args: Args) -> dict[str, Callable[[], tuple[int, int]]]:
    """Return what is timed: name to a function that plays decisions and returns their number and that of periods."""
    scenario = load_scenario(args.scenario)
    world, plan = scenario.suite(args.suite), None
    plan = make_plan(world) if has_planner(world) else None
    options = make_options(world, args.tracker)
    many = (args.worlds, args.suite, plan, options)
    vectors = {threads: ResidualVectorEnv(scenario, *many, "SameStep", threads=threads) for threads in (1, 2)}
    ways: dict[str, Callable[[], tuple[int, int]]] = {SINGLE: make_single(scenario, args, plan, options)}
    for threads, worlds in vectors.items():
        ways[f"ResidualVectorEnv, {threads} thread{'s' * (threads > 1)}"] = make_vector(worlds, args.decisions)
    ways["ResidualVecEnv of SB3, 1 thread"] = make_sb3(ResidualVecEnv(scenario, *many, threads=1), args.decisions)
    ways[BARE] = make_bare(ResidualVectorEnv(scenario, *many, "Disabled", threads=1), args.decisions)
    return ways


def make_options(world: Scenario, tracker: str | None) -> dict[str, Any]:
    """Return the expert's options: nobody plans in the background, which would be timed too."""
    known = list_options(world)
    options: dict[str, Any] = {"plan_anew": False} if "plan_anew" in known else {}
    if tracker is not None:
        if "tracker" not in known:
            raise InputError(f"tracker '{tracker}': the expert of domain '{world.domain}' has none to choose from")
        options["tracker"] = tracker
    return options


def make_single(
    scenario: Scenario, args: Args, plan: Plan | None, options: dict[str, Any]
) -> Callable[[], tuple[int, int]]:
    """Return the way of one world: eight times the decisions of one of many, so that it takes long enough."""
    world = scenario.suite(args.suite)
    env, seeds = ResidualEnv(scenario, args.suite, plan, make_expert(world, plan, options=options)), iter(range(10**6))

    def play() -> tuple[int, int]:
        periods, over = 0, True
        for _ in range(8 * args.decisions):
            if over:
                periods += env.reset(seed=next(seeds))[1]["control_steps"]
            _, _, terminated, truncated, info = env.step(np.zeros(env.action_space.shape))
            over, periods = terminated or truncated, periods + info["control_steps"]
        return 8 * args.decisions, periods

    return play


def make_vector(worlds: ResidualVectorEnv, decisions: int) -> Callable[[], tuple[int, int]]:
    """Return the way through Gymnasium's vector door."""
    worlds.reset(seed=0)
    zeros = np.zeros(worlds.action_space.shape)

    def play() -> tuple[int, int]:
        periods = 0
        for _ in range(decisions):
            _, _, terminated, truncated, infos = worlds.step(zeros)
            periods += int(infos["control_steps"].sum())
            if "final_info" in infos:
                periods += int(infos["final_info"]["control_steps"][terminated | truncated].sum())
        return decisions * worlds.num_envs, periods

    return play


def make_sb3(worlds: ResidualVecEnv, decisions: int) -> Callable[[], tuple[int, int]]:
    """Return the way through Stable-Baselines3's door."""
    worlds.seed(0)
    worlds.reset()
    zeros = np.zeros((worlds.num_envs, *worlds.worlds.single_action_space.shape))

    def play() -> tuple[int, int]:
        before = worlds.worlds.batch.steps.copy()
        periods = 0
        for _ in range(decisions):
            _, _, ended, infos = worlds.step(zeros)
            now = worlds.worlds.batch.steps
            lengths = np.array([info["episode"]["l"] if info else 0 for info in infos])
            periods += int((now - before + lengths)[ended].sum() + (now - before)[~ended].sum())
            before = now.copy()
        return decisions * worlds.num_envs, periods

    return play


def make_bare(worlds: ResidualVectorEnv, decisions: int) -> Callable[[], tuple[int, int]]:
    """Return the compiled loop alone: decisions are answered, and ended worlds start, nothing is returned."""
    loop, count = worlds.decisions, worlds.num_envs
    zeros, seeds = np.zeros(worlds.action_space.shape), iter(range(10**9))
    loop.start(np.ones(count, bool), [next(seeds) for _ in range(count)])

    def play() -> tuple[int, int]:
        periods = 0
        for _ in range(decisions):
            running = loop.awaiting_correction
            loop.answer(running, zeros)
            periods += int(loop.steps[running].sum())
            over = worlds.batch.over
            if over.any():
                loop.start(over, [next(seeds) for _ in range(int(over.sum()))])
                periods += int(loop.steps[over].sum())
        return decisions * count, periods

    return play


def time_way(way: str, play: Callable[[], tuple[int, int]]) -> Run:
    """Play once."""
    cpu, start = read_cpu(), time.perf_counter()
    decisions, periods = play()
    return Run(way, decisions, periods, read_cpu() - cpu, time.perf_counter() - start)


def read_cpu() -> float:
    """Return the CPU time of this process, all threads [s]."""
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime


def make_rows(runs: list[Run]) -> list[dict[str, Any]]:
    """Return the median rates of every way, and what share of the bare loop's reaches the learner."""
    by_way: dict[str, list[Run]] = {}
    for run in runs:
        by_way.setdefault(run.way, []).append(run)

    def compute(found: list[Run], count: str, seconds: str) -> float:
        return median(getattr(run, count) / getattr(run, seconds) for run in found)

    first = by_way.get(SINGLE)
    base = compute(first, "periods", "cpu_seconds") if first else float("nan")
    bare = compute(by_way[BARE], "periods", "cpu_seconds") if BARE in by_way else float("nan")
    return [
        {
            "way": way,
            "decisions / CPU s": compute(found, "decisions", "cpu_seconds"),
            "env-steps / CPU s": compute(found, "periods", "cpu_seconds"),
            "over one world": compute(found, "periods", "cpu_seconds") / base,
            "of the bare loop": compute(found, "periods", "cpu_seconds") / bare,
            "env-steps / s": compute(found, "periods", "seconds"),
        }
        for way, found in by_way.items()
    ]


if __name__ == "__main__":
    with exit_codes():
        main(tyro.cli(Args))

"""Time the free-flyers' closed loop, physics to robustness and expert: many worlds, one world, one world by CasADi.

    OMP_NUM_THREADS=1 python benchmarks/expert_in_loop.py --repeats 5 --out expert_in_loop.json

All in one run, taking turns, one thread, CPU time, medians. Ctrl-C prints what is measured.
"""

from __future__ import annotations

import json
import math
import os
import platform
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import tyro
from expert_in_loop_methods import PUBLISHED as IPOPT
from expert_in_loop_methods import make_batch, make_published, make_single, record_problems, time_solvers
from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from impact_envs.errors import InputError
from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.scenario import load_scenario
from planners import make_plan
from train.watch import exit_codes

LQR, MPC, SINGLE, PUBLISHED = "batch, LQR", "batch, MPC", "one world, MPC", "one world, published MPC by ipopt"
# Least that is asked of our rates [env-steps/s] and of ratios; and most of the 99th percentile
# of `act` [us per robot].
RATES, RATIO, SOLVE_RATIO, LATEST = {LQR: 1e5, MPC: 1e4}, 100.0, 50.0, 1e3
NOTES = """\
loop: vector_env or parallel_env (physics, observation, reward, robustness) and the expert, from reset on; the published
  MPC takes the place of the tracker in few periods, half of them from the start and half round the first impact.
act: the whole of the expert's act, observing and replanning included, over the number of robots.
  Of a batch: the mean over worlds and robots, of one period.
solves: the recorded problems of an episode, in their order; each 200 times in a compiled loop by mpc and lqr, once by
  the others, which are compiled once and start from their last solution: a call of `Tracker.track` by casadi, which has
  the heading free to turn, and by cvxpy, which has the problem of mpc. The published form has 10 states and 6 inputs,
  as its code, but is one problem of scalar expressions where its code has one per position of the impact: faster than
  what the authors ran.
off: of a first input from that of mpc, over the limits; lqr sees no impact and no limit, the published form has other
  weights."""


@dataclass
class Args:
    """Time the closed loop."""

    scenario: str = "throw_and_catch"
    """Shipped name or TOML file of free-flyers that are discs."""
    batch: int = 1024
    """Number of worlds."""
    steps: int = 300
    """Control periods from reset that are timed, of an episode at most."""
    published_steps: int = 20
    """Control periods by the published MPC in every repeat, half of them before the first impact."""
    repeats: int = 5
    """Rounds over all loops."""
    out: Path | None = None
    """Write every measurement here as JSON."""


@dataclass(frozen=True)
class Run:
    """Hold one timed repeat; its wall time is that of all, untimed flight by LQR too."""

    method: str
    batch: int
    steps: int
    cpu_seconds: float
    seconds: float


@dataclass
class Findings:
    """Hold what is measured so far."""

    runs: list[Run] = field(default_factory=list)
    acts: dict[str, list[float]] = field(default_factory=dict)  # CPU time of `act` per world and robot [s]
    solves: list[dict[str, Any]] = field(default_factory=list)


def main(args: Args) -> dict[str, Any]:
    """Measure, print the tables, and return what the JSON file holds."""
    if min(args.repeats, args.steps, args.batch, args.published_steps) < 1:
        raise InputError("repeats, steps, published_steps and batch must be positive")
    scenario = load_scenario(args.scenario)
    if not isinstance(scenario, FreeFlyerScenario):
        raise InputError(f"{args.scenario}: domain {scenario.domain} has no such loop; choices: free_flyer")
    machine, found = describe_machine(), Findings()
    try:
        measure_all(args, scenario, found)
    except KeyboardInterrupt:
        print(f"stopped after {len(found.runs)} measurements", file=sys.stderr)
    machine["load after"] = format_load()
    rows = make_rows(found)
    checks = make_checks(rows, found.solves)
    print(", ".join(f"{key} {value}" for key, value in machine.items()), end="\n\n")
    print_table("env-steps/s of CPU time on one core: median, and half the spread of the repeats", rows)
    print_table("MPC solves", found.solves)
    print_table("asked and found", checks)
    print(NOTES)
    record = {"machine": machine, "args": asdict(args), "rows": rows, "checks": checks, **asdict(found)}
    if args.out:
        args.out.write_text(json.dumps(record, indent=1, default=str) + "\n", encoding="utf-8")
    return record


def measure_all(args: Args, scenario: FreeFlyerScenario, found: Findings) -> None:
    """Fill in all findings, round by round."""
    plan = make_plan(scenario)
    steps = min(args.steps, round(scenario.horizon / scenario.control_period))
    loops = {
        LQR: make_batch(scenario, plan, args.batch, "lqr"),
        MPC: make_batch(scenario, plan, args.batch, "mpc"),
        SINGLE: make_single(scenario, plan),
        PUBLISHED: make_published(scenario, plan),
    }
    counts = dict.fromkeys(loops, steps) | {PUBLISHED: min(args.published_steps, steps)}
    for loop in loops.values():
        loop.run(1)  # compiles
    for _ in range(args.repeats):
        for name, loop in loops.items():
            start = time.perf_counter()
            cpu_seconds = loop.run(counts[name])
            found.runs.append(Run(name, loop.batch, counts[name], cpu_seconds, time.perf_counter() - start))
            found.acts.setdefault(name, []).extend(act / loop.batch / len(scenario.robots) for act in loop.acts)
    found.solves.extend(time_solvers(record_problems(scenario, plan, steps)))


def make_rows(found: Findings) -> list[dict[str, Any]]:
    """Return rate, share of the expert and times of `act` of every loop that is measured."""
    rates: dict[str, list[float]] = {}
    for run in found.runs:
        rates.setdefault(run.method, []).append(run.batch * run.steps / run.cpu_seconds)
    peer = median(rates[PUBLISHED]) if PUBLISHED in rates else math.nan
    rows = []
    for name, values in rates.items():
        acts, rate = np.array(found.acts[name]) * 1e6, median(values)
        rows.append(
            {
                "loop": name,
                "env-steps/s": rate,
                "spread": (max(values) - min(values)) / (2 * rate),
                "over published": rate / peer,
                "act p50 [us]": float(np.percentile(acts, 50)),
                "act p99 [us]": float(np.percentile(acts, 99)),
                "repeats": len(values),
            }
        )
    return rows


def make_checks(rows: Sequence[dict[str, Any]], solves: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return what was asked beside what was found, as far as it is measured."""
    loops = {row["loop"]: row for row in rows}
    checks = [
        (f"{name}: env-steps/s", least, loops[name]["env-steps/s"]) for name, least in RATES.items() if name in loops
    ]
    if {MPC, PUBLISHED} <= loops.keys():
        checks.append((f"{MPC} / {PUBLISHED}", RATIO, loops[MPC]["over published"]))
    checks += [
        (f"{row['method']} / mpc, {row['problems']}", SOLVE_RATIO, row["mean / mpc"])
        for row in solves
        if row["method"] == IPOPT and row["problems"] != "no impact ahead"
    ]
    found = [
        {"what": what, "asked": f">= {least:g}", "found": value, "met": bool(value >= least)}
        for what, least, value in checks
    ]
    if SINGLE in loops:
        late = loops[SINGLE]["act p99 [us]"]
        found.append(
            {"what": "p99 of act per robot [us]", "asked": f"< {LATEST:g}", "found": late, "met": late < LATEST}
        )
    return found


def describe_machine() -> dict[str, str]:
    """Return what times depend on, the load average before the start among it."""
    packages = {package: version(package) for package in ("numba", "numpy", "casadi")}
    return {
        "processor": platform.processor() or platform.machine(),
        "cores": str(len(os.sched_getaffinity(0))),
        "load before": format_load(),
        "OMP_NUM_THREADS": os.environ.get("OMP_NUM_THREADS", "unset"),
        "python": platform.python_version(),
        **packages,
    }


def format_load() -> str:
    """Return the load averages over 1, 5 and 15 minutes."""
    return "/".join(f"{load:.1f}" for load in os.getloadavg())


def format_value(value: Any) -> str:
    """Return a number with three digits, large ones whole; anything else as it is."""
    if not isinstance(value, float):
        return str(value)
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"


def print_table(title: str, rows: Sequence[dict[str, Any]]) -> None:
    """Print rows of text or numbers."""
    if not rows:
        return
    print(title)
    table = Table(box=box.MARKDOWN)
    for name, value in rows[0].items():
        table.add_column(escape(name), justify="left" if isinstance(value, str) else "right", no_wrap=True)
    for row in rows:
        table.add_row(*(escape(format_value(value)) for value in row.values()))
    Console(width=200).print(table)


if __name__ == "__main__":
    with exit_codes():
        main(tyro.cli(Args))

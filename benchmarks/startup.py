"""Time how long the command needs to start: CPU seconds of whole processes, beside bare Python and gymnasium.

    python benchmarks/startup.py --repeats 7

Each process runs once before it counts, so compiled code and bytecode are on disk.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from dataclasses import dataclass
from statistics import median

import tyro
from rich.console import Console
from rich.table import Table

from train.watch import exit_codes

IMPACT = ("-m", "train.cli.main")
PROCESSES = {
    "python -c pass": ("-c", "pass"),
    "import gymnasium": ("-c", "import gymnasium"),
    "import impact_envs": ("-c", "import impact_envs"),
    "impact --help": (*IMPACT, "--help"),
    "impact list": (*IMPACT, "list"),
    "impact run throw_and_catch": (*IMPACT, "run", "throw_and_catch"),
}


@dataclass
class Args:
    """Time how long commands need to start."""

    repeats: int = 5
    """Runs of each process; the median counts."""


def measure(arguments: tuple[str, ...]) -> tuple[float, float]:
    """Return CPU and wall time of a Python process [s].

    Args:
        arguments: of the interpreter.
    """
    start = time.perf_counter()
    process = subprocess.Popen([sys.executable, *arguments], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"{' '.join(arguments)}: exit code {process.returncode}")
    return usage.ru_utime + usage.ru_stime, time.perf_counter() - start


def main(args: Args) -> dict[str, tuple[float, float]]:
    """Print a table of median CPU and wall times; returns them by process [s]."""
    for arguments in PROCESSES.values():
        measure(arguments)
    times: dict[str, list[tuple[float, float]]] = {name: [] for name in PROCESSES}
    for _ in range(args.repeats):  # taking turns, so that all see the same machine
        for name, arguments in PROCESSES.items():
            times[name].append(measure(arguments))
    medians = {name: (median(cpu for cpu, _ in runs), median(wall for _, wall in runs)) for name, runs in times.items()}
    table = Table("process", "CPU [s]", "wall [s]", title=f"median of {args.repeats}")
    for name, (cpu, wall) in medians.items():
        table.add_row(name, f"{cpu:.2f}", f"{wall:.2f}")
    Console().print(table)
    return medians


if __name__ == "__main__":
    with exit_codes():
        main(tyro.cli(Args))

"""Time our engine beside its peers: same machine, same run, random actions from reset on, taking turns, medians.

    OMP_NUM_THREADS=1 python benchmarks/engine.py --out engine.json --plot docs/engine.png

Peers are optional (pip install vmas mpe2); without them their rows are left out. Ctrl-C prints what is measured.
"""

from __future__ import annotations

import json
import os
import platform
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from statistics import median
from typing import Any

import tyro
from engine_growth import measure_growth
from engine_methods import (
    BARE_PYMUNK,
    COMPILED,
    INSTALL,
    PETTINGZOO,
    PYMUNK,
    SPREAD,
    VECTOR,
    VMAS,
    Episode,
    Method,
    Setting,
    check_settings,
    make_methods,
)
from rich import box
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from impact_envs.errors import InputError

WARM_UP = 5  # steps before a method's first repeat
# Ours over a peer's, door beside like door.
PAIRS = (
    (COMPILED, BARE_PYMUNK),
    (VECTOR, VMAS),
    (PETTINGZOO, VMAS),
    (PETTINGZOO, PYMUNK),
    (VECTOR, PYMUNK),
    (PETTINGZOO, SPREAD),
    (VECTOR, SPREAD),
)


@dataclass
class Args:
    """Time the engine and its peers."""

    settings: tuple[str, ...] = ("2+1", "4+3")
    """Robots + objects."""
    batches: tuple[int, ...] = (1, 32, 1024, 8192, 65536)
    """Numbers of worlds."""
    looped: int = 1024
    """Largest batch of peers that step one world after another in Python."""
    steps: int = 100
    """Control periods from reset that a repeat times; the reset itself is not timed."""
    repeats: int = 5
    """Rounds over all methods at a setting and batch size."""
    budget: float = 30.0
    """Wall time after which a method is not repeated again at a setting and batch size; once is always [s]."""
    growth: bool = True
    """Measure time and memory over the number of bodies as well."""
    out: Path | None = None
    """Write every measurement here as JSON."""
    plot: Path | None = None
    """Write the plot here as PNG."""


@dataclass(frozen=True)
class Run:
    """Hold one timed repeat: `batch` worlds, `steps` control periods each."""

    setting: str
    method: str
    batch: int
    steps: int
    seconds: float
    cpu_seconds: float  # of all threads of this process


class Bench:
    """What is measured so far, and what could not be."""

    def __init__(self) -> None:
        self.runs: list[Run] = []
        self.missing: dict[str, str] = {}


def main(args: Args) -> dict[str, Any]:
    """Measure, print the tables, and return what the JSON file holds."""
    if min(args.repeats, args.steps, *args.batches) < 1 or not args.budget > 0:
        raise InputError("repeats, steps, batches and budget must be positive")
    settings, methods = check_settings(args.settings), make_methods(args.looped, max(args.batches))
    machine, bench, growth = describe_machine(), Bench(), []
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    try:
        with Progress(*columns, console=Console(stderr=True), refresh_per_second=1) as bar:
            cells = [(setting, batch) for setting in settings for batch in args.batches]
            task = bar.add_task("compiling", total=len(cells) * args.repeats)
            for setting, batch in cells:
                bar.update(task, description=f"{setting.name}, batch {batch}: making")
                chosen = [method for method in methods if batch <= method.largest]
                episodes = make_episodes(bench, chosen, setting, batch, args.steps)
                for turn in range(args.repeats):
                    bar.update(task, description=f"{setting.name}, batch {batch}")
                    measure_round(bench, episodes, setting.name, batch, args, turn)
                    bar.advance(task)
            if args.growth:
                bar.update(task, description="growth with bodies")
                growth = measure_growth(args.steps, args.repeats)
    except KeyboardInterrupt:
        print(f"stopped after {len(bench.runs)} measurements", file=sys.stderr)
    machine["load after"] = format_load()
    rates, ratios = make_rates(bench.runs, methods), make_ratios(bench.runs, methods)
    print_results(machine, methods, bench, rates, ratios, growth)
    record = {"machine": machine, "args": asdict(args), "rates": rates, "ratios": ratios, "growth": growth}
    record |= {"missing": bench.missing, "runs": [asdict(run) for run in bench.runs]}
    if args.out:
        args.out.write_text(json.dumps(record, indent=1, default=str) + "\n", encoding="utf-8")
    if args.plot and rates:
        from engine_plot import draw_rates

        draw_rates(rates, args.plot)
    return record


def describe_machine() -> dict[str, str]:
    """Return what times depend on, the load average before the start among it."""
    packages = {}
    for package in ("numba", "numpy", "torch", "pymunk", "vmas", "mpe2"):
        try:
            packages[package] = version(package)
        except PackageNotFoundError:
            continue
    return {
        "processor": platform.processor() or platform.machine(),
        "cores": str(len(os.sched_getaffinity(0))),
        "load before": format_load(),
        "python": platform.python_version(),
        **packages,
    }


def format_load() -> str:
    """Return the load averages over 1, 5 and 15 minutes."""
    return "/".join(f"{load:.1f}" for load in os.getloadavg())


def make_episodes(
    bench: Bench, methods: Sequence[Method], setting: Setting, batch: int, steps: int
) -> dict[str, Episode]:
    """Return the warm worlds of all methods whose packages are there."""
    episodes = {}
    for method in methods:
        try:
            episode = method.make(setting, batch, steps)
        except ImportError as error:
            bench.missing[method.name] = f"{method.name} is left out: {error}; {INSTALL}"
            continue
        episode.reset()
        episode.run(min(WARM_UP, steps))
        episodes[method.name] = episode
    return episodes


def measure_round(bench: Bench, episodes: dict[str, Episode], setting: str, batch: int, args: Args, turn: int) -> None:
    """Time every method once, unless its time is spent."""
    for name, episode in episodes.items():
        spent = sum(run.seconds for run in bench.runs if (run.setting, run.batch, run.method) == (setting, batch, name))
        if turn and spent > args.budget:
            continue
        episode.reset()
        start, cpu_start = time.perf_counter(), time.process_time()
        episode.run(args.steps)
        seconds, cpu_seconds = time.perf_counter() - start, time.process_time() - cpu_start
        bench.runs.append(Run(setting, name, batch, args.steps, seconds, cpu_seconds))


def make_rates(runs: Sequence[Run], methods: Sequence[Method]) -> list[dict[str, Any]]:
    """Return median, least and greatest env-steps/s of every method, setting and batch size that is measured."""
    found: dict[tuple[str, str, int], list[Run]] = {}
    for run in runs:
        found.setdefault((run.setting, run.method, run.batch), []).append(run)
    walls = {method.name: method.wall for method in methods}
    rates = []
    for (setting, name, batch), group in found.items():
        cpu = [run.batch * run.steps / max(run.cpu_seconds, 1e-9) for run in group]
        wall = [run.batch * run.steps / run.seconds for run in group]
        used = wall if walls[name] else cpu
        row = {"setting": setting, "method": name, "batch": batch, "clock": "wall" if walls[name] else "cpu"}
        row |= {"rate": median(used), "least": min(used), "greatest": max(used), "repeats": len(group)}
        rates.append(row | {"cpu_rate": median(cpu), "wall_rate": median(wall)})
    return rates


def make_ratios(runs: Sequence[Run], methods: Sequence[Method]) -> list[dict[str, Any]]:
    """Return our median rate over a peer's, both of CPU time, wherever both are measured."""
    rates = {(row["setting"], row["batch"], row["method"]): row["cpu_rate"] for row in make_rates(runs, methods)}
    ratios = []
    for setting, batch in dict.fromkeys((run.setting, run.batch) for run in runs):
        for ours, peer in PAIRS:
            if {(setting, batch, ours), (setting, batch, peer)} <= rates.keys():
                ratio = rates[setting, batch, ours] / rates[setting, batch, peer]
                ratios.append({"setting": setting, "ours": ours, "peer": peer, "batch": batch, "ratio": ratio})
    return ratios


def make_rows(entries: Sequence[dict[str, Any]], keys: tuple[str, ...], cells: Sequence[str]) -> list[dict[str, str]]:
    """Return one row of text per combination of the keys, with a column per batch size; "-" is not measured."""
    batches = sorted({entry["batch"] for entry in entries})
    rows: dict[tuple[str, ...], dict[str, str]] = {}
    for entry, cell in zip(entries, cells, strict=True):
        head = {key: str(entry[key]) for key in keys}
        empty = {f"batch {batch}": "-" for batch in batches}
        rows.setdefault(tuple(head.values()), head | empty)[f"batch {entry['batch']}"] = cell
    return list(rows.values())


def format_number(value: float) -> str:
    """Return three digits with M or k."""
    scale, unit = (1e6, " M") if value >= 1e6 else (1e3, " k") if value >= 1e3 else (1.0, "")
    scaled = value / scale
    return f"{scaled:.{2 if scaled < 10 else 1 if scaled < 100 else 0}f}{unit}"


def format_rate(row: dict[str, Any]) -> str:
    """Return the median with half the spread of all repeats."""
    spread = (row["greatest"] - row["least"]) / (2 * row["rate"])
    return f"{format_number(row['rate'])} ± {spread:.0%}" if row["repeats"] > 1 else format_number(row["rate"])


def print_results(
    machine: dict[str, str],
    methods: Sequence[Method],
    bench: Bench,
    rates: Sequence[dict[str, Any]],
    ratios: Sequence[dict[str, Any]],
    growth: Sequence[dict[str, Any]],
) -> None:
    """Print the tables, which are Markdown too, and what they say."""
    console = Console(width=200, soft_wrap=True)
    text = {"markup": False, "highlight": False}
    console.print(", ".join(f"{key} {value}" for key, value in machine.items()), **text)
    print_table(
        console,
        "env-steps/s per second of CPU time",
        make_rows(rates, ("setting", "method"), [*map(format_rate, rates)]),
    )
    cells = [format(row["ratio"], ".3g" if row["ratio"] < 100 else ".0f") for row in ratios]
    print_table(console, "ours / peer", make_rows(ratios, ("setting", "ours", "peer"), cells))
    print_table(console, "growth", [{key: str(value) for key, value in row.items()} for row in growth])
    for method in methods:
        console.print(f"{method.name}: {method.note}", **text)
    for line in bench.missing.values():
        console.print(line, **text)


def print_table(console: Console, title: str, rows: Sequence[dict[str, str]]) -> None:
    """Print rows of text."""
    if not rows:
        return
    table = Table(title=title, box=box.MARKDOWN, title_justify="left")
    for name in rows[0]:
        table.add_column(name, justify="right" if name.startswith("batch") else "left", no_wrap=True)
    for row in rows:
        table.add_row(*row.values())
    console.print(table)


if __name__ == "__main__":
    try:
        main(tyro.cli(Args))
    except InputError as error:
        sys.exit(f"error: {error}")

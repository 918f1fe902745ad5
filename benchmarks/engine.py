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
from dataclasses import asdict, dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from statistics import median
from typing import Any

import tyro
from engine_parts.growth import measure_growth, measure_memory
from engine_parts.methods import (
    BARE_PYMUNK,
    COMPILED,
    PETTINGZOO,
    PYMUNK,
    SPREAD,
    VECTOR,
    VMAS,
    Method,
    check_settings,
    make_methods,
)
from engine_parts.ours import Episode, Setting, count_impacts
from engine_parts.peers import INSTALL
from engine_parts.plot import draw_rates
from rich import box
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from impact_envs.errors import InputError
from train.watch import exit_codes

WARM_UP = 5  # steps before a method's first repeat
COUNTED = 1024  # worlds whose impacts are counted
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
    hold: int = 1
    """Control periods that each random action is held: more of them bring more impacts."""
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


@dataclass
class Findings:
    """Hold what is measured so far, and a line for each method that is missing."""

    runs: list[Run] = field(default_factory=list)
    episodes: list[dict[str, Any]] = field(default_factory=list)
    growth: list[dict[str, Any]] = field(default_factory=list)
    missing: dict[str, str] = field(default_factory=dict)


def main(args: Args) -> dict[str, Any]:
    """Measure, print the tables, and return what the JSON file holds."""
    if min(args.repeats, args.steps, args.hold, *args.batches) < 1 or not args.budget > 0:
        raise InputError("repeats, steps, hold, batches and budget must be positive")
    machine, found = describe_machine(), Findings()
    settings, methods = check_settings(args.settings, args.hold), make_methods(args.looped, max(args.batches))
    try:
        measure_all(args, settings, methods, found)
    except KeyboardInterrupt:
        print(f"stopped after {len(found.runs)} measurements", file=sys.stderr)
    machine["load after"] = format_load()
    rates = make_rates(found.runs, methods)
    ratios = make_ratios(rates)
    print(", ".join(f"{key} {value}" for key, value in machine.items()), end="\n\n")
    print_results(found, rates, ratios)
    print(*(f"{method.name}: {method.note}" for method in methods), *found.missing.values(), sep="\n")
    record = {"machine": machine, "args": asdict(args), "rates": rates, "ratios": ratios, **asdict(found)}
    if args.out:
        args.out.write_text(json.dumps(record, indent=1, default=str) + "\n", encoding="utf-8")
    if args.plot and rates:
        draw_rates(rates, args.plot)
    return record


def measure_all(args: Args, settings: Sequence[Setting], methods: Sequence[Method], found: Findings) -> None:
    """Fill in all findings, cell by cell."""
    cells = [(setting, batch) for setting in settings for batch in args.batches]
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), refresh_per_second=1) as bar:
        task = bar.add_task("compiling", total=len(cells) * args.repeats)
        for setting in settings:
            counted = count_impacts(setting, min(COUNTED, max(args.batches)), args.steps)
            found.episodes.append(counted | measure_memory(setting.scenario))
        for setting, batch in cells:
            bar.update(task, description=f"{setting.name}, batch {batch}")
            chosen = [method for method in methods if batch <= method.largest]
            episodes = make_episodes(found.missing, chosen, setting, batch, args.steps)
            for turn in range(args.repeats):
                measure_round(found.runs, episodes, setting.name, batch, args, turn)
                bar.advance(task)
        if args.growth:
            bar.update(task, description="growth with bodies")
            found.growth.extend(measure_growth(args.steps, args.repeats))


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
    missing: dict[str, str], methods: Sequence[Method], setting: Setting, batch: int, steps: int
) -> dict[str, Episode]:
    """Return the warm worlds of all methods whose packages are there."""
    episodes = {}
    for method in methods:
        try:
            episode = method.make(setting, batch, steps)
        except (ImportError, InputError) as error:
            remedy = f"; {INSTALL}" if isinstance(error, ImportError) else ""
            missing[method.name] = f"{method.name} is left out: {error}{remedy}"
            continue
        episode.reset()
        episode.run(min(WARM_UP, steps))
        episodes[method.name] = episode
    return episodes


def measure_round(
    runs: list[Run], episodes: dict[str, Episode], setting: str, batch: int, args: Args, turn: int
) -> None:
    """Time every method once, unless its time is spent."""
    for name, episode in episodes.items():
        spent = sum(run.seconds for run in runs if (run.setting, run.batch, run.method) == (setting, batch, name))
        if turn and spent > args.budget:
            continue
        episode.reset()
        start, cpu_start = time.perf_counter(), time.process_time()
        episode.run(args.steps)
        seconds, cpu_seconds = time.perf_counter() - start, time.process_time() - cpu_start
        runs.append(Run(setting, name, batch, args.steps, seconds, cpu_seconds))


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


def make_ratios(rates: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return our median rate over a peer's, both of CPU time, wherever both are measured."""
    known = {(row["setting"], row["batch"], row["method"]): row["cpu_rate"] for row in rates}
    ratios = []
    for setting, batch in dict.fromkeys((row["setting"], row["batch"]) for row in rates):
        for ours, peer in PAIRS:
            if {(setting, batch, ours), (setting, batch, peer)} <= known.keys():
                ratio = known[setting, batch, ours] / known[setting, batch, peer]
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


def count_robots(setting: str) -> int:
    """Return the robots of a setting such as 2+1."""
    return int(setting.partition("+")[0])


def format_number(value: float) -> str:
    """Return three digits with M or k."""
    scale, unit = (1e6, " M") if value >= 1e6 else (1e3, " k") if value >= 1e3 else (1.0, "")
    scaled = value / scale
    return f"{scaled:.{2 if scaled < 10 else 1 if scaled < 100 else 0}f}{unit}"


def format_rate(row: dict[str, Any]) -> str:
    """Return the median with half the spread of all repeats."""
    spread = (row["greatest"] - row["least"]) / (2 * row["rate"])
    return f"{format_number(row['rate'])} ± {spread:.0%}" if row["repeats"] > 1 else format_number(row["rate"])


def print_results(found: Findings, rates: Sequence[dict[str, Any]], ratios: Sequence[dict[str, Any]]) -> None:
    """Print the tables, which are Markdown as well."""
    table = make_rows(rates, ("setting", "method"), [*map(format_rate, rates)])
    for setting in dict.fromkeys(row["setting"] for row in table):
        table += [dict.fromkeys(table[0], "-") | {"setting": setting, "method": name} for name in found.missing]
    print_table("env-steps/s of CPU time, of wall time on all cores or a GPU; median ± half the spread", table)
    agent_steps = [format_number(row["rate"] * count_robots(row["setting"])) for row in rates]
    print_table("the same in agent-steps/s: a step of one robot", make_rows(rates, ("setting", "method"), agent_steps))
    cells = [format(row["ratio"], ".3g" if row["ratio"] < 100 else ".0f") for row in ratios]
    print_table("ours / peer, CPU time", make_rows(ratios, ("setting", "ours", "peer"), cells))
    print_table("impacts in these episodes, memory of a world", found.episodes)
    print_table("growth with bodies at equal room for each", found.growth)


def print_table(title: str, rows: Sequence[dict[str, Any]]) -> None:
    """Print rows of text or numbers."""
    if not rows:
        return
    print(title)
    table = Table(box=box.MARKDOWN)
    for name in rows[0]:
        table.add_column(name, justify="right" if name.startswith("batch") else "left", no_wrap=True)
    for row in rows:
        table.add_row(*map(str, row.values()))
    Console(width=200).print(table)


if __name__ == "__main__":
    with exit_codes():
        main(tyro.cli(Args))

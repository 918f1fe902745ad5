"""Measure what bounds an evaluation on a cluster, and model its time on more cores.

    python benchmarks/scaling.py --ray

Measured on this machine, in processor time, so that other work on it does not count: rows a core plays each second,
bytes of a row, what a new worker costs, and what the one process that asks pays for each shard and each row. Modelled
past the cores that are here: ``docs/scaling.md`` says what the model leaves out.
"""

from __future__ import annotations

import json
import math
import os
import pickle
import sys
import tempfile
import time
import tracemalloc
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd
import tyro
from rich.console import Console
from rich.table import Table
from startup import measure

from train.evaluation.batch_player import play_batched
from train.evaluation.case import TUNING_SEEDS, make_case
from train.evaluation.evaluate import make_plans
from train.evaluation.journal import Journal, row_key
from train.evaluation.metrics import summarize
from train.evaluation.player import Job
from train.evaluation.shard import ShardSizes
from train.evaluation.statistics import compare
from train.watch import exit_codes

CORES = (2, 64, 1000)
WORK = (
    "from train.evaluation.case import make_case; from train.evaluation.batch_player import play_batched; "
    "from train.evaluation.player import Job; list(play_batched([make_case('throw_and_catch', 'hard')], "
    "[Job(0, 'expert', 1)]))"
)


@dataclass
class Args:
    """Measure what bounds an evaluation on a cluster."""

    cases: tuple[str, ...] = (
        "throw_and_catch/zero",
        "throw_and_catch/lqr",
        "throw_and_catch/mpc",
        "corridor/lqr",
        "corridor/mpc",
    )
    """SCENARIO/zero, SCENARIO/lqr or SCENARIO/mpc: no control, or the expert with that tracker."""
    rows: int = 100
    """Episodes of each."""
    tasks: int = 500
    """Empty shards that Ray is given to measure what one costs."""
    ray: bool = False
    """Start Ray on this machine and measure it; without, its cost per shard is --shard-ms."""
    shard_ms: float = 1.0
    """Cost of a shard to who asks, where Ray is not measured [ms]."""


@dataclass(frozen=True)
class Costs:
    """What the one process that asks pays, and a new worker [s].

    Attributes:
        shard: for handing out and taking back a shard of one row.
        row: for taking and writing down another row.
        table: at the end, for a row of tables and statistics.
        start: processor time of a new worker until its first episode is over.
    """

    shard: float
    row: float
    table: float
    start: float


def play_rows(name: str, count: int) -> tuple[float, list[dict[str, Any]]]:
    """Return the processor time of a row [s], when all is compiled, and the rows.

    Args:
        name: SCENARIO/zero, SCENARIO/lqr or SCENARIO/mpc.
        count: of rows.
    """
    scenario, _, kind = name.partition("/")
    case = make_case(scenario, "hard", {} if kind == "zero" else {"expert.tracker": kind})
    policy = "zero" if kind == "zero" else "expert"
    jobs = [Job(0, policy, TUNING_SEEDS + k) for k in range(count)]
    (case,) = make_plans([case], jobs)
    list(play_batched([case], jobs[:2]))
    start = read_cpu()
    rows = [row for row, _ in play_batched([case], jobs)]
    return (read_cpu() - start) / count, rows


def read_cpu() -> float:
    """Return the processor time of this process and of those that it has ended [s]."""
    used = os.times()
    return used.user + used.system + used.children_user + used.children_system


def measure_writing(rows: list[dict[str, Any]]) -> tuple[float, float]:
    """Return what writing down a row costs, and a row of the tables at the end, where five policies are compared [s].

    Args:
        rows: of one policy.
    """
    with tempfile.TemporaryDirectory() as folder:
        journal = Journal(folder, {})
        start = time.process_time()
        for row in rows:
            journal.append(row, None)
        row_seconds = (time.process_time() - start) / len(rows)
    many = [row | {"seed": k, "policy": policy} for policy in "abcde" for k, row in enumerate(rows * 2)]
    for count in (10, len(many)):  # the first one imports what statistics need
        start = time.process_time()
        table = pd.DataFrame([dict(row) for row in {row_key(row): row for row in many[-count:]}.values()])
        summarize(table)
        compare(table)
    return row_seconds, (time.process_time() - start) / len(many)


def measure_memory(rows: list[dict[str, Any]]) -> float:
    """Return the memory of a row where it was read or taken [bytes]."""
    lines = [json.dumps(row) for row in rows]
    tracemalloc.start()
    try:
        held = {row_key(row): row for row in map(json.loads, lines)}
        return tracemalloc.get_traced_memory()[0] / len(held)
    finally:
        tracemalloc.stop()


def measure_shards(rows: list[dict[str, Any]], tasks: int, size: int) -> tuple[float, float]:
    """Return what a shard of one row costs who asks, and another row of it, on Ray [s].

    Args:
        rows: some to be sent back.
        tasks: shards to be given.
        size: rows of the larger shards.
    """
    from train.launch.ray import RayLauncher

    launcher, times = RayLauncher(), list[float]()
    try:
        for count in (1, 1, size):  # the first one starts the workers
            given = (rows * (1 + count // len(rows)))[:count]
            start = time.process_time()
            with closing(launcher.run(partial(start_echo, given), range(tasks))) as found:
                assert sum(1 for _ in found) == tasks * count
            times.append((time.process_time() - start) / tasks)
    finally:
        launcher.close()
    return times[1], (times[2] - times[1]) / (size - 1)


def start_echo(rows: list[dict[str, Any]]) -> Callable[[int], list[tuple[dict[str, Any], None]]]:
    """Return what answers each task with the same rows."""
    return lambda task: [(row, None) for row in rows]


def model_time(rows: int, second: float, size: int, cores: int, costs: Costs) -> tuple[float, str]:
    """Return how long it takes on some cores until the last row is there [s], and what takes most of it.

    Args:
        rows: to be played.
        second: processor time of a row on its core [s].
        size: rows of a shard.
        cores: that play; the process that asks has one more.
        costs: of that process, and of a new worker.
    """
    shards = math.ceil(rows / size)
    parts = {
        "playing": costs.start + math.ceil(shards / cores) * size * second,
        "handing out": shards * costs.shard + rows * costs.row,
    }
    limit = max(parts, key=lambda name: parts[name])
    seconds = parts[limit]
    if limit == "playing" and costs.start > 0.5 * seconds:
        limit = "starting workers"
    elif limit == "playing" and shards < cores:
        limit = "too few shards"
    return seconds, limit


def main(args: Args) -> None:
    """Measure, model, and print both."""
    console, size = Console(width=140), ShardSizes().batched
    start, _ = measure(("-c", WORK))
    played = {name: play_rows(name, args.rows) for name in args.cases}
    kept = next(iter(played.values()))[1]
    written, table = measure_writing(kept)
    shard, taken = measure_shards(kept, args.tasks, size) if args.ray else (1e-3 * args.shard_ms, 0.0)
    costs = Costs(shard, taken + written, table, start)
    heads = ("ms a row", "rows/s a core", "bytes a row", "sent", "cores fed", "with a URI")
    measured = Table("suite hard, many worlds at once", *heads)
    for name, (second, rows) in played.items():
        line = sum(len(json.dumps(row)) + 1 for row in rows) / len(rows)
        sent = len(pickle.dumps([(row, None) for row in rows])) / len(rows)
        fed = [second / (costs.shard / size + row) for row in (costs.row, taken)]
        cells = (f"{1e3 * second:.3g}", f"{1 / second:.3g}", f"{line:.0f}", f"{sent:.0f}", *(f"{x:.0f}" for x in fed))
        measured.add_row(name, *cells)
    console.print(measured)
    console.print(
        f"who asks pays: {1e3 * costs.shard:.2f} ms a shard{'' if args.ray else ' (assumed)'}, {1e6 * taken:.1f} us to "
        f"take a row, {1e6 * written:.0f} us to write it, {1e6 * table:.0f} us of tables, "
        f"{1e-3 * measure_memory(kept):.1f} kB of memory a row; a new worker: {start:.1f} s"
    )
    seconds = {name: second for name, (second, _) in played.items()}
    heads = (*(f"{cores} cores" for cores in CORES), "then tables")
    modelled = Table("rows", "what is played", "seeds a shard", *heads)
    for count, sizes in ((24_000, (size, 10)), (1_000_000, (size,))):
        for name in args.cases:
            for seeds in sizes:
                found = [model_time(count, seconds[name], seeds, cores, costs) for cores in CORES]
                cells = (f"{time:,.0f} s: {limit}" for time, limit in found)
                modelled.add_row(f"{count:,}", name, str(seeds), *cells, f"{count * costs.table:,.0f} s")
    console.print(modelled)


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
    with exit_codes():
        main(tyro.cli(Args))

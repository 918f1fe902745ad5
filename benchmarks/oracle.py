"""Play the expert and the oracle, who is told the truth of every episode, on the same seeds: what is left to learn?

    OMP_NUM_THREADS=1 python benchmarks/oracle.py --scenarios pong corridor --suites hard all

A row says how often both succeed, and their median robustness. All rows play the same seeds, many worlds at once,
without plans made in the background. Ctrl-C prints what is played.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from ablation import play, read_plan
from rich import box
from rich.console import Console
from rich.table import Table

from impact_envs import load_scenario
from planners import make_plan
from planners.free_flyer.oracle import PARTS
from planners.plan import Plan
from train.evaluation.case import EVALUATION_SEEDS
from train.watch import exit_codes

POLICIES = ("expert", "oracle")


@dataclass
class Args:
    """Play the expert and the oracle on the same seeds."""

    scenarios: tuple[str, ...] = (
        "throw_and_catch",
        "corridor",
        "obstacle_avoidance",
        "pong",
        "pingpong",
        "relay",
        "exchange",
    )
    """Shipped names or TOML files, of free-flyers."""
    suites: tuple[str, ...] = ("hard_v0", "hard", "short", "all")
    """Mismatch suites."""
    seeds: int = 200
    """Episodes of a row."""
    seed: int = EVALUATION_SEEDS
    """First of them."""
    told: tuple[str, ...] = PARTS
    """What the oracle is told."""
    plans: Path | None = None
    """Folder of plans SCENARIO.json, and SCENARIO_hard.json of the shortened horizon; made now where there is none."""
    out: Path | None = None
    """Write the rows here as JSON."""


def main(args: Args) -> list[dict[str, Any]]:
    """Play, print the table and return its rows."""
    rows: list[dict[str, Any]] = []
    try:
        for row in play_rows(args):
            rows.append(row)
            print(row, file=sys.stderr)
    except KeyboardInterrupt:
        print(f"stopped after {len(rows)} rows", file=sys.stderr)
    print_table(rows)
    if args.out:
        args.out.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    return rows


def play_rows(args: Args) -> Iterator[dict[str, Any]]:
    """Yield success, median and lowest twentieth of both policies in every scenario and suite."""
    seeds = range(args.seed, args.seed + args.seeds)
    for name in args.scenarios:
        scenario, plans = load_scenario(name), dict[float, Plan]()
        for suite in args.suites:
            world = scenario.suite(suite)
            if world.horizon not in plans:
                plans[world.horizon] = read_plan(args.plans, world, scenario) or make_plan(world)
            row: dict[str, Any] = {"scenario": scenario.name, "suite": suite, "episodes": args.seeds}
            for policy in POLICIES:
                won, robustness = play(world, plans[world.horizon], policy, seeds, args.told)
                row[f"{policy} success"] = float(won.mean())
                row[f"{policy} median"] = float(np.median(robustness))
                row[f"{policy} q05"] = float(np.quantile(robustness, 0.05))
            yield row


def print_table(rows: list[dict[str, Any]]) -> None:
    """Print rows as a Markdown table."""
    if not rows:
        return
    columns = [f"{policy} {name}" for policy in POLICIES for name in ("success", "median", "q05")]
    table = Table(box=box.MARKDOWN)
    for column in ("scenario", "suite", *columns):
        table.add_column(column, no_wrap=True)
    for row in rows:
        shown = [f"{row[name]:.1%}" if name.endswith("success") else f"{row[name]:.3f}" for name in columns]
        table.add_row(row["scenario"], row["suite"], *shown)
    Console(width=200).print(table)


if __name__ == "__main__":
    with exit_codes():
        main(tyro.cli(Args))

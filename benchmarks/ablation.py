"""Play the expert in a suite with each of its parts left out: how much of what the suite costs does one part carry?

    OMP_NUM_THREADS=1 python benchmarks/ablation.py pong --suite hard

The gap is the success without any part less that with all of them; a part closes the share of it that is won by leaving
this part out. Where the suite has an offset of the centre of mass, everything is played a second time by an expert that
is told where it is, so that no other part hides behind it. All rows play the same seeds, many worlds at once, without
plans made in the background. Ctrl-C prints what is played.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from rich import box
from rich.console import Console
from rich.table import Table
from tyro.conf import Positional

from impact_envs import Scenario, load_scenario, vector_env
from planners import make_plan
from planners.free_flyer.belief.options import EXPERT
from planners.free_flyer.expert_batch import FreeFlyerExpertBatch
from planners.free_flyer.oracle import PARTS, FreeFlyerOracleBatch
from planners.plan import Plan
from train.evaluation.case import EVALUATION_SEEDS
from train.watch import exit_codes

ALL, NONE = "all parts", "no part"
OFFSET, DEADLINE = "true.center_of_mass_offset", "horizon_scale"
# Parts that are nothing without another one, and go with it.
WITH = {"true.drift_turn": "true.drift", "true.velocity_measured": "true.position_noise"}


def list_rows(scenario: Scenario, suite: str) -> Iterator[tuple[str, Scenario]]:
    """Yield what is left out of a suite, and the scenario without it; the deadline is a part, too.

    Raises:
        InputError: the suite is unknown.
    """
    scenario.suite(suite)
    values = scenario._suites()[suite]
    deadline = {key: value for key, value in values.items() if key == DEADLINE}
    yield ALL, scenario.suite(suite)
    for part in values:
        kept = {key: value for key, value in values.items() if part not in (key, WITH.get(key))}
        yield f"without {part.removeprefix('true.')}", with_values(scenario, kept)
    yield NONE, scenario
    if deadline and len(values) > 1:
        yield f"{DEADLINE} alone", with_values(scenario, deadline)


def with_values(scenario: Scenario, values: dict[str, Any]) -> Scenario:
    """Return a scenario in a suite of these values."""
    return scenario.model_copy(update={"suites": {"ablation": values}}).suite("ablation")


def play(
    scenario: Scenario, plan: Plan, policy: str, seeds: Sequence[int], told: Sequence[str] = PARTS
) -> tuple[np.ndarray, np.ndarray]:
    """Play the expert, or an oracle that is told something, in a world for each seed.

    Args:
        scenario: with its true physics.
        plan: that is followed.
        policy: ``expert`` or ``oracle``.
        seeds: of the episodes.
        told: parts of the truth that an oracle is told.

    Returns:
        Success and robustness of every episode, shapes (seeds,) [m].
    """
    worlds = vector_env(scenario, num_envs=len(seeds), threads=1)
    options, believed = replace(EXPERT, plan_anew=False), scenario.as_believed()
    if policy == "oracle":
        experts: Any = FreeFlyerOracleBatch(believed, plan, len(seeds), options, parts=told)
        uniforms = [np.random.default_rng(seed).random(scenario.draw_count) for seed in seeds]
        experts.tell(scenario.draw_many(np.array(uniforms)))
    else:
        experts = FreeFlyerExpertBatch(believed, plan, len(seeds), options=options)
    joint, infos = worlds.reset(seed=list(seeds))
    for _ in range(scenario.steps):
        joint, _, _, _, infos = worlds.step(experts.act(joint))
    return infos["success"], infos["robustness"]


@dataclass
class Args:
    """Play the expert in a suite with each of its parts left out."""

    scenario: Positional[str]
    """Shipped name or TOML file, of free-flyers."""
    suite: str = "hard"
    """What is taken apart."""
    seeds: int = 200
    """Episodes of a row."""
    seed: int = EVALUATION_SEEDS
    """First of them."""
    policy: str = "expert"
    """expert, or oracle, who is told all."""
    plans: Path | None = None
    """Folder of plans SCENARIO.json, and SCENARIO_hard.json of the shortened horizon; made now where there is none."""
    rows: tuple[str, ...] = ()
    """What is played, by the first column; everything without."""
    out: Path | None = None
    """Write the rows here as JSON."""


def main(args: Args) -> list[dict[str, Any]]:
    """Play, print the table and return its rows."""
    rows: list[dict[str, Any]] = []
    try:
        for row in play_rows(args):
            rows.append(row)
            print(f"{row['scenario']} {row['suite']} {row['parts']}: {row['success']:.1%}", file=sys.stderr)
    except KeyboardInterrupt:
        print(f"stopped after {len(rows)} rows", file=sys.stderr)
    add_shares(rows)
    print_table(rows)
    if args.out:
        args.out.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    return rows


def play_rows(args: Args) -> Iterator[dict[str, Any]]:
    """Yield success and median of every row as it is played."""
    scenario = load_scenario(args.scenario)
    plans: dict[float, Plan] = {}
    seeds = range(args.seed, args.seed + args.seeds)
    known = args.policy == "expert" and OFFSET in scenario._suites().get(args.suite, {})
    for parts, world in list_rows(scenario, args.suite):
        if args.rows and parts not in args.rows:
            continue
        if world.horizon not in plans:
            plans[world.horizon] = read_plan(args.plans, world, scenario) or make_plan(world)
        row: dict[str, Any] = {"scenario": scenario.name, "suite": args.suite, "parts": parts, "episodes": args.seeds}
        won, robustness = play(world, plans[world.horizon], args.policy, seeds)
        row |= {"success": float(won.mean()), "median": float(np.median(robustness))}
        if known:
            won, robustness = play(world, plans[world.horizon], "oracle", seeds, ("offset",))
            row |= {"success, offset told": float(won.mean()), "median, offset told": float(np.median(robustness))}
        yield row


def read_plan(folder: Path | None, world: Scenario, whole: Scenario) -> Plan | None:
    """Return a plan that was made before, None without one.

    Args:
        folder: of plans, as ``tests/frozen/plans``.
        world: to be planned.
        whole: the same scenario with its whole horizon.
    """
    shortened = "" if world.horizon == whole.horizon else "_hard"
    path = folder / f"{whole.name}{shortened}.json" if folder else None
    if path is None or not path.exists():
        return None
    plan = Plan.load(path)
    return plan if math.isclose(plan.horizon, world.horizon) else None


def add_shares(rows: Sequence[dict[str, Any]]) -> None:
    """Add the share of the gap that each part closes; None where there is no gap."""
    named = {row["parts"]: row for row in rows}
    if not {ALL, NONE} <= named.keys():
        return
    for told in ("", ", offset told"):
        name = f"success{told}"
        if name in rows[0]:
            gap = named[NONE][name] - named[ALL][name]
            for row in rows:
                row[f"closes{told}"] = (row[name] - named[ALL][name]) / gap if gap > 0 else None


def print_table(rows: Sequence[dict[str, Any]]) -> None:
    """Print rows as a Markdown table."""
    if not rows:
        return
    columns = [f"{name}{told}" for told in ("", ", offset told") for name in ("success", "median", "closes")]
    columns = [column for column in columns if column in rows[0]]
    table = Table(box=box.MARKDOWN)
    for column in ("scenario", "suite", "parts", *columns):
        table.add_column(column, no_wrap=True)
    for row in rows:
        shown = []
        for column in columns:
            value = row[column]
            shown.append("" if value is None else f"{value:.3f}" if column.startswith("median") else f"{value:.1%}")
        table.add_row(row["scenario"], row["suite"], row["parts"], *shown)
    Console(width=200).print(table)


if __name__ == "__main__":
    with exit_codes():
        main(tyro.cli(Args))

"""Fly plans that bear deviations in worlds that have them: does the environment confirm what the plan promises?

    OMP_NUM_THREADS=1 python benchmarks/responses.py --worlds 1000 --out responses.json

Every impact of a robot changes the object's velocity by up to the plan's deviation more than the impact law says
(`true.impact_deviation`), in half of the worlds anything up to it, in the others a corner of the box. The same worlds
are flown with the plan's responses, with the same plan without them, by the paper's expert, and with the plan of most
robustness. A violation is an episode whose formula does not hold; left: the object was once outside its tube.
"""

from __future__ import annotations

import json
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import tyro
from rich import box
from rich.console import Console
from rich.table import Table

from impact_envs import load_scenario, parallel_env, vector_env
from planners import make_expert_batch, make_plan
from planners.free_flyer.belief.plan_table import read_tube
from planners.plan import Plan
from train.evaluation.case import EVALUATION_SEEDS
from train.free_flyer.plan_metrics import ON_EDGE
from train.watch import exit_codes

SCENARIOS = ("throw_and_catch", "corridor", "pong", "pingpong", "obstacle_avoidance", "relay")
Way = Literal["responses", "no responses", "paper_expert", "most robust"]
# Counters of the expert that are printed: what a flight with responses does not need.
OTHERWISE = ("unplanned_contact", "retry", "give_up", "inserted", "retimed", "reoptimised", "planned_anew")


@dataclass(frozen=True)
class Flights:
    """What N episodes came to.

    Attributes:
        success: whether the formula held, shape (N,).
        robustness: shape (N,) [m].
        outside: greatest distance of the object from its tube, per axis, 0 inside; None without one, shape (N,) [m].
        counts: of the expert.
        seconds: wall time.
    """

    success: np.ndarray
    robustness: np.ndarray
    outside: np.ndarray | None
    counts: dict[str, int]
    seconds: float


def fly(scenario: Any, plan: Plan, way: Way, worlds: int, seed: int) -> Flights:
    """Fly a plan in worlds with these seeds, all at once."""
    # Without plans made in the background, which would not be the plan's own.
    options = {"respond": way == "responses", "plan_anew": False} if way != "paper_expert" else {}
    variant = "paper_expert" if way == "paper_expert" else None
    begin = time.perf_counter()
    batch = vector_env(scenario, num_envs=worlds, threads=1)
    experts = make_expert_batch(scenario, worlds, plan, variant=variant, options=options)
    layout = parallel_env(scenario).task.joint_layout
    joint, _ = batch.reset(seed=seed)
    outside, infos = np.zeros(worlds), dict[str, Any]()
    for step in range(scenario.steps):
        joint, _, _, _, infos = batch.step(experts.act(joint))
        if step + 1 < scenario.steps:
            now = np.array([(step + 1) * scenario.control_period])
            for name, tube in plan.tubes.items():
                centre, half = read_tube(tube, now)
                x = layout[name].start
                outside = np.maximum(outside, (np.abs(joint[:, x : x + 2] - centre) - half).max(axis=1))
    counts = {name: int(values.sum()) for name, values in experts.counts.items() if values.any()}
    experts.close()
    success, robustness = np.array(infos["success"], dtype=bool), np.array(infos["robustness"], dtype=float)
    return Flights(success, robustness, outside if plan.tubes else None, counts, time.perf_counter() - begin)


@dataclass
class Args:
    """Fly plans that bear deviations in worlds that have them."""

    scenarios: tuple[str, ...] = SCENARIOS
    """Shipped names or TOML files, of one object."""
    worlds: int = 1000
    """Episodes of each row."""
    seed: int = EVALUATION_SEEDS
    """Of the first world; tuning seeds begin at 1,000,000."""
    scale: float = 1.0
    """Deviations in the environment over those that the plan bears."""
    ways: tuple[Way, ...] = get_args(Way)
    """What is flown."""
    plans: Path | None = None
    """Folder of NAME.json: plans are read from there, and written there where they are missing."""
    time_limit: float = 300.0
    """Of planning [s]."""
    out: Path | None = None
    """Write the rows here as JSON."""


def main(args: Args) -> list[dict[str, Any]]:
    """Plan, fly, print the table and return its rows."""
    rows: list[dict[str, Any]] = []
    for name in args.scenarios:
        robust = get_plan(args, name)
        scenario = load_scenario(name).override({"true.impact_deviation": args.scale * float(robust.deviation or 0.0)})
        for way in args.ways:
            plan = make_plan(load_scenario(name)) if way == "most robust" else robust
            rows.append(describe(name, way, args.scale * float(robust.deviation or 0.0), plan, scenario, args))
            print(rows[-1], file=sys.stderr, flush=True)
    print_rows(rows)
    if args.out:
        args.out.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    return rows


def get_plan(args: Args, name: str) -> Plan:
    """Return a plan that bears deviations, read or made."""
    file = args.plans / f"{Path(name).stem}.json" if args.plans else None
    if file and file.exists():
        return Plan.load(file)
    plan = make_plan(name, "impact_uncertainty", time_limit=args.time_limit)
    if file:
        file.parent.mkdir(parents=True, exist_ok=True)
        plan.save(file)
    return plan


def describe(name: str, way: Way, delta: float, plan: Plan, scenario: Any, args: Args) -> dict[str, Any]:
    """Fly a row's episodes and return the row."""
    found = fly(scenario, plan, way, args.worlds, args.seed)
    left = None if found.outside is None or way == "most robust" else int((found.outside > ON_EDGE).sum())
    return {
        "scenario": name,
        "flown": way,
        "deviation": delta,
        "impacts": len(plan.impacts),
        "episodes": args.worlds,
        "violations": int((~found.success).sum()),
        "left": left,
        "outside": None if found.outside is None else float(found.outside.max()),
        "least_robustness": float(found.robustness.min()),
        "median_robustness": float(np.median(found.robustness)),
        "counted": {key: found.counts[key] for key in OTHERWISE if key in found.counts},
        "seconds": round(found.seconds, 1),
    }


def print_rows(rows: list[dict[str, Any]]) -> None:
    """Print the table in Markdown."""
    table = Table(box=box.MARKDOWN)
    heads = ("scenario", "flown", "δ [m/s]", "episodes", "violations", "left their tube", "farthest outside [mm]")
    for head in (*heads, "least, median robustness [m]", "counted", "s"):
        table.add_column(head, no_wrap=True)
    for row in rows:
        counted = ", ".join(f"{key} {value}" for key, value in row["counted"].items())
        left = ("", "") if row["left"] is None else (str(row["left"]), f"{1e3 * row['outside']:.1f}")
        robustness = f"{row['least_robustness']:.3f}, {row['median_robustness']:.3f}"
        cells = (row["scenario"], row["flown"], f"{row['deviation']:.4f}", str(row["episodes"]), str(row["violations"]))
        table.add_row(*cells, *left, robustness, counted, f"{row['seconds']:.0f}")
    Console(width=220).print(table)


if __name__ == "__main__":
    with exit_codes():
        main(tyro.cli(Args))

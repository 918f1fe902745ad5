"""What learning adds to an expert: train, find the best constants, judge all on the same seeds, print one table a row.

    OMP_NUM_THREADS=1 python benchmarks/residuals.py --rows pong:hard corridor:hard --out runs/residuals

A row is a scenario in a suite. What ``out`` holds is not made again: Ctrl-C or a kill loses the present iteration and
nothing else.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pandas as pd
import tyro
from expert_in_loop import describe_machine, print_table

from agents.actor import DESCRIPTION
from impact_envs.domain import find_part
from impact_envs.errors import InputError, check_count
from impact_envs.scenario import load_scenario
from planners import check_oracle, list_variants
from train import clone, residual, tune
from train.arguments import Args as TrainingArgs
from train.arguments import TuneArgs
from train.evaluation.case import EVALUATION_SEEDS, check_names, make_cases
from train.evaluation.comparison import compare_groups
from train.evaluation.evaluate import evaluate_cases
from train.evaluation.journal import write_json
from train.evaluation.origins import read_origins
from train.ground import fill_args, read_cases
from train.watch import exit_codes

ROWS = (
    "pong:hard", "corridor:hard", "obstacle_avoidance:hard", "exchange:hard", "pingpong:hard", "pingpong:short",
    "relay:short", "floating_manipulator_thrusters:hard", "dual_arm_grasp:hard",
)  # fmt: skip
# The published form of each domain's expert.
PUBLISHED = ("paper_expert", "published")
# Whose experts have the same features and corrections in all scenarios.
SHARED_DOMAIN = "free_flyer"


@dataclass
class Args:
    """Train, tune, judge and compare."""

    rows: tuple[str, ...] = ROWS
    """Each SCENARIO:SUITE."""
    runs: int = 5
    """Training seeds of every policy."""
    steps: int | None = None
    """Corrections of every training; without: the default of `impact train`."""
    on_published: bool = False
    """Train residuals on the published form of the expert, too."""
    clone: bool = False
    """Clone the free-flyers' expert once for each row, too."""
    generalists: int = 0
    """Training seeds of one policy for the free-flyers of all rows in all their suites, judged in each."""
    suites: tuple[str, ...] = ()
    """Judge the first training seed in these suites, too."""
    episodes: int = 200
    """Evaluation seeds."""
    out: Path = Path("runs/residuals")
    """Folder of policies, evaluations and the table; gone on with."""
    threads: int = 2
    """That share the worlds."""


def main(args: Args) -> None:
    """Make every row and print it.

    Args:
        args: of the command line.

    Raises:
        InputError: bad arguments, or what ``out`` holds does not fit them.
        PlanningError: an expert found no plan.
    """
    for name, value in (("runs", args.runs), ("episodes", args.episodes), ("threads", args.threads)):
        check_count(name, value)
    if args.steps is not None:
        check_count("steps", args.steps)
    if args.generalists < 0:
        raise InputError(f"generalists = {args.generalists}: choices: 0, 1, 2, ...")
    rows = [split_row(row) for row in args.rows]
    check_names("row", args.rows)
    for scenario, suite in rows:
        make_cases([scenario], list(dict.fromkeys((suite, *args.suites))))  # says now what is wrong with them
    print_table("", [describe_machine()])
    shared = make_generalists(args, rows) if args.generalists else []
    for scenario, suite in rows:
        start = time.perf_counter()
        policies, found = make_row(args, scenario, suite)
        policies += shared if load_scenario(scenario).domain == SHARED_DOMAIN else []
        comparison = judge(args, policies, scenario, [suite], found / "evaluation")
        write_json(found / "comparison.json", comparison)
        seconds = time.perf_counter() - start
        print_table(f"{scenario}, {suite} ({seconds:.0f} s)", [format_row(row) for row in comparison])
        if args.suites:
            first = ["expert", str(found / "residual" / "seed0")]
            comparison = judge(args, first, scenario, args.suites, found / "elsewhere")
            print_table("the first training seed elsewhere", [format_row(row) for row in comparison])


def split_row(row: str) -> tuple[str, str]:
    """Return scenario and suite of a row.

    Raises:
        InputError: it has another form.
    """
    scenario, _, suite = row.rpartition(":")
    if not scenario or not suite:
        raise InputError(f"row '{row}': expected SCENARIO:SUITE, for example pong:hard")
    return scenario, suite


def make_row(args: Args, scenario: str, suite: str) -> tuple[list[str], Path]:
    """Train and tune what is not there yet.

    Args:
        args: of the command line.
        scenario, suite: of the row.

    Returns:
        Names of the policies to judge, as `impact evaluate` takes them, and the row's folder.
    """
    folder, loaded = args.out / f"{Path(scenario).stem}_{suite}", load_scenario(scenario)
    published = [name for name in PUBLISHED if name in list_variants(loaded)]
    policies = ["zero", *published, "expert"]
    try:
        check_oracle(loaded)
        policies.append("oracle")
    except InputError:
        pass  # the domain has none
    numbered = find_part("planners", loaded.domain, "IMPACT_NUMBERS") is not None
    for per_impact in (False, True)[: 1 + numbered]:
        out = folder / ("constant_per_impact" if per_impact else "constant")
        if not (out / DESCRIPTION).exists():
            tune.main(
                TuneArgs((scenario,), (suite,), per_impact=per_impact, out=out, threads=args.threads, report_episodes=0)
            )
        policies.append(str(out))
    for variant in [None, *(published if args.on_published else [])]:
        for seed in range(args.runs):
            out = folder / (f"residual_on_{variant}" if variant else "residual") / f"seed{seed}"
            train(args, TrainingArgs((scenario,), (suite,), variant=variant, seed=seed, out=out))
            policies.append(str(out))
    if args.clone and loaded.domain == SHARED_DOMAIN:
        out = folder / "clone"
        if not (out / "result.json").exists():
            resume = bool(clone.list_iterations(out))
            write_json(out / "result.json", clone.main(clone.Args(scenario, suite, out=out, resume=resume)))
        policies.append(str(out))
    return policies, folder


def make_generalists(args: Args, rows: Sequence[tuple[str, str]]) -> list[str]:
    """Train the policies for all rows of free-flyers, and return their names; three times as long as one for a row."""
    shared = [row for row in rows if load_scenario(row[0]).domain == SHARED_DOMAIN]
    scenarios, suites = (tuple(dict.fromkeys(part)) for part in zip(*shared, strict=True))
    names = []
    for seed in range(args.generalists):
        out = args.out / "generalist" / f"seed{seed}"
        train(args, TrainingArgs(scenarios, suites, seed=seed, out=out, eval_episodes=100), 3)
        names.append(str(out))
    return names


def train(args: Args, training: TrainingArgs, times: int = 1) -> None:
    """Train a policy to its end, so many times the usual steps; go on with an interrupted run, leave a finished one."""
    done = training.out / "result.json"
    if done.exists():
        return
    resume, filled = residual.last_checkpoint(training.out) is not None, fill_args(training, read_cases(training))
    steps = times * (args.steps or filled.steps or 0)
    run = replace(training, resume=resume, threads=args.threads, steps=steps, report_episodes=0)
    write_json(done, residual.main(run))


def judge(args: Args, policies: Sequence[str], scenario: str, suites: Sequence[str], out: Path) -> list[dict[str, Any]]:
    """Play the evaluation seeds, write the episodes and compare; see `compare_groups`."""
    cases = make_cases([scenario], list(suites))
    result = evaluate_cases(cases, policies, args.episodes, EVALUATION_SEEDS, args.threads, out, batched=True)
    episodes: pd.DataFrame = result.episodes
    return compare_groups(episodes, read_origins(policies))


def format_row(row: dict[str, Any]) -> dict[str, str]:
    """Return a row of the comparison as text; bold: its gain is sure, and more than the best constant's."""
    gain = format_interval(row, "gain", 3)
    return {
        "suite": row["suite"],
        "policy": "/".join(Path(row["policy"]).parts[-1:]),
        "runs": str(row["runs"]),
        "success [%]": format_interval(row, "success", 1, 100.0, "success_rate"),
        "IQM [m]": format_interval(row, "iqm", 3),
        "worst 5 % [m]": format_interval(row, "worst", 3),
        "gain [m]": f"**{gain}**" if row["earned"] else gain,
        "over constant [m]": format_interval(row, "gain_over_constant", 3),
        "improves [%]": format_interval(row, "improvement", 0, 100.0),
        "CPU [s]": "" if row["cpu_seconds"] is None else f"{row['cpu_seconds']:.0f}",
    }


def format_interval(row: dict[str, Any], name: str, digits: int, unit: float = 1.0, value: str | None = None) -> str:
    """Return a value with its interval, nothing where there is none."""
    if (found := row[value or name]) is None:
        return ""
    low, high = row[f"{name}_ci"]
    return f"{unit * found:.{digits}f} [{unit * low:.{digits}f}, {unit * high:.{digits}f}]"


if __name__ == "__main__":
    with exit_codes():
        main(tyro.cli(Args))

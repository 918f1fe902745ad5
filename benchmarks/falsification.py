"""Measure how many episodes a minute ``impact break`` plays while it searches.

    python benchmarks/falsification.py

In processor time of all threads and of the processes in which experts plan anew, their start included, so that other
work on the machine does not count: a minute of one core. Lanes share nothing while an episode lasts, so two cores play
twice as many, where memory and caches allow it; ``--wall`` prints what a clock says, on a quiet machine.
"""

from __future__ import annotations

import time
from contextlib import closing
from dataclasses import dataclass
from typing import Any

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table
from scaling import read_cpu

from impact_envs.errors import InputError, check_count, choices
from train.evaluation.case import TUNING_SEEDS, make_case
from train.evaluation.evaluate import make_plans
from train.evaluation.player import Job
from train.falsification.arena import Arena, Played
from train.falsification.search import SearchOptions, search_failures
from train.watch import exit_codes

# What is set of the expert, by the second part of a case's name.
KINDS: dict[str, dict[str, Any]] = {
    "zero": {},
    "lqr": {"expert.tracker": "lqr"},
    "mpc": {"expert.tracker": "mpc"},
    "mpc-kept": {"expert.tracker": "mpc", "expert.plan_anew": False},
}


@dataclass
class Args:
    """Measure how many episodes a minute a search plays."""

    cases: tuple[str, ...] = tuple(
        f"{scenario}/{policy}" for scenario in ("throw_and_catch", "pong", "corridor") for policy in KINDS
    )
    """SCENARIO/zero: no control; SCENARIO/lqr, SCENARIO/mpc: the expert with that tracker; mpc-kept: which does not
    plan anew in the background."""
    zero_episodes: int = 12_800
    """Without control."""
    episodes: int = 1280
    """With an expert."""
    workers: int = 2
    """Lanes."""
    suite: str = "hard"
    """Whose ranges are searched."""
    wall: bool = False
    """Print the time of a clock, too."""
    replay: bool = False
    """Play what SCENARIO/mpc searched again with its stand-in, mpc-kept, and count the failures of both."""


def measure_search(name: str, args: Args) -> tuple[Played, float, float]:
    """Return the episodes of a search, processor time [s], and time by a clock [s], when all is compiled.

    Args:
        name: SCENARIO/POLICY, see Args.
        args: see there.
    """
    scenario, _, kind = name.partition("/")
    policy = "zero" if kind == "zero" else "expert"
    episodes = args.zero_episodes if kind == "zero" else args.episodes
    (case,) = make_plans([make_case(scenario, args.suite, KINDS[kind])], [Job(0, policy, TUNING_SEEDS)])
    with closing(Arena(case, policy, args.workers)) as arena:
        arena.play(np.tile(arena.worlds.nominal, (2, 1)), np.arange(2))
    clock, start = time.perf_counter(), read_cpu()
    with closing(Arena(case, policy, SearchOptions(episodes=episodes).width, args.workers)) as arena:
        played = search_failures(arena, TUNING_SEEDS, SearchOptions(episodes=episodes))
    return played, read_cpu() - start, time.perf_counter() - clock


def replay_search(name: str, played: Played, args: Args) -> tuple[int, int, int, int]:
    """Return how many episodes a stand-in plays otherwise, and failures: of both, of the policy alone, of it alone.

    Args:
        name: SCENARIO/mpc.
        played: episodes of its search.
        args: see there.
    """
    jobs = [Job(0, "expert", TUNING_SEEDS)]
    (case,) = make_plans([make_case(name.partition("/")[0], args.suite, KINDS["mpc-kept"])], jobs)
    with closing(Arena(case, "expert", SearchOptions(episodes=args.episodes).width, args.workers)) as arena:
        again = arena.play(played.places, played.seeds)
    failed, fails = ~played.success, ~again.success
    others = int(np.sum(again.robustness != played.robustness))
    return others, int(np.sum(failed & fails)), int(np.sum(failed & ~fails)), int(np.sum(~failed & fails))


def main(args: Args) -> None:
    """Measure all cases and print a table.

    Raises:
        InputError: bad arguments.
    """
    for name in ("zero_episodes", "episodes", "workers"):
        check_count(name, getattr(args, name))
    for name in args.cases:
        scenario, _, kind = name.partition("/")
        if kind not in KINDS:
            raise InputError(f"case '{name}': '{kind}' is unknown after SCENARIO/; {choices(kind, KINDS)}")
        make_case(scenario, args.suite, KINDS[kind])  # says now what is wrong with it
    table = Table(title=f"Episodes a minute of a search in {args.suite}, {args.workers} lanes")
    for head in ("case", "episodes", "failures", "a minute of a core", *(["by a clock"] * args.wall)):
        table.add_column(head, justify="left" if head == "case" else "right")
    shared = Table(title="The same episodes, played by the stand-in that does not plan anew")
    for head in ("case", "other robustness", "both fail", "the policy alone", "the stand-in alone"):
        shared.add_column(head, justify="left" if head == "case" else "right")
    for name in args.cases:
        played, cpu, wall = measure_search(name, args)
        rates, count = [cpu, *([wall] * args.wall)], len(played.success)
        failures = str(np.sum(~played.success))
        table.add_row(name, str(count), failures, *(f"{60.0 * count / seconds:,.0f}" for seconds in rates))
        if args.replay and name.endswith("/mpc"):
            shared.add_row(name, *map(str, replay_search(name, played, args)))
    for one in (table, shared) if args.replay else (table,):
        Console().print(one)


if __name__ == "__main__":
    with exit_codes():
        main(tyro.cli(Args))

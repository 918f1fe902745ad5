"""Fly plans of random tasks: how often the expert succeeds in closed loop, and what stands behind a failure.

    OMP_NUM_THREADS=1 python benchmarks/tasks.py --count 100 --plans plans
    OMP_NUM_THREADS=1 python benchmarks/task_flights.py plans --worlds 5

Every plan is flown in the same worlds of each suite, all worlds of a suite at once. A failed flight is flown again
alone, which gives the same flight bit for bit, to see what happened in it first. Ctrl-C prints what is flown.
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import tyro
from tyro.conf import Positional

from impact_envs import Scenario, parallel_env, rollout, vector_env
from impact_envs.errors import InputError, check_count
from impact_envs.rollout import Episode
from impact_envs.scenario import build_scenario
from impact_envs.stream import check_seed
from planners import make_expert, make_expert_batch
from planners.plan import Plan
from train.settings import parse_settings
from train.watch import exit_codes

SUITES = ("nominal", "all")
FIRST_SEED = 1_000_000


@dataclass
class Args:
    """Fly plans of random tasks."""

    plans: Positional[Path]
    """Folder of plans task_SEED.json, as tasks.py writes them."""
    worlds: int = 5
    """Of each suite, for every plan."""
    seed: int = FIRST_SEED
    """Of the first world; the others follow."""
    suites: tuple[str, ...] = SUITES
    """Mismatch suites."""
    set: tuple[str, ...] = ()
    """Options of the expert, for example retiming.stray=0.5; it plans nothing anew in the background without
    plan_anew=true, which is much slower."""
    out: Path | None = None
    """Write the flights here, as JSON."""


@dataclass(frozen=True)
class Flight:
    """Hold what became of a flight.

    Args:
        task, kind: that was planned.
        suite, seed: of the world.
        success: whether the formula held.
        planned, robustness: of the plan, of the flight [m].
        missed: conjunct of least robustness, where the formula did not hold.
        cause: see `find_cause`.
    """

    task: str
    kind: str
    suite: str
    seed: int
    success: bool
    planned: float
    robustness: float
    missed: str = ""
    cause: str = ""


def fly_plan(
    scenario: Scenario, kind: str, plan: Plan, suites: Iterable[str], seeds: range, options: Mapping[str, Any]
) -> Iterator[Flight]:
    """Fly a plan in every suite, and yield its flights.

    Args:
        scenario: that was planned.
        kind: of task.
        plan: of it.
        suites: mismatch suites.
        seeds: of the worlds.
        options: of the expert.
    """
    for suite in suites:
        world = scenario.suite(suite)
        worlds = vector_env(world, num_envs=len(seeds), threads=1)
        experts = make_expert_batch(world, len(seeds), plan, options=options)
        joint, infos = worlds.reset(seed=list(seeds))
        for _ in range(world.steps):
            joint, _, _, _, infos = worlds.step(experts.act(joint))
        experts.close()
        worlds.close()
        for seed, success, robustness in zip(seeds, infos["success"], infos["robustness"], strict=True):
            told = () if success else explain_failure(world, plan, seed, options)
            yield Flight(
                scenario.name, kind, suite, seed, bool(success), plan.robustness, round(float(robustness), 6), *told
            )


def explain_failure(world: Scenario, plan: Plan, seed: int, options: Mapping[str, Any]) -> tuple[str, str]:
    """Return the conjunct of least robustness and the cause of a flight that failed, by flying it again alone."""
    env, expert, lowest, unplanned = (
        parallel_env(world),
        make_expert(world, plan=plan, options=options),
        [0.0],
        math.inf,
    )

    def watch(env: Any) -> None:
        nonlocal unplanned
        lowest[:] = env.conjuncts[::2]
        if unplanned == math.inf and expert.diagnostics().fallbacks.get("unplanned_contact"):
            unplanned = env.time

    episode = rollout(env, expert, seed, watch)
    conjuncts = world.specification.conjuncts()
    return str(conjuncts[lowest.index(min(lowest))]), find_cause(world, plan, episode, unplanned)


def find_cause(world: Any, plan: Plan, episode: Episode, unplanned: float) -> str:
    """Return the first thing in a failed flight that is not as it should be; what follows may be its consequence.

    Args:
        world: with its true physics.
        plan: that was flown.
        episode: the flight.
        unplanned: when the expert first saw a contact that it did not expect, inf: never [s].
    """
    if episode.failure:
        return f"simulation: {episode.failure}"
    before = [impact for impact in episode.impacts if impact.time <= unplanned]
    for impact in before:
        kinds = sorted(_get_kind(world, name) for name in (impact.a, impact.b))
        if kinds != ["object", "robot"]:
            return " meets ".join(kinds) if len(set(kinds)) > 1 else f"{kinds[0]}s meet"
    if unplanned < math.inf:
        planned = [{hit.robot, hit.object} for hit in plan.impacts]
        right = not before or {before[-1].a, before[-1].b} in planned
        return f"a robot touches {'its' if right else 'another'} object when it should not"
    if len(episode.impacts) < len(plan.impacts):
        return "fewer impacts than planned"
    return "impacts, and none amiss: the object is not where they should take it"


def _get_kind(world: Any, name: str) -> str:
    return "robot" if name in world.robots else "object" if name in world.objects else "wall"


def fly_folder(folder: Path, suites: Iterable[str], seeds: range, options: Mapping[str, Any]) -> Iterator[Flight]:
    """Fly every plan in a folder.

    Args:
        folder: of plans ``task_SEED.json``.
        suites: mismatch suites.
        seeds: of the worlds.
        options: of the expert.

    Raises:
        InputError: there is none, or one is no plan of a random task.
    """
    from tasks import draw_task  # it flies what it plans, too

    paths = sorted(folder.glob("task_*.json"))
    if not paths:
        raise InputError(f"{folder}: no plans task_SEED.json; python benchmarks/tasks.py --plans {folder} makes them")
    for path in paths:
        number = path.stem.removeprefix("task_")
        if not number.isdigit():
            raise InputError(f"{path}: the name says no seed")
        plan, (kind, data) = Plan.load(path), draw_task(int(number))
        if plan.horizon != data["horizon"]:  # it was planned in a hurry
            kind, data = draw_task(int(number), plan.horizon / data["horizon"])
        yield from fly_plan(build_scenario(data, source=data["name"]), kind, plan, suites, seeds, options)


def print_table(flights: list[Flight]) -> None:
    """Print success by suite and kind of task, and what stands behind failures."""
    print(f"{'suite':8} {'kind':8} {'plans':>5} {'flights':>7} {'success':>8} {'all worlds':>10}")
    for suite in dict.fromkeys(flight.suite for flight in flights):
        own = [flight for flight in flights if flight.suite == suite]
        for kind in (*dict.fromkeys(sorted(flight.kind for flight in own)), "all"):
            rows = [flight for flight in own if kind in (flight.kind, "all")]
            tasks = {flight.task for flight in rows}
            clean = len(tasks - {flight.task for flight in rows if not flight.success})
            won = sum(flight.success for flight in rows) / len(rows)
            print(f"{suite:8} {kind:8} {len(tasks):5d} {len(rows):7d} {won:8.1%} {clean:10d}")
    failed = Counter((flight.suite, flight.cause) for flight in flights if not flight.success)
    for (suite, cause), count in failed.most_common():
        print(f"{suite:8} {count:4d}  {cause}")


def main(args: Args) -> list[Flight]:
    """Fly the plans and print the table."""
    check_count("worlds", args.worlds)
    check_seed(args.seed)
    seeds = range(args.seed, args.seed + args.worlds)
    options = {"plan_anew": False, **parse_settings(args.set)}
    flights: list[Flight] = []
    try:
        for flight in fly_folder(args.plans, args.suites, seeds, options):
            flights.append(flight)
            if not flight.success:
                found = f"{flight.robustness:.3f} of {flight.planned:.3f} m"
                print(
                    f"{flight.task} {flight.suite} {flight.seed}: {found}, {flight.missed}: {flight.cause}", flush=True
                )
    except KeyboardInterrupt:
        print("interrupted")
    print_table(flights)
    if args.out:
        args.out.write_text(json.dumps([asdict(flight) for flight in flights], indent=1) + "\n", encoding="utf-8")
    return flights


if __name__ == "__main__":
    with exit_codes():
        main(tyro.cli(Args))

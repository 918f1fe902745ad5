"""Plan an object through rooms in a row: walls with gaps above and below in turn, so that it is hit round every end.

    OMP_NUM_THREADS=1 python benchmarks/rooms.py --walls 1 2 3 4 5 --robots 1 3 --worlds 8

Every wall adds two turns. With several robots, each starts in a room of its own, as far as there are rooms. Times are
this process's own. Ctrl-C prints what is planned.
"""

from __future__ import annotations

import itertools
import json
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import task_flights
import tyro

from impact_envs.errors import InputError, check_count
from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.scenario import build_scenario
from planners.budget import Clock, use_clock
from planners.errors import PlanningError
from planners.free_flyer.nominal.planner import make_free_flyer_plan
from planners.plan import Plan
from train.watch import exit_codes

ROOM, HEIGHT, GAP, THICK = 2.5, 6.0, 1.6, 0.2  # width and height of a room, gap of its wall and the wall [m]
SECONDS = 80.0  # of the horizon, for every room [s]
DISC = {"mass": 16.8, "inertia": 0.336, "radius": 0.2, "speed_limit": 0.3}  # of robots and the object


@dataclass
class Args:
    """Plan an object through rooms."""

    walls: tuple[int, ...] = (1, 2, 3, 4, 5)
    """Numbers of walls."""
    robots: tuple[int, ...] = (1, 3)
    """Numbers of robots."""
    time_limit: float = 60.0
    """Of each plan [s]."""
    worlds: int = 0
    """Fly every plan in so many worlds of the suites nominal and all."""
    out: Path | None = None
    """Write the table here, as JSON."""


@dataclass(frozen=True)
class Row:
    """Hold what became of one row of rooms.

    Args:
        walls, robots: their numbers.
        seconds: of planning [s].
        impacts: of the plan; 0: there is none.
        robustness, bound: of the plan [m].
        message: why there is none.
        nominal, perturbed: flights in which the formula held.
    """

    walls: int
    robots: int
    seconds: float
    impacts: int = 0
    robustness: float | None = None
    bound: float | None = None
    message: str = ""
    nominal: int | None = None
    perturbed: int | None = None


def make_rooms(walls: int, robots: int) -> FreeFlyerScenario:
    """Return the scenario of so many walls and robots."""
    width, horizon = ROOM * (walls + 1), SECONDS * (walls + 1)
    low = HEIGHT - GAP - 0.4 if walls % 2 else GAP - 0.6  # the goal is level with the last gap
    obstacles = {}
    for k in range(walls):
        span = (0.0, HEIGHT - GAP) if k % 2 == 0 else (GAP, HEIGHT)
        centre = ROOM * (k + 1)
        lower, upper = (centre - THICK / 2, span[0]), (centre + THICK / 2, span[1])
        obstacles[f"wall{k + 1}"] = {"lower": lower, "upper": upper, "solid": True}
    starts = [(0.6 + ROOM * (k % (walls + 1)), 0.8 + 0.7 * (k // (walls + 1))) for k in range(robots)]
    data: dict[str, Any] = {
        "name": f"rooms_{walls}_{robots}",
        "domain": "free_flyer",
        "formula": f"F[0,{horizon:g}] box in goal",
        "horizon": horizon,
        "control_period": 0.1,
        "world": {"lower": (0.0, 0.0), "upper": (width, HEIGHT)},
        "robots": {
            f"r{k + 1}": DISC | {"start": start, "force_limit": 1.5, "torque_limit": 0.5}
            for k, start in enumerate(starts)
        },
        "objects": {"box": DISC | {"start": (1.2, 2.2)}},
        "regions": {"goal": {"lower": (width - 1.5, low), "upper": (width - 0.5, low + 1.0)}},
        "obstacles": obstacles,
        "believed": {"restitution": 0.8},
    }
    scenario = build_scenario(data, source=data["name"])
    assert isinstance(scenario, FreeFlyerScenario)
    return scenario


def plan_rooms(scenario: FreeFlyerScenario, time_limit: float) -> tuple[Row, Plan | None]:
    """Plan the scenario; returns its row, and the plan if there is one."""
    row, start = Row(len(scenario.obstacles), len(scenario.robots), 0.0), time.process_time()
    try:
        with use_clock(Clock(time.process_time)):
            plan = make_free_flyer_plan(scenario, time_limit=time_limit)
    except PlanningError as error:
        return replace(row, seconds=time.process_time() - start, message=str(error)), None
    seconds, impacts = time.process_time() - start, len(plan.impacts)
    return replace(row, seconds=seconds, impacts=impacts, robustness=plan.robustness, bound=plan.bound), plan


def count_successes(scenario: FreeFlyerScenario, plan: Plan, suite: str, worlds: int) -> int:
    """Return in how many worlds of a suite the expert keeps the formula with a plan."""
    seeds = range(task_flights.FIRST_SEED, task_flights.FIRST_SEED + worlds)
    flights = task_flights.fly_plan(scenario, "rooms", plan, [suite], seeds, {"plan_anew": False})
    return sum(flight.success for flight in flights)


def describe(row: Row, worlds: int) -> str:
    """Return a line of the table."""
    head = f"{row.walls:5d} {row.robots:6d} {row.seconds:6.1f}"
    if row.robustness is None or row.bound is None:
        return f"{head} {row.message[:100]}"
    flights = "" if row.nominal is None else f"{row.nominal:5d}/{worlds} {row.perturbed:5d}/{worlds}"
    return f"{head} {row.impacts:7d} {row.robustness:9.3f} / {row.bound:.3f} m {flights}"


def main(args: Args) -> list[Row]:
    """Plan all rows of rooms, and print the table."""
    for name in ("walls", "robots"):
        for number in getattr(args, name):
            check_count(name, number)
    if not args.time_limit > 0.0:
        raise InputError(f"time_limit = {args.time_limit}: a number above 0 is needed [s]")
    if args.worlds < 0:
        raise InputError(f"worlds = {args.worlds}: a number of at least 0 is needed")
    rows: list[Row] = []
    print(f"walls robots  CPU s impacts  robustness / bound{'  nominal      all' * bool(args.worlds)}")
    try:
        for walls, robots in itertools.product(args.walls, args.robots):
            scenario = make_rooms(walls, robots)
            row, plan = plan_rooms(scenario, args.time_limit)
            if plan is not None and args.worlds:
                nominal, perturbed = (count_successes(scenario, plan, one, args.worlds) for one in ("nominal", "all"))
                row = replace(row, nominal=nominal, perturbed=perturbed)
            rows.append(row)
            print(describe(row, args.worlds), flush=True)
    except KeyboardInterrupt:
        print("interrupted")
    if args.out:
        args.out.write_text(json.dumps([asdict(row) for row in rows], indent=1))
    return rows


if __name__ == "__main__":
    with exit_codes():
        main(tyro.cli(Args))

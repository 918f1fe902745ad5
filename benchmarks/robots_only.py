"""Plan well-known scenarios of planners in Signal Temporal Logic, without anything to hit, beside published times.

    OMP_NUM_THREADS=1 python benchmarks/robots_only.py --out robots_only.json

Areas, starts, limits and formulas are those of stlpy's examples (github.com/vincekurtz/stlpy) and of the set of Sun et
al. (github.com/sundw2014/STLPlanning), whose robots have a speed limit alone and are given a thrust here. A small
object rests in a corner, for the planner takes at least one; a plan without impacts is one leg of equally long
straight pieces. Times are this process's own. Ctrl-C prints what is planned.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from impact_envs.errors import InputError, choices
from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.scenario import build_scenario
from planners.budget import Clock, use_clock
from planners.errors import Infeasible, PlanningError
from planners.free_flyer.nominal.planner import make_free_flyer_plan
from planners.free_flyer.nominal.task import PlanOptions
from train.watch import exit_codes

Box = tuple[float, float, float, float]  # x_min, x_max, y_min, y_max [m]
RADIUS = 0.02  # of what stands for a point, and of what rests in a corner [m]
MASS = 1.0  # [kg]
PERIOD = 0.1  # of control [s]
# Whole times of two planners on their authors' machines, by scenario: Kurtz and Lin's encoding, and graphs of convex
# sets (arXiv 2605.23240), both as a public list quotes the latter paper's table (wizwand.com, second hand).
PUBLISHED = {"stlcg_1": "0.2 s / 0.39 s", "puzzle_1": "3,020 s / 4.5 s", "rover_1": "866 s / 3.86 s"}
# What one leg of a dozen pieces does not express.
LEFT_OUT = {
    "puzzle_1": "a maze with five keys and doors: planned with 26 pieces of unequal length by its authors",
    "rover_1": "its windows end 10 s behind the horizon: such formulas are refused",
    "nonlinear_reach_avoid": "a unicycle, and circles, which have no half-planes",
}


@dataclass
class Args:
    """Plan scenarios of robots alone."""

    names: tuple[str, ...] = ()
    """Of these; all without."""
    time_limit: float = 60.0
    """Of each [s]."""
    out: Path | None = None
    """Write the table here, as JSON."""


@dataclass(frozen=True)
class Task:
    """Describe a scenario.

    Args:
        start: of the robot [m].
        world: all of it [m].
        areas: name to box; those called wall... are always avoided.
        formula: besides these.
        horizon: [s].
        corner: where the object rests [m].
        speed: limit per axis [m/s].
        acceleration: limit [m/s^2].
        goal: where the robot has to end, if anywhere [m].
        pieces: numbers of straight pieces that are tried in turn; those of the planner without.
    """

    start: tuple[float, float]
    world: Box
    areas: dict[str, Box]
    formula: str
    horizon: float
    corner: tuple[float, float]
    speed: float = 1.0
    acceleration: float = 0.5
    goal: tuple[float, float] | None = None
    pieces: tuple[int, ...] = PlanOptions().pieces


ROOM = (0.0, 10.0, 0.0, 10.0)
BLOCK = {"wall": (3.0, 5.0, 4.0, 6.0), "goal": (7.0, 8.0, 8.0, 9.0)}
CELL = (-1.45, 1.45, -1.45, 1.45)  # what the walls of Sun et al. leave
CELLS = {"wall": (-0.4, 0.4, -0.4, 0.4), "yellow": (-1.0, -0.7, -0.25, 0.5), "red": (0.0, 0.9, -1.0, -0.5)}
CELLS["green"] = (0.2, 0.7, 0.8, 1.2)
PASSAGE = {
    "wall1": (2.0, 5.0, 4.0, 6.0),
    "wall2": (5.5, 9.0, 3.8, 5.7),
    "wall3": (4.6, 8.0, 0.5, 3.5),
    "wall4": (2.2, 4.4, 6.4, 10.0),
    "goal": (7.0, 8.0, 8.0, 9.0),
    "other": (9.5, 10.0, 1.5, 2.5),
}
DOORS = {
    "wall1": (8.0, 15.0, 0.0, 4.0),
    "wall2": (8.0, 15.0, 6.0, 10.0),
    "wall3": (3.5, 5.0, 0.0, 2.5),
    "wall4": (0.0, 2.5, 4.0, 6.0),
    "wall5": (3.5, 5.0, 7.5, 10.0),
    "door": (12.8, 14.0, 3.99, 6.01),
    "key": (1.0, 2.0, 1.0, 2.0),
    "goal": (14.1, 14.9, 4.1, 5.9),
}
TASKS = {
    "reach_avoid": Task((1.0, 2.0), ROOM, BLOCK, "F[0,15] r in goal", 15.0, (9.9, 0.1)),
    "either_or": Task(
        (2.0, 2.0),
        ROOM,
        BLOCK | {"one": (1.0, 2.0, 6.0, 7.0), "two": (7.0, 8.0, 4.5, 5.5)},
        "F[0,15] (G[0,5] r in one | G[0,5] r in two) & F[0,20] r in goal",
        20.0,
        (9.9, 0.1),
    ),
    "narrow_passage": Task((3.0, 3.6), ROOM, PASSAGE, "F[0,25] (r in goal | r in other)", 25.0, (0.1, 0.1)),
    "door_puzzle": Task(
        (6.0, 1.0),
        (0.0, 15.0, 0.0, 10.0),
        DOORS,
        "(r not in door) U[0,30] r in key & F[0,30] r in goal",
        30.0,
        (0.1, 9.9),
        pieces=(8, 10, 12),
    ),
    "stlcg_1": Task(
        (-1.0, -1.0),
        CELL,
        CELLS,
        "F[0,10] G[0,5] r in red & F[0,10] G[0,5] r in green",
        15.0,
        (-1.4, 1.4),
        acceleration=2.0,
        goal=(1.0, 1.0),
        pieces=(9, 12),
    ),
    "stlcg_2": Task(
        (-1.0, -1.0),
        CELL,
        CELLS,
        "F[0,5] G[0,5] r in yellow & G[0,10] r not in green",
        10.0,
        (1.4, -1.4),
        acceleration=2.0,
        goal=(1.0, 1.0),
        pieces=(7, 10),
    ),
}


def draw_boxes(seed: int, sizes: Sequence[float]) -> list[Box]:
    """Return boxes of these sizes [m] at stlpy's random places, which come from the older generator of NumPy."""
    rng = np.random.RandomState(seed)
    corners = [rng.uniform(0.0, 9.0, 2).tolist() for _ in sizes]
    return [(x, x + size, y, y + size) for (x, y), size in zip(corners, sizes, strict=True)]


def make_multitarget() -> Task:
    """Return stlpy's example: one obstacle, and a visit to one area of each of five pairs."""
    boxes = draw_boxes(0, [2.0] + 10 * [1.0])
    areas = {"wall": boxes[0]} | {f"t{k}": box for k, box in enumerate(boxes[1:])}
    visits = [f"F[0,15] (r in t{k} | r in t{k + 1})" for k in range(0, 10, 2)]
    return Task((5.0, 2.0), ROOM, areas, " & ".join(visits), 15.0, (0.1, 0.1), pieces=(8, 12))


def make_stepping_stones() -> Task:
    """Return stlpy's example: always on one of 15 stones, the last of which is the goal."""
    areas = {f"s{k}": box for k, box in enumerate(draw_boxes(1, 15 * [1.0]))}
    stones = " | ".join(f"r in {name}" for name in areas)
    return Task((2.0, 1.3), ROOM, areas, f"G[0,20] ({stones}) & F[0,20] r in s14", 20.0, (0.1, 9.9), pieces=(8, 12))


TASKS |= {"random_multitarget": make_multitarget(), "stepping_stones": make_stepping_stones()}


def make_scenario(name: str) -> FreeFlyerScenario:
    """Return a scenario.

    Args:
        name: a key of `TASKS`.
    """
    task = TASKS[name]
    walls = [area for area in task.areas if area.startswith("wall")]
    always = [f"G[0,{task.horizon:g}] r not in {wall}" for wall in walls]
    body = {"mass": MASS, "inertia": 0.5 * MASS * RADIUS**2, "radius": RADIUS, "speed_limit": task.speed}
    robot = body | {"start": task.start, "force_limit": MASS * task.acceleration, "torque_limit": 0.1}
    left, right, low, high = task.world
    boxes = {area: {"lower": (a, c), "upper": (b, d)} for area, (a, b, c, d) in task.areas.items()}
    data: dict[str, Any] = {
        "domain": "free_flyer",
        "name": name,
        "formula": " & ".join([task.formula, *always]),
        "horizon": task.horizon,
        "control_period": PERIOD,
        "world": {"lower": (left, low), "upper": (right, high)},
        "robots": {"r": robot if task.goal is None else robot | {"goal": task.goal}},
        "objects": {"parked": body | {"start": task.corner}},
        "regions": {area: box for area, box in boxes.items() if area not in walls},
        "obstacles": {area: boxes[area] | {"solid": False} for area in walls},
        "believed": {"restitution": 1.0},
    }
    return build_scenario(data, source=name)


@dataclass(frozen=True)
class Row:
    """Hold what became of a scenario; lengths in metres, times in seconds; ``told``: what the planner says."""

    name: str
    seconds: float | None
    robustness: float | None = None
    bound: float | None = None
    published: str = ""
    message: str = ""
    told: str = ""


def plan_scenario(name: str, time_limit: float) -> Row:
    """Plan a scenario.

    Args:
        name: a key of `TASKS`.
        time_limit: [s].
    """
    scenario, pieces, published = make_scenario(name), TASKS[name].pieces, PUBLISHED.get(name, "")
    most = max(*pieces, PlanOptions().most_pieces)
    options = PlanOptions(pieces=pieces, most_pieces=most, diagnosis=0.0)
    start = time.process_time()
    try:
        with use_clock(Clock(time.process_time)):
            plan = make_free_flyer_plan(scenario, max_impacts=0, time_limit=time_limit, options=options)
    except PlanningError as error:
        verdict = "infeasible" if isinstance(error, Infeasible) else "not found"
        verdict = f"{verdict} with up to {most} pieces and a quarter of the reserves"
        return Row(name, time.process_time() - start, None, None, published, verdict, str(error))
    return Row(name, time.process_time() - start, plan.robustness, plan.bound, published)


def print_table(rows: Sequence[Row]) -> None:
    """Print rows, and why others are not there."""
    print(f"{'scenario':21} {'CPU s':>6} {'robustness':>10} {'bound':>6}  published")
    for row in rows:
        seconds = "" if row.seconds is None else f"{row.seconds:.1f}"
        found = f"{row.robustness:10.3f} {row.bound:6.3f}" if row.robustness is not None else f"{'none':>10} {'':6}"
        print(f"{row.name:21} {seconds:>6} {found}  {row.published:15} {row.message}")


def main(args: Args) -> list[Row]:
    """Plan the scenarios and print the table.

    Raises:
        InputError: an unknown scenario.
    """
    for name in args.names:
        if name not in TASKS:
            raise InputError(f"scenario '{name}' is unknown; {choices(name, TASKS)}")
    if not args.time_limit > 0.0:
        raise InputError(f"time_limit = {args.time_limit}: a number above 0 is needed [s]")
    rows = []
    try:
        for name in args.names or tuple(TASKS):
            rows.append(plan_scenario(name, args.time_limit))
            print(f"{name}: {rows[-1].seconds:.1f} s", file=sys.stderr)
    except KeyboardInterrupt:
        print(f"stopped after {len(rows)} scenarios", file=sys.stderr)
    left = {} if args.names else LEFT_OUT
    rows += [Row(name, None, published=PUBLISHED.get(name, ""), message=why) for name, why in left.items()]
    print_table(rows)
    if args.out:
        args.out.write_text(json.dumps([asdict(row) for row in rows], indent=1) + "\n", encoding="utf-8")
    return rows


if __name__ == "__main__":
    with exit_codes():
        main(tyro.cli(Args))

"""Plan random tasks that nobody wrote: how many have a plan, a proof that there is none, or neither, and how long.

    OMP_NUM_THREADS=1 python benchmarks/tasks.py --count 100 --out tasks.json

Tasks are sensible, not all are feasible: bodies start apart, areas are larger than bodies, horizons leave time. With
`--confirm 120` a task that is proven infeasible is planned again, with more impacts, four pieces a leg and less of all
reserves: a plan found then disproves the first verdict as a word about the task, not about the planner's restrictions.
Ctrl-C prints what has been planned so far.
"""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from statistics import median
from typing import Any, Literal

import numpy as np
import tyro

from impact_envs.errors import InputError, check_count
from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.scenario import build_scenario
from impact_envs.stream import check_seed
from planners.budget import Clock, get_clock, use_clock
from planners.errors import Infeasible, PlanningError
from planners.free_flyer.nominal.planner import make_free_flyer_plan
from planners.free_flyer.nominal.task import PlanOptions
from planners.free_flyer.reserves import Reserves
from train.watch import exit_codes

KINDS = ("reach", "hold", "visit", "order", "until", "nested", "either")
PLANNED, PROVEN, UNDECIDED = "planned", "proven infeasible", "undecided"
AGREES, DISAGREES, OPEN = "agrees", "disagrees", "open"  # what the finer encoding says of a proof
PERIOD = 0.1  # control period [s]


@dataclass
class Args:
    """Plan random tasks."""

    count: int = 100
    """Number of tasks."""
    seed: int = 1_000_000
    """Seed of the first one; the others follow."""
    hurry: float = 1.0
    """Factor of the horizons: below 1 there is less time, and more tasks have no plan."""
    time_limit: float = 60.0
    """Of each [s]."""
    clock: Literal["wall", "cpu"] = "wall"
    """What times and limits are measured by: this process's own time says more on a busy machine."""
    confirm: float = 0.0
    """Time for a second, finer encoding of each task that is proven infeasible; 0: none is planned again [s]."""
    scenarios: Path | None = None
    """Write the tasks into this folder, as JSON that `build_scenario` takes."""
    plans: Path | None = None
    """Write the plans into this folder, as JSON; `python benchmarks/task_flights.py` flies them."""
    fly: int = 0
    """Fly every plan in that folder in so many worlds of every suite of task_flights.py; needs --plans."""
    out: Path | None = None
    """Write the table here, as JSON."""


@dataclass(frozen=True)
class Row:
    """Hold what became of one task."""

    seed: int
    kind: str
    robots: int
    objects: int
    obstacles: int
    outcome: str
    seconds: float
    robustness: float | None = None
    bound: float | None = None
    message: str = ""
    confirmed: str = ""


@dataclass(frozen=True)
class Finer:
    """Choose the encoding that confirms proofs.

    Args:
        more_impacts: than the planner tries by itself.
        options: four pieces a leg hold all that one and two do; every model is solved, none is screened, and no reason
            is looked for outside of models.
        reserves: at first; they are halved once more: an eighth where the planner itself goes down to a quarter.
    """

    more_impacts: int = 2
    options: PlanOptions = field(
        default_factory=lambda: PlanOptions(
            pieces=(4,), most_pieces=4, halvings=1, proof_share=0.0, diagnosis=0.0, reasons=False
        )
    )
    reserves: Reserves = field(default_factory=lambda: Reserves().halved().halved())


def draw_task(seed: int, hurry: float = 1.0) -> tuple[str, dict[str, Any]]:
    """Return the kind of a random task and its tables.

    One to four robots and one to three objects of 2 to 40 kg, none to three obstacles; the formula asks one thing of
    every object, sometimes also that a robot visits or avoids an area.

    Args:
        seed: of everything.
        hurry: factor of the horizon.
    """
    rng = np.random.default_rng(seed)
    radius = float(rng.choice([0.15, 0.2, 0.3]))
    unit = radius / 0.2
    size = float(rng.choice([4.0, 6.0, 8.0, 10.0, 16.0])) * unit
    speed = float(rng.choice([0.3, 0.4, 0.6])) * unit
    robots = int(rng.choice([1, 2, 3, 4], p=[0.2, 0.4, 0.25, 0.15]))
    objects = min(int(rng.choice([1, 2, 3], p=[0.65, 0.25, 0.1])), robots)
    horizon = float(np.ceil((40.0 + 10.0 * size / speed * 0.3) * rng.uniform(1.0, 1.8) / 10.0) * 10.0)
    horizon = round(horizon * hurry, 1)
    places = _Places(rng, size, radius)
    half = 0.5 * unit * rng.uniform(0.8, 1.2)
    goals = [places.add(half, half + 0.3 * unit) for _ in range(objects)]
    vias = [places.add(half, half + 0.3 * unit) for _ in range(objects)]
    obstacles = {}
    for k in range(int(rng.integers(0, 4))):
        extent = rng.uniform(0.3, 0.12 * size / unit) * unit
        with suppress(RuntimeError):
            obstacles[f"wall{k}"] = _box(places.add(extent, extent), extent) | {"solid": bool(rng.random() < 0.8)}
    zone = places.zone(0.6 * unit)

    def body(inset: float) -> dict[str, Any]:
        mass = float(np.round(np.exp(rng.uniform(np.log(2.0), np.log(40.0))), 1))
        start = [float(x) for x in places.add(radius, inset)]
        shape = {"mass": mass, "inertia": round(0.5 * mass * radius**2, 6), "radius": radius, "speed_limit": speed}
        return {"start": start} | shape

    thrust = rng.uniform(0.04, 0.12) * unit
    kind = str(rng.choice(KINDS))
    data = {
        "domain": "free_flyer",
        "name": f"task_{seed}",
        "horizon": horizon,
        "control_period": PERIOD,
        "world": {"lower": [0.0, 0.0], "upper": [size, size]},
        "robots": {f"r{k + 1}": body(0.5 * unit) | {"torque_limit": 0.5} for k in range(robots)},
        "objects": {f"o{k + 1}": body(1.0 * unit) for k in range(objects)},
        "regions": {f"a{k + 1}": _box(goal, half) for k, goal in enumerate(goals)}
        | {f"b{k + 1}": _box(via, half) for k, via in enumerate(vias)}
        | {"zone": _box(zone, 0.6 * unit)},
        "obstacles": obstacles,
        "believed": {"restitution": float(np.round(rng.uniform(0.3, 1.0), 2))},
    }
    for robot in data["robots"].values():
        robot["force_limit"] = float(np.round(robot["mass"] * thrust, 4))
        if rng.random() < 0.6:
            robot["goal"] = robot["start"]
    data["formula"] = _write_formula(rng, kind, robots, objects, horizon, list(obstacles))
    return kind, data


def _write_formula(
    rng: np.random.Generator, kind: str, robots: int, objects: int, horizon: float, obstacles: list[str]
) -> str:
    end, late, middle = f"{horizon:g}", f"{0.8 * horizon:g}", f"{0.5 * horizon:g}"
    stay = f"{0.15 * horizon:g}"
    parts = []
    for k in range(1, objects + 1):
        o, a, b = f"o{k}", f"a{k}", f"b{k}"
        parts.append(
            {
                "reach": f"F[0,{end}] {o} in {a}",
                "hold": f"F[0,{late}] G[0,{stay}] {o} in {a}",
                "visit": f"F[0,{end}] {o} in {b} & G[{end},{end}] {o} in {a}",
                "order": f"F[0,{middle}] ({o} in {b} & F[0,{middle}] {o} in {a})",
                "until": f"({o} not in {a}) U[0,{late}] {o} in {b}",
                "nested": f"F[0,{late}] G[0,{stay}] {o} in {a} & G[0,{end}] ({o} in {a} -> r1 not in zone)",
                "either": f"(F[0,{end}] {o} in {a} | F[0,{end}] {o} in {b})",
            }[kind]
        )
    if robots > objects and rng.random() < 0.3:
        parts.append(f"F[0,{end}] r{robots} in zone")
    parts += [f"G[0,{end}] all not in {name}" for name in obstacles]
    return " & ".join(parts)


class _Places:
    """Draw places that keep their distance from each other."""

    def __init__(self, rng: np.random.Generator, size: float, radius: float) -> None:
        self.rng, self.size, self.radius = rng, size, radius
        self.taken: list[tuple[np.ndarray, float]] = []

    def add(self, half: float, inset: float) -> np.ndarray:
        """Return the centre of a box that is clear of all others.

        Raises:
            RuntimeError: there is no room.
        """
        for _ in range(1000):
            place = np.round(self.rng.uniform(inset, self.size - inset, 2), 2)
            if all(np.abs(place - other).max() > half + far + 2.5 * self.radius for other, far in self.taken):
                self.taken.append((place, half))
                return place
        raise RuntimeError("no room")

    def zone(self, half: float) -> np.ndarray:
        """Return the centre of a box anywhere."""
        return np.round(self.rng.uniform(half, self.size - half, 2), 2)


def _box(center: np.ndarray, half: float) -> dict[str, Any]:
    return {"lower": [float(x) for x in center - half], "upper": [float(x) for x in center + half]}


def draw_tasks(count: int, seed: int, hurry: float = 1.0) -> Iterator[tuple[int, str, dict[str, Any]]]:
    """Yield seeds, kinds and tables of tasks; seeds whose bodies find no room are left out."""
    while count:
        with suppress(RuntimeError):
            yield (seed, *draw_task(seed, hurry))
            count -= 1
        seed += 1


def plan_task(seed: int, kind: str, data: dict[str, Any], time_limit: float, plans: Path | None = None) -> Row:
    """Plan a task.

    Args:
        seed, kind, data: as from `draw_tasks`.
        time_limit: [s].
        plans: folder that the plan is written into, if any.
    """
    scenario = build_scenario(data, source=data["name"])
    assert isinstance(scenario, FreeFlyerScenario)
    counts = len(scenario.robots), len(scenario.objects), len(scenario.obstacles)
    read = get_clock().read
    start = read()
    try:
        plan = make_free_flyer_plan(scenario, time_limit=time_limit)
    except PlanningError as error:
        outcome = PROVEN if isinstance(error, Infeasible) else UNDECIDED
        return Row(seed, kind, *counts, outcome, read() - start, message=str(error))
    if plans:
        plan.save(plans / f"{scenario.name}.json")
    return Row(seed, kind, *counts, PLANNED, read() - start, plan.robustness, plan.bound)


def confirm_proof(data: dict[str, Any], time_limit: float, finer: Finer = Finer()) -> str:
    """Return what a finer encoding says of a task that is proven infeasible: it agrees, disagrees, or is open.

    Args:
        data: as from `draw_tasks`.
        time_limit: [s].
        finer: encoding.
    """
    scenario = build_scenario(data, source=data["name"])
    assert isinstance(scenario, FreeFlyerScenario)
    most = 3 + 3 * len(scenario.objects) + finer.more_impacts
    try:
        make_free_flyer_plan(scenario, most, time_limit, reserves=finer.reserves, options=finer.options)
    except Infeasible:
        return AGREES
    except PlanningError:
        return OPEN
    return DISAGREES


def print_table(rows: list[Row]) -> None:
    """Print the outcomes by kind, and of all tasks."""
    heads = f"{PLANNED:>8} {'at bound':>8} {'proven':>7} {UNDECIDED:>9} {'median s':>8} {'most s':>7}"
    print(f"{'kind':8} {'tasks':>5} {heads}")
    for kind in (*KINDS, "all"):
        own = [row for row in rows if kind in (row.kind, "all")]
        if not own:
            continue
        counts = Counter(row.outcome for row in own)
        best = sum(row.robustness is not None and row.bound - row.robustness < 1e-3 * row.bound for row in own)
        times = [row.seconds for row in own]
        outcomes = f"{counts[PLANNED]:8d} {best:8d} {counts[PROVEN]:7d} {counts[UNDECIDED]:9d}"
        print(f"{kind:8} {len(own):5d} {outcomes} {median(times):8.1f} {max(times):7.1f}")
    told = Counter(row.confirmed for row in rows if row.confirmed)
    if told:
        print("proofs and the finer encoding:", ", ".join(f"{told[one]} {one}" for one in (AGREES, DISAGREES, OPEN)))


def main(args: Args) -> None:
    """Plan the tasks and print the table."""
    check_count("count", args.count)
    check_seed(args.seed)
    if not args.confirm >= 0.0:
        raise InputError(f"confirm = {args.confirm}: a number of at least 0 is needed [s]")
    if not 0.0 < args.hurry <= 1.0:
        raise InputError(f"hurry = {args.hurry}: a number above 0 and at most 1 is needed")
    if not args.time_limit > 0.0:
        raise InputError(f"time_limit = {args.time_limit}: a number above 0 is needed [s]")
    if args.fly and not args.plans:
        raise InputError(f"--fly {args.fly} needs --plans, a folder for the plans")
    for folder in filter(None, (args.scenarios, args.plans)):
        folder.mkdir(parents=True, exist_ok=True)
    rows: list[Row] = []
    clock = Clock(time.process_time if args.clock == "cpu" else time.perf_counter)
    try:
        for seed, kind, data in draw_tasks(args.count, args.seed, args.hurry):
            if args.scenarios:
                (args.scenarios / f"{data['name']}.json").write_text(json.dumps(data, indent=1))
            with use_clock(clock):
                row = plan_task(seed, kind, data, args.time_limit, args.plans)
                if row.outcome == PROVEN and args.confirm:
                    row = replace(row, confirmed=confirm_proof(data, args.confirm))
            rows.append(row)
            found = row.message[:150] if row.robustness is None else f"{row.robustness:.3f} of {row.bound:.3f} m"
            print(f"{seed} {kind:7} {row.outcome:17} {row.seconds:6.1f} s {row.confirmed} {found}", flush=True)
    except KeyboardInterrupt:
        print("interrupted")
    print_table(rows)
    if args.out:
        args.out.write_text(json.dumps([asdict(row) for row in rows], indent=1))
    if args.fly:
        import task_flights  # a neighbour, which is found when this file is run, not when a test imports it

        task_flights.main(task_flights.Args(args.plans, args.fly))


if __name__ == "__main__":
    with exit_codes():
        main(tyro.cli(Args))

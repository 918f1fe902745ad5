"""Time this planner beside the paper's encoding: same scenarios, same run, taking turns, one thread, medians.

    OMP_NUM_THREADS=1 python benchmarks/planner.py --repeats 5 --limit 300 --out planner.json

Needs pyscipopt for the MIQP of Eq. (28) on SCIP and gurobipy for Gurobi; without them their columns stay empty.
Ctrl-C prints what has been measured so far.
"""

from __future__ import annotations

import json
import math
import os
import platform
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from importlib.metadata import version
from pathlib import Path
from statistics import median
from typing import Any

import tyro
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from impact_envs.errors import InputError
from impact_envs.free_flyer.schema import FreeFlyerScenario
from impact_envs.scenario import load_scenario
from planners import make_plan
from planners.errors import PlanningError
from planners.free_flyer.published.encoding import EncodingOptions, make_bezier_plan
from planners.solvers import SOLVERS, installed_solvers
from train.watch import exit_codes

SCENARIOS = ("throw_and_catch", "corridor", "pong", "pingpong", "obstacle_avoidance")
MIQP_GAP = 1e-4  # Gurobi's default; the published code sets no other
DONE, LATE = "done", "limit"
NOTES = """\
ours: the whole of make_plan at the believed restitution (robustness, least effort, smoothing, check by simulation) for
  discs with their radii and limits of thrust; wall time with model building.
Bezier: the paper's encoding with as many curves as its code and big-M from interval arithmetic; robustness only,
  points, no limit of thrust, no Eq. (26) unless asked for; time of the solver alone, HiGHS unless named.
off Eq. 5: greatest error of the planned velocities after impacts.
MIQP: the same encoding with Eq. (28) at the weights of its code, to a relative gap of 1e-4, at restitution 1, where it
  is exact; time of the solver alone. It minimises another quantity than our effort: compare times, not values.
ratio: MIQP over ours, both at restitution 1; a lower bound where the MIQP ran into the limit."""


@dataclass
class Args:
    """Time the planner and its peers."""

    scenarios: tuple[str, ...] = SCENARIOS
    """Shipped names or TOML files."""
    repeats: int = 5
    """Rounds over all scenarios and methods."""
    miqp_repeats: int = 1
    """Of these, rounds that solve the MIQP as well: the last ones."""
    limit: float = 60.0
    """Wall time of every solver run of a peer [s]."""
    separation: bool = False
    """Keep the peers' robots apart by Eq. (26), which the paper prints and its code leaves out."""
    memory: bool = True
    """Measure the planner's peak memory in a process of its own."""
    out: Path | None = None
    """Write every measurement here as JSON."""


@dataclass(frozen=True)
class Run:
    """Hold one timed run; the status is "done", "limit" or the one line of a failure."""

    scenario: str
    method: str
    seconds: float  # wall time, of a peer's solver alone
    status: str = DONE
    cpu_seconds: float = 0.0  # of this process, model building included; says more on a busy machine
    facts: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Job:
    """Hold one run to come: `call` returns facts, among them its own "seconds" and "status" if it has any."""

    scenario: str
    method: str
    call: Callable[[], dict[str, Any]]


def main(args: Args) -> list[dict[str, str]]:
    """Measure, print the table as Markdown, and return its rows."""
    if args.repeats < 1 or not args.limit > 0:
        raise InputError(f"repeats {args.repeats} and limit {args.limit:g} s must be positive")
    machine, jobs, runs = describe_machine(), list(make_jobs(args)), []
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    try:
        with Progress(*columns, console=Console(stderr=True), refresh_per_second=1) as bar:
            task = bar.add_task("warming up", total=len(jobs))
            make_bezier_plan(_load(args.scenarios[0]))
            measure(next(job for job in jobs if job.method == "ours"), args.limit)
            for job in jobs:
                bar.update(task, description=f"{job.scenario}: {job.method}")
                runs.append(measure(job, args.limit))
                bar.advance(task)
    except KeyboardInterrupt:
        print(f"stopped after {len(runs)} of {len(jobs)} runs", file=sys.stderr)
    rows = make_rows(runs)
    print(", ".join(f"{key} {value}" for key, value in machine.items()), end="\n\n")
    print(format_table(rows), NOTES, sep="\n\n")
    for failure in dict.fromkeys(run.status for run in runs if run.status not in (DONE, LATE)):
        print(f"failed: {failure}")
    if args.out:
        record = {"machine": machine, "args": asdict(args), "rows": rows, "runs": [asdict(run) for run in runs]}
        args.out.write_text(json.dumps(record, indent=1, default=str) + "\n", encoding="utf-8")
    return rows


def describe_machine() -> dict[str, str]:
    """Return what times depend on, the load average before the start among it."""
    solvers = {SOLVERS[name].package: version(SOLVERS[name].package) for name in installed_solvers()}
    return {
        "processor": platform.processor() or platform.machine(),
        "cores": str(os.cpu_count()),
        "load": "/".join(f"{load:.1f}" for load in os.getloadavg()),
        "OMP_NUM_THREADS": os.environ.get("OMP_NUM_THREADS", "unset"),
        "python": platform.python_version(),
        **solvers,
    }


def make_jobs(args: Args) -> Iterator[Job]:
    """Return all runs in their order; methods take turns within a round."""
    quadratic = [name for name in installed_solvers() if SOLVERS[name].quadratic]
    scenarios = {name: _load(name) for name in args.scenarios}
    for turn in range(args.repeats):
        for name, believed in scenarios.items():
            elastic = believed.override({"believed.restitution": 1.0})
            peer = partial(plan_bezier, believed, args)
            yield Job(name, "ours", partial(plan_ours, believed))
            yield Job(name, "Bezier first", partial(peer, relative_gap=math.inf))
            yield Job(name, "Bezier", peer)
            if "gurobi" in quadratic:
                yield Job(name, "Bezier gurobi", partial(peer, solver="gurobi"))
            yield Job(name, "ours, e = 1", partial(plan_ours, elastic))
            for solver in quadratic if turn >= args.repeats - args.miqp_repeats else ():
                options = {"solver": solver, "attenuate": True, "relative_gap": MIQP_GAP}
                yield Job(name, f"MIQP {solver}", partial(plan_bezier, elastic, args, **options))
            if turn == 0 and args.memory:
                yield Job(name, "memory", partial(measure_memory, name))


def _load(name: str) -> FreeFlyerScenario:
    scenario = load_scenario(name)
    if not isinstance(scenario, FreeFlyerScenario):
        raise InputError(f"{name}: domain {scenario.domain} has no peer to compare with; choices: free_flyer")
    return scenario.as_believed()


def measure(job: Job, limit: float) -> Run:
    """Time one run; its failure is a status, a peer's that comes with the limit is a late one."""
    facts: dict[str, Any] = {}
    start, cpu_start = time.perf_counter(), time.process_time()
    try:
        facts = job.call()
        status = facts.pop("status", DONE)
    except (PlanningError, InputError) as error:
        late = isinstance(error, PlanningError) and time.perf_counter() - start >= limit
        status = LATE if late and not job.method.startswith("ours") else f"{job.scenario}, {job.method}: {error}"
    seconds, cpu_seconds = time.perf_counter() - start, time.process_time() - cpu_start
    return Run(job.scenario, job.method, facts.pop("seconds", seconds), status, cpu_seconds, facts)


def plan_ours(scenario: FreeFlyerScenario) -> dict[str, Any]:
    """Plan with this planner and return what it proved."""
    plan = make_plan(scenario)
    return {
        "rho": plan.robustness,
        "bound": plan.bound,
        "effort_gap": None if plan.effort_bound is None else 1.0 - plan.effort_bound / max(plan.effort, 1e-12),
        "stages": plan.stage_seconds,
        "validated": plan.validated,
    }


def plan_bezier(scenario: FreeFlyerScenario, args: Args, attenuate: bool = False, **options: Any) -> dict[str, Any]:
    """Plan with the paper's encoding and return what its solver did."""
    encoding = EncodingOptions(separation=args.separation, attenuate=attenuate)
    plan = make_bezier_plan(scenario, options=encoding, time_limit=args.limit, **options)
    gap = (plan.objective - plan.objective_bound) / max(abs(plan.objective), 1e-12)
    return {
        "seconds": plan.solve_seconds,
        "status": DONE if gap <= options.get("relative_gap", 1e-6) + 1e-9 else LATE,
        "build_seconds": plan.build_seconds,
        "rho": plan.rho,
        "impact_error": plan.impact_error,
        "attenuation": plan.attenuation,
        "gap": gap,
        "size": asdict(plan.size),
    }


def measure_memory(name: str) -> dict[str, Any]:
    """Plan in a child process and return its peak resident memory, imports included."""
    code = (
        "import resource, sys; from planners import make_plan; make_plan(sys.argv[1]);"
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)"
    )
    child = subprocess.run([sys.executable, "-c", code, name], capture_output=True, text=True, check=False)
    if child.returncode:
        raise InputError((child.stderr.strip().splitlines() or ["the child process failed"])[-1])
    unit = 1 if sys.platform == "darwin" else 1024  # what ru_maxrss counts in [bytes]
    return {"megabytes": int(child.stdout) * unit / 1e6}


def make_rows(runs: Sequence[Run]) -> list[dict[str, str]]:
    """Return one row of text per scenario, with the medians of what has been measured."""
    found: dict[str, dict[str, list[Run]]] = {}
    for run in runs:
        found.setdefault(run.scenario, {}).setdefault(run.method, []).append(run)
    return [_row(scenario, methods) for scenario, methods in found.items()]


def _row(scenario: str, methods: dict[str, list[Run]]) -> dict[str, str]:
    ours, elastic = methods.get("ours", []), methods.get("ours, e = 1", [])
    row = {
        "scenario": scenario,
        "ours [s]": _time(ours),
        "by stage [s]": _stages(ours),
        "rho / bound [m]": _fact(ours, "rho", ".4f") + " / " + _fact(ours, "bound", ".4f"),
        "effort gap": _fact(ours, "effort_gap", ".1%"),
        "memory [MB]": _fact(methods.get("memory", []), "megabytes", ".0f"),
        "Bezier first / optimal [s]": _time(methods.get("Bezier first", [])) + " / " + _time(methods.get("Bezier", [])),
        "off Eq. 5 [m/s]": _fact(methods.get("Bezier", []), "impact_error", ".3f"),
        "Bezier, Gurobi [s]": _time(methods.get("Bezier gurobi", [])),
        "ours, e = 1 [s]": _time(elastic),
    }
    for solver, title in (("scip", "SCIP"), ("gurobi", "Gurobi")):
        peer = methods.get(f"MIQP {solver}", [])
        row |= {f"MIQP, {title} [s]": _time(peer), f"ratio, {title}": _ratio(peer, elastic)}
    return row


def _timed(runs: Sequence[Run]) -> list[Run]:
    return [run for run in runs if run.status in (DONE, LATE)]


def _is_late(runs: Sequence[Run]) -> bool:
    return any(run.status == LATE for run in runs)


def _number(seconds: float) -> str:
    return f"{seconds:.0f}" if seconds >= 100.0 else f"{seconds:.2g}"


def _time(runs: Sequence[Run]) -> str:
    """Return the median, "> ..." with the open gap if the limit cut a run short."""
    timed = _timed(runs)
    if not timed:
        return "failed" if runs else "-"
    text = _number(median(run.seconds for run in timed))
    if not _is_late(timed):
        return text
    gaps = [run.facts["gap"] for run in timed if math.isfinite(run.facts.get("gap", math.inf))]
    return f"> {text} (gap {median(gaps):.1%})" if gaps else f"> {text} (no plan)"


def _ratio(peer: Sequence[Run], ours: Sequence[Run]) -> str:
    """Return the quotient of medians; a peer cut short gives a lower bound."""
    if not _timed(peer) or not _timed(ours):
        return "-"
    quotient = median(run.seconds for run in _timed(peer)) / median(run.seconds for run in _timed(ours))
    return f"{'> ' * _is_late(peer)}{quotient:.0f}"


def _stages(runs: Sequence[Run]) -> str:
    stages = [run.facts["stages"] for run in _timed(runs)]
    names = dict.fromkeys(name for stage in stages for name in stage)
    return ", ".join(f"{name} {_number(median(stage.get(name, 0.0) for stage in stages))}" for name in names) or "-"


def _fact(runs: Sequence[Run], name: str, form: str) -> str:
    values = [run.facts[name] for run in runs if run.facts.get(name) is not None]
    return format(median(values), form) if values else "-"


def format_table(rows: Sequence[dict[str, str]]) -> str:
    """Return rows as a Markdown table."""
    if not rows:
        return "nothing measured"
    lines = [list(rows[0]), ["---"] * len(rows[0]), *(list(row.values()) for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


if __name__ == "__main__":
    with exit_codes():
        main(tyro.cli(Args))

"""The ``impact plan`` command."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from tyro.conf import Positional

from impact_envs.domain import find_part
from impact_envs.errors import InputError
from impact_envs.file import make_file_name, write_atomically
from impact_envs.scenario import load_scenario
from train.pictures.file import check_picture_path

if TYPE_CHECKING:
    from planners.plan import Plan


@dataclass
class Command:
    """Plan a scenario, prove the plan's optimality and check it by simulation."""

    scenario: Positional[str]
    """Shipped name or TOML file."""
    objective: Literal["robustness", "impact_uncertainty"] = "robustness"
    """What to maximise: STL robustness, or the deviation after impacts that a plan bears."""
    encoding: Literal["events", "bezier"] = "events"
    """events: the planner; bezier: the reference encoding of Verhagen & Tumova."""
    solver: str = "highs"
    """Of mixed-integer models: highs, or scip or gurobi where they are installed."""
    max_impacts: int | None = None
    """Most impacts a plan may have; 6 for one object and 3 for every further one without."""
    time_limit: float = 60.0
    """Limit of the solvers [s]."""
    time_grid: int | None = None
    """impact_uncertainty only: plan on so many equal segments of time, with zonotope hulls."""
    out: Path | None = None
    """Write the plan here as JSON."""
    csv: Path | None = None
    """Write sampled trajectories into this folder, one CSV file per body."""
    published: Path | None = None
    """Write the plan into this folder in the CSV format of the published planner."""
    plot: Path | None = None
    """Draw the plan: a file ending in .png, .pdf or .svg."""
    json: bool = False

    def run(self) -> dict[str, Any]:
        """Return robustness, bound, gap, impacts and times of the plan."""
        from planners import check_planned, make_plan

        scenario = load_scenario(self.scenario)
        check_planned(scenario)
        if self.plot and find_part("train", scenario.domain, "PLAN_PICTURE") is None:
            raise InputError(f"--plot {self.plot}: domain '{scenario.domain}' draws no picture of a plan")
        self._check()
        if self.encoding == "bezier":
            return self._plan_by_bezier(scenario)
        options: dict[str, Any] = {
            "objective": self.objective,
            "time_limit": self.time_limit,
            "solver": self.solver,
        }
        if self.max_impacts is not None:
            options["max_impacts"] = self.max_impacts
        if self.time_grid is not None:
            options["time_grid"] = self.time_grid
        plan = make_plan(scenario, **options)
        self._write(scenario, plan)
        return _summary(scenario, plan)

    def _check(self) -> None:
        """Refuse what cannot be written before anything is solved."""
        for path in (self.out, self.csv, self.published, self.plot):
            if path is not None and not path.absolute().parent.is_dir():
                raise InputError(f"cannot write {path}: folder {path.absolute().parent} does not exist")
        for name, folder in (("--csv", self.csv), ("--published", self.published)):
            if folder and folder.is_file():
                raise InputError(f"{name} {folder}: is a file; it takes a folder")
        if self.plot:
            check_picture_path(self.plot)
        if self.time_grid is not None and self.objective != "impact_uncertainty":
            raise InputError(f"--time-grid {self.time_grid} needs --objective impact_uncertainty, got {self.objective}")
        if self.encoding == "bezier":
            if self.objective != "robustness":
                raise InputError(f"--encoding bezier has objective robustness, got {self.objective}")
            for name, path in (
                ("out", self.out),
                ("csv", self.csv),
                ("published", self.published),
                ("plot", self.plot),
            ):
                if path:
                    raise InputError(f"--encoding bezier prints its result; --{name} needs --encoding events")

    def _write(self, scenario: Any, plan: Plan) -> None:
        if self.out:
            plan.save(self.out)
        if self.csv:
            _write_samples(plan, scenario.control_period, self.csv)
        if self.published:
            from planners.free_flyer.published.plan_file import write_published_plan

            write_published_plan(plan, self.published, scenario.name)
        if self.plot:
            find_part("train", scenario.domain, "PLAN_PICTURE")(scenario, plan, self.plot)

    def _plan_by_bezier(self, scenario: Any) -> dict[str, Any]:
        from planners.free_flyer.published.encoding import make_bezier_plan

        plan = make_bezier_plan(
            scenario.as_believed(), max_impacts=self.max_impacts, time_limit=self.time_limit, solver=self.solver
        )
        return {
            "scenario": scenario.name,
            "encoding": self.encoding,
            "robustness": round(plan.rho, 6),
            "bound": round(plan.bound, 6),
            "impacts": [
                {
                    "time": hit.time,
                    "robot": hit.robot,
                    "object": hit.object,
                    "position": [float(x) for x in hit.position],
                    "error": hit.error,
                }
                for hit in plan.impacts
            ],
            "impact_error": plan.impact_error,
            "is_exact": plan.is_exact,
            "warning": plan.warning,
            "solve_seconds": plan.solve_seconds,
            "binaries": plan.size.binaries,
            "rows": plan.size.rows,
        }


def load_plan(path: Path | None, scenario: Any) -> Plan | None:
    """Return the plan of a JSON file, or of a folder of published CSV files.

    Args:
        path: file or folder; None: no plan.
        scenario: that a published plan is for.

    Raises:
        InputError: it does not hold a plan, or not one for the scenario.
    """
    if path is None:
        return None
    from planners import check_planned

    check_planned(scenario)
    if path.is_dir():
        from planners.free_flyer.published.conversion import convert_published_plan
        from planners.free_flyer.published.plan_file import read_published_plan

        return convert_published_plan(read_published_plan(path), scenario)
    from planners.plan import Plan

    return Plan.load(path)


def _summary(scenario: Any, plan: Plan) -> dict[str, Any]:
    deviation = {} if plan.deviation is None else {"deviation": plan.deviation, "deviation_bound": plan.deviation_bound}
    return {
        "scenario": scenario.name,
        "objective": plan.objective,
        # Solvers stop within 1e-8 of the optimum; digits beyond the sixth say nothing.
        "robustness": round(plan.robustness, 6),
        "bound": round(plan.bound, 6),
        "gap": round(plan.gap, 6),
        **deviation,
        "effort": plan.effort,
        "effort_bound": plan.effort_bound,
        "impacts": [
            {
                "time": hit.time,
                "robot": hit.robot,
                "object": hit.object,
                "position": [float(x) for x in hit.position],
            }
            for hit in plan.impacts
        ],
        "solve_seconds": plan.solve_seconds,
        "stage_seconds": plan.stage_seconds,
        "validated": plan.validated,
    }


def _write_samples(plan: Plan, period: float, folder: Path) -> None:
    import numpy as np
    import pandas as pd

    times = np.arange(round(plan.horizon / period) + 1) * period
    for name, curve in (plan.robots | plan.objects).items():
        p = np.array([curve.position(t) for t in times])
        v = np.array([curve.velocity(t) for t in times])
        columns = {"t": times, "x": p[:, 0], "y": p[:, 1], "vx": v[:, 0], "vy": v[:, 1]}
        text = pd.DataFrame(columns).to_csv(index=False)
        write_atomically(folder / make_file_name(name, suffix=".csv"), text.encode())

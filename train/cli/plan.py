"""The ``impact plan`` command."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from tyro.conf import Positional, arg

from impact_envs.domain import find_part
from impact_envs.errors import InputError
from impact_envs.file import make_file_name, write_table
from impact_envs.scenario import load_scenario
from planners.budget import count_things
from train.cli.progress import say_written, stop_on_interrupt
from train.given_plan import load_plan
from train.pictures.file import check_picture_path

if TYPE_CHECKING:
    from planners.budget import Clock
    from planners.plan import Plan

# Solvers stop within 1e-6 of the optimum; a gap of ten times this counts as none.
PROVEN_GAP = 1e-5
SEARCH_SHARE = 0.45  # of the time limit; once there is a plan, half of the time is kept for its motions


@dataclass
class Command:
    """Plan a scenario of free-flyers, prove the plan's optimality and check it by simulation.

    The experts of the other domains, floating_manipulator and dual_arm, follow no plan.
    """

    extras: ClassVar[tuple[str, ...]] = ("plan",)
    scenario: Annotated[Positional[str], arg(metavar="SCENARIO")]
    """Shipped name or TOML file."""
    objective: Literal["robustness", "impact_uncertainty"] = "robustness"
    """What to maximise: STL robustness, or the deviation after impacts that a plan bears."""
    encoding: Literal["events", "bezier"] = "events"
    """events: the planner; bezier: the reference encoding of Verhagen & Tumova."""
    solver: str = "highs"
    """Of mixed-integer models: highs, or scip or gurobi where they are installed."""
    max_impacts: int | None = None
    """Most impacts a plan may have; without: 6, 3 for every further object, and enough for each turn of their ways."""
    time_limit: float = 60.0
    """Limit of the solvers [s]."""
    proof: float = 0.0
    """With several objects: so much time more for a closer bound of the path cost; the plan stays the same [s]."""
    time_grid: int | None = None
    """impact_uncertainty only: plan on so many equal segments of time, with zonotope hulls."""
    relax: bool = False
    """Where there is no plan, plan the task with the least loosening of its formula, and say what is given up."""
    weights: tuple[float, ...] = ()
    """With --relax: price of a metre of loosening, of each conjunct of the formula in their order; without: the
    scenario's weights, or 1 each."""
    out: Path | None = None
    """Write the plan here as JSON."""
    csv: Path | None = None
    """Write the sampled plan into this folder, one CSV file per body (t [s], x, y [m], vx, vy [m/s], heading [rad], of
    robots the force in the world's frame [N]), and plan.impacts.csv."""
    published: Path | None = None
    """Write the plan into this folder in the CSV format of the published planner."""
    plot: Path | None = None
    """Draw the plan: a file ending in .png, .pdf or .svg."""
    check: Path | None = None
    """Plan nothing: say what this plan breaks, a JSON file or a folder of published CSV files; exit 1 if refused."""
    rename: tuple[str, ...] = ()
    """With --check: names of bodies in a published plan, PLAN=SCENARIO, where roles and starts do not tell them."""
    json: bool = False

    def run(self) -> dict[str, Any]:
        """Return robustness, bound, gap, impacts and times of the plan."""
        from planners import check_planned, make_plan

        scenario = load_scenario(self.scenario)
        check_planned(scenario)
        if self.plot and find_part("train", scenario.domain, "PLAN_PICTURE") is None:
            raise InputError(f"--plot {self.plot}: domain '{scenario.domain}' draws no picture of a plan")
        self._check()
        if self.check:
            given = load_plan(self.check, scenario, self.rename)
            self._write(scenario, given.plan)
            return _summary(scenario, given.plan) | given.describe()
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
        if self.proof:
            options["proof"] = self.proof
        if self.relax:
            return self._plan_relaxed(scenario, options)
        with stop_on_interrupt() as clock:
            plan = make_plan(scenario, **options)
        self._write(scenario, plan)
        return _summary(scenario, plan) | judge_plan(plan, clock, self.time_limit, self._find_most_impacts(scenario))

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
        if self.rename and self.check is None:
            raise InputError(f"--rename {' '.join(self.rename)} needs --check DIR, a folder of published plan files")
        if self.proof and (self.objective != "robustness" or self.encoding != "events" or self.relax or self.check):
            wish = "is for plans that are made, for --objective robustness with --encoding events and without --relax"
            raise InputError(f"--proof {self.proof:g}: {wish}")
        if self.time_grid is not None and self.objective != "impact_uncertainty":
            raise InputError(f"--time-grid {self.time_grid} needs --objective impact_uncertainty, got {self.objective}")
        if self.weights and not self.relax:
            raise InputError(f"--weights {' '.join(map(str, self.weights))} needs --relax")
        if self.relax and (self.objective != "robustness" or self.encoding != "events" or self.check):
            raise InputError("--relax plans for --objective robustness with --encoding events, and checks no plan")
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

    def _find_most_impacts(self, scenario: Any) -> int:
        from planners.free_flyer.nominal.object_way import find_most_impacts

        return find_most_impacts(scenario) if self.max_impacts is None else self.max_impacts

    def _write(self, scenario: Any, plan: Plan) -> None:
        if self.out:
            plan.save(self.out)
        samples = _write_samples(scenario, plan, self.csv) if self.csv else []
        if self.published:
            from planners.free_flyer.published.plan_file import write_published_plan

            write_published_plan(plan, self.published, scenario.name)
        if self.plot:
            find_part("train", scenario.domain, "PLAN_PICTURE")(scenario, plan, self.plot)
        say_written(self.out, *samples, self.published, self.plot)

    def _plan_relaxed(self, scenario: Any, options: dict[str, Any]) -> dict[str, Any]:
        from planners.free_flyer.relaxed_plan import make_relaxed_plan

        del options["objective"]
        with stop_on_interrupt() as clock:
            found = make_relaxed_plan(scenario.as_believed(), self.weights, **options)
        self._write(scenario, found.plan)
        told = _summary(found.scenario, found.plan) | judge_plan(
            found.plan, clock, self.time_limit, self._find_most_impacts(scenario)
        )
        if not found.given_up:
            return told | {"given_up": []}
        given_up = [{"conjunct": one.conjunct, "missed": one.missed} for one in found.given_up]
        relaxed = {"asked_robustness": found.robustness, "relaxed_formula": str(found.scenario.specification)}
        limits = {} if found.bound is None else {"given_up_bound": found.bound}
        if found.tried:
            limits["given_up_tried"] = found.tried
        return told | relaxed | {"verdict": "a plan of the relaxed task", "given_up": given_up} | limits

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


def _summary(scenario: Any, plan: Plan) -> dict[str, Any]:
    from planners.free_flyer.continuous_time import compute_continuous_robustness

    between = compute_continuous_robustness(scenario.as_believed(), plan)
    deviation = {} if plan.deviation is None else {"deviation": plan.deviation, "deviation_bound": plan.deviation_bound}
    return {
        "scenario": scenario.name,
        "objective": plan.objective,
        # Solvers stop within 1e-8 of the optimum; digits beyond the sixth say nothing.
        "robustness": round(plan.robustness, 6),
        "continuous_robustness": None if between is None else round(between, 6),
        "bound": round(plan.bound, 6),
        "gap": 0.0 if plan.gap <= PROVEN_GAP else round(plan.gap, 6),
        **deviation,
        **_describe_shapes(plan),
        "path_cost": plan.effort,
        "path_cost_bound": plan.effort_bound,
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


def judge_plan(plan: Plan, clock: Clock, time_limit: float, max_impacts: int) -> dict[str, Any]:
    """Return the verdict in words, and whether planning was interrupted.

    Args:
        plan: as it was found.
        clock: of planning.
        time_limit: of planning [s].
        max_impacts: greatest number of impacts that were allowed.
    """
    if clock.stopped:
        return {"verdict": "interrupted: the best plan until then", "interrupted": True}
    if plan.objective != "robustness":
        return {"verdict": "a plan, and what no plan exceeds"}
    if plan.gap <= PROVEN_GAP:
        return {"verdict": "proven: no plan is more robust"}
    why = f"with up to {count_things(max_impacts, 'impact')} and the planner's reserves no more was found"
    if plan.solve_seconds >= SEARCH_SHARE * time_limit:
        why = "the search for more ended with its part of the time; raise --time-limit"
    return {"verdict": f"a plan with {plan.robustness:.3g} m, no plan has more than {plan.bound:.3g} m: {why}"}


def _describe_shapes(plan: Plan) -> dict[str, Any]:
    """Return by how much less a plan for objects that are no discs may keep, in figures and words."""
    if not plan.shape_error:
        return {}
    told = f"objects are no discs: the flown robustness may be lower by up to {plan.shape_error:.3g} m"
    return {"shape_error": plan.shape_error, "warning": told}


def _write_samples(scenario: Any, plan: Plan, folder: Path) -> list[Path]:
    """Write a table for each body, one row a control period, and one of the impacts; returns the files.

    Robots hold their heading, and need the force m a, in the world's frame.
    """
    import numpy as np

    times = np.arange(round(plan.horizon / scenario.control_period) + 1) * scenario.control_period
    times = np.minimum(times, plan.horizon)  # rounding must not leave the plan, where nothing moves
    bodies, files = scenario.robots | scenario.objects, []
    for name, curve in (plan.robots | plan.objects).items():
        body, (x, y), (vx, vy) = bodies[name], curve.position(times).T, curve.velocity(times).T
        columns = {"t": times, "x": x, "y": y, "vx": vx, "vy": vy}
        columns["heading"] = body.heading + body.start_rate * times
        if name in plan.robots:
            columns["force_x"], columns["force_y"] = body.mass * curve.acceleration(times).T
        files.append(folder / make_file_name(name, suffix=".csv"))
        write_table(files[-1], columns)
    files.append(folder / "plan.impacts.csv")  # no body has a name with a dot
    write_table(files[-1], _list_impacts(plan))
    return files


def _list_impacts(plan: Plan) -> dict[str, Any]:
    columns: dict[str, Any] = {
        name: [getattr(hit, name) for hit in plan.impacts] for name in ("time", "robot", "object")
    }
    for name in ("position", "contact", "normal", "robot_minus", "robot_plus", "object_minus", "object_plus"):
        for axis, letter in enumerate("xy"):
            columns[f"{name}_{letter}"] = [float(getattr(hit, name)[axis]) for hit in plan.impacts]
    return columns

"""The ``impact sweep`` command."""

from __future__ import annotations

import itertools
import shlex
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, Literal, get_type_hints

from pydantic import TypeAdapter, ValidationError
from tyro.conf import OmitArgPrefixes, Positional

from impact_envs.errors import InputError, choices
from impact_envs.file import make_file_name
from train.arguments import Args, TuneArgs
from train.cli.progress import say_kept, say_written
from train.cli.seeds import list_runs
from train.errors import NothingFound
from train.evaluation.case import EVALUATION_SEEDS, TUNING_SEEDS, Case, make_cases
from train.given_plan import load_plans
from train.launch.choice import Launch, use_launcher
from train.launch.launcher import Launcher
from train.runs import TrainingRun, check_runs, name_folder
from train.search.search import Sampling, Trial, check_sampling, find_best, list_trials, run_search
from train.search.space import Point, Space, check_distinct, list_shown, parse_space, write_value
from train.settings import list_settings, parse_settings

if TYPE_CHECKING:
    from planners.plan import Plan

LEARNED = "learn."  # how a value of the training script begins


@dataclass
class Command:
    """Judge policies, or train them, in every scenario and suite, at every point of a grid or of a search.

    Policies are judged in one evaluation, of which each point is a suite of its own: "hard, true.restitution=0.5". With
    --learn a policy is trained for each scenario, suite, point and training seed. With --sample points are proposed by
    Optuna, from what those before came to, and the best is told.
    """

    extras: ClassVar[tuple[str, ...]] = ("plan", "report")
    scenarios: Positional[tuple[str, ...]]
    """Shipped names or TOML files."""
    suite: tuple[str, ...] = ("nominal",)
    """Mismatch suites."""
    grid: tuple[str, ...] = ()
    """KEY=[VALUE, ...] each, every combination is a point: values of the scenario, expert.NAME of the expert, and with
    --learn learn.NAME of the training script."""
    policies: tuple[str, ...] = ("expert", "zero")
    """As impact evaluate takes them; not with --learn."""
    episodes: int = 200
    """Episodes per scenario, suite, point and policy; not with --learn."""
    seed: int | None = None
    """First seed of the episodes; without, 2,000,000, and 1,000,000 with --sample; not with --learn."""
    plan: tuple[str, ...] = ()
    """Let the experts follow this plan, as impact evaluate does; of several scenarios SCENARIO=PATH each, those that
    are not named are planned. Not with --learn."""
    single: bool = False
    """Play one world at a time, with solve times, effort and replays; without, many at once."""
    learn: Literal["train", "tune"] | None = None
    """Train residuals, or find the best constants, instead of judging."""
    seeds: tuple[int, ...] = (0,)
    """Training seeds of --learn."""
    set: tuple[str, ...] = ()
    """Values to change at all points, for example true.restitution=0.5 expert.NAME=VALUE learn.NAME=VALUE."""
    out: str | None = None
    """Folder or URI of the evaluation, or of the runs; a second call with it goes on. Needed by --learn."""
    sampling: OmitArgPrefixes[Sampling] = field(default_factory=Sampling)
    launch: OmitArgPrefixes[Launch] = field(default_factory=Launch)
    json: bool = False

    def run(self) -> dict[str, Any]:
        """Return the evaluation's rows and paired differences, or a row of each run; of a search its trials."""
        check_sampling(self.sampling)
        self._check_meant()
        points = list_points(self.grid)
        with use_launcher(self.launch) as launcher:
            if self.sampling.sample:
                return self._search(launcher)
            return self._judge(launcher, points) if self.learn is None else self._train(launcher, points)

    def _check_meant(self) -> None:
        """Raise if an option is given that nothing looks at.

        Raises:
            InputError: naming it.
        """
        plain = Command(())
        for name in ("seeds",) if self.learn is None else ("policies", "episodes", "seed", "single"):
            value = getattr(self, name)
            if value != getattr(plain, name):
                given = value if isinstance(value, tuple) else () if value is True else (value,)
                why = "needs --learn, what is trained" if self.learn is None else "is for judging, not for --learn"
                raise InputError(f"{' '.join((f'--{name}', *map(str, given)))}: {why}")

    def _judge(self, launcher: Launcher, points: Sequence[Point]) -> dict[str, Any]:
        from train.evaluation.evaluate import evaluate_cases

        plans = self._load_plans()
        cases = [case for point in points for case in self._make_cases(point, plans)]
        result = evaluate_cases(
            cases,
            self.policies,
            self.episodes,
            EVALUATION_SEEDS if self.seed is None else self.seed,
            self.launch.workers or 1,
            self.out,
            batched=not self.single,
            launcher=launcher if launcher.remote else None,
        )
        say_written(result.out)
        say_kept(result.others, result.out)
        return {"rows": result.rows, "paired": result.paired, "set": parse_settings(self.set)}

    def _load_plans(self) -> dict[str, Plan]:
        return load_plans(self._make_cases((), {}), self.plan)

    def _make_cases(self, point: Point, plans: Mapping[str, Plan]) -> list[Case]:
        """Return the scenarios in their suites, which a point of the grid names, with the plans that are given."""
        cases = make_cases(self.scenarios, self.suite, parse_settings(self.set) | dict(point))
        return [
            replace(case, suite=", ".join((case.suite, *map(write_value, point))), plan=plans.get(case.scenario.name))
            for case in cases
        ]

    def _train(self, launcher: Launcher, points: Sequence[Point]) -> dict[str, Any]:
        self._check_learning()
        runs = self._make_runs(points)
        check_runs(runs)
        return list_runs(launcher, runs)

    def _check_learning(self) -> None:
        if self.out is None:
            raise InputError("--learn needs --out: where the policies go")
        if self.plan:
            raise InputError(f"--plan {' '.join(self.plan)}: is for judging; with --learn each training plans")

    def _search(self, launcher: Launcher) -> dict[str, Any]:
        """Propose and score points until there are enough; return all trials and the best."""
        if self.grid:
            raise InputError(f"--grid {self.grid[0]}: is not searched; --sample takes KEY=[VALUE, ...], too")
        space = parse_space(self.sampling.sample)
        if self.out is None:
            raise InputError("--sample needs --out: where trials go, from which a second call goes on")
        find = self._judge_points if self.learn is None else self._train_points
        return find(launcher, self.out, space)

    def _judge_points(self, launcher: Launcher, out: str, space: Space) -> dict[str, Any]:
        from train.search.judging import SCORES, Judging

        seed = TUNING_SEEDS if self.seed is None else self.seed
        judging = Judging(
            partial(self._make_cases, plans=self._load_plans()), self.policies, self.episodes, seed, self.single, out,
            launcher, self.launch.workers or 1, self.sampling.maximise or SCORES[0],
        )  # fmt: skip
        judging.check(list_shown(space))
        names = ("scenarios", "suite", "policies", "episodes", "single", "set", "plan")
        asked = {name: getattr(self, name) for name in names} | {"seed": seed, "maximise": judging.maximise}
        trials = run_search(out, space, self.sampling, asked, judging.score)
        best = _choose_best(trials)
        judging.finish([trial.point for trial in trials if trial.score is not None])
        report = judging.report(best.point)
        say_written(out)
        values = [*self.set, *map(write_value, best.point)]
        words = ["--suite", *self.suite, "--policies", self.policies[0], "--set", *values]
        print(f"next: impact evaluate {shlex.join([*self.scenarios, *words])}", file=sys.stderr)
        return _describe_search(trials, best, judging.maximise) | {"report": report}

    def _train_points(self, launcher: Launcher, out: str, space: Space) -> dict[str, Any]:
        from train.search.training import SCORES, Training

        self._check_learning()
        training = Training(lambda point: self._make_runs([point]), launcher, self.sampling.maximise or SCORES[0])
        training.check(list_shown(space))
        names = ("scenarios", "suite", "learn", "seeds", "set")
        asked = {name: getattr(self, name) for name in names} | {"maximise": training.maximise}
        trials = run_search(out, space, self.sampling, asked, training.score)
        best = _choose_best(trials)
        return _describe_search(trials, best, training.maximise) | list_runs(launcher, self._make_runs([best.point]))

    def _make_runs(self, points: Sequence[Point]) -> list[TrainingRun]:
        fixed = parse_settings(self.set)
        return [
            self._make_run(scenario, suite, point, fixed, seed)
            for scenario in self.scenarios
            for suite in self.suite
            for point in points
            for seed in self.seeds
        ]

    def _make_run(self, scenario: str, suite: str, point: Point, fixed: dict[str, Any], seed: int) -> TrainingRun:
        assert self.learn is not None and self.out is not None
        values = fixed | dict(point)
        plain: Args | TuneArgs = Args() if self.learn == "train" else TuneArgs()
        learned = {key.removeprefix(LEARNED): value for key, value in values.items() if key.startswith(LEARNED)}
        world = tuple(write_value(item) for item in values.items() if not item[0].startswith(LEARNED))
        args = replace(plain, scenarios=(scenario,), suite=(suite,), seed=seed, set=world, **_fit(plain, learned))
        words = [make_file_name(scenario, suite, *map(write_value, point), suffix=""), f"seed{seed}"]
        told = (("scenario", scenario), ("suite", suite), *point, ("seed", seed))
        return TrainingRun(self.learn, args, name_folder(self.out, *words), told)


def list_points(grid: Sequence[str]) -> list[Point]:
    """Return every combination of a grid's values; one without any if there is no grid.

    Args:
        grid: KEY=[VALUE, ...] each.

    Raises:
        InputError: a text that gives no list, an empty one, or a key or value given twice.
    """
    axes = list[list[tuple[str, Any]]]()
    for text in grid:
        ((key, values),) = parse_settings([text]).items()
        if not isinstance(values, list) or not values:
            raise InputError(f"--grid {text}: expected KEY=[VALUE, ...], for example true.restitution=[0.5,0.7]")
        if key in [axis[0][0] for axis in axes]:
            raise InputError(f"--grid {key}: is given twice")
        check_distinct("--grid", key, values)
        axes.append([(key, value) for value in values])
    return list(itertools.product(*axes))


def _choose_best(trials: Sequence[Trial]) -> Trial:
    """Return the best trial.

    Raises:
        NothingFound: all failed.
    """
    best = find_best(trials)
    if best is None:
        raise NothingFound(f"none of {len(trials)} trials has a score; the last one: {trials[-1].failure}")
    return trials[best]


def _describe_search(trials: Sequence[Trial], best: Trial, maximise: str) -> dict[str, Any]:
    return {"trials": list_trials(trials), "best": best.values, "maximised": maximise, "score": best.score}


def _fit(args: Args | TuneArgs, values: dict[str, Any]) -> dict[str, Any]:
    """Return values of a training script by the types that it has them in.

    Raises:
        InputError: it has no such argument, or one of another type, or one that the sweep sets itself.
    """
    plain, kinds = list_settings(vars(args)), get_type_hints(type(args))
    own = ("scenarios", "suite", "seed", "set", "out", "resume", "progress")
    fitting: dict[str, Any] = {}
    for name, value in values.items():
        if name not in plain or name in own:
            known = choices(name, [key for key in plain if key not in own])
            raise InputError(f"{LEARNED}{name}: the training script has no such value to sweep; {known}")
        given = tuple(value) if isinstance(value, list) else value
        try:
            fitting[name] = TypeAdapter(kinds[name]).validate_python(given, strict=True)
        except ValidationError as error:
            raise InputError(f"{LEARNED}{name}={value}: {error.errors()[0]['msg']}") from None
    return fitting

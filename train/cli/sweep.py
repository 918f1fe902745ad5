"""The ``impact sweep`` command."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Literal, get_type_hints

from pydantic import TypeAdapter, ValidationError
from tyro.conf import OmitArgPrefixes, Positional

from impact_envs.errors import InputError, choices
from impact_envs.file import make_file_name
from train.arguments import Args, TuneArgs
from train.cli.progress import say_written
from train.cli.seeds import list_runs
from train.evaluation.case import EVALUATION_SEEDS, Case, make_cases
from train.launch.choice import Launch, use_launcher
from train.launch.launcher import Launcher
from train.runs import TrainingRun, name_folder
from train.settings import list_settings, parse_settings

LEARNED = "learn."  # how a value of the training script begins
Point = tuple[tuple[str, Any], ...]  # of a grid: name to value


@dataclass
class Command:
    """Judge policies, or train them, in every scenario and suite, at every point of a grid of values.

    Policies are judged in one evaluation, of which each point of the grid is a suite of its own: "hard,
    true.restitution=0.5". With --learn a policy is trained for each scenario, suite, point and training seed.
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
    seed: int = EVALUATION_SEEDS
    """First seed of the episodes; not with --learn."""
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
    launch: OmitArgPrefixes[Launch] = field(default_factory=Launch)
    json: bool = False

    def run(self) -> dict[str, Any]:
        """Return the evaluation's rows and paired differences, or a row of each run."""
        points = list_points(self.grid)
        with use_launcher(self.launch) as launcher:
            return self._judge(launcher, points) if self.learn is None else self._train(launcher, points)

    def _judge(self, launcher: Launcher, points: Sequence[Point]) -> dict[str, Any]:
        from train.evaluation.evaluate import evaluate_cases

        cases = [case for point in points for case in self._make_cases(point)]
        result = evaluate_cases(
            cases,
            self.policies,
            self.episodes,
            self.seed,
            self.launch.workers or 1,
            self.out,
            batched=not self.single,
            launcher=launcher if launcher.remote else None,
        )
        say_written(result.out)
        return {"rows": result.rows, "paired": result.paired, "set": parse_settings(self.set)}

    def _make_cases(self, point: Point) -> list[Case]:
        """Return the scenarios in their suites at a point of the grid, which names the suite."""
        cases = make_cases(self.scenarios, self.suite, parse_settings(self.set) | dict(point))
        return [replace(case, suite=", ".join((case.suite, *map(_write, point)))) for case in cases]

    def _train(self, launcher: Launcher, points: Sequence[Point]) -> dict[str, Any]:
        if self.out is None:
            raise InputError("--learn needs --out: where the policies go")
        fixed = parse_settings(self.set)
        runs = [
            self._make_run(scenario, suite, point, fixed, seed)
            for scenario in self.scenarios
            for suite in self.suite
            for point in points
            for seed in self.seeds
        ]
        return list_runs(launcher, runs)

    def _make_run(self, scenario: str, suite: str, point: Point, fixed: dict[str, Any], seed: int) -> TrainingRun:
        assert self.learn is not None and self.out is not None
        values = fixed | dict(point)
        plain: Args | TuneArgs = Args() if self.learn == "train" else TuneArgs()
        learned = {key.removeprefix(LEARNED): value for key, value in values.items() if key.startswith(LEARNED)}
        world = tuple(_write(item) for item in values.items() if not item[0].startswith(LEARNED))
        args = replace(plain, scenarios=(scenario,), suite=(suite,), seed=seed, set=world, **_fit(plain, learned))
        words = [make_file_name(scenario, suite, *map(_write, point), suffix=""), f"seed{seed}"]
        told = (("scenario", scenario), ("suite", suite), *point, ("seed", seed))
        return TrainingRun(self.learn, args, name_folder(self.out, *words), told)


def list_points(grid: Sequence[str]) -> list[Point]:
    """Return every combination of a grid's values; one without any if there is no grid.

    Args:
        grid: KEY=[VALUE, ...] each.

    Raises:
        InputError: a text that gives no list, an empty one, or a key given twice.
    """
    axes = list[list[tuple[str, Any]]]()
    for text in grid:
        ((key, values),) = parse_settings([text]).items()
        if not isinstance(values, list) or not values:
            raise InputError(f"--grid {text}: expected KEY=[VALUE, ...], for example true.restitution=[0.5,0.7]")
        if key in [axis[0][0] for axis in axes]:
            raise InputError(f"--grid {key}: is given twice")
        axes.append([(key, value) for value in values])
    return list(itertools.product(*axes))


def _write(item: tuple[str, Any]) -> str:
    """Return a value as --set takes it."""
    key, value = item
    text = str(value).lower() if isinstance(value, bool) else str(value)
    return f"{key}={text}"


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

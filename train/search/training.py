"""Points scored by what is learned with them: a run of a training script for each scenario, suite and training seed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from impact_envs.errors import InputError, choices
from train.arguments import Args
from train.launch.launcher import Launcher
from train.runs import TrainingRun, check_runs, launch_runs
from train.search.space import Point

SCORES = ("low", "gain", "success_rate")


@dataclass(frozen=True)
class Training:
    """Runs by which points are scored.

    Attributes:
        make_runs: returns the runs of a point, each in a folder of its own.
        launcher: who does them.
        maximise: one of SCORES: the kept policy's, on tuning seeds.
    """

    make_runs: Callable[[Point], list[TrainingRun]]
    launcher: Launcher
    maximise: str

    def check(self, points: Sequence[Point]) -> None:
        """Raise unless points of the space can be learned with; before anything is learned or written.

        Raises:
            InputError: one line naming what is wrong.
        """
        if self.maximise not in SCORES:
            raise InputError(f"--maximise {self.maximise}: is unknown; {choices(self.maximise, SCORES)}")
        runs = [run for point in points for run in self.make_runs(point)]
        check_runs(runs)
        for run in runs:
            if isinstance(run.args, Args) and run.args.eval_every == 0:
                raise InputError("learn.eval_every=0: a search needs evaluations on tuning seeds")

    def score(self, points: Sequence[Point]) -> list[float | str]:
        """Return each point's score, or a line that says why one of its runs failed."""
        runs = [self.make_runs(point) for point in points]
        everyone = [run for some in runs for run in some]
        results = launch_runs(self.launcher, everyone, keep_failures=True)
        found = dict(zip([run.out for run in everyone], results, strict=True))
        return [self._compute([found[run.out] for run in some]) for some in runs]

    def _compute(self, results: Sequence[dict[str, Any]]) -> float | str:
        for result in results:
            if "failure" in result:
                return str(result["failure"])
        return float(np.mean([result["eval"][self.maximise] for result in results]))

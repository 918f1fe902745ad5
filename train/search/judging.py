"""Points scored by episodes on tuning seeds: one evaluation, in which each point is a suite of its own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from impact_envs.errors import InputError, choices
from planners.errors import PlanningError
from planners.plan import Plan
from train.evaluation.case import REPORT_SEEDS, TUNING_SEEDS, Case
from train.evaluation.evaluate import EvaluationResult, check_request, evaluate_cases, make_plans
from train.evaluation.own_policy import read_policies
from train.evaluation.player import Job
from train.launch.launcher import Launcher
from train.search.space import Point

SCORES = ("robustness_mean", "robustness_median", "robustness_q05", "success_rate")


@dataclass(frozen=True)
class Judging:
    """Episodes by which points are scored.

    Attributes:
        make_cases: returns the cases of a point, which names their suites.
        policies: that play; the first one's episodes are the score.
        episodes: seeds per case and policy.
        seed: the first one.
        single: whether one world is played at a time.
        out: folder of the evaluation, or its URI.
        launcher: who plays.
        workers: processes, where this machine plays.
        maximise: one of SCORES.
        plans: made so far, by what they are for.
    """

    make_cases: Callable[[Point], list[Case]]
    policies: tuple[str, ...]
    episodes: int
    seed: int
    single: bool
    out: str
    launcher: Launcher
    workers: int
    maximise: str
    plans: dict[str, Plan] = field(default_factory=dict)

    def check(self, points: Sequence[Point]) -> None:
        """Raise unless points of the space can be judged; before anything is played or written.

        Raises:
            InputError: one line naming what is wrong.
        """
        if self.maximise not in SCORES:
            raise InputError(f"--maximise {self.maximise}: is unknown; {choices(self.maximise, SCORES)}")
        if self.seed < TUNING_SEEDS or self.seed + self.episodes > REPORT_SEEDS:
            raise InputError(
                f"--seed {self.seed}, --episodes {self.episodes}: a search scores on tuning seeds, {TUNING_SEEDS} to "
                f"{REPORT_SEEDS - 1}, never on those that judge what it found"
            )
        labels, batched = read_policies(self.policies), not self.single
        for point in points:
            check_request(
                self.make_cases(point), labels, self.episodes, self.seed, self.workers, self.launcher.remote, batched
            )

    def score(self, points: Sequence[Point]) -> list[float | str]:
        """Return each point's score, or a line that says why its expert has no plan."""
        cases = [self.make_cases(point) for point in points]
        failures = [self._plan(some) for some in cases]
        played = [case for some, failure in zip(cases, failures, strict=True) if failure is None for case in some]
        if not played:
            return [str(failure) for failure in failures]
        rows = self._evaluate(played, self.policies, self.seed, self.out).rows
        scores = {
            (row["scenario"], row["suite"]): row[self.maximise] for row in rows if row["policy"] == self.policies[0]
        }
        return [
            failure or float(np.mean([scores[case.scenario.name, case.suite] for case in some]))
            for some, failure in zip(cases, failures, strict=True)
        ]

    def finish(self, points: Sequence[Point]) -> None:
        """Write the tables of the whole evaluation: rounds wrote their own."""
        cases = [case for point in points for case in self.make_cases(point)]
        once = {(case.scenario.name, case.suite): case for case in cases}  # a point may have been proposed twice
        self._evaluate(list(once.values()), self.policies, self.seed, self.out)

    def report(self, best: Point) -> list[dict[str, Any]]:
        """Return what the first policy comes to at the best point, and without it, on seeds nothing was chosen on."""
        plain = self.make_cases(())
        cases = [*(plain if self._plan(plain) is None else ()), *self.make_cases(best)]
        found = self._evaluate(cases, self.policies[:1], REPORT_SEEDS, f"{self.out.rstrip('/')}/report").rows
        shown = ("scenario", "suite", "policy", "episodes", "success_rate", "robustness_median", self.maximise)
        return [{name: row[name] for name in dict.fromkeys(shown)} for row in found]

    def _plan(self, cases: Sequence[Case]) -> str | None:
        """Make the plans of a point, kept for later; return why there is none."""
        jobs = [Job(place, policy, self.seed) for place in range(len(cases)) for policy in self.policies]
        try:
            make_plans(cases, jobs, self.plans)
        except PlanningError as error:
            return str(error)
        return None

    def _evaluate(self, cases: Sequence[Case], policies: Sequence[str], seed: int, out: str) -> EvaluationResult:
        return evaluate_cases(
            cases,
            policies,
            self.episodes,
            seed,
            self.workers,
            out,
            batched=not self.single,
            launcher=self.launcher if self.launcher.remote else None,
            plans=self.plans,
        )

"""The ``impact evaluate`` command."""

from __future__ import annotations

import shlex
import sys
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar, Literal

from tyro.conf import OmitArgPrefixes, Positional

from impact_envs.errors import InputError
from train.cli.progress import say_kept, say_written
from train.evaluation.case import EVALUATION_SEEDS, make_cases
from train.given_plan import check_plan_options, load_plans
from train.launch.choice import Launch, use_launcher
from train.settings import parse_settings


@dataclass
class Command:
    """Judge policies on the same seeds."""

    extras: ClassVar[tuple[str, ...]] = ("plan", "report")
    scenarios: Positional[tuple[str, ...]]
    """Shipped names or TOML files."""
    policies: tuple[str, ...] = ("expert", "zero")
    """expert, oracle (told the truth), zero, random, variants of the expert, shipped policies or checkpoint folders, or
    MODULE:FACTORY of your own (module in the working folder, or a file: mine.py:make)."""
    episodes: int = 20
    """Episodes per scenario, suite and policy."""
    seed: int = EVALUATION_SEEDS
    """First seed; the episodes take the following ones."""
    suite: tuple[str, ...] = ("nominal",)
    """Mismatch suites."""
    set: tuple[str, ...] = ()
    """Values to change, for example true.restitution=0.5 expert.NAME=VALUE."""
    plan: tuple[str, ...] = ()
    """Let the experts follow this plan: a JSON file, or a folder of published CSV files. Of several scenarios:
    SCENARIO=PATH each; those that are not named are planned."""
    rename: tuple[str, ...] = ()
    """Names of bodies in a published plan, each PLAN=SCENARIO."""
    force: bool = False
    """Fly a plan whatever it breaks."""
    objective: Literal["robustness", "impact_uncertainty"] | None = None
    """Without --plan: what the experts' plans maximise; robustness without."""
    launch: OmitArgPrefixes[Launch] = field(default_factory=Launch)
    batched: bool = False
    """Play many worlds at once: the same verdicts much sooner, without solve times, effort and replays."""
    out: Path | None = None
    """Folder of rows, summary and replays, or its URI, such as s3://BUCKET/FOLDER; a second call with it resumes."""
    json: bool = False

    def run(self) -> dict[str, Any]:
        """Return the summary's rows and paired differences."""
        from train.evaluation.evaluate import evaluate_cases

        settings = parse_settings(self.set)
        cases = make_cases(self.scenarios, self.suite, settings)
        check_plan_options(self.plan, self.rename, self.force)
        if self.plan:
            self._check_plan()
            plans = load_plans(cases, self.plan, self.rename, self.force)
            cases = [replace(case, plan=plans.get(case.scenario.name)) for case in cases]
        elif self.objective is not None:
            cases = [replace(case, objective=self.objective) for case in cases]
        with use_launcher(self.launch) as launcher:
            result = evaluate_cases(
                cases,
                self.policies,
                self.episodes,
                self.seed,
                self.launch.workers or 1,
                self.out,
                batched=self.batched,
                launcher=launcher if launcher.remote else None,  # here smaller shards lose less
            )
        if result.out is not None:
            say_written(result.out)
            say_kept(result.others, result.out)
            if isinstance(result.out, Path):
                print(f"next: impact report {shlex.quote(str(self.out))}", file=sys.stderr)
        return {"rows": result.rows, "paired": result.paired, "set": settings} | self._describe_plan()

    def _check_plan(self) -> None:
        if self.objective is not None:
            given = " ".join(self.plan)
            raise InputError(f"--plan {given}: has its objective; leave out --objective {self.objective}")

    def _describe_plan(self) -> dict[str, Any]:
        """Return what was asked for of the plans."""
        asked = {"plan": " ".join(self.plan), "objective": self.objective}
        return {key: value for key, value in asked.items() if value}

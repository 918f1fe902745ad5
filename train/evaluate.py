"""Paired evaluation: every policy on the same seeds of the same worlds, one tidy row per episode."""

from __future__ import annotations

import io
import time
from collections.abc import Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from agents.checkpoint import write_atomically
from impact_envs.errors import InputError, choices
from impact_envs.scenario import Scenario, load_scenario
from planners import has_planner, list_variants, make_plan
from planners.plan import Plan
from train.grasp_metrics import add_figures, add_torque_steps
from train.metrics import compare, summarize
from train.play import Case, Job, checkpoint_directory, follows_plan, is_built_in, make_policy, play
from train.record import Journal, digest, episode_to_dict, row_key, write_json

__all__ = ["EVALUATION_SEEDS", "EvaluationResult", "episode_to_dict", "evaluate", "make_policy"]

# Training uses seeds below 1,000,000, tuning those below this one.
EVALUATION_SEEDS = 2_000_000


@dataclass(frozen=True)
class EvaluationResult:
    """What an evaluation found.

    Attributes:
        rows: aggregates per scenario, suite and policy, see metrics.summarize and grasp_metrics.add_figures.
        paired: paired differences, see metrics.compare and grasp_metrics.add_torque_steps.
        episodes: one row per episode, see record.make_row and grasp_metrics.compute_figures.
        episodes_played: how many were played now; the rest came from the output directory.
        wall_seconds: duration, planning included [s].
        out: where the files are; None if nothing was written.
    """

    rows: list[dict[str, Any]]
    paired: list[dict[str, Any]]
    episodes: pd.DataFrame
    episodes_played: int
    wall_seconds: float
    out: Path | None

    def to_dict(self) -> dict[str, Any]:
        """Return the result as one JSON object, without the single episodes."""
        return {
            "rows": self.rows,
            "paired": self.paired,
            "episodes_played": self.episodes_played,
            "wall_seconds": round(self.wall_seconds, 3),
            "episodes_per_second": round(self.episodes_played / max(self.wall_seconds, 1e-9), 3),
            "out": str(self.out) if self.out else None,
        }


def evaluate(
    scenarios: Sequence[str | Path | Scenario],
    policies: Sequence[str] = ("expert", "zero"),
    episodes: int = 20,
    seed: int = EVALUATION_SEEDS,
    suites: Sequence[str] = ("nominal",),
    workers: int = 1,
    out: str | Path | None = None,
    progress: bool = True,
) -> EvaluationResult:
    """Play every policy on the same seeds and sum up what happened.

    Rows do not depend on the number of workers, except for measured times. With ``out``, finished episodes
    are kept: calling again with the same arguments plays only what is missing.

    Args:
        scenarios: shipped names, paths of TOML files, or Scenarios.
        policies: names as train.play.make_policy takes them; in a pair the later one is compared with the
            earlier.
        episodes: seeds per scenario, suite and policy.
        seed: first seed; the others follow.
        suites: mismatch suites of the true world.
        workers: processes; 1 plays in this one.
        out: folder for rows.parquet, summary.json, replays and the journal; nothing is written without.
        progress: show a bar on standard error.

    Returns:
        Aggregates, paired differences and rows.

    Raises:
        InputError: one line naming what is unknown or does not fit.
        PlanningError: an expert found no plan.
    """
    start = time.perf_counter()
    labels = [str(policy).rstrip("/") or str(policy) for policy in policies]
    cases = _make_cases(scenarios, suites)
    _check_request(cases, labels, episodes, seed, workers)
    jobs = [
        Job(case, label, number, replay=out is not None and number == seed)
        for case in range(len(cases))
        for label in labels
        for number in range(seed, seed + episodes)
    ]
    journal = Journal(out, _digests(cases, labels)) if out is not None else None
    rows = dict(journal.rows) if journal else {}
    missing = [job for job in jobs if _key(cases, job) not in rows]
    if journal:
        journal.write_manifest(_describe(cases, labels, episodes, seed))
    cases = _make_plans(cases, missing)
    bar = (TextColumn("evaluating"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    # Closed, not left to the garbage collector: an interruption must reach the workers at once.
    with (
        Progress(*bar, console=Console(stderr=True), disable=not progress) as shown,
        closing(play(cases, missing, workers)) as outcomes,
    ):
        for row, replay in shown.track(outcomes, total=len(missing)):
            rows[row_key(row)] = row
            if journal:
                journal.append(row, replay)
    table = pd.DataFrame([rows[_key(cases, job)] for job in jobs])
    seconds = time.perf_counter() - start
    folder = journal.directory if journal else None
    rows_of_groups, pairs = add_figures(summarize(table), table), add_torque_steps(compare(table), table)
    result = EvaluationResult(rows_of_groups, pairs, table, len(missing), seconds, folder)
    if folder:
        _write(folder, result)
    return result


def _make_cases(scenarios: Sequence[str | Path | Scenario], suites: Sequence[str]) -> list[Case]:
    loaded = [load_scenario(scenario) for scenario in scenarios]
    _check_list("scenario", [scenario.name for scenario in loaded])
    _check_list("suite", suites)
    return [Case(scenario.suite(suite), suite) for scenario in loaded for suite in suites]


def _check_request(cases: Sequence[Case], labels: Sequence[str], episodes: int, seed: int, workers: int) -> None:
    _check_list("policy", labels)
    for name, value, least in (("episodes", episodes, 1), ("seed", seed, 0), ("workers", workers, 1)):
        if value < least:
            raise InputError(f"{name} {value} is too small; choices: {least}, {least + 1}, ...")
    for label in labels:
        for case in cases:
            if not is_built_in(label, case.scenario):
                _check_checkpoint(label, list_variants(case.scenario))


def _check_list(kind: str, names: Sequence[str]) -> None:
    if not names:
        raise InputError(f"no {kind} to evaluate; name at least one")
    for place, name in enumerate(names):
        if name in names[:place]:
            raise InputError(f"{kind} '{name}' is given twice; {choices('', sorted(set(names)))}")


def _check_checkpoint(label: str, variants: Sequence[str]) -> None:
    # Imported here: an evaluation without checkpoints needs no torch.
    from agents.actor import load_policy

    load_policy(checkpoint_directory(label, variants))


def _digests(cases: Sequence[Case], labels: Sequence[str]) -> dict[str, str]:
    """Return what each input's content is told by, so that a journal is never continued with other inputs."""
    digests = {f"{case.scenario.name}/{case.suite}": digest(case.scenario.model_dump_json().encode()) for case in cases}
    for label in labels:
        if not all(is_built_in(label, case.scenario) for case in cases):
            files = sorted(checkpoint_directory(label).glob("policy.*"))
            digests[label] = digest(*(file.read_bytes() for file in files))
    return digests


def _describe(cases: Sequence[Case], labels: Sequence[str], episodes: int, seed: int) -> dict[str, Any]:
    fields = ("name", "domain", "description", "formula", "horizon")
    return {
        "cases": [{key: getattr(case.scenario, key) for key in fields} | {"suite": case.suite} for case in cases],
        "policies": list(labels),
        "episodes": episodes,
        "seed": seed,
    }


def _key(cases: Sequence[Case], job: Job) -> tuple[str, str, str, int]:
    case = cases[job.case]
    return case.scenario.name, case.suite, job.policy, job.seed


def _make_plans(cases: Sequence[Case], jobs: Iterable[Job]) -> list[Case]:
    """Plan once per believed scenario, and not in the workers: a plan may depend on how busy they are."""
    needed = {job.case for job in jobs if follows_plan(job.policy) and has_planner(cases[job.case].scenario)}
    plans: dict[str, Plan] = {}
    planned = []
    for place, case in enumerate(cases):
        believed = case.scenario.as_believed()
        key = believed.model_dump_json()
        if place in needed and key not in plans:
            plans[key] = make_plan(believed)
        planned.append(Case(case.scenario, case.suite, plans.get(key)))
    return planned


def _write(folder: Path, result: EvaluationResult) -> None:
    table = io.BytesIO()
    result.episodes.to_parquet(table, index=False)
    write_atomically(folder / "rows.parquet", table.getvalue())
    write_json(folder / "summary.json", result.to_dict())

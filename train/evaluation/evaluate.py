"""Paired evaluation: every policy on the same seeds of the same worlds, one tidy row per episode."""

from __future__ import annotations

import io
import json
import pickle
import time
from collections.abc import Generator, Iterable, Mapping, Sequence
from contextlib import closing, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from impact_envs.errors import InputError
from impact_envs.scenario import Scenario
from impact_envs.stream import check_seed
from planners import has_planner, list_variants, make_plan
from planners.plan import Plan
from train.evaluation.batch_player import check_batched
from train.evaluation.case import (
    EVALUATION_SEEDS,
    Case,
    check_names,
    check_plan,
    check_settings,
    has_expert,
    is_built_in,
    list_changes,
    make_cases,
)
from train.evaluation.folder_lock import lock_folder
from train.evaluation.journal import Journal, digest, row_key
from train.evaluation.metrics import compare_metrics, summarize
from train.evaluation.own_policy import Factory, OwnPolicy, announce, read_policies
from train.evaluation.player import Job, Outcome, checkpoint_directory
from train.evaluation.shard import Request, ShardSizes, cut_shards, describe_facts, digest_policies, start_playing
from train.evaluation.statistics import compare
from train.launch.ending import end_on_sigterm, keep_interrupts
from train.launch.folder import is_uri, write_uri
from train.launch.launcher import Launcher
from train.launch.local import PATIENCE, LocalLauncher
from train.launch.origin import describe_origin

# Per scenario, suite and policy. All are listed: a slip of the keyboard must not fill the memory.
MOST_EPISODES = 1_000_000


@dataclass(frozen=True)
class EvaluationResult:
    """What an evaluation found.

    Attributes:
        rows: aggregates per scenario, suite and policy, see metrics.summarize.
        paired: paired differences, see statistics.compare and metrics.compare_metrics.
        episodes: one row per episode, see metrics.make_row.
        episodes_played: how many were played now; the rest came from the output directory.
        wall_seconds: duration, planning included [s].
        out: where the files are, a folder or its URI; None if nothing was written.
        others: how many episodes of other requests are kept there, which are not in the tables.
    """

    rows: list[dict[str, Any]]
    paired: list[dict[str, Any]]
    episodes: pd.DataFrame
    episodes_played: int
    wall_seconds: float
    out: Path | str | None
    others: int = 0

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
    policies: Sequence[str] | Mapping[str, Factory | str] = ("expert", "zero"),
    episodes: int = 20,
    seed: int = EVALUATION_SEEDS,
    suites: Sequence[str] = ("nominal",),
    workers: int = 1,
    out: str | Path | None = None,
    progress: bool = True,
    batched: bool = False,
    launcher: Launcher | None = None,
) -> EvaluationResult:
    """Play every policy on the same seeds and sum up what happened.

    Rows do not depend on the number of workers, except for measured times. With ``out``, finished episodes
    are kept: calling again with the same arguments plays only what is missing.

    Args:
        scenarios: shipped names, paths of TOML files, or Scenarios.
        policies: names as player.make_policy takes them, or label to a function that makes a policy of the scenario,
            such as ``{"expert": "expert", "mine": make_mine}``; in a pair the later is compared with the earlier.
        episodes: seeds per scenario, suite and policy.
        seed: first seed; the others follow.
        suites: mismatch suites of the true world.
        workers: processes; 1 plays in this one.
        out: folder for rows.parquet, summary.json, replays and the journal, or its URI (``s3://``, ``file://``, what
            pyarrow reaches); default: nothing is written.
        progress: show a bar on standard error.
        batched: play many worlds at once: the same success and robustness a hundred times sooner, without solve times,
            effort, a domain's figures and replays; see batch_player. ``workers`` are started where that takes longer
            than some seconds.
        launcher: who plays, such as a Ray cluster; default: this machine, by ``workers``.

    Returns:
        Aggregates, paired differences and rows.

    Raises:
        InputError: one line naming what is unknown or does not fit, or that another process writes into ``out``.
        PlanningError: an expert found no plan.
        WorkerLost: an episode ended its worker process twice.
    """
    cases = make_cases(scenarios, suites)
    return evaluate_cases(cases, policies, episodes, seed, workers, out, progress, batched, launcher)


def evaluate_cases(
    cases: Sequence[Case],
    policies: Sequence[str] | Mapping[str, Factory | str],
    episodes: int = 20,
    seed: int = EVALUATION_SEEDS,
    workers: int = 1,
    out: str | Path | None = None,
    progress: bool = True,
    batched: bool = False,
    launcher: Launcher | None = None,
    sizes: ShardSizes | None = None,
    plans: dict[str, Plan] | None = None,
) -> EvaluationResult:
    """Play every policy on the same seeds of the same cases; see evaluate.

    Args:
        cases: worlds to be judged in.
        policies: names as player.make_policy takes them, or label to what makes one.
        episodes: seeds per case and policy.
        seed: first seed; the others follow.
        workers: processes; 1 plays in this one.
        out: folder for rows.parquet, summary.json, replays and the journal, or its URI (``s3://``, ``file://``, what
            pyarrow reaches); default: nothing is written.
        progress: show a bar on standard error.
        batched: play many worlds at once: the same success and robustness a hundred times sooner, without solve times,
            effort, a domain's figures and replays; see batch_player. ``workers`` are started where that takes longer
            than some seconds.
        launcher: who plays, such as a Ray cluster; default: this machine, by ``workers``.
        sizes: of the shards that a launcher is given, or that are kept behind a URI.
        plans: made by other calls for the same believed scenarios, see make_plans; those made here are added.

    Raises:
        InputError: one line naming what is unknown or does not fit, or that another process writes into ``out``.
        PlanningError: an expert found no plan.
        WorkerLost: an episode ended its worker process twice.
    """
    start = time.perf_counter()
    if out is not None:
        import pyarrow  # noqa: F401  # that it is missing must not be found out after everything was played
    labels = read_policies(policies)
    sent = launcher is not None or workers > 1
    check_request(cases, labels, episodes, seed, workers, sent, batched)
    jobs = [
        Job(case, label, number, replay=out is not None and number == seed and not batched)
        for case in range(len(cases))
        for label in labels
        for number in range(seed, seed + episodes)
    ]
    shared = out is not None and is_uri(out)
    out = write_uri(out) if out is not None and shared else out
    # Behind a URI nobody can lock: two who write there write the same rows under the same names.
    with nullcontext() if out is None or shared else lock_folder(out):
        journal = Journal(out, _digests(cases, labels)) if out is not None else None
        rows = dict(journal.rows) if journal else {}
        missing = [job for job in jobs if _key(cases, job) not in rows]
        request = _describe(cases, labels, episodes, seed)
        # In a folder, not before there is an episode to describe: a policy that fails at once leaves nothing behind.
        if journal and (shared or not missing):
            journal.write_manifest(request)
        cases = make_plans(cases, missing, plans)
        bar = (TextColumn("evaluating"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
        # Closed, not left to the garbage collector: an interruption must reach the workers at once.
        with (
            end_on_sigterm(),
            keep_interrupts(),
            Progress(*bar, console=Console(stderr=True), disable=not (progress and missing)) as shown,
            closing(_play(cases, labels, missing, batched, workers, out, launcher, sizes or ShardSizes())) as outcomes,
        ):
            for place, (row, replay) in enumerate(shown.track(outcomes, total=len(missing))):
                rows[row_key(row)] = row
                if journal:
                    if place == 0 and not shared:
                        journal.write_manifest(request)
                    journal.append(row, replay)
        table = pd.DataFrame([rows[_key(cases, job)] for job in jobs])
        return _sum_up(table, cases, len(missing), start, journal)


def _play(
    cases: Sequence[Case],
    labels: Sequence[str],
    jobs: Sequence[Job],
    batched: bool,
    workers: int,
    out: str | Path | None,
    launcher: Launcher | None,
    sizes: ShardSizes,
) -> Generator[Outcome]:
    """Play what is missing: here, where the smallest shards lose least, or by a launcher."""
    request = Request(tuple(cases), tuple(labels), batched, out=str(out) if out is not None and is_uri(out) else None)
    size: int | None = sizes.batched if batched else sizes.single
    if launcher is None:
        # Many worlds are those of shipped policies and of checkpoints: nothing in them comes from the user's script.
        launcher = LocalLauncher(workers, PATIENCE, with_main=False) if batched else LocalLauncher(workers)
        if request.out is None:
            size = sizes.share(len(jobs), workers) if batched else 1
    elif launcher.remote:
        request = replace(
            request, origin=describe_origin(describe_facts(cases, labels), bool(digest_policies(cases, labels)))
        )
    return launcher.run(partial(start_playing, request), cut_shards(jobs, size))


def _sum_up(
    table: pd.DataFrame, cases: Sequence[Case], played: int, start: float, journal: Journal | None
) -> EvaluationResult:
    domains = {case.scenario.name: case.scenario.domain for case in cases}
    pairs = [pair | compare_metrics(table, pair, domains[pair["scenario"]]) for pair in compare(table)]
    folder = (getattr(journal.folder, "path", None) or str(journal.folder)) if journal else None
    rows, seconds = summarize(table, domains), time.perf_counter() - start
    others = len(journal.rows) - len(table) if journal else 0
    result = EvaluationResult(rows, pairs, table, played, seconds, folder, others)
    if journal:
        _write(journal, result)
    return result


def check_request(
    cases: Sequence[Case],
    labels: Sequence[str],
    episodes: int,
    seed: int,
    workers: int,
    sent: bool = False,
    batched: bool = False,
) -> None:
    """Raise unless policies, cases and numbers fit together, and can be sent to other processes; see evaluate_cases."""
    check_names("policy", labels)
    for name, value, least in (("episodes", episodes, 1), ("seed", seed, 0), ("workers", workers, 1)):
        if value < least:
            raise InputError(f"{name} {value} is too small; choices: {least}, {least + 1}, ...")
    if episodes > MOST_EPISODES:
        raise InputError(f"episodes {episodes} is too large; at most {MOST_EPISODES}")
    check_seed(seed + episodes - 1, "seed of the last episode")
    for label in labels:
        for case in cases:
            if not is_built_in(label, case.scenario):
                _check_checkpoint(label, list_variants(case.scenario))
    for case in cases:
        check_settings(case, labels, batched)
        check_plan(case, labels)
    for label in labels if batched else ():
        check_batched(label)
    announce(labels)
    if sent:
        _check_sendable(labels)


def _check_sendable(labels: Sequence[str]) -> None:
    for label in labels:
        if isinstance(label, OwnPolicy):
            try:
                pickle.dumps(label)
            except (pickle.PicklingError, AttributeError, TypeError) as error:
                raise InputError(
                    f"policy '{label}': cannot be sent to other processes ({error}); use one worker, or a function of "
                    "a module"
                ) from None


def _check_checkpoint(label: str, variants: Sequence[str]) -> None:
    # Imported here: an evaluation without checkpoints needs no torch.
    from agents.actor import load_policy
    from agents.shared_actor import is_shared, load_shared

    directory = checkpoint_directory(label, variants)
    if is_shared(directory):
        load_shared(directory)
    else:
        load_policy(directory)


def _digests(cases: Sequence[Case], labels: Sequence[str]) -> dict[str, str]:
    """Return what each input's content is told by, so that a journal is never continued with other inputs."""
    digests = {}
    for case in cases:
        contents = [case.scenario.model_dump_json()]
        if case.options:
            contents.append(json.dumps(case.options, sort_keys=True, default=str))
        if case.plan:
            contents.append(case.plan.to_json())
        if case.objective != "robustness":
            contents.append(case.objective)
        digests[f"{case.scenario.name}/{case.suite}"] = digest(*(content.encode() for content in contents))
    return digests | digest_policies(cases, labels)


def _describe(cases: Sequence[Case], labels: Sequence[str], episodes: int, seed: int) -> dict[str, Any]:
    fields = ("name", "domain", "description", "formula", "horizon")
    # A sweep sets other values in each of its cases, which are then changes of the case's.
    first = cases[0].settings
    common = {key: first[key] for key in first if all(case.settings.get(key) == first[key] for case in cases)}
    return {
        "cases": [
            {key: getattr(case.scenario, key) for key in fields}
            | {"suite": case.suite, "changes": _list_changes(case, common)}
            for case in cases
        ],
        "policies": list(labels),
        "episodes": episodes,
        "seed": seed,
        "set": common,
    }


def _list_changes(case: Case, common: Mapping[str, Any]) -> dict[str, Any]:
    own = {key: value for key, value in case.settings.items() if key not in common}
    # The suite of a sweep's case is named by its values, too.
    return list_changes(case.scenario, case.suite.partition(", ")[0] if own else case.suite) | own


def _key(cases: Sequence[Case], job: Job) -> tuple[str, str, str, int]:
    case = cases[job.case]
    return case.scenario.name, case.suite, job.policy, job.seed


def make_plans(cases: Sequence[Case], jobs: Iterable[Job], plans: dict[str, Plan] | None = None) -> list[Case]:
    """Plan once per believed scenario, and not in the workers: a plan may depend on how busy they are.

    Args:
        cases: to be planned.
        jobs: for which plans are needed.
        plans: that are there, by what they are for; new ones are added.

    Raises:
        PlanningError: there is no plan.
    """
    needed = {job.case for job in jobs if has_expert(job.policy) and has_planner(cases[job.case].scenario)}
    plans = {} if plans is None else plans
    planned = []
    for place, case in enumerate(cases):
        believed = case.scenario.as_believed()
        key = believed.model_dump_json() + case.objective
        if place in needed and case.plan is None and key not in plans:
            plans[key] = make_plan(believed, case.objective)
        planned.append(replace(case, plan=case.plan or plans.get(key)))
    return planned


def _write(journal: Journal, result: EvaluationResult) -> None:
    table = io.BytesIO()
    result.episodes.to_parquet(table, index=False)
    journal.folder.write("rows.parquet", table.getvalue())
    journal.write("summary.json", result.to_dict())

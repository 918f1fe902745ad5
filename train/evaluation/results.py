"""Read an evaluation back from its directory: every file validated, every fault one line."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import pandas as pd
from pandas.api.types import is_numeric_dtype
from pydantic import BaseModel, Field, FiniteFloat, create_model

from impact_envs.errors import InputError, choices
from planners.plan import Plan
from train.evaluation.journal import Manifest, read_record
from train.evaluation.metric import Pair
from train.evaluation.metrics import METRICS

COLUMNS = ["scenario", "suite", "policy", "seed", "robustness", "success"]


class Group(BaseModel):
    """What every aggregate tells: of which episodes it is."""

    scenario: str
    suite: str
    policy: str
    episodes: int


def _list_fields() -> dict[str, Any]:
    """Return the fields of an aggregate, as pydantic takes them; those that older evaluations lack default to None."""
    return {
        aggregate.key: (aggregate.kind, ...) if metric.required else (aggregate.kind | None, None)
        for metric in METRICS
        for aggregate in metric.aggregates
    }


if TYPE_CHECKING:
    Row = Group
else:
    # The aggregate of one scenario, suite and policy, see metrics.summarize.
    Row = create_model("Row", __base__=Group, **_list_fields())


class Difference(BaseModel):
    """The paired difference of two policies, robustness(a) - robustness(b), see statistics.compare."""

    scenario: str
    suite: str
    a: str
    b: str
    episodes: int
    difference_median: FiniteFloat
    ci: Pair
    difference_mean: FiniteFloat
    win_rate: FiniteFloat
    tie_rate: FiniteFloat
    success_difference: FiniteFloat


class Summary(BaseModel):
    """All aggregates (summary.json)."""

    rows: list[Row] = Field(min_length=1)
    paired: list[Difference]


class ReplayShape(BaseModel):
    """One disc or polygon, see impact_envs.interface.shape.Shape."""

    body: str | None
    role: str
    radius: FiniteFloat | None
    vertices: list[Pair] | None
    label: str


class ReplayImpact(BaseModel):
    """When [s] and where [m] two bodies met."""

    time: FiniteFloat
    point: Pair


class Replay(BaseModel):
    """One recorded episode (replays/*.json), see replay.episode_to_dict."""

    format: Literal[1]
    scenario: str
    suite: str
    policy: str
    seed: int
    formula: str
    period: FiniteFloat
    world: tuple[Pair, Pair]
    bodies: list[str]
    shapes: list[ReplayShape]
    times: list[FiniteFloat] = Field(min_length=2)
    signals: dict[str, list[FiniteFloat]]
    impacts: list[ReplayImpact]
    robustness_bounds: list[tuple[FiniteFloat | None, FiniteFloat | None]]
    robustness: FiniteFloat
    plan: Plan | None
    links: dict[str, Any] = {}


@dataclass(frozen=True, eq=False)
class Evaluation:
    """All that a report shows.

    Args:
        manifest: what was asked.
        summary: aggregates and paired differences.
        episodes: one row per episode, columns COLUMNS.
        replays: one episode per scenario, suite and policy, in the order of the summary's rows.
        written: when the summary was written.
    """

    manifest: Manifest
    summary: Summary
    episodes: pd.DataFrame
    replays: tuple[Replay, ...]
    written: datetime


def read_evaluation(directory: str | Path) -> Evaluation:
    """Read what an evaluation wrote.

    Args:
        directory: the evaluation's output directory.

    Returns:
        The evaluation.

    Raises:
        InputError: the directory or one of its files is missing, or does not hold what it should.
    """
    directory = Path(directory)
    if not directory.is_dir():
        raise InputError(f"evaluation '{directory}' is not a directory; `impact evaluate ... --out DIR` makes one")
    manifest = read_record(Manifest, directory / "manifest.json")
    summary = read_record(Summary, directory / "summary.json")
    _check_manifest(manifest, summary, directory)
    episodes = _read_episodes(directory / "rows.parquet")
    replays = [_read_replay(path) for path in sorted((directory / "replays").glob("[!.]*.json"))]
    # A directory that was used before may hold replays of other policies or seeds.
    found = {(replay.scenario, replay.suite, replay.policy, replay.seed): replay for replay in replays}
    keys = [(row.scenario, row.suite, row.policy, manifest.seed) for row in summary.rows]
    written = datetime.fromtimestamp((directory / "summary.json").stat().st_mtime)
    return Evaluation(manifest, summary, episodes, tuple(found[key] for key in keys if key in found), written)


def _check_manifest(manifest: Manifest, summary: Summary, directory: Path) -> None:
    """Raise unless the manifest has every case and policy of the summary."""
    cases = [f"{case.name} under {case.suite}" for case in manifest.cases]
    for row in summary.rows:
        if (case := f"{row.scenario} under {row.suite}") not in cases:
            raise InputError(
                f"evaluation file {directory / 'manifest.json'}: cases lack {case}; {choices(case, cases)}"
            )
    named = [row.policy for row in summary.rows] + [name for pair in summary.paired for name in (pair.a, pair.b)]
    for name in named:
        if name not in manifest.policies:
            known = choices(name, manifest.policies)
            raise InputError(f"evaluation file {directory / 'manifest.json'}: policies lack '{name}'; {known}")


def _read_episodes(path: Path) -> pd.DataFrame:
    try:
        episodes = pd.read_parquet(path, columns=COLUMNS)
        for name in COLUMNS:
            episodes[name].tolist()  # text is decoded when it is used, and may turn out to be none
    except OSError as error:
        raise InputError(f"evaluation file {path}: cannot be read: {error.strerror or 'not Parquet'}") from None
    except ValueError as error:  # pyarrow's own errors are ValueErrors with many lines
        raise InputError(f"evaluation file {path}: {str(error).splitlines()[0]}") from None
    for name in COLUMNS:
        if is_numeric_dtype(episodes[name]) != (name in COLUMNS[3:]) or episodes[name].isna().any():
            raise InputError(f"evaluation file {path}: column '{name}' has type {episodes[name].dtype} or holds gaps")
    return episodes


def _read_replay(path: Path) -> Replay:
    """Read a replay and check what its fields say of each other."""
    replay = read_record(Replay, path)
    carried = {shape.body for shape in replay.shapes if shape.body is not None}
    wanted = [f"{body}.{name}" for body in replay.bodies for name in ("x", "y", "heading")]
    lengths = {len(replay.signals.get(name, ())) for name in (*wanted, *replay.signals)}
    lengths.add(len(replay.robustness_bounds))
    if lengths != {len(replay.times)}:
        raise InputError(f"evaluation file {path}: signals and bounds need {len(replay.times)} samples each")
    if carried - set(replay.bodies):
        raise InputError(f"evaluation file {path}: shapes name bodies that are not there: {sorted(carried)}")
    if any(shape.radius is None and not shape.vertices for shape in replay.shapes):
        raise InputError(f"evaluation file {path}: a shape has neither radius nor vertices")
    return replay

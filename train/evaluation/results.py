"""Read an evaluation back from its directory: every file validated, every fault one line."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import pandas as pd
from pydantic import BaseModel, Field, FiniteFloat, ValidationError, create_model

from impact_envs.errors import InputError
from train.evaluation.metric import Pair
from train.evaluation.metrics import METRICS

COLUMNS = ["scenario", "suite", "policy", "seed", "robustness"]


class JudgedCase(BaseModel):
    """One scenario in one suite (manifest.json)."""

    name: str
    suite: str
    description: str
    formula: str
    horizon: FiniteFloat


class Manifest(BaseModel):
    """What was asked of the evaluation (manifest.json); ``set``: values changed by the user."""

    format: Literal[1]
    cases: list[JudgedCase]
    policies: list[str]
    episodes: int
    seed: int
    versions: dict[str, str]
    cores: int
    set: dict[str, Any] = {}


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
    """One disc or polygon, see impact_envs.shape.Shape."""

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
    plan: dict[str, Any] | None
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


Content = TypeVar("Content", bound=BaseModel)


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
    manifest = _read(Manifest, directory / "manifest.json")
    summary = _read(Summary, directory / "summary.json")
    episodes = _read_episodes(directory / "rows.parquet")
    # A directory that was used before may hold replays of other policies or seeds.
    replays = [_read_replay(path) for path in sorted((directory / "replays").glob(f"*__{manifest.seed}.json"))]
    found = {(replay.scenario, replay.suite, replay.policy): replay for replay in replays}
    keys = [(row.scenario, row.suite, row.policy) for row in summary.rows]
    written = datetime.fromtimestamp((directory / "summary.json").stat().st_mtime)
    return Evaluation(manifest, summary, episodes, tuple(found[key] for key in keys if key in found), written)


def _read(model: type[Content], path: Path) -> Content:
    try:
        return model.model_validate_json(path.read_bytes())
    except OSError as error:
        raise InputError(f"evaluation file {path}: cannot be read: {error.strerror}") from None
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(str(part) for part in first["loc"]) or "content"
        raise InputError(f"evaluation file {path}: {where}: {first['msg']}") from None


def _read_episodes(path: Path) -> pd.DataFrame:
    try:
        return pd.read_parquet(path, columns=COLUMNS)
    except OSError as error:
        raise InputError(f"evaluation file {path}: cannot be read: {error.strerror or 'not Parquet'}") from None
    except ValueError as error:  # pyarrow's own errors are ValueErrors with many lines
        raise InputError(f"evaluation file {path}: {str(error).splitlines()[0]}") from None


def _read_replay(path: Path) -> Replay:
    """Read a replay and check what its fields say of each other."""
    replay = _read(Replay, path)
    carried = {shape.body for shape in replay.shapes if shape.body is not None}
    wanted = [f"{body}.{name}" for body in replay.bodies for name in ("x", "y", "heading")]
    lengths = {len(replay.signals.get(name, ())) for name in wanted} | {len(replay.robustness_bounds)}
    if lengths != {len(replay.times)}:
        raise InputError(f"evaluation file {path}: signals and bounds need {len(replay.times)} samples each")
    if carried - set(replay.bodies):
        raise InputError(f"evaluation file {path}: shapes name bodies that are not there: {sorted(carried)}")
    if any(shape.radius is None and not shape.vertices for shape in replay.shapes):
        raise InputError(f"evaluation file {path}: a shape has neither radius nor vertices")
    return replay

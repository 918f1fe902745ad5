"""A search: rounds of points, scored, written down, and gone on with after any end.

In its folder:

    search.json   what was asked, and every trial: its values, and its score or why it has none
    trials.csv    the same as a table

Points of a round are proposed together, before any of them is scored, and told in the order of their numbers: the
trials are the same for any number of workers, and for a search that was ended and begun again.
"""

from __future__ import annotations

import csv
import io
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from pydantic import BaseModel, FiniteFloat

from impact_envs.errors import InputError
from train.evaluation.journal import parse_record
from train.launch.folder import Folder, open_folder
from train.search.space import Point, Space

RECORD, TABLE = "search.json", "trials.csv"


@dataclass(frozen=True)
class Sampling:
    """Values that are searched instead of listed, and how."""

    sample: tuple[str, ...] = ()
    """Search by Optuna instead of a grid: KEY=LOW,HIGH a range (whole numbers if both ends are), KEY=LOW,HIGH,log one
    on a logarithmic scale, KEY=[VALUE, ...] choices; keys as --grid has them. Needs --out."""
    trials: int = 20
    """Points that are tried; a second call with more of them goes on."""
    together: int = 4
    """Points proposed at a time, before any of them is scored: more of them use more workers, fewer learn sooner."""
    maximise: str | None = None
    """Mean over scenarios, suites and seeds of: robustness_mean, robustness_median, robustness_q05 or success_rate, of
    the first policy; with --learn low (the gain over the expert that is sure), gain or success_rate. The first of each
    list without."""
    sampler: Literal["tpe", "random"] = "tpe"
    """How points are proposed: by tree-structured Parzen estimators, or at random."""
    search_seed: int = 0
    """Of the proposals."""


class Trial(BaseModel):
    """A point that was proposed (search.json).

    ``values``: name to value; ``score``: None until it is known, and of one that failed; ``failure``: why it did.
    """

    values: dict[str, Any]
    score: FiniteFloat | None = None
    failure: str | None = None

    @property
    def point(self) -> Point:
        """Return its values in their order."""
        return tuple(self.values.items())

    @property
    def over(self) -> bool:
        """Return whether nothing is left to do for it."""
        return self.score is not None or self.failure is not None


class Record(BaseModel):
    """A search on disk (search.json)."""

    format: Literal[1] = 1
    asked: dict[str, Any]
    trials: list[Trial]


# Scores of points, in their order, or lines that say why one has none.
Score = Callable[[Sequence[Point]], list[float | str]]


def check_sampling(sampling: Sampling) -> None:
    """Raise unless the numbers of a search make sense.

    Raises:
        InputError: one line naming the argument, its value and the choices.
    """
    if not sampling.sample:
        for name, usual in vars(Sampling()).items():
            if (value := getattr(sampling, name)) != usual:
                raise InputError(f"--{name.replace('_', '-')} {value}: needs --sample, what is searched")
    for name, least in (("trials", 1), ("together", 1), ("search_seed", 0)):
        if (value := getattr(sampling, name)) < least:
            raise InputError(f"--{name.replace('_', '-')} {value} is too small; choices: {least}, {least + 1}, ...")


def run_search(
    out: str, space: Space, sampling: Sampling, asked: Mapping[str, Any], score: Score, progress: bool = True
) -> list[Trial]:
    """Propose and score points until there are enough, and return all trials.

    Args:
        out: folder of the search, or its URI.
        space: to choose from.
        sampling: how.
        asked: what scores depend on, as JSON values; a search of other things is not gone on with.
        score: returns the score of each of some points, or a line why it has none.
        progress: say on standard error what each round came to.

    Raises:
        InputError: the folder holds another search, or is damaged.
    """
    from train.search.proposal import propose  # imported here: Optuna is an extra

    folder, how = open_folder(out), {name: getattr(sampling, name) for name in ("together", "sampler", "search_seed")}
    record = _read_record(folder, json.loads(json.dumps({**asked, "sample": sampling.sample, **how})))
    trials, together = record.trials, sampling.together
    while len(trials) < sampling.trials or not all(trial.over for trial in trials):
        if all(trial.over for trial in trials):
            # Whole rounds are proposed, so that more trials than before begin as if they had been asked for at once.
            begun = len(trials) - len(trials) % together
            tried = [(trial.point, trial.score) for trial in trials[:begun]]
            points = propose(space, tried, together, sampling.search_seed, sampling.sampler)
            trials += [Trial(values=dict(point)) for point in points[len(trials) - begun : sampling.trials - begun]]
            _write(folder, record)
        _score_rest(trials, score)
        _write(folder, record)
        if progress:
            print(_describe_best(trials, together), file=sys.stderr, flush=True)
    return trials


def find_best(trials: Sequence[Trial]) -> int | None:
    """Return the place of the trial with the greatest score, the first of several; None if all failed."""
    scored = {place: trial.score for place, trial in enumerate(trials) if trial.score is not None}
    return max(scored, key=scored.__getitem__, default=None)


def list_trials(trials: Sequence[Trial]) -> list[dict[str, Any]]:
    """Return a row of each trial: number, values, score; why it failed where any did."""
    failed = any(trial.failure for trial in trials)
    return [
        {"trial": number, **trial.values, "score": trial.score, **({"failure": trial.failure} if failed else {})}
        for number, trial in enumerate(trials)
    ]


def _score_rest(trials: Sequence[Trial], score: Score) -> None:
    """Score what has no score yet; a point that was there before has the score that it had."""
    known = {_key(trial): trial for trial in trials if trial.over}
    rest = {_key(trial): trial.point for trial in trials if not trial.over and _key(trial) not in known}
    found = dict(zip(rest, score(list(rest.values())) if rest else [], strict=True))
    for trial in trials:
        if trial.over:
            continue
        if (before := known.get(_key(trial))) is not None:
            trial.score, trial.failure = before.score, before.failure
        elif isinstance(result := found[_key(trial)], str):
            trial.failure = result
        else:
            trial.score = float(result)


def _key(trial: Trial) -> str:
    return json.dumps(trial.values)


def _describe_best(trials: Sequence[Trial], together: int) -> str:
    first = (len(trials) - 1) // together * together
    best = find_best(trials)
    found = "none has a score" if best is None else f"best score {trials[best].score:.4g}, of trial {best}"
    return f"trials {first} to {len(trials) - 1} are over; {found}"


def _read_record(folder: Folder, asked: dict[str, Any]) -> Record:
    """Return the record of a search, a new one if there is none."""
    data = folder.read(RECORD)
    if data is None:
        return Record(asked=asked, trials=[])
    record = parse_record(Record, data, f"{folder}/{RECORD}")
    for name in asked | record.asked:  # in the order of the command's options
        before, now = record.asked.get(name), asked.get(name)
        if before != now:
            raise InputError(f"{folder}: holds a search with {name} {before}, not {now}; choose another out")
    return record


def _write(folder: Folder, record: Record) -> None:
    folder.write(RECORD, (json.dumps(record.model_dump(), allow_nan=False) + "\n").encode())
    text = io.StringIO()
    rows = list_trials([trial for trial in record.trials if trial.over])
    if rows:
        writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
        folder.write(TABLE, text.getvalue().encode())

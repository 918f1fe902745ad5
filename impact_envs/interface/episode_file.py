"""Files of an episode: one NumPy archive, or tables for other programs; all in SI units."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from impact_envs.errors import InputError, choices
from impact_envs.file import replace_file, write_atomically, write_table

SUFFIXES = (".npz", ".parquet", ".csv")
FACTS = (
    "scenario",
    "policy",
    "seed",
    "period",
    "robustness",
    "success",
    "failure",
    "effort",
    "fallbacks",
    "replans",
    "reoptimised",
    "wall_seconds",
)
IMPACT = ("time", "a", "b", "point_x", "point_y", "normal_x", "normal_y", "impulse_x", "impulse_y", "speed")


def check_episode_path(path: str | Path) -> Path:
    """Return where an episode is to be written.

    Raises:
        InputError: unknown suffix, or a folder that is missing.
    """
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"episode file '{path}': {choices(path.suffix, SUFFIXES)}")
    if not path.absolute().parent.is_dir():
        raise InputError(f"cannot write {path}: folder {path.absolute().parent} does not exist")
    return path


def save_episode(episode: Any, path: str | Path) -> tuple[Path, ...]:
    """Write an episode; see Episode.save.

    Args:
        episode: an Episode.
        path: ends in .npz, .parquet or .csv.

    Returns:
        The files written, that of the trajectory first.

    Raises:
        InputError: unknown suffix, or a file that cannot be written.
    """
    path = check_episode_path(path)
    facts = {name: getattr(episode, name) for name in FACTS}
    if path.suffix.lower() == ".npz":
        content: dict[str, Any] = {**_list_arrays(episode), "facts": np.array(json.dumps(facts, default=_plain))}
        with replace_file(path) as partial:
            np.savez_compressed(partial, **content)
        return (path,)
    facts_path = path.with_name(f"{path.stem}.facts.json")  # FILE.json may be something else
    written = [path, _insert(path, "impacts"), facts_path]
    write_table(path, _list_columns(episode))
    write_table(written[1], _split_records(episode.impacts, IMPACT))
    write_atomically(facts_path, (json.dumps(facts, default=_plain, indent=2) + "\n").encode())
    if episode.lasting_contacts:
        written.append(_insert(path, "lasting_contacts"))
        write_table(written[-1], _split_records(episode.lasting_contacts, ()))
    return tuple(written)


def _insert(path: Path, word: str) -> Path:
    return path.with_name(f"{path.stem}.{word}{path.suffix}")


def _list_arrays(episode: Any) -> dict[str, np.ndarray]:
    """Return what an archive holds besides the facts."""
    arrays = {"times": episode.times, **episode.signals, "robustness_bounds": episode.robustness_bounds}
    for agent in episode.actions:
        arrays |= {f"{agent}.actions": episode.actions[agent], f"{agent}.rewards": episode.rewards[agent]}
    arrays["solve_seconds"] = episode.solve_seconds
    for word, records in (("impacts", episode.impacts), ("lasting_contacts", episode.lasting_contacts)):
        for key in asdict(records[0]) if records else ():
            arrays[f"{word}.{key}"] = np.array([getattr(record, key) for record in records])
    return arrays


def _list_columns(episode: Any) -> dict[str, Sequence[Any]]:
    """Return the columns of the trajectory's table; what is of a step stands in the row where the step begins."""
    lower, upper = episode.robustness_bounds.T
    columns = {"time": episode.times, **episode.signals, "robustness_lower": lower, "robustness_upper": upper}
    of_steps: dict[str, np.ndarray] = {}
    for agent, actions in episode.actions.items():
        of_steps |= {f"{agent}.action_{k}": column for k, column in enumerate(actions.T)}
        of_steps[f"{agent}.reward"] = episode.rewards[agent]
    if len(episode.solve_seconds) == len(episode.times) - 1:
        of_steps["solve_seconds"] = episode.solve_seconds
    return columns | {name: np.append(values, np.nan) for name, values in of_steps.items()}


def _split_records(records: Sequence[Any], names: Sequence[str]) -> Mapping[str, Sequence[Any]]:
    """Return the columns of impacts or contacts, vectors split into x and y; empty ones under the names."""
    rows = []
    for record in records:
        row: dict[str, Any] = {}
        for key, value in asdict(record).items():
            row |= (
                {f"{key}_x": float(value[0]), f"{key}_y": float(value[1])} if isinstance(value, tuple) else {key: value}
            )
        rows.append(row)
    return {name: [row[name] for row in rows] for name in (rows[0] if rows else names)}


def _plain(value: Any) -> Any:
    return value.tolist() if hasattr(value, "tolist") else dict(value)

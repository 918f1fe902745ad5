"""What a search found, beside an evaluation, where `impact report` shows it: a record, a map, and films of failures."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from impact_envs.env import parallel_env
from impact_envs.errors import InputError
from impact_envs.file import make_file_name, write_atomically
from impact_envs.picture.film import Film
from impact_envs.rollout import rollout
from train.evaluation.case import Case
from train.evaluation.player import make_policy
from train.falsification.counterexample import Counterexample
from train.pictures.file import save_figure
from train.pictures.film import sample_curves
from train.report.failures import FOLDER

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# A page holds some films: what one takes but for its end [s], frames per second, how long the end stays [s], and pixels
# along each axis that become one.
FILM_SECONDS, FPS, HOLD, SHRINK = 6.0, 10.0, 1.5, 2


def check_folder(folder: Path) -> None:
    """Raise unless a folder holds an evaluation.

    Raises:
        InputError: it does not.
    """
    if not (folder / "manifest.json").is_file():
        raise InputError(f"--report {folder}: holds no evaluation; `impact evaluate ... --out {folder}` makes one")


def write_record(
    folder: Path,
    case: Case,
    policy: str,
    result: Mapping[str, Any],
    found: Sequence[Counterexample],
    figure: Figure | None,
) -> Path:
    """Write what was found into an evaluation's folder; what was found there in the same case is replaced.

    Args:
        folder: of the evaluation.
        case: that was searched.
        policy: that was searched.
        result: of the search, as the command prints it.
        found: counterexamples, in the result's order.
        figure: map of robustness; None where one number alone is drawn.

    Returns:
        Path of the record.
    """
    key = (case.scenario.name, case.suite, policy)
    path = folder / FOLDER / make_file_name(*key, suffix=".json")
    path.parent.mkdir(exist_ok=True)
    drawn = path.with_suffix(".png")
    if figure is not None:
        save_figure(figure, drawn)
    films = []
    for row, one in zip(result["counterexamples"], found, strict=True):
        film = path.parent / make_file_name(*key, row["suite"], suffix=".mp4")
        write_film(case, policy, one, film, f"{case.scenario.name} · {Path(policy).name} · seed {one.seed}")
        films.append(film.name)
    rows = [row | {"film": name} for row, name in zip(result["counterexamples"], films, strict=True)]
    record = {"format": 1, **result, "counterexamples": rows, "map": drawn.name if figure is not None else None}
    write_atomically(path, json.dumps(record, indent=1).encode())
    return path


def write_film(case: Case, policy: str, one: Counterexample, path: Path, caption: str) -> None:
    """Play a counterexample's episode again, in a single world, and write its film.

    Args:
        case: that was searched, with its plan.
        policy: that was searched.
        one: the counterexample.
        path: of the film.
        caption: over the pictures.
    """
    values = {key: {"uniform": [value, value]} for key, value in one.values.items()}
    scenario = case.scenario.override(values)
    player = make_policy(policy, scenario, case.plan, case.options or None)
    env = parallel_env(scenario, render_mode="rgb_array")
    env.curves |= sample_curves(player)
    every = max(1, round(scenario.steps / (FILM_SECONDS * FPS)))
    env.caption, env.speed = caption, every * scenario.control_period * FPS

    def watch(shown: Any) -> None:
        if shown.steps % every == 0 or not shown.agents:
            film.add(_shrink(shown.render()))

    with Film(path, FPS, HOLD) as film:
        rollout(env, player, one.seed, on_step=watch)
    env.close()


def _shrink(picture: np.ndarray) -> np.ndarray:
    """Return a picture whose pixels are means of squares, shape (height, width, 3) uint8."""
    height, width = (size // (2 * SHRINK) * 2 for size in picture.shape[:2])  # even, as films need it
    squares = picture[: SHRINK * height, : SHRINK * width].reshape(height, SHRINK, width, SHRINK, 3)
    means: np.ndarray = squares.mean(axis=(1, 3))
    return means.astype(np.uint8)

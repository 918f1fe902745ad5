"""What ``impact break --report`` left beside an evaluation: causes and their mildest worlds, a map, films."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, FiniteFloat, JsonValue

from impact_envs.errors import InputError
from train.evaluation.journal import read_record
from train.report.tables import write_table

FOLDER = "failures"  # in that of an evaluation
TYPES = {".png": "image/png", ".mp4": "video/mp4"}
MOST_NUMBERS = 4  # that are listed with what they explain


class Failure(BaseModel):
    """One cause and the mildest world in which it was found."""

    suite: str
    cause: str
    seed: int
    robustness: FiniteFloat
    failure_rate: FiniteFloat
    found: int
    not_nominal: dict[str, FiniteFloat]
    nominal: dict[str, FiniteFloat] = {}
    film: str | None = None


class Search(BaseModel):
    """What a search of one policy in one case found."""

    format: Literal[1]
    scenario: str
    suite: str
    policy: str
    vary: list[str] = []
    stand_in: dict[str, JsonValue] = {}
    replayed: int = 0
    confirmed: int = 0
    episodes: int
    failures: int
    least_robustness: FiniteFloat
    explains: dict[str, FiniteFloat]
    counterexamples: list[Failure]
    map: str | None


def write_failures(directory: Path) -> str:
    """Write a block for each search whose record lies in an evaluation's folder, or how to make one.

    Args:
        directory: of the evaluation.

    Returns:
        HTML with its pictures inside.

    Raises:
        InputError: a record or one of its pictures cannot be read.
    """
    paths = sorted((directory / FOLDER).glob("[!.]*.json"))
    if not paths:
        return (
            '<p class="empty">Nobody searched for failures: <code>impact break POLICY SCENARIO --report FOLDER</code> '
            "does.</p>"
        )
    return "".join(_write_search(read_record(Search, path), path.parent) for path in paths)


def _write_search(search: Search, folder: Path) -> str:
    varied = f", varied {', '.join(search.vary)}" if search.vary else ""
    title = f"{search.policy} in {search.scenario} · {search.suite}{varied}"
    explained = [f"{name} {share:.0%}" for name, share in list(search.explains.items())[:MOST_NUMBERS]]
    by = again = ""
    if search.stand_in:
        by = f" of a stand-in with {', '.join(f'{name}={value}' for name, value in search.stand_in.items())}"
        again = (
            f" The policy itself played {search.replayed} of them again, or milder ones, and failed in "
            f"{search.confirmed}: the worlds below are its own failures."
        )
    text = (
        f"{search.failures} of {search.episodes} episodes{by} failed; the least robustness was "
        f"{search.least_robustness:.3g}.{again} Share of the robustness' variance that one number explains: "
        f"{', '.join(explained)}."
    )
    number = 1 + min(range(len(search.counterexamples)), key=lambda k: search.counterexamples[k].robustness, default=-1)
    pictures = [_write_picture(folder, search.map, f"Map of robustness, {title}")] if search.map else []
    films = [
        (f"{k}{' (the worst)' * (k == number)}", one.film)
        for k, one in enumerate(search.counterexamples, start=1)
        if one.film
    ]
    pictures += [_write_picture(folder, film, f"Counterexample {name}") for name, film in films]
    return (
        f"<h3>{escape(title)}</h3><p>{escape(text)}</p>{_write_causes(search.counterexamples)}"
        f'<div class="found">{"".join(pictures)}</div>'
    )


def _write_causes(found: Sequence[Failure]) -> str:
    """Write the table of causes, each with its mildest world."""
    if not found:
        return '<p class="empty">Nothing failed.</p>'
    heads = [
        ("Number, suite", "text"),
        ("Cause: what is broken the most, after how many impacts", "text"),
        ("The mildest world: what is not nominal", "text"),
        ("Seed", "number"),
        ("Robustness", "number"),
        ("Other seeds that fail there", "number"),
        ("Found", "number"),
    ]
    body = [
        f'<tr><th scope="row">{k}, {escape(one.suite)}</th><td class="wrap"><code>{escape(one.cause)}</code></td>'
        f'<td class="wrap">{escape(_list_moved(one))}</td><td class="number">{one.seed}</td>'
        f'<td class="number">{one.robustness:.3g}</td><td class="number">{one.failure_rate:.0%}</td>'
        f'<td class="number">{one.found}</td></tr>'
        for k, one in enumerate(found, start=1)
    ]
    return write_table("failures-table", heads, body)


def _list_moved(one: Failure) -> str:
    """Return the numbers of a world that are not nominal, with what nominal is."""
    parts = [
        f"{name} {value:.3g}" + (f" (nominal {one.nominal[name]:.3g})" if name in one.nominal else "")
        for name, value in one.not_nominal.items()
    ]
    return ", ".join(parts) or "nothing: the seed's noise alone"


def _write_picture(folder: Path, name: str, caption: str) -> str:
    """Write a picture or a film whose content is part of the page.

    Raises:
        InputError: it lies elsewhere, is of another kind, or cannot be read.
    """
    kind = TYPES.get(Path(name).suffix)
    if kind is None or Path(name).name != name:
        raise InputError(f"evaluation file {folder / name}: is no picture of the folder")
    try:
        content = base64.b64encode((folder / name).read_bytes()).decode()
    except OSError as error:
        raise InputError(f"evaluation file {folder / name}: cannot be read: {error.strerror}") from None
    source, told = f"data:{kind};base64,{content}", escape(caption)
    shown = f'<img src="{source}" alt="{told}">'
    if kind.startswith("video"):
        shown = f'<video controls loop muted playsinline preload="metadata" src="{source}" aria-label="{told}"></video>'
    return f"<figure>{shown}<figcaption>{told}</figcaption></figure>"

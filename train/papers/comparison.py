"""Rows that put published numbers beside those computed here."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

from train.papers.paper import Paper, Row

HEADS = ("quantity", "unit", "paper", "place", "here", "difference", "verdict", "why")


def compare(paper: Paper, results: Mapping[str, Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return a row for each published number whose plays were played.

    Args:
        paper: with the published numbers.
        results: play to what its command returned.

    Returns:
        ``quantity``, ``unit``, ``paper``, ``place``, ``here``, ``difference``, ``verdict`` (agrees, agrees by
        construction, differs, not comparable, holds, fails, not applicable, no published number) and ``why``.
    """
    return [
        compare_row(row, [find_value(place, results) for place in row.here])
        for row in paper.rows
        if all(place.partition(":")[0] in results for place in row.here)
    ]


def find_value(place: str, results: Mapping[str, Mapping[str, Any]]) -> Any:
    """Return a value of a play's result.

    Args:
        place: ``PLAY:key.index``; in a list of rows one is found by its ``name``, and ``count`` is their number.
        results: play to what its command returned.
    """
    play, _, path = place.partition(":")
    value: Any = results[play]
    for key in path.split("."):
        if value is None:
            return None
        if isinstance(value, Mapping):
            value = value[key]
        elif key == "count":
            value = len(value)
        elif key.isdigit():
            value = value[int(key)]
        else:
            value = next(row for row in value if row["name"] == key)
    return value


def compare_row(row: Row, found: list[Any]) -> dict[str, Any]:
    """Return one published number or ordering beside the values found for it."""
    values = [None if value is None else value if row.scale == 1.0 else row.scale * value for value in found]
    difference, verdict = _judge(row, values)
    here = values[0] if len(values) == 1 else values
    texts = row.quantity, row.unit, row.paper, row.place, here, difference, verdict, row.why
    return dict(zip(HEADS, texts, strict=True))


def _judge(row: Row, values: list[Any]) -> tuple[float | None, str]:
    """Return the difference to the published number, None without one, and the verdict."""
    if any(value is None for value in values):
        return None, "not applicable"
    if len(values) > 1:
        return None, "holds" if all(a < b for a, b in pairwise(values)) else "fails"
    if isinstance(row.paper, str):
        return None, "no published number"
    difference = values[0] - row.paper
    if row.tolerance is None:
        return difference, "not comparable"
    if abs(difference) > row.tolerance:
        return difference, "differs"
    return difference, "agrees by construction" if row.fitted else "agrees"


def write_table(rows: list[dict[str, Any]]) -> str:
    """Return rows of `compare` as a table in Markdown."""
    lines = ["| " + " | ".join(HEADS) + " |", "|" + "---|" * len(HEADS)]
    lines += ["| " + " | ".join(_write(row[head]) for head in HEADS) + " |" for row in rows]
    return "\n".join(lines) + "\n"


def _write(value: Any) -> str:
    if value is None:
        return "–"
    if isinstance(value, list):
        return ", ".join(map(_write, value))
    return f"{value:.4g}" if isinstance(value, float) else str(value).replace("|", "\\|")

"""The report's table of learned policies: training seeds together, beside the expert and the best constant."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from html import escape
from itertools import groupby
from pathlib import PurePath
from typing import TYPE_CHECKING, Any

from train.evaluation.comparison import compare_groups
from train.evaluation.metric import UNKNOWN, signed, write_interval
from train.evaluation.origins import read_origins
from train.report.tables import Look, write_block, write_table

if TYPE_CHECKING:
    import pandas as pd

HEADS = (
    ("Policy", "text"),
    ("Runs", "number"),
    ("Success", "number"),
    ("Interquartile mean [m]", "number"),
    ("Worst 5 % [m]", "number"),
    ("Gain over expert [m]", "number"),
    ("Gain over best constant [m]", "number"),
    ("Better on a seed", "number"),
    ("Training CPU [s]", "number"),
)


def write_comparison(episodes: pd.DataFrame, looks: Mapping[str, Look]) -> str:
    """Write the comparison of learned policies, one block per scenario and suite.

    Args:
        episodes: one row per episode, see `compare_groups`.
        looks: policy label to its look.

    Returns:
        An HTML table, or a sentence where no policy was learned.
    """
    origins = read_origins(looks)
    if not origins:
        return '<p class="empty">None of these policies was learned.</p>'
    rows = compare_groups(episodes, origins)
    body = [
        write_block(scenario, suite, len(HEADS)) + "".join(_write_row(row, looks) for row in group)
        for (scenario, suite), group in groupby(rows, key=lambda row: (row["scenario"], row["suite"]))
    ]
    return write_table("comparison-table", HEADS, body)


def _write_row(row: Mapping[str, Any], looks: Mapping[str, Look]) -> str:
    label = row["policy"]
    name = looks[label].name if label in looks else "/".join(PurePath(label).parts[-2:])
    cells = [
        str(row["runs"]),
        _write_value(row, "success", f"{100 * row['success_rate']:.1f} %", 100.0),
        _write_value(row, "iqm", signed(row["iqm"])),
        _write_value(row, "worst", signed(row["worst"])),
        _emphasise(_write_gain(row, "gain"), row["earned"]),
        _write_gain(row, "gain_over_constant"),
        UNKNOWN if row["improvement"] is None else _write_value(row, "improvement", f"{row['improvement']:.2f}"),
        UNKNOWN if row["cpu_seconds"] is None else f"{row['cpu_seconds']:.0f}",
    ]
    head = f'<th scope="row"><span class="policy" title="{escape(label)}">{escape(name)}</span></th>'
    return f"<tr>{head}{_join(cells)}</tr>"


def _write_gain(row: Mapping[str, Any], key: str) -> str:
    return UNKNOWN if row[key] is None else _write_value(row, key, signed(row[key]))


def _write_value(row: Mapping[str, Any], key: str, text: str, unit: float = 1.0) -> str:
    low, high = row[f"{key}_ci"]
    ends = f"[{unit * low:.0f}, {unit * high:.0f}]" if unit != 1.0 else write_interval((low, high))
    return f"{text}<br><small>{ends}</small>"


def _emphasise(text: str, sure: bool) -> str:
    return f"<b>{text}</b>" if sure else text


def _join(cells: Iterable[str]) -> str:
    return "".join(f'<td class="number">{cell}</td>' for cell in cells)

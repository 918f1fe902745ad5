"""What a command prints for people, where ``--json`` is not asked for."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Column, Table

from train.evaluation.metric import UNKNOWN
from train.evaluation.metrics import list_columns
from train.evaluation.statistics import GROUP

TABLE_WIDTH = 150  # columns; a narrower table would cut its numbers


def show(result: dict[str, Any]) -> None:
    """Print a command's result for people: tables of scenarios, episodes and impacts, then plain values.

    Args:
        result: what the command would print as JSON.
    """
    console = Console()
    console.width = max(console.width, TABLE_WIDTH)
    if "scenarios" in result:
        console.print(_table(result["scenarios"]))
    if "rows" in result:
        console.print(_evaluation_table(result["rows"]))
    plain = {k: v for k, v in result.items() if k not in ("scenarios", "rows", "paired", "plans")}
    if not plain.get("set"):
        plain.pop("set", None)
    for key, value in plain.items():
        if isinstance(value, list):
            console.print(_table(value) if value else f"{key}: none")
        else:
            console.print(f"{key}: {value}", highlight=False)


def _table(rows: Sequence[dict[str, Any]]) -> Table:
    table = Table(*(Column(name, overflow="fold") for name in rows[0]))
    for row in rows:
        table.add_row(*(_text(value) for value in row.values()))
    return table


def _text(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, list | tuple):
        return ", ".join(_text(item) for item in value)
    return str(value)


def _evaluation_table(rows: Sequence[dict[str, Any]]) -> Table:
    columns = list_columns()
    table = Table(
        *(Column(name, no_wrap=True) for name in GROUP),
        *(Column(title, justify="right" if column.cell == "number" else "left") for title, column in columns),
        caption="intervals: Wilson of success, bootstrap of median robustness; effort of arms in N m s",
        padding=(0, 1, 0, 0),
    )
    for row in rows:
        key = (row["scenario"], row["suite"], Path(row["policy"]).name)
        table.add_row(*key, *(UNKNOWN if row[a.key] is None else a.write(row) for _, a in columns))
    return table

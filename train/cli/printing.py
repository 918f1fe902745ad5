"""What a command prints for people, where ``--json`` is not asked for."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.measure import Measurement
from rich.table import Column, Table

from train.evaluation.metric import UNKNOWN
from train.evaluation.metrics import list_columns
from train.evaluation.statistics import GROUP

NOT_APPLICABLE = "not applicable"
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
        table = _evaluation_table(result["rows"])
        # Rather broken by the terminal than cut.
        least = Measurement.get(console, console.options.update(max_width=1000), table).minimum
        console.print(table, width=max(console.width, least), crop=False)
    if "comparison" in result:
        console.print(_comparison_table(result["comparison"]), crop=False)
    plain = {k: v for k, v in result.items() if k not in ("scenarios", "rows", "paired", "plans", "comparison")}
    if not plain.get("set"):
        plain.pop("set", None)
    for key, value in plain.items():
        if isinstance(value, list):
            console.print(_table(value) if value else f"{key}: none")
        else:
            console.print(f"{key}: {NOT_APPLICABLE if value is None else value}", highlight=False)


def _table(rows: Sequence[dict[str, Any]]) -> Table:
    table = Table(*(Column(name, overflow="fold") for name in rows[0]))
    for row in rows:
        table.add_row(*(_text(value) for value in row.values()))
    return table


def _text(value: Any) -> str:
    if value is None:
        return UNKNOWN
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, list | tuple):
        return ", ".join(_text(item) for item in value)
    return str(value)


def _evaluation_table(rows: Sequence[dict[str, Any]]) -> Table:
    shown = [(title, column) for title, column in list_columns() if not column.detail]
    cells = [
        [row["scenario"], row["suite"], Path(row["policy"]).name]
        + [UNKNOWN if row[column.key] is None else column.write(row) for _, column in shown]
        for row in rows
    ]
    heads = [(name, "left") for name in GROUP]
    heads += [(title, "right" if column.cell == "number" else "left") for title, column in shown]
    table = Table(
        caption="intervals: Wilson of success, bootstrap of median robustness; effort of arms in N m s",
        box=SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
    )
    for (title, justify), texts in zip(heads, zip(*cells, strict=True), strict=True):
        # Titles are broken, cells are not.
        table.add_column(escape(title), justify=justify, min_width=max(map(len, texts)))  # type: ignore[arg-type]
    for row_cells in cells:
        table.add_row(*map(escape, row_cells))
    return table


def _comparison_table(rows: Sequence[dict[str, Any]]) -> Table:
    """Return the table of `comparison.compare_groups`; bold where a policy surely beats expert and best constant."""
    table = Table(
        caption="intervals of 95 % over training seeds and episodes; gains: interquartile means of paired differences; "
        "bold: surely more than expert and best constant",
        box=SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
    )
    for title in ("scenario", "suite", "policy", "runs", "Success", "Robustness [m]", "Worst 5 % [m]"):
        table.add_column(title)
    for title in ("Gain [m]", "Over the constant [m]", "Better than the expert", "Training CPU [s]"):
        table.add_column(title)
    for row in rows:
        rate, (low, high) = row["success_rate"], row["success_ci"]
        cells = [row["scenario"], row["suite"], row["policy"], str(row["runs"])]
        cells += [f"{100 * rate:.1f} % [{100 * low:.1f}, {100 * high:.1f}]"]
        cells += [_with_interval(row, name) for name in ("iqm", "worst", "gain", "gain_over_constant")]
        cells += [_with_interval(row, "improvement", 2)]
        cells += [UNKNOWN if row["cpu_seconds"] is None else f"{row['cpu_seconds']:.0f}"]
        table.add_row(*map(escape, cells), style="bold" if row["earned"] else None)
    return table


def _with_interval(row: dict[str, Any], name: str, decimals: int = 3) -> str:
    if row[name] is None:
        return UNKNOWN
    low, high = row[f"{name}_ci"]
    return f"{row[name]:.{decimals}f} [{low:.{decimals}f}, {high:.{decimals}f}]"

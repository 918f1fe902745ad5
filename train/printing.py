"""What a command prints for people, where ``--json`` is not asked for."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Column, Table

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
    names = ("scenario", "suite", "policy", "n", "success", "robustness [m]", "effort", "hits", "p99 ms", "fallbacks")
    table = Table(
        *(Column(name, no_wrap=True) for name in names),
        caption="[95 % intervals]: Wilson of success, bootstrap of median robustness; effort in N s, of arms in N m s",
        padding=(0, 1, 0, 0),
    )
    for row in rows:
        low, high = row["success_ci"]
        rho_low, rho_high = row["robustness_ci"]
        p99 = (row["solve_ms"] or {}).get("p99")
        table.add_row(
            row["scenario"],
            row["suite"],
            Path(row["policy"]).name,
            str(row["episodes"]),
            f"{row['success_rate']:.0%} [{low:.0%}, {high:.0%}]",
            f"{row['robustness_median']:.3f} [{rho_low:.3f}, {rho_high:.3f}]",
            f"{row['effort_median']:.1f}",
            f"{row['impacts_mean']:.1f}",
            "-" if p99 is None else f"{p99:.2f}",
            str(sum(row["fallbacks"].values())),
        )
    return table

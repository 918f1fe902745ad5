"""What a command prints for people, where ``--json`` is not asked for: names with units, four significant digits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.measure import Measurement
from rich.table import Column, Table

from impact_envs.domain import find_part, list_domains
from train.evaluation.metric import UNKNOWN
from train.evaluation.metrics import find_metrics, list_columns
from train.evaluation.statistics import GROUP

NOT_APPLICABLE = "not applicable"
ROUNDING = 1e-12  # below which a number of a result is a rounding error of zero, in any unit
TABLE_WIDTH = 150  # columns; a narrower table would cut its numbers
# Key of a result to what it is called and its unit; domains bring more units, see UNITS in train.
NAMES: dict[str, tuple[str, str]] = {
    "robustness": ("robustness", "m"),
    "continuous_robustness": ("robustness between control steps, too", "m"),
    "bound": ("no plan has more than", "m"),
    "gap": ("gap: what is missing to that, over max(1 m, it)", ""),
    "asked_robustness": ("robustness of the formula as asked", "m"),
    "relaxed_formula": ("relaxed formula, areas renamed where they changed", ""),
    "given_up_bound": ("no plan misses it by less than", "m"),
    "given_up_tried": ("not found: plans that give up less than", "m"),
    "path_cost": ("path cost, sum of displacement² / duration", "m²/s"),
    "path_cost_bound": ("no plan as robust with these reserves costs less than", "m²/s"),
    "effort": ("effort, sum of |force| dt", "N s"),
    "solve_seconds": ("time to plan", "s"),
    "stage_seconds": ("of it", "s"),
    "validated": ("checked by simulation", ""),
    "success": ("formula satisfied", ""),
    "failure": ("simulation failed", ""),
    "accepted": ("given plan accepted", ""),
    "solve_ms": ("computing time of a control period", "ms"),
    "replans": ("plans changed on the way", ""),
    "reoptimised": ("rest of the task planned anew", ""),
    "episode_seconds": ("time to play the episode", "s"),
    "wall_seconds": ("you waited", "s"),
    "set": ("changed values", ""),
    "deviation": ("deviation of impacts that it bears", "m/s"),
    "deviation_bound": ("no plan bears more than", "m/s"),
    "impact_error": ("largest error of the impact law", "m/s"),
    "shape_error": ("robustness may be lower by", "m"),
}
COLUMNS = {
    "missed": "missed by [m]",
    "time": "time [s]",
    "a": "body",
    "b": "other body",
    "position": "centre of object [m]",
    "point": "contact [m]",
    "impulse": "impulse [N s]",
    "speed": "approach [m/s]",
    "mass": "mass [kg]",
    "mass_spread": "its spread [kg]",
    "restitution_spread": "its spread",
    "drift": "drift [m/s²]",
}
SKIPPED = ("scenarios", "rows", "paired", "plans", "domain", "unit", "groups")


def show(result: dict[str, Any]) -> None:
    """Print a command's result for people: tables of scenarios, episodes and impacts, and named values.

    Args:
        result: what the command would print as JSON.
    """
    console = Console()
    console.width = max(console.width, TABLE_WIDTH)
    if "scenarios" in result:
        console.print(_scenario_table(result["scenarios"]))
    if "rows" in result:
        table = _evaluation_table(result["rows"])
        _print_whole(console, table)
    if "groups" in result:
        _print_whole(console, _comparison_table(result["groups"]))
    units = _find_units(result.get("domain", ""))
    lines = _Lines(console, units | ({"robustness": result["unit"]} if "unit" in result else {}))
    for key, value in result.items():
        if key in SKIPPED or (key in ("set", "failure", "renamed", "violations") and not value):
            continue
        if value is None and key in units:  # a measure of other episodes, such as those of a robust plan
            continue
        if isinstance(value, list) and value and isinstance(value[0], dict):
            lines.end()
            console.print(f"{_name(key)}:", highlight=False)
            console.print(_table(value))
        else:
            lines.add(key, value)
    lines.end()


def _print_whole(console: Console, table: Table) -> None:
    """Print a table rather broken by the terminal than cut."""
    least = Measurement.get(console, console.options.update(max_width=1000), table).minimum
    console.print(table, width=max(console.width, least), crop=False)


class _Lines:
    """Gather named values, and print them one below the other.

    Args:
        console: to print on.
        units: of values, by their keys.
    """

    def __init__(self, console: Console, units: Mapping[str, str]) -> None:
        self._console, self._units = console, units
        self._rows: list[tuple[str, str]] = []

    def add(self, key: str, value: Any) -> None:
        """Take a value."""
        unit = self._units.get(key, NAMES.get(key, ("", ""))[1])
        text = _text(value, none="none") if value is not None else NOT_APPLICABLE
        self._rows.append((_name(key), f"{text} {unit}" if unit and value not in (None, {}) else text))

    def end(self) -> None:
        """Print what was gathered."""
        width = max((len(name) for name, _ in self._rows), default=0)
        for name, text in self._rows:
            self._console.print(f"{name:<{width}}  {text}", markup=False, highlight=False, soft_wrap=True)
        self._rows = []


@cache
def _find_units(domain: str) -> dict[str, str]:
    """Return the units of what a domain measures and prints, by the keys."""
    if domain not in list_domains():
        return {}
    return {metric.name: metric.unit for metric in find_metrics(domain)} | (find_part("train", domain, "UNITS") or {})


def _name(key: str) -> str:
    return NAMES.get(key, (key.replace("_", " "), ""))[0]


def _table(rows: Sequence[dict[str, Any]]) -> Table:
    heads = (escape(COLUMNS.get(name) or (name if "." in name else name.replace("_", " "))) for name in rows[0])
    table = Table(*(Column(head, overflow="fold") for head in heads))
    for row in rows:
        table.add_row(*(escape(_text(value)) for value in row.values()))
    return table


def _scenario_table(scenarios: Sequence[dict[str, Any]]) -> Table:
    table = Table("scenario", "what it is; domain, agents, horizon, Gymnasium id", box=SIMPLE_HEAD, show_lines=True)
    for s in scenarios:
        facts = f"{s['domain']}; {', '.join(s['agents'])}; {_text(s['horizon'])} s; {s['gym_id']}"
        table.add_row(escape(s["name"]), f"{escape(s['description'])}\n[dim]{escape(facts)}[/dim]")
    return table


def _text(value: Any, none: str = "") -> str:
    """Return a value as a person reads it: words for truth, four digits, no brackets."""
    if value is None:
        return UNKNOWN
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{0.0 if abs(value) < ROUNDING else value:.4g}"
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {_text(item)}" for key, item in value.items()) or none
    if isinstance(value, list | tuple):
        return ", ".join(_text(item) for item in value) or none
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
    titles = ["scenario", "suite", "policy", "runs", "Success", "Robustness [m]", "Worst 5 % [m]", "Gain [m]"]
    titles += ["Over the constant [m]", "Better than the expert", "Training CPU [s]"]
    lines = []
    for row in rows:
        rate, (low, high) = row["success_rate"], row["success_ci"]
        cells = [row["scenario"], row["suite"], Path(row["policy"]).name, str(row["runs"])]
        cells += [f"{100 * rate:.1f} % [{100 * low:.1f}, {100 * high:.1f}]"]
        cells += [_with_interval(row, name) for name in ("iqm", "worst", "gain", "gain_over_constant")]
        cells += [_with_interval(row, "improvement", 2)]
        lines.append([*cells, UNKNOWN if row["cpu_seconds"] is None else f"{row['cpu_seconds']:.0f}"])
    for title, texts in zip(titles, zip(*lines, strict=True), strict=True):
        table.add_column(escape(title), min_width=max(map(len, texts)))  # titles are broken, cells are not
    for row, cells in zip(rows, lines, strict=True):
        table.add_row(*map(escape, cells), style="bold" if row["earned"] else None)
    return table


def _with_interval(row: dict[str, Any], name: str, decimals: int = 3) -> str:
    if row[name] is None:
        return UNKNOWN
    low, high = row[f"{name}_ci"]
    return f"{row[name]:.{decimals}f} [{low:.{decimals}f}, {high:.{decimals}f}]"

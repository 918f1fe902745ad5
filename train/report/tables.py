"""The report's tables as HTML: results per policy, and paired differences with a picture of each interval."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from html import escape
from itertools import groupby
from typing import Any

from train.evaluation.metric import UNKNOWN, Aggregate, signed, write_interval
from train.evaluation.metrics import list_columns
from train.evaluation.results import Difference, Group

FOREST_WIDTH = 160  # [px]
BASELINES = ("zero", "random")


@dataclass(frozen=True)
class Look:
    """How a policy is shown.

    Args:
        name: short name.
        color: hexadecimal colour, for example "#0072b2".
    """

    name: str
    color: str


def write_results(rows: Iterable[Group], looks: Mapping[str, Look]) -> str:
    """Write the table of results, one block per scenario and suite.

    Args:
        rows: aggregates in the order shown.
        looks: policy label to its look.

    Returns:
        An HTML table.
    """
    heads = [("Policy", "text"), *((title, column.cell) for title, column in list_columns())]
    body = [
        write_block(scenario, suite, len(heads)) + "".join(_result(row, looks[row.policy]) for row in group)
        for (scenario, suite), group in groupby(rows, key=lambda row: (row.scenario, row.suite))
    ]
    return write_table("results-table", heads, body)


def write_differences(differences: Iterable[Difference], looks: Mapping[str, Look]) -> str:
    """Write the table of paired differences, one block per scenario and suite.

    Args:
        differences: in the order shown.
        looks: policy label to its look.

    Returns:
        An HTML table, or a sentence where there is nothing to compare.
    """
    differences, left_out = _drop_trivial(list(differences))
    if not differences:
        return '<p class="empty">Only one policy was evaluated: there is nothing to compare.</p>'
    reach = max(max(map(abs, (*d.ci, d.difference_median))) for d in differences) or 1.0
    ticks = " ".join(f"{tick:g}" for tick in _list_ticks(reach))
    heads = [
        ("Comparison", "text"),
        ("Median [m]", "number"),
        ("95 % interval", "interval"),
        (f"Worse ← 0 → better{f', ticks at ±{ticks} m' if ticks else ''}", "text"),
        ("Seeds better / same / worse", "number"),
        ("Success", "number"),
        ("Reading", "text"),
    ]
    body = [
        write_block(scenario, suite, len(heads)) + "".join(_difference(d, looks, reach) for d in group)
        for (scenario, suite), group in groupby(differences, key=lambda d: (d.scenario, d.suite))
    ]
    return write_table("paired-table", heads, body) + left_out


def _drop_trivial(differences: list[Difference]) -> tuple[list[Difference], str]:
    """Leave out comparisons with policies that do nothing sensible, where there are others; returns a note of it."""
    known = [len({d.a, d.b} & set(BASELINES)) for d in differences]
    least = min(known, default=0)
    telling = [d for d, count in zip(differences, known, strict=True) if count == least]
    left_out = len(differences) - len(telling)
    if not left_out:
        return differences, ""
    what = "with" if least == 0 else "between"
    names = " and ".join(sorted({name for d in differences for name in (d.a, d.b)} & set(BASELINES)))
    return telling, f'<p class="how">{left_out} comparisons {what} {names} are left out; summary.json has them.</p>'


def write_table(name: str, heads: Iterable[tuple[str, str]], body: Iterable[str]) -> str:
    """Write a table; each head has its text and the kind of the cells below it."""
    cells = (f'<th scope="col" class="{kind}">{escape(text)}</th>' for text, kind in heads)
    return (
        f'<div class="scroll"><table id="{name}"><thead><tr>{"".join(cells)}</tr></thead>'
        f"<tbody>{''.join(body)}</tbody></table></div>"
    )


def write_block(scenario: str, suite: str, width: int) -> str:
    """Write the line above a table's rows of one scenario in one suite."""
    title = f"{escape(scenario)} <span>· {escape(suite)}</span>"
    return f'<tr class="block"><th scope="rowgroup" colspan="{width}">{title}</th></tr>'


def _result(row: Group, look: Look) -> str:
    values = row.model_dump()
    cells = "".join(_cell(column, values, look.color) for _, column in list_columns())
    return f'<tr data-policy="{escape(row.policy)}"><th scope="row">{_policy(row.policy, look)}</th>{cells}</tr>'


def _cell(column: Aggregate, values: Mapping[str, Any], color: str) -> str:
    """Write a cell, with a bar and a hint where the column has them."""
    if values[column.key] is None:
        return f'<td class="{column.cell}">{UNKNOWN}</td>'
    bar = ""
    if column.bar:
        share, low, high = (100 * part for part in column.bar(values))
        bar = (
            f'<span class="bar"><i style="width:{share:.2f}%;background:{color}"></i>'
            f'<s style="left:{low:.2f}%;width:{high - low:.2f}%"></s></span>'
        )
    text = escape(column.write(values))
    if column.hint:  # opened by mouse, key or finger, which a title is not
        text = f"<details><summary>{text}</summary>{escape(column.hint(values))}</details>"
    return f'<td class="{column.cell}">{bar}{text}</td>'


def _difference(d: Difference, looks: Mapping[str, Look], reach: float) -> str:
    a, b = looks[d.a], looks[d.b]
    wins, ties = round(d.win_rate * d.episodes), round(d.tie_rate * d.episodes)
    kind, reading = _read_difference(d, a.name, b.name)
    return (
        f'<tr data-pair="{escape(d.a)}|{escape(d.b)}"><th scope="row">{_policy(d.a, a)} − {_policy(d.b, b)}</th>'
        f'<td class="number">{signed(d.difference_median)}</td>{_interval(d.ci)}'
        f"<td>{_forest(d, a.color, reach)}</td>"
        f'<td class="number">{wins} / {ties} / {d.episodes - wins - ties}</td>'
        f'<td class="number">{100 * d.success_difference:+.0f} points</td>'
        f'<td class="{kind}">{escape(reading)}</td></tr>'
    )


def _read_difference(d: Difference, a: str, b: str) -> tuple[str, str]:
    if d.ci[0] > 0:
        return "better", f"{a} better"
    if d.ci[1] < 0:
        return "worse", f"{a} worse"
    return "same", "same on every seed" if d.tie_rate == 1 else "no difference shown"


def _forest(d: Difference, color: str, reach: float) -> str:
    """Draw an interval; signed square root, so that small differences stay visible beside large ones."""

    def place(value: float) -> float:
        return FOREST_WIDTH / 2 + (FOREST_WIDTH / 2 - 5) * math.copysign(math.sqrt(abs(value) / reach), value)

    low, middle, high = (place(value) for value in (d.ci[0], d.difference_median, d.ci[1]))
    ends = [place(sign * tick) for tick in _list_ticks(reach) for sign in (-1, 1)]
    ticks = "".join(f'<line class="tick" x1="{x:.1f}" x2="{x:.1f}" y1="14" y2="18"/>' for x in ends)
    return (
        f'<svg class="forest" viewBox="0 0 {FOREST_WIDTH} 18" width="{FOREST_WIDTH}" height="18" aria-hidden="true">'
        f'<line class="zero" x1="{FOREST_WIDTH / 2}" x2="{FOREST_WIDTH / 2}" y1="0" y2="18"/>'
        f'{ticks}<line class="range" x1="{low:.1f}" x2="{high:.1f}" y1="9" y2="9" stroke="{color}"/>'
        f'<circle cx="{middle:.1f}" cy="9" r="4" fill="{color}"/></svg>'
    )


def _list_ticks(reach: float) -> list[float]:
    """Return the powers of ten that the picture of an interval has room for, at most three [m]."""
    return [10.0**k for k in range(-3, 4) if 10.0**k <= reach][-3:]


def _policy(label: str, look: Look) -> str:
    swatch = f'<i class="swatch" style="background:{look.color}"></i>'
    return f'<span class="policy" title="{escape(label)}">{swatch}{escape(look.name)}</span>'


def _interval(ends: tuple[float, float]) -> str:
    return f'<td class="interval">{write_interval(ends)}</td>'

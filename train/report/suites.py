"""What the suites of an evaluation change, as a table."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import Any

from train.evaluation.journal import JudgedCase


def write_suites(cases: Sequence[JudgedCase]) -> str:
    """Write one row per suite and definition; scenarios of a domain share most of them.

    Args:
        cases: scenarios in their suites.

    Returns:
        An HTML table.
    """
    rows: dict[tuple[str, str], list[str]] = {}
    for case in cases:
        rows.setdefault((case.suite, _describe(case.changes)), []).append(case.name)
    several = len({case.name for case in cases}) > 1
    body = "".join(
        f'<tr><th scope="row">{escape(suite)}</th>{_where(names, several)}<td>{text}</td></tr>'
        for (suite, text), names in rows.items()
    )
    of = '<th scope="col">Scenarios</th>' if several else ""
    head = f'<tr><th scope="col">Suite</th>{of}<th scope="col">The true world has</th></tr>'
    return f'<div class="scroll"><table id="suites-table"><thead>{head}</thead><tbody>{body}</tbody></table></div>'


def _where(names: list[str], several: bool) -> str:
    return f"<td>{escape(', '.join(names))}</td>" if several else ""


def _describe(changes: dict[str, Any] | None) -> str:
    if changes is None:
        return "<em>not kept by the version that evaluated</em>"
    if not changes:
        return "what is believed, and no disturbance"
    parts = [
        f"<code>{escape(key.removeprefix('true.'))}</code> {escape(_write(value))}" for key, value in changes.items()
    ]
    return "; ".join(parts)


def _write(value: Any) -> str:
    """Return a value as text; a range as its kind and ends."""
    if isinstance(value, dict) and len(value) == 1:
        ((kind, ends),) = value.items()
        if isinstance(ends, list | tuple) and len(ends) == 2:
            between = f"{_write(ends[0])} to {_write(ends[1])}"
            return between if kind == "uniform" else f"{kind} {between}"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:g}" if isinstance(value, int | float) else str(value)

"""Tables and other pieces of Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Sequence


def make_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a Markdown table; its cells must not break lines."""
    lines = [head, ["---"] * len(head), *rows]
    return "".join(f"| {' | '.join(map(_escape, line))} |\n" for line in lines)


def _escape(cell: str) -> str:
    return cell.replace("|", r"\|")


def make_code(text: str, language: str = "") -> str:
    """Return a block of code."""
    return f"```{language}\n{text.strip()}\n```\n"


def split_unit(element: str) -> tuple[str, str]:
    """Return what an element is, and its unit: ``vx [m/s]`` gives ``vx`` and ``m/s``."""
    what, _, unit = element.partition(" [")
    return what, unit.rstrip("]")

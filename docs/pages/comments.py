"""What is said of the fields of a class, in comments beside them or in its docstring's Attributes."""

from __future__ import annotations

import ast
import inspect
import io
import re
import textwrap
import tokenize
from functools import cache

UNIT = re.compile(r"\s*\[([^\]]+)\]")
ATTRIBUTES = re.compile(r"^    (\w+(?:, \w+)*): (.+(?:\n {8}.+)*)", re.MULTILINE)


@cache
def read_comments(kind: type) -> dict[str, str]:
    """Return the comment of each field of a class: on its line, or alone on the lines right above it."""
    comments: dict[str, str] = {}
    for parent in reversed(kind.__mro__):
        if parent.__module__.partition(".")[0] in ("impact_envs", "planners"):
            comments |= _read_attributes(parent) | _read_own_comments(parent)
    return comments


def split_comment(text: str) -> tuple[str, str]:
    """Return what a comment says, and the unit in brackets; "" where it names none or two."""
    units = UNIT.findall(text)
    unit = units[0] if len(units) == 1 else ""
    said = (UNIT.sub("", text) if unit else text).strip(" ,;.")
    symbol = not said or (len(word := re.split(r"\W", said)[0]) == 1 and word != "a")
    return said if symbol else said[0].upper() + said[1:], unit


def _read_attributes(kind: type) -> dict[str, str]:
    """Return what the docstring says of attributes; several names before a colon share it."""
    block = re.split(r"^(?:Attributes|Args):\n", inspect.cleandoc(kind.__doc__ or ""), maxsplit=1, flags=re.MULTILINE)
    listed = ATTRIBUTES.findall(block[1].partition("\n\n")[0]) if len(block) > 1 else []
    return {name: " ".join(said.split()) for names, said in listed for name in names.split(", ")}


def _read_own_comments(kind: type) -> dict[str, str]:
    source = textwrap.dedent(inspect.getsource(kind))
    beside, alone = dict[int, str](), dict[int, str]()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            own_line = not token.line[: token.start[1]].strip()
            (alone if own_line else beside)[token.start[0]] = token.string.lstrip("# ").strip()
    body = ast.parse(source).body[0]
    assert isinstance(body, ast.ClassDef)
    comments = {}
    for node in body.body:
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            line, above = node.lineno - 1, list[str]()
            while line in alone:
                above.insert(0, alone[line])
                line -= 1
            if text := " ".join([*above, beside.get(node.end_lineno or 0, "")]).strip():
                comments[node.target.id] = text
    return comments

"""Docstrings as Sphinx takes them: ours are plain text with code in backticks, as people read them in the source."""

from __future__ import annotations

import re
from typing import Any

CODE = re.compile(r"(``.+?``)")


def register_docstrings(app: Any) -> None:
    """Let Sphinx read docstrings through `convert_docstring`."""
    app.connect("autodoc-process-docstring", lambda *event: convert_docstring(event[-1]))


def convert_docstring(lines: list[str]) -> None:
    """Rewrite the lines of a docstring in place: `code` as code, and |x| as the absolute value that it is."""
    for k, line in enumerate(lines):
        code = re.sub(r"(?<![`:])`([^`]+)`(?!`)", r"``\1``", line)
        parts = CODE.split(code)
        parts[::2] = [part.replace("|", r"\|") for part in parts[::2]]
        lines[k] = "".join(parts)

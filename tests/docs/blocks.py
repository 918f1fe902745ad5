"""Run the blocks of a Markdown page in order, as a reader would: ``python -m tests.docs.blocks PAGE``.

Blocks of Python share one namespace; one with ``title=FILE`` is written to that file; other words behind ``python``
name packages without which a block is left out. Commands of ``impact`` run in the same folder. Numbers that only make a
run longer are made smaller.
"""

from __future__ import annotations

import re
import shlex
import sys
import tomllib
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
FENCE = re.compile(r"^(`{3,})([^\n]*)\n(.*?)^\1\s*$", re.MULTILINE | re.DOTALL)
INLINE = re.compile(r"(?<!`)`((?:impact|python) [^`]+)`(?!`)")
COMMANDS = ("impact ", "python ", "make ", "pip ")
# Subcommands that wait for a person; how they are read is checked, and tests of their own run them.
ATTENDED = ("play",)
# Options whose value says how long a run takes, and the value that shows the same in seconds.
SHORTER = {"--episodes": "1", "--steps": "64", "--worlds": "64", "--generations": "1", "--trials": "2"}
# Options that need a package which developers may lack.
NEEDS = {"--sample": "optuna"}
# By command: the one of them whose default takes minutes.
MISSING = {"evaluate": "--episodes", "demo": "--episodes", "train": "--steps", "tune": "--generations"}
SMALLER = {"4096": "64", "num_envs=256": "num_envs=16"}


class Block(NamedTuple):
    """A fenced block: language as written, the rest of its first line, and its text."""

    language: str
    options: str
    text: str


def list_pages() -> list[Path]:
    """Return README and all pages under docs that people wrote."""
    made = (ROOT / "docs" / "generated", ROOT / "docs" / "build")
    pages = [page for page in (ROOT / "docs").rglob("*.md") if not any(folder in page.parents for folder in made)]
    return [ROOT / "README.md", *sorted(pages)]


def read_blocks(page: Path) -> list[Block]:
    """Return the fenced blocks of a page."""
    found = FENCE.findall(page.read_text(encoding="utf-8"))
    return [Block(*_split_head(head), text) for _, head, text in found]


def _split_head(head: str) -> tuple[str, str]:
    language, _, options = head.strip().partition(" ")
    return language, options


def list_commands(page: Path) -> list[str]:
    """Return the commands of a page: lines of its blocks without a language, and code within its text."""
    lines = [line for block in read_blocks(page) for line in read_commands(block)]
    text = FENCE.sub("", page.read_text(encoding="utf-8"))
    return [*lines, *(" ".join(command.split()) for command in INLINE.findall(text))]


def read_commands(block: Block) -> list[str]:
    """Return the commands in a block: its lines that begin with a program, without what follows a ``#``."""
    if block.language:
        return []
    lines = [line.partition(" #")[0].strip().removeprefix("$ ") for line in block.text.splitlines()]
    return [line.removeprefix(".venv/bin/") for line in lines if line.removeprefix(".venv/bin/").startswith(COMMANDS)]


def split_command(command: str) -> list[str]:
    """Return the words of a command, with an example in place of each placeholder."""
    return ["corridor" if word == "SCENARIO" else word for word in shlex.split(command)]


def shorten(words: list[str]) -> list[str]:
    """Return a command that shows the same in less time."""
    if words[0] == "break":  # takes seconds, and fewer episodes find no failure that the next command can play
        return words
    short = [SHORTER.get(before, word) for before, word in zip(["", *words], words, strict=False)]
    option = MISSING.get(words[0])
    return [*short, option, SHORTER[option]] if option and option not in words else short


def run_page(page: Path) -> None:
    """Run all blocks of a page in the working folder.

    Raises:
        AssertionError: a command failed.
    """
    from train.cli.main import main

    sys.path.insert(0, ".")
    namespace: dict[str, object] = {"__name__": "__main__"}
    for block in read_blocks(page):
        title = re.search(r"title=(\S+)", block.options)
        if title:
            Path(title.group(1)).write_text(block.text, encoding="utf-8")
        elif block.language == "python" and not all(map(find_spec, block.options.split())):
            print(f"left out, for want of {block.options}", flush=True)
        elif block.language in ("python", "{code-cell}"):
            text = "\n".join(line for line in block.text.splitlines() if not line.startswith(":"))
            for long, short in SMALLER.items():
                text = text.replace(long, short)
            exec(compile(text, str(page), "exec"), namespace)
        elif block.language == "toml":
            tomllib.loads(block.text)
        for command in read_commands(block):
            program, *words = split_command(command)
            if lacking := [NEEDS[word] for word in words if word in NEEDS and find_spec(NEEDS[word]) is None]:
                print(f"left out, for want of {', '.join(lacking)}: {command}", flush=True)
            elif program == "impact" and words[0] not in ATTENDED:
                print(f"$ {command}", flush=True)
                code = main(shorten(words))
                assert code == 0, f"{command}: exit code {code}"


if __name__ == "__main__":
    run_page(Path(sys.argv[1]).absolute())

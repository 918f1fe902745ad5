"""Every command and code block of README and docs: read by the command line (fast), run in an empty folder (slow)."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import tyro

from impact_envs import list_scenarios, load_scenario
from tests.docs.blocks import (
    ATTENDED,
    ROOT,
    list_commands,
    list_pages,
    read_blocks,
    read_commands,
    shorten,
    split_command,
)
from train.cli.main import _parse

PAGES = list_pages()
# Kinds of blocks that are run or read here, and kinds that show what stands elsewhere, which the site's build checks.
RUN = {"", "python", "toml", "{code-cell}"}
SHOWN = {"{toctree}", "{include}", "{literalinclude}", "{eval-rst}", "{warning}"}
TIME_LIMIT = 1500  # of a page [s]; the machine of the tests may be slow and have other work


def name_page(page: Path) -> str:
    return str(page.relative_to(ROOT))


def find_runnable() -> list[Path]:
    languages = ("python", "{code-cell}", "toml")
    return [
        page
        for page in PAGES
        if any(block.language in languages for block in read_blocks(page))
        or any(command.startswith("impact ") for command in list_block_commands(page))
    ]


def list_block_commands(page: Path) -> list[str]:
    return [command for block in read_blocks(page) for command in read_commands(block)]


def list_inline() -> list[str]:
    """Return the impact commands that stand in running text and tables only, each once."""
    inside = {command for page in PAGES for command in list_block_commands(page)}
    every = dict.fromkeys(command for page in PAGES for command in list_commands(page) if command not in inside)
    return [command for command in every if is_whole(command)]


def is_whole(command: str) -> bool:
    """Return whether a command can be typed as it stands, but for SCENARIO: it is no name or part of one."""
    program, *words = split_command(command)
    if program != "impact" or words[0] in ATTENDED or "--help" in words or len(words) < 2 or words[1].startswith("-"):
        return False
    return not any(re.fullmatch(r"[A-Z][A-Z.=|-]*|.*(\.\.\.|…).*|\|", word) for word in words)


@pytest.mark.parametrize("page", PAGES, ids=name_page)
def test_every_block_is_of_a_kind_that_is_run_or_shown(page: Path) -> None:
    assert {block.language for block in read_blocks(page)} <= RUN | SHOWN


@pytest.mark.parametrize("page", PAGES, ids=name_page)
def test_the_command_line_reads_every_command(page: Path) -> None:
    scenarios = set(list_scenarios())
    for command in list_commands(page):
        if command.startswith("impact ") and is_whole(command):
            parsed = vars(_parse(split_command(command)[1:]))
            named = parsed.get("scenarios") or [parsed.get("scenario")]
            for name in (name for name in named if name in scenarios):
                for suite in parsed.get("suite", ()) if isinstance(parsed.get("suite"), tuple) else ():
                    load_scenario(name).suite(suite)
        elif command.startswith("python "):
            check_script(command)
        elif command.startswith("make "):
            target = command.split()[1]
            assert re.search(rf"^{target}:", (ROOT / "Makefile").read_text(), re.MULTILINE), command


def check_script(command: str) -> None:
    """Check that a script or module exists, and that the training script takes the arguments given."""
    words = split_command(command)[1:]
    if words[0] == "-m":
        module = ROOT.joinpath(*words[1].split("."))
        assert module.with_suffix(".py").is_file() or module.is_dir() or "." not in words[1], command
        if words[1] == "train.residual" and "--help" not in words and "..." not in words:
            from train.arguments import Args

            tyro.cli(Args, args=words[2:])
    elif words[0].endswith(".py"):
        assert (ROOT / words[0]).is_file(), command


def test_shortening_keeps_the_words_and_changes_numbers_only() -> None:
    words = ["evaluate", "corridor", "--episodes", "200", "--suite", "all"]
    assert shorten(words) == ["evaluate", "corridor", "--episodes", "1", "--suite", "all"]


@pytest.mark.slow
@pytest.mark.parametrize("page", find_runnable(), ids=name_page)
def test_the_blocks_of_a_page_run(page: Path, tmp_path: Path) -> None:
    run_in(tmp_path, [sys.executable, "-m", "tests.docs.blocks", str(page)])


@pytest.mark.slow
@pytest.mark.parametrize("command", list_inline())
def test_a_command_in_the_text_runs(command: str, tmp_path: Path) -> None:
    run_in(tmp_path, [sys.executable, "-m", "train.cli.main", *shorten(split_command(command)[1:])])


def run_in(folder: Path, command: list[str]) -> None:
    # A window of SDL's dummy driver is shown nowhere, and takes the time that it would be seen.
    environment = {"SDL_VIDEODRIVER": "dummy", **os.environ, "PYTHONPATH": str(ROOT), "MPLBACKEND": "agg"}
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=TIME_LIMIT, check=False
    )
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-4000:]

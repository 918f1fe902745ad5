"""The ``impact reproduce`` command."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, ClassVar

from tyro.conf import Positional, arg

from impact_envs.domain import find_part
from impact_envs.errors import InputError
from impact_envs.file import write_atomically
from impact_envs.scenario import load_scenario
from train.cli.progress import say_written
from train.papers.comparison import compare, write_table
from train.papers.paper import Paper, Play, load_paper


@dataclass
class Command:
    """Put a paper's published numbers beside those computed here, and draw its figures."""

    extras: ClassVar[tuple[str, ...]] = ("plan", "report")
    paper: Annotated[Positional[str], arg(metavar="PAPER")]
    """verhagen, nekoo, van_steen, or the domain's name."""
    figure: Positional[str | None] = None
    """Only this figure, such as fig4; a wrong name lists them."""
    time_limit: float = 60.0
    """Of each plan's solvers [s]."""
    out: Path | None = None
    """Draw the figures into this folder, and write the table there as Markdown."""
    json: bool = False

    def run(self) -> dict[str, Any]:
        """Return one row per published number, and the figures drawn."""
        paper = load_paper(self.paper)
        plays = paper.select(self.figure)
        if not 0.0 < self.time_limit < math.inf:
            raise InputError(f"--time-limit {self.time_limit:g}: must be above 0 s, and finite")
        if self.out is not None:
            if self.out.exists() and not self.out.is_dir():
                raise InputError(f"--out {self.out}: is a file; it takes a folder")
            self.out.mkdir(parents=True, exist_ok=True)
        results, drawn = {}, {}
        for name, play in plays.items():
            plot = self._place_picture(paper, name, play)
            self._announce(name, play)
            results[name] = self._play(play, plot)
            if plot is not None:
                drawn[name] = plot
        rows = compare(paper, results)
        if self.out is not None:
            write_atomically(self.out / f"{paper.name}.md", write_table(rows).encode())
            say_written(self.out / f"{paper.name}.md")
        figures = [
            {"figure": figure, "file": str(drawn[entry.play]), "shows": entry.says}
            for figure, entry in paper.figures.items()
            if entry.play in drawn and self.figure in (None, figure)
        ]
        return {
            "paper": paper.name,
            "title": paper.title,
            "comparison": rows,
            "figures": figures,
            "plays": [{"play": name, "does": play.says, "as": describe_play(play)} for name, play in plays.items()],
        }

    def _announce(self, name: str, play: Play) -> None:
        limit = f", solvers limited to {self.time_limit:g} s" if play.command == "plan" else ""
        print(f"{name}: {describe_play(play)} (about {play.seconds:g} s{limit})", file=sys.stderr, flush=True)

    def _place_picture(self, paper: Paper, name: str, play: Play) -> Path | None:
        """Return where a play is drawn; None without --out, or if no figure shows it."""
        if self.out is None or all(entry.play != name for entry in paper.figures.values()):
            return None
        part = "PLAN_PICTURE" if play.command == "plan" else "PICTURE"
        domain = load_scenario(play.arguments["scenario"]).domain
        return None if find_part("train", domain, part) is None else self.out / f"{paper.name}_{name}.png"

    def _play(self, play: Play, plot: Path | None) -> dict[str, Any]:
        """Return what the command returns."""
        limit = {"time_limit": self.time_limit} if play.command == "plan" else {}
        arguments = {key: tuple(value) if isinstance(value, list) else value for key, value in play.arguments.items()}
        command = import_module(f"train.cli.{play.command}").Command
        return command(**arguments, **limit, plot=plot).run()


def describe_play(play: Play) -> str:
    """Return a play as a user would type it."""
    words = ["impact", play.command, play.arguments["scenario"]]
    for key, value in play.arguments.items():
        if key != "scenario":
            values = value if isinstance(value, list) else [value]
            words += [f"--{key.replace('_', '-')}", *map(str, values)]
    return " ".join(words)

"""The ``impact demo`` command."""

from __future__ import annotations

import json as jsonlib
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from rich.console import Console

from impact_envs.errors import InputError
from train.cli.plan import Command as PlanCommand
from train.cli.progress import say_written
from train.evaluation.folder_lock import lock_folder

SCENARIOS = ("throw_and_catch", "pong")
POLICY = "pong_hard"


@dataclass
class Command:
    """Do the main job in small: plan, evaluate expert and learned policy, write the report."""

    extras: ClassVar[tuple[str, ...]] = ("all",)
    episodes: int = 20
    """Episodes per scenario, suite and policy."""
    out: Path = Path("report")
    """Folder of the report."""
    json: bool = False

    def run(self) -> dict[str, Any]:
        """Return the summary, the plans and the report's path."""
        from train.evaluation.evaluate import evaluate
        from train.report.page import write_report

        if self.episodes < 1:
            raise InputError(f"episodes {self.episodes} is too small; choices: 1, 2, ...")
        policies = ("expert", POLICY, "zero")
        _clear_last_demo(self.out, policies)
        say = Console(stderr=True)
        plans = {}
        for name in SCENARIOS:
            plans[name] = PlanCommand(name).run()
            p = plans[name]
            say.print(
                f"plan of {name}: robustness {p['robustness']:.3f} m, gap {p['gap']:.3g}, "
                f"{len(p['impacts'])} impacts, {p['solve_seconds']:.2f} s"
            )
        say.print(f"{POLICY} was trained on pong under hard; elsewhere it shows how it carries over")
        result = evaluate(
            scenarios=SCENARIOS,
            policies=policies,
            episodes=self.episodes,
            suites=("all", "hard"),
            workers=min(2, os.cpu_count() or 1),
            out=self.out,
        )
        report = write_report(self.out)
        say_written(report)
        return {"plans": plans, "rows": result.rows, "paired": result.paired, "report": str(report)}


def _clear_last_demo(folder: Path, policies: Sequence[str]) -> None:
    """Forget the last demo's episodes: a demo shows the code as it is, so nothing is resumed."""
    if folder.exists() and not folder.is_dir():
        raise InputError(f"--out {folder}: is a file; it takes a folder")
    manifest = folder / "manifest.json"
    if manifest.exists():
        try:
            held = jsonlib.loads(manifest.read_text(encoding="utf-8")).get("policies")
        except (ValueError, AttributeError):
            held = None
        if held != list(policies):
            raise InputError(f"--out {folder}: holds another evaluation; choose another folder")
    if not folder.exists():
        return
    with lock_folder(folder):
        for name in ("rows.jsonl", "manifest.json"):
            (folder / name).unlink(missing_ok=True)

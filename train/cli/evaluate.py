"""The ``impact evaluate`` command."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tyro.conf import Positional

from train.cli.settings import parse_settings
from train.evaluation.case import EVALUATION_SEEDS, make_cases


@dataclass
class Command:
    """Judge policies on the same seeds."""

    scenarios: Positional[tuple[str, ...]]
    """Shipped names or TOML files."""
    policies: tuple[str, ...] = ("expert", "zero")
    """expert, zero, random, variants of the expert, shipped policies or checkpoint folders."""
    episodes: int = 20
    """Episodes per scenario, suite and policy."""
    seed: int = EVALUATION_SEEDS
    """First seed; the episodes take the following ones."""
    suite: tuple[str, ...] = ("nominal",)
    """Mismatch suites."""
    set: tuple[str, ...] = ()
    """Values to change, for example true.restitution=0.5 expert.NAME=VALUE."""
    workers: int = 1
    """Processes."""
    out: Path | None = None
    """Folder of rows, summary and replays; a second call with it resumes."""
    json: bool = False

    def run(self) -> dict[str, Any]:
        """Return the summary's rows and paired differences."""
        from train.evaluation.evaluate import evaluate_cases

        settings = parse_settings(self.set)
        result = evaluate_cases(
            make_cases(self.scenarios, self.suite, settings),
            self.policies,
            self.episodes,
            self.seed,
            self.workers,
            self.out,
        )
        return {"rows": result.rows, "paired": result.paired, "set": settings}

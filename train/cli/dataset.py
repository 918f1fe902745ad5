"""The ``impact dataset`` command."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar

from tyro.conf import Positional, arg

from train.cli.progress import say_written


@dataclass
class Command:
    """Write episodes as a Minari dataset, for learning from what an expert did."""

    extras: ClassVar[tuple[str, ...]] = ("plan", "learn")
    scenario: Annotated[Positional[str], arg(metavar="SCENARIO")]
    """Shipped name or TOML file."""
    episodes: int = 100
    """How many."""
    policy: str = "expert"
    """Who flies, as in impact run."""
    suite: str = "nominal"
    """Mismatch suite of the true world."""
    seed: int = 0
    """Of the first episode; the others follow. Training seeds are below 1,000,000."""
    name: str | None = None
    """Of the dataset; impact_envs/SCENARIO/POLICY-v0 without."""
    out: Path | None = None
    """Folder of Minari's datasets; without, Minari's own (MINARI_DATASETS_PATH)."""
    json: bool = False

    def run(self) -> dict[str, Any]:
        """Return the dataset's name, folder and what is in it."""
        from train.dataset import write_dataset
        from train.evaluation.own_policy import announce

        announce((self.policy,))
        result = write_dataset(self.scenario, self.episodes, self.policy, self.suite, self.seed, self.name, self.out)
        say_written(result["folder"])
        return result

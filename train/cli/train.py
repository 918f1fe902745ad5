"""The ``impact train`` command."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar

from tyro.conf import OmitArgPrefixes

from train.arguments import Args
from train.cli.progress import say_written
from train.cli.seeds import launch_seeds
from train.launch.choice import Launch


@dataclass
class Command:
    """Train a residual on top of the expert."""

    extras: ClassVar[tuple[str, ...]] = ("plan", "learn")
    args: OmitArgPrefixes[Args] = field(default_factory=Args)
    seeds: tuple[int, ...] = ()
    """A run of each of these seeds in OUT/seedN, instead of one of --seed in OUT; a second call goes on with all."""
    launch: OmitArgPrefixes[Launch] = field(default_factory=Launch)
    json: bool = False

    def run(self) -> dict[str, Any]:
        """Return steps, folder, time and the tuning evaluation; a row of each run where there are several."""
        if self.seeds or self.launch != Launch():
            return launch_seeds("train", self.args, self.seeds, self.launch)
        from train.residual import main

        result = main(self.args)
        say_written(result["out"])
        return result
